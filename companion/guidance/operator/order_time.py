"""Orders in time: what ends an order that was given earlier, as a table, and how the times of other clocks meet ours. No I/O.

Every order carries when it was given. One that begins, takes or lands is not carried out if something stopped the vehicle since:
its sender cannot have known. One that gives the sticks back does not give those back that were taken since. A stop is always
carried out, however old it is. What came since counts by when it came here, so a late stop ends what was given before it arrived.
`python -m companion.guidance.operator.order_time` prints the table of docs/operator.md.
"""

import sys
from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType

from msgspec import Struct

from companion.base.orders import OperatorOrder, OrderSender, OrderSource
from estimator.contracts.time import MonoNs, after, seconds_between

_AHEAD_S = 0.2
"""Time by which a sender that counts on from our newest time may be ahead of us, s."""
_IN_ORDER = (OrderSource.PAGE, OrderSource.TERMINAL)
"""Sources whose sender is one connection: its orders come in the order in which they were given, and it knows its own stops."""


UNKNOWN = MonoNs(-1)
"""The time of an order that does not say when it was given: whatever stopped the vehicle came after it."""


def given_at(now: MonoNs, age_s: float | None) -> MonoNs:
    """Return when an order was given, on our clock.

    Args:
        age_s: its age by its sender, s; None if that does not say. One that cannot be counts as that, too.
    """
    return UNKNOWN if age_s is None or not age_s >= -_AHEAD_S else after(now, -max(0.0, age_s))


class Stop(Enum):
    """Something that ends what was ordered before it. The value is its name in the documentation."""

    EMERGENCY = "emergency"
    """A person's order, or the vehicle's own emergency state."""
    ABORT = "abort"
    HOLD = "hold"
    """A person's order, the end of who flew by hand, or a limit."""
    LAND = "land"
    MANUAL = "manual"
    TAKEN = "taken"
    """A pilot's mode or disarm, or a failsafe."""


_ALL = frozenset(Stop)
_BY_ORDER = {OperatorOrder(stop.value): stop for stop in Stop if stop is not Stop.TAKEN}

ENDED_BY: Mapping[OperatorOrder, frozenset[Stop]] = MappingProxyType({
    OperatorOrder.EMERGENCY: frozenset(),
    OperatorOrder.MANUAL: _ALL,
    OperatorOrder.ABORT: frozenset(),
    OperatorOrder.HOLD: frozenset(),
    OperatorOrder.LAND: _ALL - {Stop.LAND},
    OperatorOrder.TAKE_OFF: _ALL,
    OperatorOrder.STAY: _ALL,
    OperatorOrder.BEGIN: _ALL,
    OperatorOrder.RELEASE: frozenset({Stop.MANUAL}),
    OperatorOrder.RESET: frozenset({Stop.EMERGENCY}),
    OperatorOrder.CLEAR: _ALL,
    OperatorOrder.RECORD: frozenset(),
})  # fmt: skip
"""The stops after which each order is not carried out any more, if it was given before them."""
if set(ENDED_BY) != set(OperatorOrder):
    raise ValueError("an order has no row")
BEGINS = frozenset(order for order, stops in ENDED_BY.items() if Stop.HOLD in stops)
"""Orders that begin or take something: a hold ends each of them."""


class _Come(Struct, frozen=True):
    """The newest stop of its kind."""

    at: MonoNs
    by: OrderSender | None
    why: str


class Stops(Struct, frozen=True):
    """The newest stop of each kind."""

    newest: Mapping[Stop, _Come] = MappingProxyType({})

    def on_order(self, order: OperatorOrder, sender: OrderSender, now: MonoNs) -> "Stops":
        """Return the memory after an order that was carried out."""
        stop = _BY_ORDER.get(order)
        return self if stop is None else self.on_stop(stop, now, f'{sender} ordered "{order.value}"', sender)

    def on_stop(self, stop: Stop, now: MonoNs, why: str, by: OrderSender | None = None) -> "Stops":
        """Return the memory after a stop, with its words for the sender of an order that it ends."""
        return Stops({**self.newest, stop: _Come(now, by, why)})

    def since(self, order: OperatorOrder, sender: OrderSender, given: MonoNs, now: MonoNs) -> str | None:
        """Return what ended an order since it was given, in words; None if nothing did."""
        come = [self.newest[stop] for stop in ENDED_BY[order] if stop in self.newest]
        known = sender if sender.source in _IN_ORDER else None
        ended = max((c for c in come if c.at > given and (c.by is None or c.by != known)), key=lambda c: c.at, default=None)
        if ended is None:
            return None
        ago = "at a time that is not known" if given == UNKNOWN else f"{seconds_between(given, now):.1f} s ago"
        return f"it was given {ago}, and since then {ended.why}: give it again"


def markdown() -> str:
    """Return the table as docs/operator.md shows it."""
    lines = ["| order | not carried out if this came after it was given |", "|---|---|"]
    for order, stops in ENDED_BY.items():
        named = ", ".join(stop.value for stop in Stop if stop in stops)
        lines.append(f"| `{order.value}` | {named or 'nothing: it is carried out however late it comes'} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(markdown())
