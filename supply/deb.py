"""Make a Debian package that carries every wheel the service needs: `python -m supply.deb`, or `make deb`.

The package holds the wheels, not an environment: unpacking it touches nothing that runs. Its scripts make an environment beside
the one that runs and turn a link (docs/decisions/debian-package.md). Two builds of one commit give the same bytes where
SOURCE_DATE_EPOCH is the same; `make deb` takes the commit's.

Sources: Debian Policy 4.6, chapters 3, 5, 6 and 9; the specification of reproducible builds, SOURCE_DATE_EPOCH.
"""

import argparse
import gzip
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap
from datetime import UTC, datetime
from email.utils import format_datetime
from pathlib import Path
from typing import NamedTuple

from companion.cli.commands import COMMANDS
from supply import wheels

ROOT = wheels.ROOT
PINS = ROOT / "requirements/video.txt"
SHIP_PINS = PINS.with_name("ship.txt")
"""An AR.Drone is landed without fetching anything."""

ARCHITECTURES = {"x86_64": "amd64", "aarch64": "arm64"}
"""Debian's names of the architectures. There is no 32-bit one: dpkg refuses the package there."""


class System(NamedTuple):
    """A system that a package is for."""

    codename: str
    """The name of the release by which its mirror has it."""
    python: tuple[int, int]
    glibc: int
    """The minor version of its glibc 2."""
    title: str


SYSTEMS = {
    "debian12": System("bookworm", (3, 11), 36, "Debian 12, Raspberry Pi OS 12"),
    "debian13": System("trixie", (3, 13), 41, "Debian 13, Raspberry Pi OS 13"),
    "ubuntu24.04": System("noble", (3, 12), 39, "Ubuntu 24.04"),
}
"""The systems, by the mark in a package's version; Raspberry Pi OS of 64 bits is Debian's."""
CARRIED = "usr/share/decklander/wheels"
SLIM = "usr/share/decklander/slim.sh"
SYSTEM_FILES = {
    "decklander.service": "usr/lib/systemd/system/decklander.service",
    "70-decklander.rules": "usr/lib/udev/rules.d/70-decklander.rules",
    "decklander.sysusers.conf": "usr/lib/sysusers.d/decklander.conf",
}
DESCRIPTION = "land a quadcopter on a small helipad on a moving ship"
_DOC = "usr/share/doc/decklander"

MAINTAINER = "Decklander developers <decklander@users.noreply.github.com>"
PREFIX = "/opt/decklander"
"""Holds a folder for each version, and the link `current` to the one that runs."""
SETTINGS = "/etc/decklander/rig.toml"
PURGED = (
    "/etc/decklander /etc/systemd/system/decklander.service.d /etc/credstore/decklander.* /opt/decklander"
    " /var/lib/decklander /var/lib/private/decklander /var/cache/decklander /var/cache/private/decklander"
)
"""Settings, secrets, recordings and caches; systemd keeps the state of the service below `private`, with a link beside it."""


class PackageError(Exception):
    """The package could not be made; the text gives the reason."""


