"""The gamepad as a part of the service: found when it is plugged in, its edges are orders, its sticks fly by hand.

An order that nothing takes back is given by a second press; the first says what comes of it to all who read orders.
A gamepad that is unplugged, or whose radio the kernel gives up, loses the hand at once; it is looked for again.
"""

import asyncio
import logging
from collections import Counter
from collections.abc import Callable, Iterable, Mapping

from companion.base.orders import TWICE_S, HandledOrder, OperatorOrder, OrderSender, OrderSource, StickPositions
from companion.cycle.ports import Assembly
from companion.guidance.pilot import Pilot
from companion.guidance.pilot_operator import FlightWatch, PilotOperator
from companion.parts.gamepad.mapping_file import mapping_of
from companion.parts.gamepad.options import GamepadOperator
from drivers.gamepad.device import AXES, AxisRange, EventDevice, events_in, gamepads
from drivers.gamepad.mapping import STICKS, GamepadMapping, GamepadMemory, gamepad_step, positions, start
from estimator.contracts.errors import SetupImpossible
from estimator.contracts.time import Clock, MonoNs, seconds_between

log = logging.getLogger(__name__)

_SCAN_S = 1.0  # interval at which a gamepad is looked for
_TICK_S = 0.02  # interval of its state
_NO_PERMISSION_S = 30.0  # that interval where none may be opened


class GamepadPart(FlightWatch):
    """The supervised task.

    Args:
        wanted: a part of the gamepad's name, or its path; empty for the first one found.
        find: yields the gamepads that are plugged in, open.
    """

    def __init__(
        self,
        mapping: GamepadMapping,
        wanted: str,
        pilot: Pilot,
        clock: Clock,
        find: Callable[[], Iterable[EventDevice]] = gamepads,
    ) -> None:
        super().__init__(pilot, clock)
        self._mapping = mapping
        self._wanted = wanted
        self._find = find
        self._counts: Counter[str] = Counter()
        self._plugged = False

    def counted(self) -> Mapping[str, float]:
        """Return the counters for health."""
        return {"plugged": self._plugged, **self._counts}

    async def run(self) -> None:
        """Look for the gamepad and serve it, until cancelled."""
        while True:
            wait_s = _SCAN_S
            try:
                device = self._chosen()
            except SetupImpossible as why:
                if not self._counts["no_permission"]:
                    log.error("%s", why)
                self._counts["no_permission"] += 1
                device, wait_s = None, _NO_PERMISSION_S
            if device is not None:
                await self._serve(device)
            await self._clock.sleep(wait_s)

    def _chosen(self) -> EventDevice | None:
        """Return the wanted gamepad, open, or None; the others are closed."""
        chosen: EventDevice | None = None
        for device in self._find():
            if chosen is None and (self._wanted in (device.path, "any") or self._wanted.lower() in device.name.lower()):
                chosen = device
            else:
                device.close()
        return chosen

    async def _serve(self, device: EventDevice) -> None:
        session = _Session(device, self._mapping, self._pilot, self, self._clock, self._counts)
        loop = asyncio.get_running_loop()
        self._plugged = True
        self._counts["opened"] += 1
        log.info("gamepad %s (%s), mapping %s", device.name, device.path, self._mapping.name)
        loop.add_reader(device.fileno(), session.on_readable)
        try:
            while session.lost is None:
                session.move()
                await self._clock.sleep(_TICK_S)
        finally:
            loop.remove_reader(device.fileno())
            device.close()
            self._plugged = False
            self._counts["bounced"] += session.memory.bounced
            session.release()
        log.warning("gamepad %s is gone: %s", device.name, session.lost)


class _Session:
    """One gamepad while it is plugged in."""

    def __init__(
        self, device: EventDevice, mapping: GamepadMapping, pilot: Pilot, flight: FlightWatch, clock: Clock, counts: Counter[str]
    ) -> None:
        self._device = device
        self._mapping = mapping
        self._arbiter = pilot.operator
        self._flight = flight
        self._clock = clock
        self._counts = counts
        self._once: tuple[OperatorOrder | None, MonoNs] = None, clock.now()
        """The order that a second press would give, and when the first was."""
        self._sender = OrderSender(OrderSource.GAMEPAD, device.name)
        self._operator = PilotOperator(pilot, self._sender, clock)
        self._rest = b""
        self.lost: str | None = None
        """Reason why the gamepad is gone; None while it is there."""
        self._ranges: dict[int, AxisRange] = {}
        self.memory: GamepadMemory = start(mapping, {})
        self._read_axes()

    def on_readable(self) -> None:
        """Process the events that wait."""
        try:
            data = self._device.read()
        except OSError as why:
            self._lose(why)
            return
        events, self._rest = events_in(self._rest + data)
        self.memory, orders = gamepad_step(self._mapping, self.memory, events, self._ranges, self._clock.now())
        if self.memory.stale:
            self._counts["dropped"] += 1
            self._read_axes()
        for order in orders:
            self._give(order)

    def move(self) -> None:
        """Send the stick positions, if the gamepad has the hand: a stick that is held still sends no events."""
        if self.lost is None and self._arbiter.hand == self._sender:
            self._arbiter.move(self._sender, StickPositions(**positions(self._mapping, self.memory)), self._clock.now())

    def release(self) -> None:
        """Give the hand up, because the gamepad is gone or the part ends."""
        self._arbiter.lost(self._sender, self._clock.now(), self.lost or "the gamepad's driver ends")

    def _give(self, name: str) -> None:
        order, now, (before, at) = OperatorOrder(name), self._clock.now(), self._once
        if order is OperatorOrder.MANUAL and self._arbiter.hand == self._sender:
            order = OperatorOrder.RELEASE
        within_s = TWICE_S.get(order, 0.0)
        second = before is order and seconds_between(at, now) <= within_s
        if not within_s or second or self._arbiter.refusal(order, self._sender, now) is not None:
            self._once = None, now
            self._operator.order(order)
            return
        self._once = order, now
        where = f": lands {self._flight.below(now)[0]}" if order is OperatorOrder.LAND else ""
        self._arbiter.tell(HandledOrder(now, self._sender, order, f"press it again within {within_s:g} s{where}"))

    def _read_axes(self) -> None:
        try:
            codes = {AXES[getattr(self._mapping.sticks, stick).axis] for stick in STICKS} & self._device.axes
            self._ranges = {code: self._device.axis(code) for code in codes}
        except OSError as why:
            self._lose(why)
            return
        fresh = start(self._mapping, self._ranges)
        before = self.memory
        self.memory = GamepadMemory(
            fresh.deflections, fresh.live | before.live if before.stale else fresh.live, before.pressed_at, before.given_at,
            bounced=before.bounced,
        )  # fmt: skip

    def _lose(self, why: OSError) -> None:
        if self.lost is None:
            self.lost = why.strerror or str(why)
            asyncio.get_running_loop().remove_reader(self._device.fileno())
            self.release()


def join(service: Assembly) -> None:
    """Add the gamepad of the settings."""
    operator = service.settings.of(GamepadOperator)
    gamepad = GamepadPart(mapping_of(operator.gamepad), operator.gamepad_device, service.pilot, service.clock)
    service.observers.append(gamepad)
    service.add("gamepad", gamepad)
