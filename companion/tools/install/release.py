"""The wheel to install: found in a file, in a folder of wheels, built from a checkout, or fetched by its name."""

import hashlib
import json
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote, urlsplit

from estimator.contracts.errors import BadInput, Recoverable

NAME = "decklander"
PINS = "companion/tools/install/runtime.txt"
"""The pinned dependencies in the wheel (`requirements/runtime.txt` of its checkout)."""
SLIM = "companion/tools/install/slim.sh"
_VERSION = re.compile(r"\d+(\.\d+)*([abrc.+-].*)?")


@dataclass(frozen=True, slots=True)
class Release:
    """A wheel of ours."""

    wheel: Path
    version: str
    name: str
    """The name of its folder: the version, and eight digits of the wheel's digest, since a version may be built again."""
    pins: bytes
    """The dependencies by name, version and hash."""
    slim: bytes
    """The script that takes out of an environment what the service does not use."""
    files: dict[str, bytes]
    """The wheel's files in `configs/systemd`, by name."""
    wheels: Path | None
    """The folder that holds the dependencies; None to fetch them from the index."""


def read(wheel: Path, wheels: Path | None = None) -> Release:
    """Read a wheel of ours.

    Raises:
        BadInput: it is none.
    """
    try:
        content = wheel.read_bytes()
        with zipfile.ZipFile(wheel) as archive:
            names = archive.namelist()
            described = next(name for name in names if name.endswith(".dist-info/METADATA"))
            fields = dict(
                line.split(": ", 1) for line in archive.read(described).decode().split("\n\n")[0].splitlines() if ": " in line
            )
            files = {Path(name).name: archive.read(name) for name in names if re.fullmatch(r"configs/systemd/[^/]+", name)}
            pins, slim = archive.read(PINS), archive.read(SLIM)
        if fields["Name"] != NAME:
            raise BadInput(f"{wheel}: a wheel of {fields['Name']}, not of {NAME}")
        version = fields["Version"]
    except OSError as why:
        raise BadInput(f"{wheel}: {why.strerror or why}") from why
    except (zipfile.BadZipFile, StopIteration, KeyError, ValueError) as why:
        raise BadInput(f"{wheel}: not a wheel of {NAME} that can install itself ({why or type(why).__name__})") from why
    digest = hashlib.sha256(content).hexdigest()
    return Release(wheel, version, f"{version}-{digest[:8]}", pins, slim, files, wheels)


@contextmanager
def release(source: str | None, wheels: Path | None) -> Iterator[Release]:
    """Yield the release that the user names; what is made or fetched for it is removed afterwards.

    Args:
        source: a wheel, a folder of wheels, a checkout, a name such as `decklander==0.2.0`, or a version; None for that of this
            very program.
        wheels: a folder with the dependencies.

    Raises:
        BadInput: there is no such file, or it is no wheel of ours.
        Recoverable: it cannot be built or fetched.
    """
    source = own() if source is None else source
    path = Path(source)
    with tempfile.TemporaryDirectory(prefix="decklander-release-") as folder:
        if path.is_dir() and (path / "pyproject.toml").is_file():
            isolation = [] if find_spec("hatchling") is None else ["--no-build-isolation"]
            _pip(
                ["wheel", "--no-deps", *isolation, "--wheel-dir", folder, str(path.resolve())], f"{source}: no wheel can be built"
            )
            yield read(_only(Path(folder)), wheels)
        elif path.is_dir():
            yield read(_only(path), wheels or path)
        elif path.suffix == ".whl":
            yield read(path, wheels)
        else:
            wanted = f"{NAME}=={source}" if _VERSION.fullmatch(source) else source
            if not re.match(rf"{NAME}\b", wanted):
                raise BadInput(
                    f"{source}: no such file or folder, and no version; give a wheel, a folder of wheels, a checkout, or "
                    f"{NAME}==VERSION"
                )
            _pip(["download", "--no-deps", "--only-binary", ":all:", "--dest", folder, wanted], f"{wanted}: not to be fetched")
            yield read(_only(Path(folder)), wheels)


def own() -> str:
    """Return the source of this very program: its wheel, its checkout, or its name and version."""
    for parent in Path(__file__).parents:
        if parent.suffix == ".whl" and parent.is_file():
            return str(parent)
    try:
        distribution = metadata.distribution(NAME)
    except metadata.PackageNotFoundError:
        return str(Path(__file__).parents[2])
    origin = urlsplit(json.loads(distribution.read_text("direct_url.json") or "{}").get("url", ""))
    path = Path(unquote(origin.path))
    return str(path) if origin.scheme == "file" and path.exists() else f"{NAME}=={distribution.version}"


def _only(folder: Path) -> Path:
    """Return the only wheel of ours in a folder.

    Raises:
        BadInput: there is none, or there are several.
    """
    found = sorted(folder.glob(f"{NAME}-*.whl"))
    if len(found) != 1:
        several = ", ".join(path.name for path in found)
        raise BadInput(f"{folder}: " + (f"several wheels of {NAME} ({several}); name one" if found else f"no wheel of {NAME}"))
    return found[0]


def _pip(words: list[str], what: str) -> None:
    command = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        said = done.stderr.strip().splitlines() or ["pip said nothing"]
        raise Recoverable(f"{what}: {said[-1]}")
