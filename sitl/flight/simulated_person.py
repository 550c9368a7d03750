"""The person beside a simulated flight: gives the orders of the scenario's `operator` faults to the service's arbiter."""

from __future__ import annotations

from companion.base.orders import OperatorOrder, OrderSender, OrderSource, StickPositions
from companion.guidance.arbiter import OperatorArbiter
from estimator.contracts.time import MonoNs
from sitl.faults.operator import OperatorActs
from sitl.faults.timer import FaultTimer

_SENDER = OrderSender(OrderSource.GAMEPAD, "simulated")


class SimulatedPerson:
    """Acts as the scenario says.

    Args:
        faults: which faults are active.
    """

    def __init__(self, faults: FaultTimer) -> None:
        self._faults = faults
        self._doing: OperatorActs | None = None

    def act(self, arbiter: OperatorArbiter, now: MonoNs) -> None:
        """Give what orders are due, and move the sticks; call it before each guidance cycle."""
        active = self._faults.on(OperatorActs)
        wanted = active[-1][0] if active else None
        if wanted is not self._doing:
            if self._doing is not None and wanted is None:
                if self._doing.order == "manual":
                    arbiter.take(OperatorOrder.RELEASE, _SENDER, now)
                arbiter.take(OperatorOrder.BEGIN, _SENDER, now)
            elif wanted is not None:
                if wanted.order == "begin" and self._doing is not None and self._doing.order == "manual":
                    arbiter.take(OperatorOrder.RELEASE, _SENDER, now)
                arbiter.take(OperatorOrder(wanted.order), _SENDER, now)
            self._doing = wanted
        if wanted is not None and wanted.order == "manual":
            arbiter.move(_SENDER, StickPositions(wanted.forward, wanted.right, wanted.climb, wanted.turn), now)
