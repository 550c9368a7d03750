"""The watches over the service itself: the service manager's watchdog, and the event loop's own."""

import logging
from functools import partial

from companion.base.loop_lag import LoopWatch
from companion.base.orders import OperatorOrder, OrderSender, OrderSource
from companion.base.watchdog import Manager, Pulse, watchdog_interval_s
from companion.cycle.ports import Assembly
from companion.guidance.pilot import Pilot
from companion.guidance.pilot_operator import PilotOperator
from drivers.clock import SystemClock
from estimator.contracts.errors import BadInput

log = logging.getLogger(__name__)


def join(service: Assembly) -> None:
    """Add the pulse for a service manager, if there is one, and in real time the watch over the event loop."""
    pilot, health, clock = service.pilot, service.health, service.clock
    if (pulse := _pulse(service)) is not None:
        service.observers.append(pulse)
        service.extras["manager"] = pulse.run
    if isinstance(clock, SystemClock):
        stands = PilotOperator(pilot, OrderSender(OrderSource.LIMITS, "(the service stood still)"), clock)
        service.extras["loop"] = LoopWatch(health, partial(_flies, pilot), partial(stands.order, OperatorOrder.HOLD)).run


def _pulse(service: Assembly) -> Pulse | None:
    """Return the systemd observer, or None. A wrong environment is only logged: it is no setting and must not stop us."""
    try:
        interval_s, manager = watchdog_interval_s(), Manager.of()
    except BadInput as why:
        log.error("%s; the service manager is not notified", why)
        return None
    if manager is None:
        return None
    return Pulse(manager, service.health, service.clock, partial(_flies, service.pilot), interval_s)


def _flies(pilot: Pilot) -> bool:
    """Return whether the vehicle flew by its newest status."""
    return pilot.vehicle is not None and bool(pilot.vehicle.flying)
