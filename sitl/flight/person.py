"""A simulated person: gives the orders of a scenario's `operator` faults to the service, or acts by his remote control."""

from collections.abc import Callable

from companion.base.orders import CENTRED, HandledOrder, OperatorOrder, OrderSender, OrderSource, StickPositions
from companion.guidance.operator.arbiter import OperatorArbiter
from estimator.contracts.time import MonoNs, after
from sitl.faults.fault import FaultTimer
from sitl.faults.kinds import OperatorActs
from sitl.flight.hands import BY_REMOTE

_SENDER = OrderSender(OrderSource.GAMEPAD, "simulated")


class SimulatedPerson:
    """Acts as the scenario says.

    Args:
        faults: which faults are active.
        on_act: receives each order with its answer, the sticks, and how long before it arrived it was given.
        by_remote: carries out an act of a remote control.
    """

    def __init__(
        self,
        faults: FaultTimer,
        on_act: Callable[[HandledOrder, StickPositions, float], None] = lambda handled, sticks, late_s: None,
        by_remote: Callable[[str], None] = lambda act: None,
    ) -> None:
        self._faults, self._on_act, self._by_remote = faults, on_act, by_remote
        self._doing: OperatorActs | None = None

    @property
    def gives_back(self) -> bool:
        """True while the person has the vehicle and will give it back."""
        return self._doing is not None and self._doing.for_s is not None

    def act(self, arbiter: OperatorArbiter, now: MonoNs) -> None:
        """Give what orders are due, and move the sticks; call it before each guidance cycle."""
        active = self._faults.on(OperatorActs)
        wanted = active[-1][0] if active else None
        if wanted is not self._doing:
            by_hand = self._doing is not None and self._doing.order == "manual"
            orders: list[str] = ["begin" if wanted is None else wanted.order]
            if by_hand and orders[0] == "begin":
                orders.insert(0, "release")
            for order in orders:
                if order in BY_REMOTE:
                    self._by_remote(order)
                else:
                    sticks, late_s = (CENTRED, 0.0) if wanted is None else (wanted.sticks, wanted.late_s)
                    given_at = after(now, -late_s) if late_s else None
                    self._on_act(arbiter.take(OperatorOrder(order), _SENDER, now, given_at=given_at), sticks, late_s)
            self._doing = wanted
        if wanted is not None and wanted.order == "manual":
            arbiter.move(_SENDER, wanted.sticks, now)
