"""Write and read what a service and the sender of its AR.Drone exchange.

A service sends its orders to the sender as lines of JSON over a stream socket; the sender answers each command of a period with
`UP`.
"""

import os
from collections.abc import Sequence

from msgspec import Struct, json

from drivers.ardrone.arbiter import TimedCommand
from drivers.ardrone.at import AtCommand, arguments
from estimator.contracts.time import MonoNs

READ_MAX = 1 << 16
"""Longest piece of the socket's stream that is read at once, bytes."""
UP = b"up"
"""The line of a sender that runs."""
BUSY = b"busy"
"""The line of a sender that ends at once, because another service, which is alive, flies this drone."""
TextCommand = tuple[str, str]
"""A command as text: its name, and its arguments as they follow the sequence number."""


class SenderOptions(Struct, frozen=True):
    """The options that the service gives its sender at the start, as JSON on its command line."""

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

    @property
    def name(self) -> str:
        """The name of the abstract socket of the process that sends to this drone: one for each user, host and port."""
        return f"\0decklander-sender/{os.getuid()}/{self.host}:{self.at_port}"

    @property
    def marked(self) -> str:
        """The name of the abstract socket by which a service marks this drone as the one that it flies."""
        return f"\0decklander-service/{os.getuid()}/{self.host}:{self.at_port}"


class SenderOrder(Struct, frozen=True, omit_defaults=True):
    """One line of the service: at most one of the fields is set, `until` beside `commands`."""

    latest: TimedCommand | None = None
    """The command of the period."""
    commands: tuple[TextCommand, ...] = ()
    """Further commands."""
    until: MonoNs | None = None
    """The instant after which `commands` are dropped."""
    reopen: bool = False
    """Open the AT socket again, which then takes this host's present address."""
    end: TimedCommand | None = None
    """The final command, after which the sender ends."""


def as_text(commands: Sequence[AtCommand]) -> tuple[TextCommand, ...]:
    """Return the commands as text.

    Raises:
        ValueError: an argument cannot be encoded.
    """
    return tuple((command.NAME, arguments(command)) for command in commands)


def pack(order: SenderOrder) -> bytes:
    """Return an order as it is sent."""
    return json.encode(order) + b"\n"


order_of = json.Decoder(SenderOrder).decode
"""Parse a line of the service; raises `msgspec.DecodeError`."""
