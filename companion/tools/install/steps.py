"""Install, update, roll back and uninstall. Each may be ended at any instant and begun again; a version is always there whole."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from companion.tools.install import service, system_files, versions
from companion.tools.install.layout import (
    COMMAND,
    CURRENT,
    DATA,
    DROP_IN,
    LOCK,
    PREFIX,
    SETTINGS,
    SETTINGS_FOLDER,
    SYSTEM_FILES,
    UNIT_NAME,
    USER,
    WANTED,
)
from companion.tools.install.machine import Machine
from companion.tools.install.release import Release
from estimator.contracts.errors import BadInput, DecklanderError, Recoverable


@dataclass(frozen=True, slots=True)
class InstallOptions:
    """What the user asks for beside the release."""

    config: Path | None = None
    """Settings to copy."""
    secrets: dict[str, Path] = field(default_factory=dict)
    """Files of secrets by name of the credential."""
    python: str = "/usr/bin/python3"
    packaged: bool = False
    """Whether a package owns the unit, the device rules, the users and the command."""
    on_ground: bool = False
    """Whether the operator sees the drone stand."""
    sleep: Callable[[float], None] = time.sleep


def install(machine: Machine, release: Release, options: InstallOptions) -> None:
    """Install a release: on a computer that has one, this is an update to it.

    Raises:
        SetupImpossible: the computer cannot run the service.
        BadInput: a file of the user's is wrong, or the release refuses the settings.
        Recoverable: the drone flies, or a step failed; the version that was current still is.
    """
    versions.check_python(machine, options.python)
    service.refuse_in_flight(machine, on_ground=options.on_ground)
    machine.folder(PREFIX)
    with machine.locked(LOCK):
        old = versions.current(machine)
        system_files.keep_settings(machine, options.config)
        system_files.keep_secrets(machine, options.secrets, release.files.get(UNIT_NAME, b""))
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
        raise BadInput("nothing is installed here that could be updated: decklander install")
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
    found = service.state(machine)
    wanted = found is not None and found.wanted
    if old == name and (found is None or not wanted or service.running_version(machine, found) == name):
        system_files.place(machine, name, files, packaged=options.packaged)
        machine.say(f"version {name} is current already")
        return
    service.refuse_in_flight(machine, on_ground=options.on_ground)
    older = versions.previous(machine)
    if old != name:
        versions.turn(machine, name, old)
    system_files.place(machine, name, files, packaged=options.packaged)
    fault = service.start(machine, options.sleep) if wanted else None
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
    system_files.place(machine, good, {}, packaged=options.packaged)
    worse = service.start(machine, options.sleep)
    raise Recoverable(
        f"version {name} does not come up: {fault}; version {good} is current again and "
        + ("runs" if worse is None else f"does not come up either: {worse}")
    )


def _begin(machine: Machine, options: InstallOptions) -> None:
    system_files.enable(machine, packaged=options.packaged)
    if machine.read(SETTINGS) is None and not (machine.dry and options.config is not None):
        machine.say(f"next: write {SETTINGS} (decklander config show raspberry_ardupilot), then: systemctl start decklander")
    elif not service.has_manager(machine):
        machine.say(
            "the service starts when this root is booted"
            if not machine.is_this
            else "systemd does not run here: start it by hand"
        )
    elif (fault := service.start(machine, options.sleep)) is not None:
        raise Recoverable(f"installed, but the service does not come up: {fault} (journalctl -u decklander)")


def roll_back(machine: Machine, options: InstallOptions) -> None:
    """Return to the version before the current one.

    Raises:
        BadInput: there is none, or it refuses the present settings.
        Recoverable: the drone flies, or that version does not come up; the current one still is.
    """
    service.refuse_in_flight(machine, on_ground=options.on_ground)
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
    service.refuse_in_flight(machine, on_ground=options.on_ground)
    found = service.state(machine)
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
    kept = [SETTINGS_FOLDER, DROP_IN, *system_files.credentials(machine), *DATA]
    if purge:
        for path in kept:
            machine.remove(path)
        _remove_user(machine)
    elif left := [path for path in kept if machine.exists(path)]:
        machine.say(f"left, since they are yours: {', '.join(left)} (uninstall --purge removes them)")


def _remove_user(machine: Machine) -> None:
    if f"\n{USER}:".encode() in b"\n" + (machine.read("/etc/passwd") or b"") and machine.exists("/usr/sbin/userdel"):
        machine.do(["userdel", USER])
