"""The belief about the deck widens where sightings keep missing it, and single wrong sightings change nothing."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.ekf.state import POS_DOWN, POS_EAST, POS_NORTH, SWAY_PER_HEAVE, WAVES, InnovationExcesses, N
from tests.estimator.ekf.oracle import deck_jolt
from tests.support.voyage_score import fly
from tests.support.voyage_truth import VoyageScene

COV = np.diag([0.01, 0.02, 0.03]) ** 2


def seen(*sigmas: tuple[float, float, float], every_ns: int = 66_000_000) -> InnovationExcesses:
    excesses = InnovationExcesses()
    for k, one in enumerate(sigmas):
        excesses = deck_jolt.extended(excesses, k * every_ns, np.array(one) * [0.01, 0.02, 0.03], COV)
    return excesses


def test_the_sightings_of_the_last_third_of_a_second_count() -> None:
    excesses = seen(*[(0.5 * k, 0.5, -1.0) for k in range(8)])
    ratios = [(k * k, 0.25, 1.0) for k in (1.0, 1.5, 2.0, 2.5, 3.0, 3.5)]
    np.testing.assert_allclose(excesses.values, (np.array(ratios) - deck_jolt.RATIO_MAX) * np.diagonal(COV))
    assert excesses.t == tuple(k * 66_000_000 for k in range(2, 8))


def test_only_the_axis_that_keeps_missing_falls_short_and_by_the_median() -> None:
    missing = deck_jolt.missing(seen((1.0, 0.5, 3.0), (0.0, 1.0, -4.0), (0.5, 1.0, 5.0)))
    assert missing is not None
    np.testing.assert_allclose(missing, [0.0, 0.0, (16.0 - deck_jolt.RATIO_MAX) * 0.03**2])


@pytest.mark.parametrize(
    "sigmas",
    [
        [(3.0, 3.0, 3.0)] * 2,
        [(1.0, -1.0, 1.0)] * 5,
        [(1.0, 1.0, 1.0)] * 3 + [(6.0, 6.0, 6.0)] * 2,
    ],
    ids=["too few", "honest", "two wrong ones among five"],
)
def test_nothing_falls_short(sigmas: list[tuple[float, float, float]]) -> None:
    assert deck_jolt.missing(seen(*sigmas)) is None


def test_three_sightings_within_a_tenth_of_a_second_are_too_short_a_time() -> None:
    assert deck_jolt.missing(seen(*[(3.0, 3.0, 3.0)] * 3, every_ns=33_000_000)) is None
    assert deck_jolt.missing(seen(*[(3.0, 3.0, 3.0)] * 5, every_ns=33_000_000)) is not None


def test_a_sighting_that_tells_little_of_an_axis_does_not_scale_what_others_missed() -> None:
    excesses = seen((3.0, 1.0, 1.0), (-3.0, 1.0, 1.0), (3.0, 1.0, 1.0))
    blind = deck_jolt.extended(excesses, 200_000_000, np.array([0.01, 0.0, 0.0]), np.diag([0.6, 0.02, 0.03]) ** 2)
    missing = deck_jolt.missing(blind)
    assert missing is not None
    assert missing[0] <= (9.0 - deck_jolt.RATIO_MAX) * 0.01**2


def test_a_sighting_of_something_else_is_not_counted() -> None:
    for far in ((7.1, 0.0, 0.0), (0.0, -50.0, 0.0), (0.0, 0.0, 1e4)):
        assert seen((1.0, 1.0, 1.0), far) == seen((1.0, 1.0, 1.0))


def test_the_pad_and_its_wave_become_uncertain_together() -> None:
    x, P = np.zeros(N), np.eye(N) * 1e-4
    x[SWAY_PER_HEAVE] = 0.5, -0.2
    var = np.array([0.0, 0.0, 0.04])
    grown = deck_jolt.widened(P, x, var) - P
    heave, rate = WAVES[2, :2].tolist()
    np.testing.assert_allclose(grown[POS_DOWN, POS_DOWN], 0.04)
    np.testing.assert_allclose(grown[heave, heave], 0.04)
    np.testing.assert_allclose(grown[POS_DOWN, heave], 0.04)
    np.testing.assert_allclose(grown[POS_NORTH, POS_NORTH], 0.01)
    np.testing.assert_allclose(grown[POS_EAST, POS_DOWN], -0.008)
    # The place above its wave, the mean level of the deck, is as well known as before.
    level = np.zeros(N)
    level[POS_DOWN], level[heave] = 1.0, -1.0
    np.testing.assert_allclose(level @ grown @ level, 0.0, atol=1e-15)
    assert grown[rate, rate] > 0.04
    assert np.linalg.eigvalsh(grown).min() > -1e-12
    np.testing.assert_array_equal(grown[WAVES[:2].ravel()], 0.0)
    assert P[POS_DOWN, POS_DOWN] == 1e-4, "its argument stays as it was"


def test_a_wake_after_a_calm_is_followed_from_its_first_second() -> None:
    """Without the widening the filter refuses the pad for a while: 0.46 m rms, NEES/7 3.8."""
    scene = VoyageScene(seed=406, sea="wake", hidden_delay_s=-0.03, duration_s=17.0, imu_hz=50.0, range_hz=5.0)
    s = fly(scene, since_s=10.0, forecasts=False)
    assert np.mean(s.nees) / 7.0 < 3.2
    assert s.rms_m < 0.3
