"""What becomes of a forecast is compared with it, and as much of the next one is kept as came true."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimator.ekf.deck_motion_bank import HORIZONS_S, Skill
from tests.estimator.ekf.oracle import skill
from tests.estimator.ekf.oracle.skill import factor

STEP_NS = 600_000_000
SWELL = np.full(5, 0.5)
"""rad/s by direction."""


def learned(slope: float, n: int, step_ns: int = STEP_NS) -> Skill:
    """Forecasts of a slow wave that says `1 / slope` times what comes."""
    known = skill.unknown()
    for k in range(n):
        t = k * step_ns * 1e-9
        came = np.full((5, 2), np.sin(0.5 * t))
        ahead = np.stack([np.full((5, 2), np.sin(0.5 * (t + h)) / slope) for h in HORIZONS_S])
        assert skill.due(known, k * step_ns)
        known = skill.compared(known, k * step_ns, came, ahead)
    return known


def test_before_anything_was_compared_less_is_kept_the_more_of_a_period_a_forecast_spans() -> None:
    w = math.tau / np.array([2.0, 4.0, 8.0, 16.0, 100.0])
    share = factor(skill.unknown(), np.array([0.0, 1.0, 1.5, 3.0, 9.0]), w)
    assert share.shape == (5, 5, 2)
    np.testing.assert_array_equal(share[..., 0], share[..., 1])
    np.testing.assert_allclose(share[0], 1.0)
    np.testing.assert_allclose(share[1, :, 0], 0.8 * np.exp([-0.25, -1 / 16, -1 / 64, -1 / 256, -1e-4]))
    np.testing.assert_allclose(share[3, :2, 0], 0.8 * np.exp([-2.25, -9 / 16]))
    np.testing.assert_allclose(share[2], 0.5 * (share[1] + factor(skill.unknown(), np.array([2.0]), w)[0]))
    np.testing.assert_allclose(share[4], share[3])
    assert np.all(np.diff(share[3, :, 0]) > 0.0), "a longer wave is foretold farther"


def test_the_share_goes_from_its_prior_to_the_slope_of_what_came_over_what_was_foretold() -> None:
    for slope, expected in ((0.5, 0.5), (1.0, 1.0), (2.0, 1.0), (1e-3, 0.0), (-1.0, 0.0)):
        share = factor(learned(slope, 200), HORIZONS_S, SWELL)
        np.testing.assert_allclose(share, expected, atol=0.2)
    few = factor(learned(0.4, 12), HORIZONS_S, SWELL)
    assert np.all((few > 0.45) & (few < 0.85))


def test_beyond_a_period_the_prior_outweighs_a_minute_of_comparisons() -> None:
    quick = np.full(5, math.tau / 2.5)
    assert factor(learned(1.0, 200), HORIZONS_S, SWELL)[2].min() > 0.9
    assert factor(learned(1.0, 200), HORIZONS_S, quick)[2].max() < 0.5


def test_a_band_grows_to_what_past_forecasts_have_missed_and_never_shrinks() -> None:
    rng = np.random.default_rng(5)
    known, missed_by = skill.unknown(), np.array([0.1, 0.3, 0.5])
    claimed = np.full((3, 5, 2), 0.2**2)
    horizons_s = HORIZONS_S - 1e-9
    for k in range(400):
        ahead = missed_by[:, None, None] * rng.normal(size=(3, 5, 2))
        known = skill.compared(known, k * 500_000_000, np.zeros((5, 2)), ahead)
        if k == 0:
            np.testing.assert_array_equal(skill.missed(known, horizons_s, SWELL, claimed), claimed)
    # Where nothing comes the regression leaves the forecasts out, so what still misses is what came: make it theirs.
    known = known._replace(product=known.square, came=2.0 * known.square)
    found = np.sqrt(skill.missed(known, horizons_s, SWELL, claimed))
    rms = np.sqrt(known.square / known.n[:, None, None])
    np.testing.assert_allclose(found, np.maximum(0.2, rms), rtol=0.06)
    assert np.all(skill.missed(known, np.linspace(0.0, 5.0, 21), SWELL, np.full((21, 5, 2), 0.04)) >= 0.04)


def test_forecasts_are_kept_until_their_longest_horizon_has_come_and_no_longer() -> None:
    known = learned(1.0, 100)
    assert 5 <= len(known.issued) <= 8
    assert not skill.due(known, known.issued[-1].t + 499_999_999)
    assert skill.due(known, known.issued[-1].t + 500_000_000)


def test_a_pause_in_the_sightings_compares_nothing_across_it() -> None:
    assert learned(1.0, 30, 5_000_000_000).n.max() == 0.0
    assert learned(1.0, 30).n.min() == pytest.approx(24, abs=6)
