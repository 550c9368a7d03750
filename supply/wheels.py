"""Make the wheels that need no compiler where they are installed: `python -m supply.wheels`, or `make wheels`.

The source archive is made beside them, and the metadata of all are held to what PyPI takes. One wheel for each
architecture that flies, for every glibc from 2.17 on (manylinux_2_17), cross-built by zig's compiler.
Source: PEP 600, Future manylinux platform tags.
"""

import argparse
import os
import re
import shutil
import struct
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

from packaging.metadata import Metadata

from supply import core

ROOT = Path(__file__).parents[1]
ARCHITECTURES = {"x86_64": 62, "aarch64": 183}
"""Each with its number in an ELF file (e_machine)."""
_GLIBC = re.compile(rb"GLIBC_(\d+)\.(\d+)")


class WheelError(Exception):
    """A wheel could not be made, or does not fit its tag; the text gives the reason."""


def make(architecture: str, out: Path) -> Path:
    """Make the wheel for one architecture, check its libraries, and return its file.

    Raises:
        WheelError: it cannot be built, or a library in it is for another machine or a newer glibc than its tag says.
    """
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "wheel", "--no-deps", "--no-build-isolation",
            "--wheel-dir", folder, str(ROOT),
        ]  # fmt: skip
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, env={**os.environ, core.ARCHITECTURE: architecture}
        )
        if done.returncode != 0:
            raise WheelError(f"no wheel for {architecture}: {done.stderr.strip()[-2000:]}")
        (made,) = Path(folder).glob("*.whl")
        with zipfile.ZipFile(made) as wheel:
            for library in core.LIBRARIES:
                check(wheel.read(str(library.file.relative_to(ROOT))), architecture)
        out.mkdir(parents=True, exist_ok=True)
        return made.replace(out / made.name)


def check(library: bytes, architecture: str) -> None:
    """Hold a library to the tag of its wheel.

    Raises:
        WheelError: it is for another machine, needs a newer glibc, or says where it was built.
    """
    (machine,) = struct.unpack_from("<H", library, 18)
    if machine != ARCHITECTURES[architecture]:
        raise WheelError(f"the library for {architecture} is built for ELF machine {machine}, not {ARCHITECTURES[architecture]}")
    if str(ROOT).encode() in library:
        raise WheelError(f"the library for {architecture} holds the folder of its build, {ROOT}")
    newest = max((tuple(map(int, found)) for found in _GLIBC.findall(library)), default=(0, 0))
    if newest > core.GLIBC:
        raise WheelError(f"the library for {architecture} needs glibc {newest[0]}.{newest[1]}, its tag says 2.17")


def make_archive(out: Path) -> Path:
    """Make the source archive, and return its file.

    Raises:
        WheelError: it cannot be made.
    """
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", folder]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise WheelError(f"no source archive: {done.stderr.strip()[-2000:]}")
        (made,) = Path(folder).glob("*.tar.gz")
        return Path(shutil.move(made, out / made.name))


def check_metadata(made: Path) -> None:
    """Hold the metadata of a wheel or a source archive to their specification, as an index does before it takes a file.

    Raises:
        WheelError: a field is missing or wrong, or there is no text that an index can show.
    """
    if made.suffix == ".whl":
        with zipfile.ZipFile(made) as wheel:
            text = wheel.read(next(name for name in wheel.namelist() if name.endswith(".dist-info/METADATA")))
    else:
        with tarfile.open(made) as archive:
            file = archive.extractfile(f"{made.name.removesuffix('.tar.gz')}/PKG-INFO")
            text = b"" if file is None else file.read()
    try:
        found = Metadata.from_email(text, validate=True)
    except ExceptionGroup as why:
        raise WheelError(f"{made.name}: {'; '.join(map(str, why.exceptions))}") from why
    if not (found.description or "").strip() or found.description_content_type != "text/markdown":
        raise WheelError(f"{made.name}: no description in Markdown")
    if not found.summary or not found.license_expression or found.requires_python is None:
        raise WheelError(f"{made.name}: summary, licence or Python's version is missing")
    if not found.project_urls or not (found.author or found.author_email):
        raise WheelError(f"{made.name}: nobody can find the authors or the source by it")


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m supply.wheels", description="Make a wheel for each architecture.")
    parser.add_argument("--out", type=Path, default=Path("dist"))
    args = parser.parse_args()
    try:
        for architecture in ARCHITECTURES:
            _tell(make(architecture, args.out))
        _tell(make_archive(args.out))
    except WheelError as why:
        print(why, file=sys.stderr)
        return 1
    return 0


def _tell(made: Path) -> None:
    check_metadata(made)
    print(f"{made} ({made.stat().st_size / 1e3:.0f} kB)", flush=True)


if __name__ == "__main__":
    sys.exit(main())
