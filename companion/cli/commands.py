"""The table of commands: Decklander's own, those of the capabilities that are installed, and those of other packages.

A package offers a command as an entry point of the group `decklander.commands`, under the word that a person types: a
`CommandModule`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

from companion.settings.capabilities import CAPABILITIES, Command
from drivers.extras import is_installed

if TYPE_CHECKING:
    import argparse

PACKAGE_GROUP = "decklander.commands"
_OURS = {
    "demo": Command("see it", "companion.cli.demo", "land a simulated drone on this machine and write a report"),
    "detect": Command("see it", "companion.cli.detect", "find the pad in images, videos or recordings"),
    "report": Command("see it", "companion.cli.report", "write the report of a recorded flight, or compare two"),
    "replay": Command("see it", "companion.cli.replay", "replay a recording through vision and estimator"),
    "record": Command(
        "see it", "companion.cli.record", "show what is in recordings; cut, repair, export, import and upload them"
    ),
    "run": Command("fly", "companion.cli.run", "run the landing service"),
    "fly": Command("fly", "companion.cli.fly", "give orders to the running service, or fly by the keyboard"),
    "start": Command("set up", "companion.cli.start", "make the settings of your drone: asks, writes, checks"),
    "config": Command("set up", "companion.cli.config", "check, show, import or look up settings"),
    "calibrate": Command("set up", "companion.cli.calibrate", "calibrate camera and vehicle"),
    "doctor": Command("set up", "companion.cli.doctor", "diagnose the setup: autopilot, links, camera, broker"),
    "simulate": Command("study", "companion.cli.simulate", "simulate one flight in virtual time"),
    "keys": Command(
        "maintain", "companion.cli.keys", "make, show, install and remove MAVLink signing keys; make the operator page's token"
    ),
    "completion": Command("maintain", "companion.cli.completion", "print the completion of commands for bash, zsh or fish"),
}
OWNERS = {name: capability for capability in CAPABILITIES for name in capability.commands}
"""The capabilities by their commands, whether they are installed or not."""
_INSTALLED = {
    **_OURS,
    **{name: owner.commands[name] for name, owner in OWNERS.items() if is_installed(owner.module)},
}
COMMANDS = {name: command for name, command in _INSTALLED.items() if " " not in name}
"""The commands that are installed, by the word that is typed."""


class CommandModule(Protocol):
    """The port of a command: a module, or whatever has these."""

    DESCRIPTION: str

    def add_arguments(self, parser: argparse.ArgumentParser) -> None: ...

    def run(self, args: argparse.Namespace) -> int:
        """Return the exit code.

        Raises:
            DecklanderError: it cannot be done; the message is printed in one line.
        """
        ...


def by_group() -> Mapping[str, Mapping[str, Command]]:
    """Return the commands by a person's need."""
    groups: dict[str, dict[str, Command]] = {}
    for name, command in COMMANDS.items():
        groups.setdefault(command.group, {})[name] = command
    return groups


def actions_of(command: str) -> Mapping[str, Command]:
    """Return the actions that installed capabilities add to a command of ours, by the word after it."""
    words = ((name.split(), action) for name, action in _INSTALLED.items())
    return {word: action for (first, *rest), action in words for word in rest if first == command}
