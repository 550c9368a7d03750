"""Orders by a switch on the transmitter: the pulse width of one channel in RC_CHANNELS, as the autopilot sends it.

An order is given by a change alone. A switch that stands at "begin" when the service starts, when the link comes back or when the
receiver is found again begins nothing until it is moved away and back. A band must hold for `DEBOUNCE_S`, and between the bands
the switch keeps its position. Lost or implausible input forgets the position. A receiver that loses its transmitter may move the
channel, and the autopilot reports that a second later: an order to fly to the pad waits for an SYS_STATUS after the change in
which the receiver is well.

Source: mavlink.io, common message set: RC_CHANNELS (65), SYS_STATUS (1), MAV_SYS_STATUS_SENSOR_RC_RECEIVER.
"""

from collections import Counter
from collections.abc import Callable

from msgspec import Struct

from companion.base.orders import OperatorOrder
from companion.settings.operator import SwitchOptions
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.rc_channels import RATE_HZ, band_of, pulse_us
from estimator.contracts.time import MonoNs, seconds_between

DEBOUNCE_S = 0.3
"""Time for which a position must be held."""
GAP_S = 1.0
"""The gap between two messages after which it is forgotten."""
_RECEIVER = int(mav.MAV_SYS_STATUS_SENSOR_RC_RECEIVER)
_WAITS = frozenset({OperatorOrder.BEGIN, OperatorOrder.STAY})
"""Orders that fly the vehicle to the pad."""


class SwitchPosition(Struct, frozen=True):
    """The memory of a switch."""

    position: int | None = None
    """Number of the band that it stands in; None while it is not known."""
    next: int | None = None
    """Band that it has been in since `since`, if that is another one."""
    since: MonoNs | None = None
    at: MonoNs | None = None
    """Time of the newest message."""


def moved(before: SwitchPosition, pulse: int | None, now: MonoNs) -> tuple[SwitchPosition, MonoNs | None]:
    """Return the memory after a message, and when the switch was moved to the position that it is in; None if it was not.

    Args:
        pulse: pulse width, microseconds; None where the input is lost.
    """
    if pulse is None:
        return SwitchPosition(), None
    if before.at is not None and not 0.0 <= seconds_between(before.at, now) <= GAP_S:
        before = SwitchPosition()
    band = band_of(pulse)
    if band is None or band == before.position:
        return SwitchPosition(before.position, at=now), None
    if band != before.next or before.since is None:
        return SwitchPosition(before.position, band, now, now), None
    if seconds_between(before.since, now) < DEBOUNCE_S:
        return SwitchPosition(before.position, band, before.since, now), None
    return SwitchPosition(band, at=now), None if before.position is None else before.since


class RcSwitch:
    """The switch of one autopilot's receiver.

    Args:
        order: gives an order, with the time when the switch was moved; returns why it is refused, or None.
    """

    def __init__(self, options: SwitchOptions, order: Callable[[OperatorOrder, MonoNs], str | None]) -> None:
        self._o, self._order = options, order
        self._connects = -1
        self._memory = SwitchPosition()
        self._waiting: tuple[OperatorOrder, MonoNs, MonoNs] | None = None
        """Order that waits for the receiver's health, the time of the message that gave it, and that of the switch's move."""
        self._strength = False
        """True once the receiver's strength was not 0: one that never reports it says nothing by a 0."""
        self.counts: Counter[str] = Counter()

    def counted(self) -> dict[str, float]:
        """Return the numbers of orders and of messages without a pulse, and the position: 1 low, 2 middle, 3 high, 0 unknown."""
        position = 0 if self._memory.position is None else self._memory.position + 1
        return {"orders": self.counts["orders"], "lost": self.counts["lost"], "position": position}

    def on_message(self, autopilot: Autopilot, received: ReceivedMessage) -> None:
        """Take any message of the autopilot's links."""
        m, kind = received.message, received.message.get_type()
        if not autopilot.is_own(received) or autopilot.streams is None:
            return
        autopilot.streams.also("RC_CHANNELS", RATE_HZ)
        if autopilot.connects != self._connects:
            self._connects, self._memory, self._waiting = autopilot.connects, SwitchPosition(), None
        if kind == "SYS_STATUS":
            self._on_status(m, received.received_at)
        elif kind == "RC_CHANNELS":
            self._on_channels(m, received.received_at)

    def _on_status(self, m: Message, now: MonoNs) -> None:
        if m.onboard_control_sensors_enabled & ~m.onboard_control_sensors_health & _RECEIVER:
            self._memory, self._waiting = SwitchPosition(), None
        elif self._waiting is not None and now > self._waiting[1]:
            (order, _, moved_at), self._waiting = self._waiting, None
            self._give(order, moved_at)

    def _on_channels(self, m: Message, now: MonoNs) -> None:
        self._strength |= 0 < m.rssi < 255
        width = None if self._strength and m.rssi == 0 else pulse_us(m, self._o.channel)
        self.counts["lost"] += width is None
        before = self._memory
        self._memory, moved_at = moved(before, width, now)
        if width is None or self._memory.next is not None or moved_at is not None:
            self._waiting = None
        name = (self._o.low, self._o.middle, self._o.high)[self._memory.position or 0]
        if moved_at is None or name == "none":
            return
        order = OperatorOrder(name)
        if order in _WAITS:
            self._waiting = order, now, moved_at
        else:
            self._give(order, moved_at)

    def _give(self, order: OperatorOrder, moved_at: MonoNs) -> None:
        self.counts["orders"] += 1
        self._order(order, moved_at)
