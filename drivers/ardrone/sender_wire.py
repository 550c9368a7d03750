"""The protocol between a service and its sender: lines of JSON over a stream socket. No I/O.

The service sends words (`pack`), further commands with a deadline (`pack_commands`), REOPEN, and at its end the last word
(`pack_end`). The sender answers each word with its status.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from drivers.ardrone.arbiter import Word
from drivers.ardrone.at import AtCommand, Pcmd, arguments
from estimator.contracts.time import MonoNs

LINE_MAX = 1 << 16
REOPEN = b'{"reopen": true}\n'
"""Open the AT socket again: it then takes this host's present address."""
BUSY = b"busy"
"""The line of a sender that ends at once, as another service, which is alive, flies this drone."""

TextCommand = tuple[str, str]
"""A command as text: its name, and its arguments as they stand after the sequence number."""


@dataclass(frozen=True, slots=True)
class SenderOptions:
    """The options that the service gives its sender at the start."""

    host: str
    at_port: int
    navdata_port: int
    period_s: float
    hold_s: float
    alone: tuple[TextCommand, ...] = ()
    """Sent once the service is gone or silent."""
    again: tuple[TextCommand, ...] = ()
    """Sent when the service is back, or the drone stands: undoes `alone`."""

    def as_json(self) -> str:
        """The text that `of_json` reads."""
        return json.dumps(asdict(self))

    @staticmethod
    def of_json(text: str) -> SenderOptions:
        """The options that `as_json` wrote."""
        given = json.loads(text)
        for name in ("alone", "again"):
            given[name] = tuple((str(command), str(rest)) for command, rest in given[name])
        return SenderOptions(**given)

    @property
    def name(self) -> str:
        """The abstract socket of whoever sends to this drone: one for each user, host and port."""
        return f"\0decklander-sender/{os.getuid()}/{self.host}:{self.at_port}"


@dataclass(frozen=True, slots=True)
class SenderStatus:
    """What a sender has done since it began."""

    sequence: int
    """Number of the newest command."""
    datagrams: int
    errors: int
    late_hovers: int
    """Datagrams in which hover stood for a word that had run out."""


@dataclass(frozen=True, slots=True)
class SenderOrder:
    """One line of the service, taken apart: at most one of the fields is set."""

    word: Word | None = None
    commands: tuple[TextCommand, ...] = ()
    until: MonoNs | None = None
    """The instant until which `commands` may be sent."""
    reopen: bool = False
    end: Word | None = None


def as_text(commands: Sequence[AtCommand]) -> tuple[TextCommand, ...]:
    """Commands as text.

    Raises:
        ValueError: an argument that cannot travel.
    """
    return tuple((command.NAME, arguments(command)) for command in commands)


def pack(word: Word) -> bytes:
    """The line of a word."""
    return json.dumps(_fields(word)).encode() + b"\n"


def pack_end(word: Word) -> bytes:
    """The line that ends the sender, with the last word."""
    return json.dumps({"end": _fields(word)}).encode() + b"\n"


def pack_commands(commands: Sequence[AtCommand], until: MonoNs) -> bytes:
    """The line of further commands, which are dropped after `until`.

    Raises:
        ValueError: an argument that cannot travel.
    """
    return json.dumps({"send": as_text(commands), "until": until}).encode() + b"\n"


def pack_status(status: SenderStatus) -> bytes:
    """The line of a status."""
    return json.dumps([status.sequence, status.datagrams, status.errors, status.late_hovers]).encode() + b"\n"


def order_of(line: bytes) -> SenderOrder:
    """Take a line of the service apart."""
    said = json.loads(line)
    if isinstance(said, list):
        return SenderOrder(word=_word(said))
    if "send" in said:
        return SenderOrder(commands=tuple((str(name), str(rest)) for name, rest in said["send"]), until=MonoNs(said["until"]))
    if "end" in said:
        return SenderOrder(end=_word(said["end"]))
    return SenderOrder(reopen=True)


def status_of(line: bytes) -> SenderStatus:
    """Take a line of the sender apart."""
    return SenderStatus(*json.loads(line))


def _fields(word: Word) -> list[object]:
    p = word.sticks
    sticks = [p.flags, p.roll, p.pitch, p.gaz, p.yaw]
    return [word.until, sticks, word.ref, word.landing, word.watchdog]


def _word(said: list[object]) -> Word:
    until, sticks, *rest = said
    return Word(until, Pcmd(*sticks), *rest)  # type: ignore[arg-type, misc]
