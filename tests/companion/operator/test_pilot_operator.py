"""Orders of an operator to a real pilot."""

from collections.abc import Callable

import pytest

from companion.base.mission import FlightOutcome
from companion.base.orders import HandledOrder, OperatorOrder, OrderSender, OrderSource
from companion.guidance.pilot import Pilot, make_pilot
from companion.guidance.pilot_operator import PilotOperator
from companion.settings.load import load
from estimator.contracts.commands import Hover
from estimator.contracts.time import MonoNs
from tests.support.mqtt_service import vehicle_status


def flying(shadows: tuple[str, ...] = ()) -> Pilot:
    pilot = make_pilot(load("sim"), shadows=shadows)  # type: ignore[arg-type]
    pilot.on_sample(vehicle_status(MonoNs(1)))
    return pilot


class StillClock:
    """A clock that stands."""

    def now(self) -> MonoNs:
        return MonoNs(2)

    async def sleep(self, seconds: float) -> None:
        raise AssertionError(seconds)


def operating(pilot: Pilot, recording: Callable[[bool], str | None] | None = None) -> PilotOperator:
    return PilotOperator(pilot, OrderSender(OrderSource.MQTT), StillClock(), recording)


@pytest.mark.hazard("H6")
def test_start_pause_and_abort_reach_the_pilot_and_nothing_follows_an_abort() -> None:
    pilot = flying()
    operator = operating(pilot)
    assert operator.pause() is None
    assert pilot.decide(MonoNs(2)).phase == "paused"
    assert operator.start() is None
    assert pilot.decide(MonoNs(3)).phase != "paused"
    assert operator.abort() is None
    assert pilot.outcome is FlightOutcome.ABORTED
    assert isinstance(pilot.decide(MonoNs(4)).command, Hover)
    assert operator.start() == operator.pause() == operator.abort() == "the flight is over: aborted"


def test_a_path_that_runs_along_may_take_over_in_an_approach_another_only_while_paused() -> None:
    first = load("sim").estimator.path
    operator = operating(flying(shadows=("median_mean",)))
    assert operator.steer_by("median_mean") is None
    assert operator.steer_by(first) is None
    operator = operating(pilot := flying())
    assert operator.steer_by("median_mean") == "median_mean does not run along; pause the approach first"
    assert operator.pause() is None
    assert operator.steer_by("median_mean") is None
    assert pilot.estimator.path == "median_mean"
    assert operator.start() is None
    assert operator.steer_by(first) is None, "the path that steered goes on as a shadow"


@pytest.mark.parametrize("on", [True, False])
def test_recording_is_switched_where_there_is_a_recorder(on: bool) -> None:
    switched: list[bool] = []

    def switch(wanted: bool) -> str | None:
        switched.append(wanted)
        return "the disk is full" if wanted else None

    assert operating(flying()).record(on) == "there is no recorder in this service"
    assert operating(flying(), switch).record(on) == ("the disk is full" if on else None)
    assert switched == [on]


@pytest.mark.hazard("H9")
def test_every_order_is_reported_with_its_answer() -> None:
    pilot, reported = flying(), list[HandledOrder]()
    pilot.operator.on_order = reported.append
    operator = operating(pilot)
    operator.pause()
    operator.record(True)
    operator.steer_by("median_mean")
    operator.abort()
    operator.start()
    assert [(h.order, h.accepted) for h in reported] == [
        (OperatorOrder.HOLD, True),
        (OperatorOrder.RECORD, False),
        (OperatorOrder.PATH, True),
        (OperatorOrder.ABORT, True),
        (OperatorOrder.BEGIN, False),
    ]
    assert str(reported[-1]) == "mqtt: begin: refused, the flight is over: aborted"
