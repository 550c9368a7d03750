"""Install, update, roll back and uninstall. Each may be ended at any instant and begun again; a version is always there whole.

The running service is seen as systemd sees it: whether it may be stopped, and whether it comes up again.
"""

import json
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from companion.tools.install import versions
from companion.tools.install.layout import (
    COMMAND,
    CREDENTIAL_PREFIX,
    CREDENTIALS,
    CURRENT,
    DATA,
    DROP_IN,
    LOCK,
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
from companion.tools.install.versions import Release, there
from estimator.contracts.errors import BadInput, DecklanderError, Recoverable, in_words

WATCHED_S = 20.0
"""Time for which a restarted service is watched after it reports that it is ready, s."""
_POLL_S = 1.0
_RATES = re.compile(r"(\d+) frames and (\d+) inertial samples a second")


@dataclass(frozen=True, slots=True)
class ServiceState:
    """The service at one instant."""

    active: str
    """ActiveState of systemd: active, inactive, failed, activating..."""
    pid: int
    restarts: int
    status: str
    """The service's own line: phase and rates."""

    @property
    def runs(self) -> bool:
        """True if there is a process, or will be at once."""
        return self.active in ("active", "activating", "reloading", "deactivating")

    @property
    def wanted(self) -> bool:
        """True if it was started and not stopped, even if it failed."""
        return self.runs or self.active == "failed"

    def flows(self) -> tuple[bool, bool]:
        """Return whether frames and inertial samples come."""
        found = _RATES.search(self.status)
        return (False, False) if found is None else (found[1] != "0", found[2] != "0")


def has_manager(machine: Machine) -> bool:
    """Return whether systemd runs the computer, so that services can be started on it."""
    return machine.is_this and machine.exists("/run/systemd/system")


def state(machine: Machine) -> ServiceState | None:
    """Return the state of the service; None where no systemd runs."""
    if not has_manager(machine):
        return None
    done = machine.ask(["systemctl", "show", UNIT_NAME, "--property=ActiveState,MainPID,NRestarts,StatusText"])
    output = dict(line.split("=", 1) for line in done.stdout.splitlines() if "=" in line)
    return ServiceState(
        output.get("ActiveState", "unknown"),
        int(output.get("MainPID") or 0),
        int(output.get("NRestarts") or 0),
        output.get("StatusText", ""),
    )


def running_version(machine: Machine, found: ServiceState) -> str | None:
    """Return the name of the version that the running process was started from; None if there is no such process."""
    words = (machine.read(f"/proc/{found.pid}/cmdline") or b"").decode(errors="replace").split("\0") if found.pid else [""]
    return words[0].removeprefix(f"{PREFIX}/").split("/")[0] if words[0].startswith(f"{PREFIX}/") else None


def refuse_in_flight(machine: Machine, *, on_ground: bool = False) -> None:
    """Refuse to go on while the drone flies, or while a running service cannot say that it does not.

    Args:
        on_ground: the operator sees it stand; counts only where the service does not know.

    Raises:
        Recoverable: it flies, or it is not known whether it does.
    """
    found = state(machine)
    if found is None or not found.runs:
        return
    done = machine.ask([f"{CURRENT}/bin/decklander", "fly", "status", "--json"])
    try:
        flying = json.loads(done.stdout)["flying"] if done.returncode == 0 else None
        why = (
            "the service has no word of the vehicle"
            if done.returncode == 0
            else f"the service does not answer: {_last(done.stderr)}"
        )
    except (ValueError, KeyError, TypeError) as error:
        flying, why = None, f"the service's answer cannot be read: {in_words(error)}"
    if flying:
        raise Recoverable(f"the drone is flying ({found.status or 'no status'}): land it first; nothing was changed")
    if flying is None and not on_ground:
        raise Recoverable(
            f"whether the drone flies is not known ({why}); if you see it stand, add --on-ground, or stop the service first "
            "(systemctl stop decklander)"
        )


def start(machine: Machine, sleep: Callable[[float], None] = time.sleep, seconds: float = WATCHED_S) -> str | None:
    """Start the service again and watch it; return why it does not come up, None if it does.

    It is up when it has reported that it is ready, keeps its process for `seconds`, and has the frames and samples that came
    before.
    """
    before = state(machine)
    try:
        machine.do(["systemctl", "restart", UNIT_NAME])
    except Recoverable as why:
        now = state(machine)
        return f"{why}" + (f" ({now.status})" if now is not None and now.status else "")
    if machine.dry:
        return None
    first = now = state(machine)
    waited = 0.0
    while waited < seconds and now is not None and first is not None:
        if now.active != "active":
            return f"the service is {now.active}" + (f" ({now.status})" if now.status else "")
        if (now.pid, now.restarts) != (first.pid, first.restarts):
            return "the service ended and was started again"
        sleep(_POLL_S)
        waited += _POLL_S
        now = state(machine)
    if before is not None and now is not None and before.active == "active":
        for what, came, comes in zip(("frames", "inertial samples"), before.flows(), now.flows(), strict=True):
            if came and not comes:
                return f"no {what} come, and before they did ({now.status})"
    return None


def _last(text: str) -> str:
    return (text.strip().splitlines() or ["no reason"])[-1].removeprefix("decklander: ")


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


@dataclass(frozen=True, slots=True)
class InstallOptions:
    """Installation options of the user, beside the release."""

    config: Path | None = None
    """Settings to copy."""
    secrets: dict[str, Path] = field(default_factory=dict)
    """Files of secrets by name of the credential."""
    python: str = "/usr/bin/python3"
    packaged: bool = False
    """True if a package owns the unit, the device rules, the users and the command."""
    on_ground: bool = False
    """True if the operator sees the drone stand."""
    sleep: Callable[[float], None] = time.sleep


def install(machine: Machine, release: Release, options: InstallOptions) -> None:
    """Install a release: on a computer that has one, this is an update to it.

    Raises:
        SetupImpossible: the computer cannot run the service.
        BadInput: a file of the user's is wrong, or the release refuses the settings.
        Recoverable: the drone flies, or a step failed; the version that was current still is.
    """
    versions.check_python(machine, options.python)
    refuse_in_flight(machine, on_ground=options.on_ground)
    machine.folder(PREFIX)
    with machine.locked(LOCK):
        old = versions.current(machine)
        keep_settings(machine, options.config)
        keep_secrets(machine, options.secrets, release.files.get(UNIT_NAME, b""))
        _advance(machine, release, options, old)
        if old is None:
            _begin(machine, options)


def update(machine: Machine, release: Release, options: InstallOptions) -> None:
    """Make a release the current version, and return to the one before it if the service does not come up.

    Raises:
        BadInput: nothing is installed, or the release refuses the settings.
        Recoverable: the drone flies, or a step failed; the version that was current still is.
    """
    old = versions.current(machine)
    if old is None:
        raise BadInput("nothing is installed here that could be updated: decklander service install")
    install(machine, release, options)


def _advance(machine: Machine, release: Release, options: InstallOptions, old: str | None) -> None:
    made = versions.make(machine, release, options.python)
    try:
        versions.check(machine, release.name)
    except DecklanderError:
        if made and not machine.dry:
            machine.remove(f"{PREFIX}/{release.name}")
        raise
    _change(machine, release.name, old, options, release.files)
    versions.sweep(machine)


def _change(machine: Machine, name: str, old: str | None, options: InstallOptions, files: dict[str, bytes]) -> None:
    """Turn from one version to another, start the service if it ran, and turn back if it does not come up."""
    found = state(machine)
    wanted = found is not None and found.wanted
    if old == name and (found is None or not wanted or running_version(machine, found) == name):
        place(machine, name, files, packaged=options.packaged)
        machine.say(f"version {name} is current already")
        return
    refuse_in_flight(machine, on_ground=options.on_ground)
    older = versions.previous(machine)
    if old != name:
        versions.turn(machine, name, old)
    place(machine, name, files, packaged=options.packaged)
    fault = start(machine, options.sleep) if wanted else None
    if fault is None:
        ran = "the service runs with it" if wanted else "the service did not run and was left so" if old is not None else "ready"
        if not machine.dry:
            machine.say(f"version {name} is current; {ran}")
        return
    # An update that was ended after its turn has left the version to return to in the other link.
    good, older = (old, older) if old != name else (older, None)
    if good is None:
        raise Recoverable(f"version {name} does not come up: {fault}")
    machine.say(f"version {name} does not come up: {fault}; going back to {good}")
    versions.turn_back(machine, good, older)
    place(machine, good, {}, packaged=options.packaged)
    worse = start(machine, options.sleep)
    raise Recoverable(
        f"version {name} does not come up: {fault}; version {good} is current again and "
        + ("runs" if worse is None else f"does not come up either: {worse}")
    )


def _begin(machine: Machine, options: InstallOptions) -> None:
    enable(machine, packaged=options.packaged)
    if machine.read(SETTINGS) is None and not (machine.dry and options.config is not None):
        machine.say(f"next: decklander start --out {SETTINGS}, then: systemctl start decklander")
    elif not has_manager(machine):
        machine.say(
            "the service starts when this root is booted"
            if not machine.is_this
            else "systemd does not run here: start it by hand"
        )
    elif (fault := start(machine, options.sleep)) is not None:
        raise Recoverable(f"installed, but the service does not come up: {fault} (journalctl -u decklander)")


def roll_back(machine: Machine, options: InstallOptions) -> None:
    """Return to the version before the current one.

    Raises:
        BadInput: there is none, or it refuses the present settings.
        Recoverable: the drone flies, or that version does not come up; the current one still is.
    """
    refuse_in_flight(machine, on_ground=options.on_ground)
    with machine.locked(LOCK):
        old, before = versions.current(machine), versions.previous(machine)
        if old is None or before is None:
            raise BadInput("there is no version to return to: only the last update can be taken back")
        versions.check(machine, before)
        _change(machine, before, old, options, {})


def uninstall(machine: Machine, options: InstallOptions, *, purge: bool) -> None:
    """Remove the service; settings, keys and recordings stay unless they are to be purged.

    Raises:
        Recoverable: the drone flies, or a step failed.
    """
    refuse_in_flight(machine, on_ground=options.on_ground)
    found = state(machine)
    if found is not None and (found.runs or machine.exists(WANTED)):
        machine.do(["systemctl", "disable", "--quiet", "--now", UNIT_NAME])
    machine.remove(WANTED)
    if not options.packaged:
        for target in SYSTEM_FILES.values():
            machine.remove(target)
        if machine.target(COMMAND) == f"{CURRENT}/bin/decklander":
            machine.remove(COMMAND)
    if machine.exists(PREFIX):
        with machine.locked(LOCK):
            machine.remove(CURRENT)
            machine.remove(PREFIX)
    if found is not None:
        machine.do(["systemctl", "daemon-reload"])
    kept = [SETTINGS_FOLDER, DROP_IN, *credentials(machine), *DATA]
    if purge:
        for path in kept:
            machine.remove(path)
        _remove_user(machine)
    elif left := [path for path in kept if machine.exists(path)]:
        machine.say(f"left, since they are yours: {', '.join(left)} (uninstall --purge removes them)")


def _remove_user(machine: Machine) -> None:
    if f"\n{USER}:".encode() in b"\n" + (machine.read("/etc/passwd") or b"") and machine.exists("/usr/sbin/userdel"):
        machine.do(["userdel", USER])
