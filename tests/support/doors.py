"""The doors through which a person's order reaches a service, in virtual time: what is given at one is delivered later."""

import json
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from companion.base.orders import OperatorOrder as Order
from companion.base.orders import OrderSender, OrderSource
from companion.facts.wire import OrderRequest, line_of, request_of
from companion.guidance.operator.arbiter import OperatorArbiter
from companion.guidance.pilot_operator import PilotOperator
from companion.parts.mavlink.commands import CommandServer, Offered, PilotTower
from companion.parts.mavlink.rc_switch import RcSwitch
from companion.parts.mqtt.messages import Topics
from companion.parts.mqtt.part import CommandHandler
from companion.parts.page.messages import request_in
from companion.settings.operator import SwitchOptions
from companion.tools.ros2.node import RosOrders
from drivers.mavlink.dialect import mav
from estimator.contracts.time import MonoNs, after
from tests.companion.mavlink.test_rc_switch import RECEIVER, channels

RUN = "r" * 32
US, STATION = (1, 191), (255, 190)
PULSES = {Order.HOLD: 1000, Order.STAY: 1500, Order.BEGIN: 2000}
COMMANDS = {
    Order.BEGIN: (mav.MAV_CMD_NAV_LAND, 0.0), Order.STAY: (mav.MAV_CMD_NAV_LOITER_UNLIM, 0.0),
    Order.HOLD: (mav.MAV_CMD_DO_PAUSE_CONTINUE, 0.0), Order.ABORT: (mav.MAV_CMD_DO_GO_AROUND, 0.0),
}  # fmt: skip
Deliver = Callable[[], None]


class Doors:
    """The doors of a service that flies.

    Args:
        now: returns the time.
        pass_s: lets that much time pass, s.
    """

    def __init__(self, arbiter: OperatorArbiter, now: Callable[[], MonoNs], pass_s: Callable[[float], None]) -> None:
        self.now, self._pass_s = now, pass_s
        self.pilot: Any = SimpleNamespace(operator=arbiter, outcome=None)
        self.mqtt = CommandHandler(Topics("deck"), "s", self.by(OrderSource.MQTT), RUN)
        self.mavlink = CommandServer(PilotTower(self.pilot, lambda: None, self), Offered({}))
        self.requests: list[Any] = []
        node: Any = SimpleNamespace(reader=lambda *_, **__: list, server=lambda path: lambda: self._asked(path))
        self.ros = RosOrders(node, "d", self)  # type: ignore[arg-type]
        self.switch = RcSwitch(SwitchOptions(channel=7), self.by(OrderSource.SWITCH).order)
        self.numbers = 0

    def by(self, source: OrderSource, name: str = "") -> PilotOperator:
        return PilotOperator(self.pilot, OrderSender(source, name), self)  # type: ignore[arg-type]

    def _asked(self, path: str) -> list[Any]:
        mine = [r for name, r in self.requests if path.endswith(f"/{name}")]
        self.requests = [(name, r) for name, r in self.requests if not path.endswith(f"/{name}")]
        return mine

    def give(self, door: str, order: Order) -> Deliver:
        """Give an order at a door; return what delivers it."""
        self.numbers += 1
        number, given = self.numbers, self.now()
        if door == "mqtt":
            fields = {"command": order.value, "id": f"c{number}", "run": RUN, "given_ns": given, "expires_ns": after(given, 59.0)}
            return lambda: self._take(self.mqtt.take, json.dumps(fields).encode(), self.now())
        if door == "mavlink":
            command, first = COMMANDS[order]
            message = mav.MAVLink_command_long_message(*US, command, 0, first, 0, 0, 0, 0, 0, 0)
            return lambda: self._take(self.mavlink.on_message, message, STATION, US, self.now())
        if door == "page":
            text = json.dumps({"kind": "order", "number": number, "order": order.value, "seen_at_s": 1e-9 * given})
            return lambda: self._take(self.by(OrderSource.PAGE, "1").answer, request_in(text), 1e-9 * self.now())
        if door == "terminal":
            line = line_of(OrderRequest(number=number, order=order)).strip()
            return lambda: self._take(self.by(OrderSource.TERMINAL, "1").answer, request_of(line))
        if door == "ros":
            return lambda: self._by_ros(order, 1e-9 * (self.now() - given))
        if door == "switch":
            return lambda: self._by_switch(order)
        sender = self.by(OrderSource(door), "one")
        return lambda: self._take(sender.order, order, given)

    @staticmethod
    def _take(call: Callable[..., Any], *args: Any) -> None:
        call(*args)

    def _by_ros(self, order: Order, age_s: float) -> None:
        sent = SimpleNamespace(sent_at_ns=time.time_ns() - round(1e9 * age_s), answer=lambda *_: None)
        self.requests.append((order.value, sent))
        for name, _, age in list(self.ros.come()):
            request = request_of(line_of(OrderRequest(number=1, order=Order(name), age_s=age)).strip())
            self._take(self.by(OrderSource.TERMINAL, "ros").answer, request)

    def _by_switch(self, order: Order) -> None:
        autopilot: Any = SimpleNamespace(is_own=lambda _: True, streams=SimpleNamespace(also=lambda *_: None), connects=1)
        for pulse in (next(p for o, p in PULSES.items() if o is not order), PULSES[order]):
            for _ in range(8):
                self.switch.on_message(autopilot, SimpleNamespace(message=channels(pulse), received_at=self.now()))  # type: ignore[arg-type]
                self._pass_s(0.05)
        well = mav.MAVLink_sys_status_message(RECEIVER, RECEIVER, RECEIVER, 0, 12000, -1, 80, 0, 0, 0, 0, 0, 0)
        self.switch.on_message(autopilot, SimpleNamespace(message=well, received_at=self.now()))  # type: ignore[arg-type]


ALL = (Order.BEGIN, Order.STAY, Order.TAKE_OFF, Order.LAND, Order.MANUAL, Order.CLEAR, Order.HOLD, Order.ABORT)
_OVER = (Order.BEGIN, Order.STAY, Order.HOLD, Order.ABORT)
DOORS = {
    "mqtt": _OVER, "mavlink": _OVER, "ros": _OVER, "page": ALL, "terminal": ALL, "gamepad": ALL, "switch": tuple(PULSES),
    "handover": (Order.BEGIN,), "signal": (Order.BEGIN, Order.HOLD),
}  # fmt: skip
LATE_DOORS = ("mqtt", "page", "ros", "handover", "gamepad")
"""Doors whose orders carry a time of their own, or that hand one on; at all others the time of arrival counts."""