def fetch(system: System, architecture: str, into: Path) -> None:
    """Fetch the pinned wheels for a system's Python on an architecture.

    Raises:
        PackageError: one cannot be had.
    """
    abi = "cp{}{}".format(*system.python)
    minors = range(system.glibc, 4, -1)
    platforms = [*(f"manylinux_2_{minor}_{architecture}" for minor in minors), f"manylinux2014_{architecture}"]
    command = [
        sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "download", "--dest", str(into), "--no-deps",
        "--only-binary", ":all:", "--require-hashes", "-r", str(PINS), "-r", str(SHIP_PINS), "--implementation", "cp",
        "--python-version", ".".join(map(str, system.python)),
        *(word for name in (abi, "abi3", "none") for word in ("--abi", name)),
        *(word for name in platforms for word in ("--platform", name)),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise PackageError(f"the wheels for {architecture} cannot be had: {done.stderr.strip().splitlines()[-1:]}")


def bill() -> bytes:
    """Return the bill of materials of the wheels that the package carries, as CycloneDX JSON.

    Raises:
        PackageError: cyclonedx-py is not there, or refuses the pins.
    """
    project = str(ROOT / "pyproject.toml")
    command = [sys.executable, "-m", "cyclonedx_py", "requirements", "--pyproject", project, "--output-reproducible", "-"]
    pins = [pin for path in (PINS, SHIP_PINS) for pin in re.split(r"\n(?=\w)", path.read_text())]
    unique = {pin.partition("==")[0]: pin.strip() for pin in pins}
    done = subprocess.run(command, input="\n".join(unique.values()).encode(), capture_output=True, check=False)
    if done.returncode != 0:
        raise PackageError(f"no bill of materials: {done.stderr.decode().strip().splitlines()[-1:]}")
    return done.stdout


def stage(folder: Path, name: str, architecture: str, carried: Path, bill: bytes) -> None:
    """Lay out the package's files.

    Args:
        folder: an empty folder.
        name: of the system, one of `SYSTEMS`.
        carried: the folder of the wheels, ours among them.
        bill: the bill of materials.

    Raises:
        PackageError: there is not one wheel of ours.
    """
    own = sorted(carried.glob("decklander-*.whl"))
    if len(own) != 1:
        raise PackageError(f"{carried}: {len(own)} wheels of decklander, want one")
    version = own[0].name.split("-")[1]
    major, minor = SYSTEMS[name].python
    marked = f"{debian_version(version)}{'.' if '+' in version else '+'}{name}"
    dated = {"version": marked, "codename": SYSTEMS[name].codename, "maintainer": MAINTAINER, "date": _date()}
    for file in sorted(carried.glob("*.whl")):
        _put(folder / CARRIED / file.name, file.read_bytes())
    for name, target in SYSTEM_FILES.items():
        _put(folder / target, (ROOT / "configs/systemd" / name).read_bytes())
    (folder / "usr/bin").mkdir(parents=True)
    (folder / SETTINGS.lstrip("/")).parent.mkdir(parents=True)
    (folder / "usr/bin/decklander").symlink_to(f"{PREFIX}/current/bin/decklander")
    _put(folder / SLIM, (ROOT / "requirements/slim.sh").read_bytes())
    _put(folder / _DOC / "copyright", copyright_file((ROOT / "docs/licences.md").read_text()).encode())
    _put(folder / _DOC / "CHANGELOG.md.gz", _gzipped((ROOT / "CHANGELOG.md").read_bytes()))
    _put(folder / _DOC / "changelog.gz", _gzipped(filled("changelog", dated)))
    _put(folder / "usr/share/man/man1/decklander.1.gz", _gzipped(manual(version).encode()))
    _put(folder / _DOC / "sbom.cdx.json.gz", _gzipped(bill))
    # A version may be built twice: the digest keeps the two apart.
    words = {
        "prefix": PREFIX, "name": f"{version}-{hashlib.sha256(own[0].read_bytes()).hexdigest()[:8]}", "carried": CARRIED,
        "slim": SLIM, "settings": SETTINGS, "purged": PURGED,
    }  # fmt: skip
    for script in ("postinst", "prerm", "postrm"):
        _put(folder / "DEBIAN" / script, filled(script, words), 0o755)
    size_kb = sum(-(-path.stat().st_size // 1024) for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    words |= dated | {
        "architecture": ARCHITECTURES[architecture], "size_kb": f"{size_kb}",
        "python": f"{major}.{minor}", "next_python": f"{major}.{minor + 1}",
    }  # fmt: skip
    _put(folder / "DEBIAN/control", filled("control", words))
    sums = subprocess.run(
        ["sh", "-c", "find * -path DEBIAN -prune -o -type f -print0 | LC_ALL=C sort -z | xargs -0 md5sum"],
        cwd=folder, capture_output=True, check=True,
    ).stdout  # fmt: skip
    _put(folder / "DEBIAN/md5sums", sums)


def filled(name: str, words: dict[str, str]) -> bytes:
    """Return a file of supply/debian with its @words@ filled in."""
    text = (ROOT / "supply/debian" / name).read_text(encoding="utf-8")
    return re.sub("@([a-z_]+)@", lambda word: words[word[1]], text).encode()


def copyright_file(licences: str) -> str:
    """Return the package's copyright file in Debian's machine-readable form 1.0: ours, then each wheel that it carries.

    Args:
        licences: the text of docs/licences.md.
    """
    blocks = [
        "Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/\nUpstream-Name: decklander",
        "Files: *\nCopyright: 2026 the Decklander developers\nLicense: Apache-2.0\n On Debian systems the full text is in"
        " /usr/share/common-licenses/Apache-2.0.",
    ]
    held, _, shipped = licences.partition("\n## The service\n")
    for name, version, licence in sorted(_rows(shipped.partition("\n## The extra `report`")[0])):
        stem = re.sub(r"[-.]+", "_", name)
        # A licence's short name has no spaces there.
        terms = licence.replace(" ", "-") if "License" in licence else licence.replace(" AND ", " and ").replace(" OR ", " or ")
        also = "".join(
            "\n" + textwrap.indent(_filled(f"The wheel also holds {what}, under {under}."), " ")
            for what, under, where in _rows(held)
            if where == f"in the wheel of {name}"
        )
        blocks.append(
            f"Files: {CARRIED}/{stem}-*\nCopyright: 2026 and before, the authors of {name}\nLicense: {terms}\n"
            f" The text is in the wheel itself, below {stem}-{version}.dist-info.{also}"
        )
    return "\n\n".join(blocks) + "\n"


def _rows(tables: str) -> list[tuple[str, str, str]]:
    """Return the rows of Markdown's tables of three columns, without their heads."""
    rows = re.findall(r"^\| (\S.*?) +\| (\S.*?) +\| (\S.*?) +\|$", tables, re.MULTILINE)
    return [row for row in rows if row[0] not in ("Name", "what")]


def _filled(text: str) -> str:
    return textwrap.fill(text, 76, break_on_hyphens=False)


def debian_version(version: str) -> str:
    """Return a version of Python's packages as dpkg sorts it: 1.1.0.dev7, a step on the way to 1.1.0, is 1.1.0~dev7."""
    return re.sub(r"\.?(a|b|rc|dev)(?=\d)", r"~\1", version, count=1)


def manual(version: str) -> str:
    """Return the manual page of the command: the commands with one line each, and where the rest is."""
    commands = "\n".join(f".TP\n.B {name}\n{one.summary[0].upper()}{one.summary[1:]}." for name, one in COMMANDS.items())
    return (
        f'.TH DECKLANDER 1 "" "decklander {version}"\n.SH NAME\ndecklander \\- {DESCRIPTION}\n'
        ".SH SYNOPSIS\n.B decklander\n.I COMMAND\n[\\fIOPTIONS\\fR]\n.SH DESCRIPTION\n"
        "Each command explains its options with\n.BR \\-\\-help .\n"
        f".SH COMMANDS\n{commands}\n.SH EXIT STATUS\n"
        "0: done; 1: it did not reach its goal; 2: wrong use or bad input, with one line that says what.\n"
        ".SH FILES\n.TP\n.I /etc/decklander/rig.toml\nThe settings of the service.\n"
        ".TP\n.I /etc/credstore/decklander.*\nIts secrets.\n.TP\n.I /var/lib/decklander\nRecordings and waiting events.\n"
    )


def _date() -> str:
    return format_datetime(datetime.fromtimestamp(int(os.environ.get("SOURCE_DATE_EPOCH", "0")), UTC))


def _put(path: Path, content: bytes, mode: int = 0o644) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    path.chmod(mode)


def _gzipped(content: bytes) -> bytes:
    return gzip.compress(content, 9, mtime=0)


def build(folder: Path, out: Path, architecture: str) -> Path:
    """Pack laid-out files, and return the package.

    Raises:
        PackageError: dpkg-deb refuses them, or is not there.
    """
    version = next(line.split()[1] for line in (folder / "DEBIAN/control").read_text().splitlines() if line.startswith("Version"))
    made = out / f"decklander_{version}_{ARCHITECTURES[architecture]}.deb"
    out.mkdir(parents=True, exist_ok=True)
    for path in [folder, *folder.rglob("*")]:
        if path.is_dir():
            path.chmod(0o755)
    # Wheels are compressed already: a better compression takes minutes and saves nothing.
    command = ["dpkg-deb", "--root-owner-group", "-Zgzip", "-z1", "--build", str(folder), str(made)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError as why:
        raise PackageError("a Debian package needs dpkg-deb (Debian: apt install dpkg)") from why
    if done.returncode != 0:
        raise PackageError(f"dpkg-deb: {done.stderr.strip()}")
    return made


def _made(name: str, architecture: str, given: Path | None, out: Path) -> Path:
    """Make the package for a system, with the wheels of a folder or fetched ones, and return it."""
    with tempfile.TemporaryDirectory() as work:
        carried, folder = Path(work, "wheels"), Path(work, "package")
        folder.mkdir()
        if given is None:
            fetch(SYSTEMS[name], architecture, carried)
        else:
            shutil.copytree(given, carried, ignore=shutil.ignore_patterns("decklander-*"))
        wheels.make(architecture, carried)
        stage(folder, name, architecture, carried, bill())
        return build(folder, out, architecture)


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m supply.deb", description="Make a Debian package.")
    parser.add_argument("--out", type=Path, default=Path("dist"))
    parser.add_argument("--system", choices=SYSTEMS, nargs="+", default=list(SYSTEMS), help="the systems to make one for (all)")
    parser.add_argument("--architecture", choices=ARCHITECTURES, default=os.uname().machine)
    parser.add_argument("--wheels", type=Path, help="folder with the pinned wheels, in place of fetching them")
    args = parser.parse_args()
    try:
        for name in args.system:
            made = _made(name, args.architecture, args.wheels, args.out)
            print(f"{made} ({made.stat().st_size / 1e6:.0f} MB): {SYSTEMS[name].title}")
    except (PackageError, wheels.WheelError) as why:
        print(why, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
