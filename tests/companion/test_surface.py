"""A surface that is ranged out of sight: it is met slowly, whatever the swell does."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.mission import State
from companion.guidance.mission.land_here import Descent
from companion.guidance.mission.machine import mission_step
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Velocity
from tests.companion.test_land_here import cycle, landing
from tests.make import deck, estimate

OPTIONS = GuidanceOptions()
FEET_M = OPTIONS.cone.feet_below_m
DT_S, LAG_S, LATE = 0.02, 0.3, 3


def met_m_s(high_m: float, swell_m: float, period_s: float, phase: float, seed: int) -> tuple[float, float]:
    """Return the speed against the deck with which the feet meet it out of sight, and the time that the way down takes."""
    rng, p, t, v_down, z = np.random.default_rng(seed), landing(), 0.0, 0.0, 0.0
    ranges = []
    while t < 60.0:
        t += DT_S
        turn = math.tau * t / period_s + phase
        range_m = high_m - z + swell_m * math.sin(turn)
        falls_m_s = swell_m * math.tau / period_s * math.cos(turn)
        if range_m <= FEET_M:
            return v_down - falls_m_s, t
        ranges.append(range_m + rng.normal(0.0, 0.01))
        p, command, _ = mission_step(p, cycle(t, range_m=ranges[-min(len(ranges), LATE)] if range_m < 6.0 else None), OPTIONS)
        if range_m > 0.3 + FEET_M + 0.1:
            assert p.state is State.LAND_HERE, "no deck is met before"
            assert isinstance(command, Velocity)
        wanted = float(command.v_level[2]) if isinstance(command, Velocity) else 0.4
        v_down += DT_S / LAG_S * (wanted - v_down)
        z += DT_S * v_down
    raise AssertionError("it never came down")


@pytest.mark.hazard("H3")
@settings(max_examples=25)
@given(st.floats(1.5, 8.0), st.floats(0.0, 1.5), st.floats(7.0, 14.0), st.floats(0.0, math.tau), st.integers(0, 99))
def test_without_sight_a_swell_is_met_slowly_by_its_range(high_m, swell_m, period_s, phase, seed):
    met, took_s = met_m_s(max(high_m, swell_m + 0.5), swell_m, period_s, phase, seed)
    assert met < 0.8
    assert took_s < 30.0


def test_a_range_that_leaps_begins_again_and_in_sight_and_beside_a_driver_that_follows_the_deck_there_is_none() -> None:
    def below(t: float, range_m: float | None, p: object = None, **of: object) -> Descent:
        nonlocal flight
        flight, _, _ = mission_step(flight, cycle(t, range_m=range_m, **of), OPTIONS)
        assert isinstance(flight.kept, Descent)
        return flight.kept

    flight = landing()
    for k in range(50):
        fell = below(0.02 * k, 3.0 + 0.02 * k)
    assert fell.below.ordered_m_s > OPTIONS.cone.commit_rate_m_s + 0.3, "a deck that falls is followed"
    edge = below(1.02, 5.5)
    assert edge.below.ordered_m_s == OPTIONS.cone.descent_rate_m_s, "the water beside the deck"
    assert below(1.04, None).below is None
    assert below(1.06, 3.0, deck=deck(1.06, (0.0, 0.0, 1.0)), over_ground=True).below is None
    assert below(1.08, 3.0, seen=estimate(1.08, (0.0, 0.0, 3.0))).below is None
