"""Orders by a switch on the transmitter: the pulse width of one channel in RC_CHANNELS, as the autopilot sends it.

An order is given by a change alone. A switch that stands at "begin" when the service starts, when the link comes back or when the
receiver is found again begins nothing until it is moved away and back. A band must hold for `DEBOUNCE_S`, and between the bands
the switch keeps its position. Lost or implausible input forgets the position. A receiver that loses its transmitter may move the
channel, and the autopilot reports that a second later: an order to fly to the pad waits for an SYS_STATUS after the change in
which the receiver is well.

Source: mavlink.io, common message set: RC_CHANNELS (65), SYS_STATUS (1), MAV_SYS_STATUS_SENSOR_RC_RECEIVER.
"""

from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import NoReturn

from msgspec import Struct

from companion.base.orders import OperatorOrder
from companion.settings.operator import SwitchOptions
from drivers.mavlink.access import AccessLevel
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.requests import Streams
from drivers.reconnect import running_beside
from estimator.contracts.time import Clock, MonoNs, seconds_between

DEBOUNCE_S, GAP_S = 0.3, 1.0
"""Time for which a position must be held, and the gap between two messages after which it is forgotten, s."""
BANDS_US = ((800, 1300), (1400, 1600), (1700, 2200))
"""Pulse widths of the low, the middle and the high position, microseconds."""
_THROTTLE_LOST_US = 950
"""Throttle at or below which a receiver says by it that its transmitter is lost: autopilots take 975 and less for that."""
_RATE_HZ, _TICK_S = 10.0, 0.1
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


def moved(before: SwitchPosition, pulse_us: int | None, now: MonoNs) -> tuple[SwitchPosition, bool]:
    """Return the memory after a message, and whether the switch was moved to the position that it is in.

    Args:
        pulse_us: pulse width, microseconds; None where the input is lost.
    """
    if pulse_us is None:
        return SwitchPosition(), False
    if before.at is not None and not 0.0 <= seconds_between(before.at, now) <= GAP_S:
        before = SwitchPosition()
    band = next((n for n, (least, most) in enumerate(BANDS_US) if least <= pulse_us <= most), None)
    if band is None or band == before.position:
        return SwitchPosition(before.position, at=now), False
    if band != before.next or before.since is None:
        return SwitchPosition(before.position, band, now, now), False
    if seconds_between(before.since, now) < DEBOUNCE_S:
        return SwitchPosition(before.position, band, before.since, now), False
    return SwitchPosition(band, at=now), before.position is not None


def pulse_us(message: Message, channel: int) -> int | None:
    """Return the pulse width of a channel, microseconds; None where it is not there or the input is lost."""
    width, throttle = getattr(message, f"chan{channel}_raw"), message.chan3_raw
    if channel > message.chancount or not BANDS_US[0][0] <= width <= BANDS_US[-1][1] or throttle <= _THROTTLE_LOST_US:
        return None
    return int(width)


class RcSwitch:
    """The switch of one autopilot's receiver.

    Args:
        order: gives an order; returns why it is refused, or None.
    """

    def __init__(self, options: SwitchOptions, order: Callable[[OperatorOrder], str | None]) -> None:
        self._o, self._order = options, order
        self._streams, self._connects = Streams({"RC_CHANNELS": _RATE_HZ}), -1
        self._memory = SwitchPosition()
        self._waiting: tuple[OperatorOrder, MonoNs] | None = None
        self._strength = False
        """True once the receiver's strength was not 0: one that never reports it says nothing by a 0."""
        self.counts: Counter[str] = Counter()

    def counted(self) -> dict[str, float]:
        """Return the numbers of orders and of messages without a pulse, and the position: 1 low, 2 middle, 3 high, 0 unknown."""
        position = 0 if self._memory.position is None else self._memory.position + 1
        return {"orders": self.counts["orders"], "lost": self.counts["lost"], "position": position}

    def on_message(self, autopilot: Autopilot, received: ReceivedMessage) -> None:
        """Take any message of the autopilot's links."""
        identity, m, kind = autopilot.identity, received.message, received.message.get_type()
        if identity is None or (received.system, received.component) != (identity.system, identity.component):
            return
        if received.access_level < AccessLevel.PEER:
            return
        self._streams.on_message(m, received.received_at)
        if kind == "SYS_STATUS":
            self._on_status(m, received.received_at)
        elif kind == "RC_CHANNELS":
            self._on_channels(m, received.received_at)

    def _on_status(self, m: Message, now: MonoNs) -> None:
        if m.onboard_control_sensors_enabled & ~m.onboard_control_sensors_health & _RECEIVER:
            self._memory, self._waiting = SwitchPosition(), None
        elif self._waiting is not None and now > self._waiting[1]:
            order, self._waiting = self._waiting[0], None
            self._give(order)

    def _on_channels(self, m: Message, now: MonoNs) -> None:
        self._strength |= 0 < m.rssi < 255
        width = None if self._strength and m.rssi == 0 else pulse_us(m, self._o.channel)
        self.counts["lost"] += width is None
        before = self._memory
        self._memory, is_moved = moved(before, width, now)
        if width is None or self._memory.next is not None or is_moved:
            self._waiting = None
        name = (self._o.low, self._o.middle, self._o.high)[self._memory.position or 0]
        if not is_moved or name == "none":
            return
        order = OperatorOrder(name)
        if order in _WAITS:
            self._waiting = order, now
        else:
            self._give(order)

    def _give(self, order: OperatorOrder) -> None:
        self.counts["orders"] += 1
        self._order(order)

    def due(self, autopilot: Autopilot, now: MonoNs) -> list[Message]:
        """Return the requests to send now."""
        identity, streams = autopilot.identity, autopilot.streams
        if identity is None or streams is None or not autopilot.connected:
            return []
        if autopilot.connects != self._connects:
            self._connects, self._memory, self._waiting = autopilot.connects, SwitchPosition(), None
            self._streams.restart()
        # An answer does not name the stream that it is for: the autopilot has answered all others first.
        return self._streams.due(now, identity.address) if streams.settled else []


@asynccontextmanager
async def switching(switch: RcSwitch | None, autopilot: Autopilot, clock: Clock) -> AsyncIterator[None]:
    """Read the switch on the links of an autopilot. Without one do nothing."""
    if switch is None:
        yield
        return

    def step() -> None:
        if autopilot.unclear is None:
            for message in switch.due(autopilot, clock.now()):
                autopilot.send(message)

    async def tick() -> NoReturn:
        while True:
            autopilot.links.contained.run("the switch's tick", "us", step)
            await clock.sleep(_TICK_S)

    autopilot.add_listener(lambda received: switch.on_message(autopilot, received))
    async with running_beside([("mavlink-switch", tick())]):
        yield
