"""The response of a vehicle as a file gives it: its ranges, how late it is, and the model of it in steps."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.guidance.response import ClimbResponse, TiltResponse, tilt_model
from estimator.contracts.motion import G_M_S2


@pytest.mark.parametrize(
    "wrong", [{"delay_s": 0.61}, {"frequency_rad_s": 0.9}, {"damping": 0.1}, {"lag_s": -0.01}, {"max_deg": 46.0}]
)
def test_a_tilt_outside_its_range_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        TiltResponse(**{"delay_s": 0.05, "frequency_rad_s": 5.0, "damping": 0.7, **wrong})


@pytest.mark.parametrize("wrong", [{"delay_s": 0.61}, {"lag_s": 0.01}, {"max_m_s": 5.1}])
def test_a_climb_outside_its_range_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        ClimbResponse(**{"delay_s": 0.05, "lag_s": 0.4, **wrong})


def test_the_largest_tilt_is_the_acceleration_of_a_hovering_thrust() -> None:
    assert TiltResponse(0.05, 5.0, 0.7, max_deg=30.0).max_m_s2 == pytest.approx(G_M_S2 / math.sqrt(3.0))


@pytest.mark.parametrize(
    "tilt", [TiltResponse(0.07, 6.0, 0.8, 0.05), TiltResponse(0.2, 15.0, 0.4), TiltResponse(0.0, 5.0, 1.5, 0.2)]
)
def test_a_steady_change_of_the_command_is_followed_as_late_as_is_said(tilt: TiltResponse) -> None:
    """A command that is held for a period is half a period later than the line through its beginnings."""
    period_s = 0.01
    model = tilt_model(tilt, period_s)
    x = np.zeros(len(model.A))
    for k in range(2000):
        x = model.A @ x + model.B * (k * period_s)
    assert 2000 * period_s - x[2] == pytest.approx(tilt.slowness_s + 0.5 * period_s, abs=1e-6)


@pytest.mark.parametrize(("lag_s", "states"), [(0.0, 4), (0.00009, 4), (0.00015, 5), (0.05, 5)])
def test_a_lag_of_less_than_a_tenth_of_a_millisecond_is_none(lag_s: float, states: int) -> None:
    assert tilt_model(TiltResponse(0.04, 5.0, 0.7, lag_s), 0.02).states == states


@pytest.mark.parametrize(("delay_s", "delays"), [(0.0, 1), (0.02, 1), (0.021, 2), (0.06, 3), (0.14, 7), (0.141, 8)])
def test_as_many_commands_are_under_way_as_the_delay_has_periods(delay_s: float, delays: int) -> None:
    """0.14 / 0.02 is a little more than seven in floating point."""
    model = tilt_model(TiltResponse(delay_s, 5.0, 0.7, 0.05), 0.02)
    assert (model.delays, len(model.B)) == (delays, 5 + delays)
