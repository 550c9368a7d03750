"""The versions below the prefix: each an environment of its own, one of them current. Turning is one rename.

A version is made of a release, a wheel: found in a file, in a folder of wheels, built from a checkout, or fetched by its name.
"""

import errno
import hashlib
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlsplit

from companion.settings.plain_file import refuse_special, unzipped
from companion.tools.install.layout import COMPLETE, CURRENT, PREFIX, PREVIOUS, SETTINGS, SHARE
from companion.tools.install.machine import Machine
from estimator.contracts.errors import BadInput, DecklanderError, Recoverable, SetupImpossible

NAME = "decklander"
PINS = "companion/tools/install/runtime.txt"
"""The pinned dependencies in the wheel (`requirements/runtime.txt` of its checkout)."""
VIDEO_PINS = "companion/tools/install/video.txt"
"""The same with the extra `video`."""
VIDEO = "-video"
"""The end of the name of a version that has it."""
SLIM = "companion/tools/install/slim.sh"
_READ = re.compile(rf"[^/]+\.dist-info/METADATA|configs/systemd/[^/]+|{PINS}|{VIDEO_PINS}|{SLIM}")
"""The files of the wheel that are read here."""
_WHEEL_MAX, _READ_MAX = 200_000_000, 10_000_000
"""Largest wheel, and most bytes that are read of it."""
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


def read(wheel: Path, wheels: Path | None = None, *, video: bool = False) -> Release:
    """Read a wheel of ours.

    Args:
        wheels: the folder with the dependencies; the extra `video` is installed if it is there.
        video: whether to install it anyway.

    Raises:
        BadInput: it is none.
    """
    video = video or (wheels is not None and any(wheels.glob("av-*.whl")))
    try:
        refuse_special(wheel, str(wheel), _WHEEL_MAX)
        content = wheel.read_bytes()
        found = unzipped(wheel, _READ_MAX, lambda name: _READ.fullmatch(name) is not None)
        described = next(found[name] for name in found if name.endswith("/METADATA")).decode()
        fields = dict(line.split(": ", 1) for line in described.split("\n\n")[0].splitlines() if ": " in line)
        files = {Path(name).name: each for name, each in found.items() if name.startswith("configs/")}
        pins, slim = found[VIDEO_PINS if video else PINS], found[SLIM]
        if fields["Name"] != NAME:
            raise BadInput(f"{wheel}: a wheel of {fields['Name']}, not of {NAME}")
        version = fields["Version"]
    except OSError as why:
        raise BadInput(f"{wheel}: {why.strerror or why}") from why
    except (StopIteration, KeyError, ValueError) as why:
        raise BadInput(f"{wheel}: not a wheel of {NAME} that can install itself ({why or type(why).__name__})") from why
    digest = hashlib.sha256(content).hexdigest()
    return Release(wheel, version, f"{version}-{digest[:8]}{VIDEO if video else ''}", pins, slim, files, wheels)


@contextmanager
def release(source: str | None, wheels: Path | None, *, video: bool = False) -> Iterator[Release]:
    """Yield the release that the user names; what is made or fetched for it is removed afterwards.

    Args:
        source: a wheel, a folder of wheels, a checkout, a name such as `decklander==1.1.0`, or a version; None for that of this
            very program.
        wheels: a folder with the dependencies.
        video: whether to install the extra `video`.

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
            yield read(_only(Path(folder)), wheels, video=video)
        elif path.is_dir():
            yield read(_only(path), wheels or path, video=video)
        elif path.suffix == ".whl":
            yield read(path, wheels, video=video)
        else:
            wanted = f"{NAME}=={source}" if _VERSION.fullmatch(source) else source
            if not re.match(rf"{NAME}\b", wanted):
                raise BadInput(
                    f"{source}: no such file or folder, and no version; give a wheel, a folder of wheels, a checkout, or "
                    f"{NAME}==VERSION"
                )
            _pip(
                ["download", "--no-deps", "--only-binary", ":all:", "--dest", folder, wanted],
                f"{wanted} cannot be fetched; name a wheel or a folder of wheels",
            )
            yield read(_only(Path(folder)), wheels, video=video)


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
    with tempfile.TemporaryDirectory(prefix="decklander-pip-") as folder:
        python = sys.executable
        if find_spec("pip") is None:  # an installed version carries none
            if subprocess.run([python, "-m", "venv", folder], capture_output=True, check=False).returncode != 0:
                raise Recoverable(f"{what}: there is no pip; on Debian: apt install python3-venv")
            python = f"{folder}/bin/python"
        command = [python, "-m", "pip", "--quiet", "--disable-pip-version-check", *words]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        output = done.stderr.strip().splitlines() or ["pip printed nothing"]
        raise Recoverable(f"{what}: {output[-1]}")


_NEEDED_BYTES = 900_000_000
"""Largest size of an environment before it is slimmed, with pip's temporary files."""
_PROBE = "import sys, struct; print(*sys.version_info[:2], 8 * struct.calcsize('P')); import ensurepip, venv"


def current(machine: Machine) -> str | None:
    """Return the name of the current version; None if none is complete."""
    return _named(machine, CURRENT)


def previous(machine: Machine) -> str | None:
    """Return the name of the version before; None if there is none to return to."""
    found = _named(machine, PREVIOUS)
    return None if found == current(machine) else found


def _named(machine: Machine, link: str) -> str | None:
    target = machine.target(link)
    name = None if target is None else PurePosixPath(target).name
    return name if name is not None and is_complete(machine, name) else None


def is_complete(machine: Machine, name: str) -> bool:
    """Return whether a version was made to its end."""
    return machine.read(f"{PREFIX}/{name}/{COMPLETE}") is not None


