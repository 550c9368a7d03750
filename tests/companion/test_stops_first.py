"""A person's stop comes before estimator and law: whatever raises at any instant, a cut, a hold and an abort leave at once."""

from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.orders import OperatorOrder
from companion.guidance.pilot import Pilot, make_pilot
from companion.settings.load import load
from estimator.contracts.commands import CutMotors, Hover, Velocity
from tests.make import attitude, ns, stamp_at, status
from tests.support.toy_autopilot import PAGE

PARTS = (
    "estimator.all_at", "estimator.motion", "estimator.forecast", "landing.knowledge", "landing.command", "landing.on_command",
    "landing.forecast_made", "operator.place",
)  # fmt: skip
STOPS = {OperatorOrder.EMERGENCY: CutMotors, OperatorOrder.HOLD: Hover, OperatorOrder.ABORT: Hover}
SETTINGS = load("raspberry_ardupilot")


def fail(*_: object, **__: object) -> Any:
    raise ZeroDivisionError("broken")


def one_cycle(pilot: Pilot, t_s: float) -> Any:
    stamp = stamp_at(ns(t_s))
    pilot.on_samples((status(t_s, flying=True), attitude(stamp, var=1e-5)))
    return pilot.decide(ns(t_s))


@pytest.mark.hazard("H5", "H11", "A2")
@settings(max_examples=40)
@given(
    st.sampled_from(PARTS), st.sampled_from([*STOPS]), st.integers(0, 12), st.integers(0, 12),
    st.sampled_from([OperatorOrder.BEGIN, OperatorOrder.STAY, OperatorOrder.MANUAL, None]),
)  # fmt: skip
def test_no_fault_at_any_instant_holds_back_a_stop(part, stop, fails_at, stops_at, before):
    pilot = make_pilot(SETTINGS)
    owner, name = part.split(".")
    one_cycle(pilot, 1.0)
    if before is not None:
        assert pilot.operator.take(before, PAGE, ns(1.0)).accepted
    fault = patch.object(getattr(pilot, owner), name, fail)
    for k in range(24):
        t_s = 1.6 + 0.04 * k
        if k == fails_at:
            fault.start()
        if k == stops_at:
            assert pilot.operator.take(stop, PAGE, ns(t_s)).accepted
        try:
            decision = one_cycle(pilot, t_s)
        except ZeroDivisionError:
            assert fails_at <= k < stops_at, "the service ends while nothing is ordered, and the vehicle holds by itself"
            continue
        if k == stops_at:
            assert isinstance(decision.command, STOPS[stop])
        if k > stops_at:
            assert isinstance(decision.command, STOPS[stop] if stop is OperatorOrder.EMERGENCY else Hover | Velocity)
            assert (pilot.failure is not None) == ("guidance failed" in decision.reason)
    patch.stopall()
