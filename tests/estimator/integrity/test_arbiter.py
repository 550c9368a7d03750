"""The arbiter: it follows the pad by sightings alone, and says when the filter has gone elsewhere."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from estimator.integrity.tracks import Arbiter, Place, arbitrate, compare_estimate, record_fused

T = 5_000_000_000
SURE = (1e-4,) * 6


def swaying(t_s: float) -> tuple[float, float, float]:
    return 0.5 * math.sin(t_s), -0.3 * t_s, 3.0 + 0.4 * math.cos(1.3 * t_s)


def place(t_s: float, at: tuple[float, float, float]) -> Place:
    return Place(T + round(t_s * 1e9), at, 0.02, 0.03)


def followed(
    seconds: float, believed: Callable[[float], tuple[float, float, float]], *, fused: bool = True, hz: float = 30.0
) -> tuple[Arbiter, list[float]]:
    """Return the arbiter after a flight by a filter with this belief, and the instants at which it overruled it."""
    state, overruled, rng = Arbiter(), [], np.random.default_rng(3)
    for n in range(round(seconds * hz)):
        t = n / hz
        x, y, z = np.array(swaying(t)) + 0.02 * rng.standard_normal(3)
        state = arbitrate(state, place(t, (x, y, z)))
        v = [(b - a) / 0.02 for a, b in zip(swaying(t - 0.01), swaying(t + 0.01), strict=True)]
        state = compare_estimate(state, believed(t), tuple(v), SURE)
        state = record_fused(state, state.t, fused)
        if state.overrules:
            overruled.append(t)
            break
    return state, overruled


def test_it_follows_a_swaying_deck_and_leaves_a_right_filter_alone() -> None:
    state, overruled = followed(20.0, swaying)
    assert not overruled
    assert not state.apart
    assert state.n == 600, "no sighting is lost"
    off = np.array([a.p for a in state.axes]) - swaying(599 / 30.0)
    assert np.abs(off).max() < 0.05
    assert np.abs([a.v for a in state.axes] - np.array([0.5 * math.cos(20.0), -0.3, -0.52 * math.sin(26.0)])).max() < 0.4


@pytest.mark.hazard("H1")
def test_a_filter_five_sigma_apart_is_reported_after_half_a_second_and_overruled_after_two() -> None:
    def away(t: float) -> tuple[float, float, float]:
        x, y, z = swaying(t)
        return x, y, z + max(0.0, t - 5.0)

    _, overruled = followed(20.0, away)
    assert overruled == [pytest.approx(7.8, abs=0.3)]
    reported, _ = followed(7.0, away)
    assert reported.apart
    early, _ = followed(6.0, away)
    assert not early.apart


def test_a_filter_that_refuses_all_sightings_is_overruled_though_it_is_near() -> None:
    _, overruled = followed(20.0, swaying, fused=False)
    assert overruled == [pytest.approx(2.0, abs=0.1)]


def test_it_explains_what_goes_on_from_where_it_is_and_nothing_beside_or_later() -> None:
    state, _ = followed(5.0, swaying)
    x, y, z = swaying(5.0)
    assert state.explains(place(5.0, (x, y, z)))
    assert not state.explains(place(5.0, (x + 0.78, y, z))), "another pad"
    assert not state.explains(place(5.5, swaying(5.5))), "after a pause it is not sure"
    assert not Arbiter().explains(place(5.0, (x, y, z)))


def test_single_sightings_elsewhere_do_not_move_it_and_five_in_a_row_do() -> None:
    state, _ = followed(5.0, swaying)
    aside = (swaying(5.0)[0] + 1.0, *swaying(5.0)[1:])
    for n in range(4):
        state = arbitrate(state, place(5.0 + n / 30.0, aside))
    assert state.misses == 4
    assert abs(state.axes[0].p - swaying(5.0)[0]) < 0.1
    assert not state.overrules
    state = arbitrate(state, place(5.0 + 4 / 30.0, aside))
    assert (state.n, state.misses, state.axes[0].p) == (1, 0, aside[0])
