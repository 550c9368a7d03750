"""The versions below the prefix: each an environment of its own, one of them current. Turning is one rename."""

import errno
import json
from pathlib import Path, PurePosixPath

from companion.tools.install.layout import COMPLETE, CURRENT, PREFIX, PREVIOUS, SETTINGS, SHARE
from companion.tools.install.machine import Machine
from companion.tools.install.release import Release
from estimator.contracts.errors import BadInput, DecklanderError, Recoverable, SetupImpossible

_NEEDED_BYTES = 900_000_000
"""What an environment takes at its largest, before it is slimmed, with pip's temporary files."""
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
        SetupImpossible: it is of 32 bits, too old, without `venv`, or not there; the text says what helps.
    """
    done = machine.ask([python, "-c", _PROBE])
    words = done.stdout.split()
    if len(words) < 3:
        raise SetupImpossible(f"{python}: no Python here ({(done.stderr.strip() or 'it said nothing').splitlines()[-1]})")
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
    return lines[-1] if lines else "it said nothing"
