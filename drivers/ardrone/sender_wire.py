"""The protocol between a service and its sender: lines of JSON over a stream socket. No I/O.

The service sends its command of each period (`pack`), further commands with a deadline (`pack_commands`), REOPEN, and at its end
the final command (`pack_end`). The sender answers each command of a period with its status.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from drivers.ardrone.arbiter import TimedCommand
from drivers.ardrone.at import AtCommand, Pcmd, arguments
from estimator.contracts.time import MonoNs

LINE_MAX = 1 << 16
REOPEN = b'{"reopen": true}\n'
"""The line that makes the sender open the AT socket again, which then takes this host's present address."""
BUSY = b"busy"
"""The line of a sender that ends at once, because another service, which is alive, flies this drone."""

TextCommand = tuple[str, str]
"""A command as text: its name, and its arguments as they follow the sequence number."""


@dataclass(frozen=True, slots=True)
class SenderOptions:
    """The options that the service gives its sender at the start."""

    host: str
    at_port: int
    navdata_port: int
    period_s: float
    hold_s: float
    climb_m_s: float
    on_service_lost: tuple[TextCommand, ...] = ()
    """The commands that are sent once the service is gone or silent."""
    on_service_back: tuple[TextCommand, ...] = ()
    """The commands that undo `on_service_lost`; they are sent when the service is back, or the drone is on the ground."""
    replaces: bool = False
    """True if an earlier sender of the same service flew the drone, which waits for commands while this one starts."""

    def as_json(self) -> str:
        """Return the text that `of_json` reads."""
        return json.dumps(asdict(self))

    @staticmethod
    def of_json(text: str) -> SenderOptions:
        """Return the options that `as_json` wrote."""
        given = json.loads(text)
        for name in ("on_service_lost", "on_service_back"):
            given[name] = tuple((str(command), str(rest)) for command, rest in given[name])
        return SenderOptions(**given)

    @property
    def name(self) -> str:
        """The name of the abstract socket of the process that sends to this drone: one for each user, host and port."""
        return f"\0decklander-sender/{os.getuid()}/{self.host}:{self.at_port}"

    @property
    def marked(self) -> str:
        """The name of the abstract socket by which a service marks this drone as the one that it flies."""
        return f"\0decklander-service/{os.getuid()}/{self.host}:{self.at_port}"


@dataclass(frozen=True, slots=True)
class SenderStatus:
    """The totals of a sender since it began."""

    sequence: int
    """The sequence number of the newest command."""
    datagrams: int
    errors: int
    late_hovers: int
    """Number of datagrams in which hover replaced an expired command."""


@dataclass(frozen=True, slots=True)
class SenderOrder:
    """One parsed line of the service: at most one of the fields is set."""

    latest: TimedCommand | None = None
    """The command of the period."""
    commands: tuple[TextCommand, ...] = ()
    until: MonoNs | None = None
    """The instant until which `commands` may be sent."""
    reopen: bool = False
    end: TimedCommand | None = None


def as_text(commands: Sequence[AtCommand]) -> tuple[TextCommand, ...]:
    """Return the commands as text.

    Raises:
        ValueError: an argument cannot be encoded.
    """
    return tuple((command.NAME, arguments(command)) for command in commands)


def pack(command: TimedCommand) -> bytes:
    """Return the line of the command of one period."""
    return json.dumps(_fields(command)).encode() + b"\n"


def pack_end(command: TimedCommand) -> bytes:
    """Return the line that ends the sender, with the final command."""
    return json.dumps({"end": _fields(command)}).encode() + b"\n"


def pack_commands(commands: Sequence[AtCommand], until: MonoNs) -> bytes:
    """Return the line of further commands, which are dropped after `until`.

    Raises:
        ValueError: an argument cannot be encoded.
    """
    return json.dumps({"send": as_text(commands), "until": until}).encode() + b"\n"


def pack_status(status: SenderStatus) -> bytes:
    """Return the line of a status."""
    return json.dumps([status.sequence, status.datagrams, status.errors, status.late_hovers]).encode() + b"\n"


def order_of(line: bytes) -> SenderOrder:
    """Parse a line of the service."""
    output = json.loads(line)
    if isinstance(output, list):
        return SenderOrder(latest=_timed_command(output))
    if "send" in output:
        return SenderOrder(commands=tuple((str(name), str(rest)) for name, rest in output["send"]), until=MonoNs(output["until"]))
    if "end" in output:
        return SenderOrder(end=_timed_command(output["end"]))
    return SenderOrder(reopen=True)


def status_of(line: bytes) -> SenderStatus:
    """Parse a line of the sender."""
    return SenderStatus(*json.loads(line))


def _fields(command: TimedCommand) -> list[object]:
    climb = None if command.climb is None else _of_sticks(command.climb)
    return [command.until, _of_sticks(command.sticks), command.ref, command.landing, command.watchdog, climb]


def _timed_command(said: list[Any]) -> TimedCommand:
    until, sticks, ref, landing, watchdog, climb = said
    climbs = None if climb is None else Pcmd(*climb)
    return TimedCommand(until, Pcmd(*sticks), ref, landing, watchdog, climbs)


def _of_sticks(p: Pcmd) -> list[float]:
    return [p.flags, p.roll, p.pitch, p.gaz, p.yaw]
