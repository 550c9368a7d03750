"""The orders of people, their senders, and the answer that each order gets."""

import math
import re
import tomllib
from enum import Enum
from pathlib import Path

from msgspec import Struct

from estimator.contracts.time import MonoNs


class OperatorOrder(Enum):
    """An order of a person. `companion.guidance.operator.precedence` says when each is accepted."""

    EMERGENCY = "emergency"
    """Cut the motors at once."""
    MANUAL = "manual"
    """Fly by hand: the sender's sticks command the vehicle."""
    LAND = "land"
    """Land where the vehicle is, with its own means."""
    ABORT = "abort"
    """End the automatic landing and hover."""
    HOLD = "hold"
    """Hover in place until BEGIN."""
    TAKE_OFF = "takeoff"
    """Leave the ground and hover; call off a landing that a person ordered."""
    STAY = "stay"
    """Fly over the pad, wait there at a height and follow the ship; no landing begins by it."""
    BEGIN = "begin"
    """Begin the automatic landing, or resume it."""
    RELEASE = "release"
    """Give the hand back; the vehicle hovers."""
    RESET = "reset"
    """Leave the emergency state; the motors stay off."""
    CLEAR = "clear"
    """Ignore the thing that bars the landing: this one alone, where it is, in this attempt."""
    RECORD = "record"
    """Start or stop recording."""


TWICE_S = {OperatorOrder(name): 2.0 for name in ("takeoff", "land", "reset", "clear")} | {OperatorOrder.EMERGENCY: 1.0}
"""Orders that nothing takes back, and the time in which a second press of a key or a button confirms the first, s."""


class OrderSource(Enum):
    """The way on which an order arrives."""

    GAMEPAD = "gamepad"
    SWITCH = "switch"
    """A switch on the transmitter, as the autopilot reports its channel."""
    HANDOVER = "handover"
    """The end of a mission or a return of the autopilot's own, which may only begin."""
    TERMINAL = "terminal"
    PAGE = "page"
    """The operator page in a browser."""
    MAVLINK = "mavlink"
    MQTT = "mqtt"
    SIGNAL = "signal"
    LIMITS = "limits"
    """The geofence or another limit of `companion.guidance.operator.command_limits`, which may only hold."""


class OrderSender(Struct, frozen=True):
    """One sender of orders; two terminals are two senders."""

    source: OrderSource
    name: str = ""

    def __str__(self) -> str:
        return f"{self.source.value} {self.name}".rstrip()

    def reads(self, text: str) -> str:
        """Return a text as the person at this page or terminal reads it: its sender as "you", the others without numbers.

        A page names its buttons where the text has orders in quotes.
        """
        if self.source is OrderSource.PAGE:
            text = _QUOTED.sub(lambda m: f'"{WORDS["orders"].get(m[1], m[1])}"', text)
        text = text.replace(f"{self} has", "you have").replace(str(self), "you")
        return _NUMBERED.sub(lambda m: f"{'another' if m[1] == self.source.value else 'a'} {m[1]} ", text)


WORDS: dict[str, dict[str, str]] = tomllib.loads(Path(__file__).with_name("words.toml").read_text("utf-8"))
"""The words of a screen by what they are of: `orders`, `phases`, `situations`."""
_QUOTED = re.compile(r'"(\w+)"')
_NUMBERED = re.compile(r"\b(page|terminal) \d+ (?=\()")
"""A page or a terminal by the number of its connection, which no screen shows."""


class HandledOrder(Struct, frozen=True):
    """An order and its answer."""

    at: MonoNs
    sender: OrderSender
    order: OperatorOrder
    refusal: str | None
    """The reason why it was refused; None if it was carried out."""
    detail: str = ""
    """Argument of the order (on or off), or the reason why it was given."""

    @property
    def accepted(self) -> bool:
        return self.refusal is None

    def __str__(self) -> str:
        what = f"{self.order.value} {self.detail}".rstrip()
        return f"{self.sender}: {what}: " + ("accepted" if self.refusal is None else f"refused, {self.refusal}")


class StickPositions(Struct, frozen=True):
    """Positions of the sticks, -1 to 1.

    Raises:
        ValueError: a position is not finite or out of range.
    """

    forward: float = 0.0
    right: float = 0.0
    climb: float = 0.0
    turn: float = 0.0
    """Clockwise from above positive."""

    def __post_init__(self) -> None:
        for name in ("forward", "right", "climb", "turn"):
            value = getattr(self, name)
            if not (math.isfinite(value) and abs(value) <= 1.0):
                raise ValueError(f"a stick's position lies in -1 to 1, got {name} {value!r}")

    @property
    def centred(self) -> bool:
        """True if every stick is centred."""
        return self.forward == self.right == self.climb == self.turn == 0.0


CENTRED = StickPositions()
