"""The messages of the service's local socket: one JSON object a line, requests in, answers and states out. No I/O."""

from collections import deque
from typing import Annotated, TypeVar

import msgspec
from msgspec import Meta, Struct

from companion.base.orders import OperatorOrder, StickPositions
from estimator.contracts.time import MonoNs, seconds_between

T = TypeVar("T")
LINE_MAX = 1024
"""The longest line, bytes."""
_Stick = Annotated[float, Meta(ge=-1.0, le=1.0)]


class OrderRequest(Struct, frozen=True, kw_only=True, tag_field="kind", tag="order", forbid_unknown_fields=True):
    """Give an order; it is answered by an `OrderAnswer` with the same number."""

    number: Annotated[int, Meta(ge=0, le=1 << 53)]
    order: OperatorOrder
    seen_at_s: float | None = None
    """`at_s` of the newest state that the sender's screen showed; null if it shows none."""
    age_s: float = 0.0
    """Time since it was given, where a program of this computer passes it on."""


class SticksRequest(Struct, frozen=True, kw_only=True, tag_field="kind", tag="sticks", forbid_unknown_fields=True):
    """The present positions of the sticks, -1 to 1; without an answer."""

    forward: _Stick = 0.0
    right: _Stick = 0.0
    climb: _Stick = 0.0
    turn: _Stick = 0.0

    @property
    def positions(self) -> StickPositions:
        """The positions as the arbiter takes them."""
        return StickPositions(self.forward, self.right, self.climb, self.turn)


class WatchRequest(Struct, frozen=True, kw_only=True, tag_field="kind", tag="watch", forbid_unknown_fields=True):
    """Send the state now and then several times a second."""


Request = OrderRequest | SticksRequest | WatchRequest


class OrderAnswer(Struct, frozen=True, kw_only=True, tag_field="kind", tag="answer"):
    """The answer to an order."""

    number: int
    accepted: bool
    text: str


class FlightState(Struct, frozen=True, kw_only=True, tag_field="kind", tag="state"):
    """The state of the flight for a person; unknown values are null."""

    situation: str
    phase: str
    reason: str
    hand: str | None
    """The sender that flies by hand."""
    yours: bool = False
    """True if the receiver of this message has the hand."""
    hand_taken: str = ""
    """Reason why the receiver has lost the hand since its last order; empty if it has not."""
    flying: bool | None
    mode: str | None
    battery_fraction: float | None
    height_m: float | None
    """Height above the pad, or above what is below if the pad is not known well enough."""
    lateral_m: float | None
    """Horizontal distance from the pad."""
    below: str = ""
    """The place at which a landing that is ordered now would end, by the estimate, in words."""
    over_pad: bool = False
    """True if that is surely on the pad."""
    bars: str = ""
    """The thing that bars the landing, in words; empty if nothing does."""


class RequestRefused(Struct, frozen=True, kw_only=True, tag_field="kind", tag="refused"):
    """A line that is no request; the connection is closed after it."""

    text: str


Answer = OrderAnswer | FlightState | RequestRefused

_requests: msgspec.json.Decoder[Request] = msgspec.json.Decoder(Request)
_answers: msgspec.json.Decoder[Answer] = msgspec.json.Decoder(Answer)
_encode = msgspec.json.Encoder().encode


def read(decoder: msgspec.json.Decoder[T], data: bytes | str) -> T | str:
    """Return what a peer's message says, or the reason why it is none, in words. Never raises."""
    try:
        return decoder.decode(data)
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as why:
        return str(why)[:200]


class RequestRate:
    """The requests of one peer, which a service bounds.

    Args:
        most: the most that are allowed in a second.
    """

    def __init__(self, most: int) -> None:
        self._recent: deque[MonoNs] = deque(maxlen=most)

    def exceeded(self, now: MonoNs) -> bool:
        """Take note of a request; return whether there were more than are allowed in the last second."""
        exceeded = len(self._recent) == self._recent.maxlen and seconds_between(self._recent[0], now) < 1.0
        self._recent.append(now)
        return exceeded


def request_of(line: bytes) -> Request | str:
    """Return the request in a line, or the reason why it is none. Never raises."""
    return read(_requests, line)


def answer_of(line: bytes) -> Answer | None:
    """Return the answer in a line of the service, or None if it is none."""
    found = read(_answers, line)
    return None if isinstance(found, str) else found


def line_of(message: Request | Answer) -> bytes:
    """Return the line of a message."""
    return _encode(message) + b"\n"
