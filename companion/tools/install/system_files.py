"""What an installation puts outside its own folder: unit, device rules, users, keys, settings, the command's link."""

from __future__ import annotations

import re
from pathlib import Path

from companion.tools.install.layout import (
    COMMAND,
    CREDENTIAL_PREFIX,
    CREDENTIALS,
    CURRENT,
    PACKAGED_UNIT,
    PREFIX,
    SETTINGS,
    SETTINGS_FOLDER,
    SHARE,
    SYSTEM_FILES,
    SYSUSERS,
    UNIT,
    UNIT_NAME,
    USER,
    WANTED,
)
from companion.tools.install.machine import Machine
from companion.tools.install.service import has_manager
from companion.tools.install.versions import there
from estimator.contracts.errors import BadInput

_LOADED = re.compile(rb"^LoadCredential=([^:\n]+):", re.MULTILINE)


def place(machine: Machine, version: str, files: dict[str, bytes], *, packaged: bool) -> None:
    """Put a version's unit, device rules and users in their places, and have the system read them.

    Args:
        files: the version's files, where it is not made yet (in a dry run).
        packaged: a package owns these files; the system reads them all the same.
    """
    for name, target in SYSTEM_FILES.items():
        content = machine.read(f"{PREFIX}/{version}/{SHARE}/{name}") or files.get(name)
        if packaged:
            _give_up(machine, name, target)
        elif content is not None:
            machine.write(target, content)
    if not packaged:
        machine.link(COMMAND, f"{CURRENT}/bin/decklander")
    _make_user(machine, packaged=packaged)
    if has_manager(machine):
        machine.do(["systemctl", "daemon-reload"])
    if machine.is_this and machine.exists("/run/udev/control"):
        machine.do(["udevadm", "control", "--reload"])
        machine.do(["udevadm", "trigger", "--subsystem-match=video4linux", "--subsystem-match=tty", "--action=change"])


def _give_up(machine: Machine, name: str, target: str) -> None:
    """Remove a file of an installation before the package, which would hide the package's own; one that was changed stays."""
    found = machine.read(target)
    if found is not None and found in (machine.read(f"{PREFIX}/{made}/{SHARE}/{name}") for made in there(machine)):
        machine.remove(target)


def _make_user(machine: Machine, *, packaged: bool) -> None:
    if re.search(rf"^{USER}:".encode(), machine.read("/etc/passwd") or b"", re.MULTILINE):
        return
    if machine.exists("/usr/bin/systemd-sysusers") or machine.exists("/bin/systemd-sysusers"):
        machine.do(["systemd-sysusers", *([] if packaged else [SYSUSERS])])
    elif machine.exists("/usr/sbin/useradd"):
        machine.do(
            ["useradd", "--system", "--no-create-home", "--home-dir", "/var/lib/decklander", "--shell", "/usr/sbin/nologin", USER]
        )
    else:
        machine.say(f"there is neither systemd-sysusers nor useradd: the user {USER} is made whenever the service starts")


def keep_secrets(machine: Machine, given: dict[str, Path], unit: bytes) -> None:
    """Put secrets where systemd takes them from, for root alone, and take every right from others on those that are there.

    Args:
        given: files by name of the credential.
        unit: the unit's text.

    Raises:
        BadInput: the unit loads no credential of that name, or a file cannot be read.
    """
    known = [name.decode() for name in _LOADED.findall(unit)]
    for name, file in given.items():
        if name not in known:
            raise BadInput(f"--credential {name}: the unit loads none of that name; it loads {', '.join(known)}")
        try:
            content = file.read_bytes()
        except OSError as why:
            raise BadInput(f"--credential {name}: {file}: {why.strerror or why}") from why
        machine.folder(CREDENTIALS, 0o700)
        machine.write(f"{CREDENTIALS}/{CREDENTIAL_PREFIX}{name}", content, 0o600)
    for path in credentials(machine):
        kept = machine.read(path)
        if kept is not None:
            machine.write(path, kept, 0o600)


def credentials(machine: Machine) -> list[str]:
    """Return the paths of our secrets."""
    return sorted(f"{CREDENTIALS}/{path.name}" for path in machine.path(CREDENTIALS).glob(f"{CREDENTIAL_PREFIX}*"))


def keep_settings(machine: Machine, given: Path | None) -> None:
    """Put the settings in their place; settings that are there are never overwritten.

    Raises:
        BadInput: the file cannot be read, or other settings are there.
    """
    machine.folder(SETTINGS_FOLDER)
    if given is None:
        return
    try:
        content = given.read_bytes()
    except OSError as why:
        raise BadInput(f"--config {given}: {why.strerror or why}") from why
    found = machine.read(SETTINGS)
    if found is None:
        machine.write(SETTINGS, content)
    elif found != content:
        raise BadInput(f"--config {given}: {SETTINGS} is there and differs; it is yours, so change it, or move it away first")


def enable(machine: Machine, *, packaged: bool) -> None:
    """Have the service start with the computer."""
    if not machine.exists("/usr/bin/systemctl") and not machine.exists("/bin/systemctl"):
        machine.say("there is no systemd on this computer: nothing starts or watches the service")
    elif machine.is_this:
        machine.do(["systemctl", "enable", "--quiet", UNIT_NAME])
    else:
        machine.link(WANTED, PACKAGED_UNIT if packaged else UNIT)
