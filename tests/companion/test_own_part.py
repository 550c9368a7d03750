"""The lean that a vehicle adds by itself: learned in its own time, never taken for an answer to what was asked, and bounded."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.settings.response import TiltResponse
from tests.companion.oracle.own_part import OwnPart, begun, flown, hovered

TILT = TiltResponse(0.06, 12.0, 0.6, 0.08)
DT = 0.02


@pytest.mark.parametrize("lean", [-0.4, 0.7])
def test_where_somebody_else_steered_all_of_the_lean_is_the_vehicle_s_own_and_at_rest(lean: float) -> None:
    assert begun(lean) == OwnPart(own=lean, lean=lean, rate=0.0)
    assert flown(begun(lean), lean, lean, DT, TILT) == OwnPart(lean, lean, 0.0), "nothing changes while nothing moves"


@pytest.mark.parametrize("wind", [-0.6, 0.6])
def test_hovering_it_goes_over_to_the_lean_in_two_seconds_whatever_the_cycle(wind: float) -> None:
    for dt in (0.02, 0.05):
        part = begun(0.1)
        for k in range(1, 60):
            part = hovered(part, wind, dt)
            assert part.own == pytest.approx(wind + (0.1 - wind) * math.exp(-k * dt / 2.0))
            assert (part.lean, part.rate) == (wind, 0.0)


@pytest.mark.parametrize("wind", [-0.6, 0.6])
def test_steering_it_goes_over_to_what_the_response_does_not_explain_in_seven_tenths(wind: float) -> None:
    """The vehicle leans by its own part beside what it is asked for, which is less by what is known of that part."""
    for dt in (0.02, 0.05):
        part = begun(0.0)
        for k in range(1, 60):
            part = flown(part, wind - part.own, 0.0, dt, TILT)
            assert part.own == pytest.approx(wind * (1.0 - math.exp(-k * dt / 0.7)))


def test_an_answer_to_what_was_asked_is_no_part_of_it() -> None:
    """A vehicle that answers as the response says, against small steps of the differential equation."""
    part, lean, rate, fine = begun(0.0), 0.0, 0.0, 40
    w, z = TILT.frequency_rad_s, TILT.damping
    rng, lag, explained = np.random.default_rng(4), 0.0, []
    for _ in range(400):
        lag += 0.2 * (rng.normal() - lag)
        part = flown(part, lean, lag, 0.002, TILT)
        for _ in range(fine):
            rate += 0.002 / fine * (w * w * (lag - lean) - 2.0 * z * w * rate)
            lean += 0.002 / fine * rate
        explained.append(part.lean - lean)
    assert np.abs(explained).max() < 0.02


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_it_never_grows_beyond_three_metres_a_second_squared(sign: float) -> None:
    steered = held = begun(0.0)
    for _ in range(1000):
        steered, held = flown(steered, sign * 9.0, 0.0, DT, TILT), hovered(held, sign * 9.0, DT)
    assert steered.own == held.own == sign * 3.0