def there(machine: Machine) -> list[str]:
    """Return the names of the folders of versions, complete or not."""
    folder = machine.path(PREFIX)
    return sorted(path.name for path in folder.iterdir() if path.is_dir() and not path.is_symlink()) if folder.is_dir() else []


def check_python(machine: Machine, python: str) -> None:
    """Refuse a computer whose Python cannot run the service.

    Raises:
        SetupImpossible: it is of 32 bits, too old, without `venv`, or not there; the text names the cure.
    """
    done = machine.ask([python, "-c", _PROBE])
    words = done.stdout.split()
    if len(words) < 3:
        raise SetupImpossible(f"{python}: no Python here ({(done.stderr.strip() or 'it printed nothing').splitlines()[-1]})")
    major, minor, bits = map(int, words[:3])
    if bits != 64:
        raise SetupImpossible(
            f"{python} is a {bits}-bit Python; decklander needs a 64-bit operating system "
            "(on a Raspberry Pi 3 or newer write Raspberry Pi OS (64-bit) to the card; a 64-bit kernel alone is not enough)"
        )
    if (major, minor) < (3, 11):
        raise SetupImpossible(f"{python} is Python {major}.{minor}; decklander needs 3.11 or newer (--python names another)")
    if done.returncode != 0:
        raise SetupImpossible(f"{python} cannot make environments; on Debian: apt install python3-venv")


def make(machine: Machine, release: Release, python: str) -> bool:
    """Make the environment of a release beside the others, unless it is there; return whether it was made.

    A failure leaves nothing of it; what a killed run left is made again from the beginning.

    Raises:
        Recoverable: there is no room, or a package cannot be had.
    """
    folder = f"{PREFIX}/{release.name}"
    if is_complete(machine, release.name):
        return False
    machine.remove(folder)
    free = machine.free_bytes(PREFIX)
    if free < _NEEDED_BYTES:
        raise Recoverable(
            f"{PREFIX}: {free / 1e6:.0f} MB are free, a version needs {_NEEDED_BYTES / 1e6:.0f} MB while it is made"
        )
    try:
        machine.do([python, "-m", "venv", folder])
        _fill(machine, release, folder)
        machine.sync()
        machine.write(f"{folder}/{COMPLETE}", json.dumps({"version": release.version, "name": release.name}).encode() + b"\n")
        machine.sync()
    except (DecklanderError, OSError) as why:
        machine.remove(folder)
        if isinstance(why, OSError):
            text = "the disk is full" if why.errno == errno.ENOSPC else why.strerror or str(why)
            raise Recoverable(f"{folder}: {text}") from why
        raise
    return True


def _fill(machine: Machine, release: Release, folder: str) -> None:
    machine.write(f"{folder}/{SHARE}/runtime.txt", release.pins)
    machine.write(f"{folder}/{SHARE}/slim.sh", release.slim)
    for name, content in release.files.items():
        machine.write(f"{folder}/{SHARE}/{name}", content)
    wheel = _lend(machine, folder, release.wheel)
    where = [] if release.wheels is None else ["--no-index", "-f", _lend(machine, folder, release.wheels)]
    pip = [f"{folder}/bin/python", "-m", "pip", "--quiet", "--disable-pip-version-check", "install", "--no-cache-dir"]
    machine.do([*pip, *where, "--only-binary", ":all:", "--require-hashes", "-r", f"{folder}/{SHARE}/runtime.txt"])
    machine.do([*pip, "--no-index", "--no-deps", wheel])
    machine.remove(f"{folder}/lent")
    machine.do(["sh", f"{folder}/{SHARE}/slim.sh", folder])


def _lend(machine: Machine, folder: str, path: Path) -> str:
    """Return the name by which the computer finds a file or folder of wheels; a bare root gets a copy."""
    if machine.is_this:
        return str(path.resolve())
    lent = f"{folder}/lent/{path.name}"
    machine.copy(path, lent)
    return lent


def check(machine: Machine, name: str) -> None:
    """Check that a version starts, and that it takes the present settings, if there are any.

    Raises:
        Recoverable: it does not start.
        BadInput: it refuses the settings; the text has its reason.
    """
    command = f"{PREFIX}/{name}/bin/decklander"
    if machine.dry and not is_complete(machine, name):
        machine.say(f"would run {command} config check {SETTINGS}")
        return
    done = machine.ask([command, "--version"])
    if done.returncode != 0:
        raise Recoverable(f"version {name} does not start: {_last(done.stderr)}")
    if machine.read(SETTINGS) is None:
        return
    done = machine.ask([command, "config", "check", SETTINGS])
    if done.returncode != 0:
        raise BadInput(f"version {name} refuses the present settings: {_last(done.stderr).removeprefix('decklander: ')}")
    for line in done.stdout.splitlines():
        machine.say(line)


def turn(machine: Machine, name: str, before: str | None) -> None:
    """Make a version the current one, after the one to return to is remembered."""
    if before is not None:
        machine.link(PREVIOUS, before)
    machine.link(CURRENT, name)
    machine.sync()


def turn_back(machine: Machine, name: str, before: str | None) -> None:
    """Make a version the current one again, and only then remember the one that was before it."""
    machine.link(CURRENT, name)
    if before is None:
        machine.remove(PREVIOUS)
    else:
        machine.link(PREVIOUS, before)
    machine.sync()


def sweep(machine: Machine) -> None:
    """Remove every version but the current one and the one before."""
    kept = {current(machine), previous(machine)}
    for name in there(machine):
        if name not in kept:
            machine.remove(f"{PREFIX}/{name}")


def _last(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1] if lines else "it printed nothing"
