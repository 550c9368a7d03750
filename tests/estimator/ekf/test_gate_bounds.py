"""The gate's numbers, each at its edge: from which side a row of refusals counts, a belief is overthrown or called consistent."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec import structs
from scipy.stats import chi2

from estimator.ekf import EkfOptions, gate
from estimator.ekf.state import RejectionStreak
from tests.estimator.ekf.oracle import gate as oracle

S = 1_000_000_000
OPTIONS = EkfOptions()


@pytest.mark.parametrize("probability", [0.01, 1e-3, 1e-4])
@pytest.mark.parametrize("dof", range(1, 10))
def test_an_honest_measurement_exceeds_its_gate_as_often_as_said(probability: float, dof: int) -> None:
    assert gate.nis_max(probability, dof) == pytest.approx(chi2.isf(probability, dof), abs=6e-4)


def test_a_mean_nis_of_two_is_no_longer_consistent() -> None:
    assert gate.consistent(0.0)
    assert gate.consistent(1.999)
    assert not gate.consistent(2.0)
    assert not gate.consistent(20.0)


def test_the_recent_mean_forgets_a_twentieth_at_a_time_and_no_outlier_counts_for_more_than_twenty() -> None:
    assert oracle.mean_of(1.0, 6.0, 2) == pytest.approx(1.1)
    assert oracle.mean_of(2.0, 0.0, 3) == pytest.approx(1.9)
    assert oracle.mean_of(1.0, 60.0, 3) == pytest.approx(1.95)
    assert oracle.mean_of(1.0, 1e9, 3) == pytest.approx(1.95)
    mean = 5.0
    for _ in range(14):
        mean = oracle.mean_of(mean, 3.0, 3)
    assert (mean - 1.0) / 4.0 == pytest.approx(0.5, abs=0.02)


def test_the_sigma_of_a_covariance_is_the_root_of_its_mean_variance_and_never_imaginary() -> None:
    assert oracle.sigma_of(np.diag([1.0, 4.0, 7.0])) == pytest.approx(2.0)
    assert oracle.sigma_of(np.diag([-1.0, 0.0, 0.0])) == 0.0


def refused(doubt: RejectionStreak, t: int, x: float = 0.0, sigma_m: float = 0.01, z: float = 0.0) -> RejectionStreak:
    return oracle.extended(doubt, t, np.array([x, 0.0, z]), sigma_m**2)


def test_a_row_begins_goes_on_and_keeps_its_beginning() -> None:
    first = refused(RejectionStreak(), 5 * S, 0.5, z=0.25)
    assert first == RejectionStreak(1, 5 * S, 5 * S, (0.5, 0.0, 0.25), 1e-4)
    second = refused(first, 6 * S, 0.5, sigma_m=0.02, z=0.25)
    assert second == RejectionStreak(2, 5 * S, 6 * S, (0.5, 0.0, 0.25), pytest.approx(4e-4))
    assert refused(second, 6 * S, 0.5, z=0.25).n == 3, "two of one instant"
    assert refused(second, 6 * S - 1, 0.5, z=0.25).n == 1, "an older one begins anew"


def test_a_row_is_broken_by_more_than_two_seconds() -> None:
    first = refused(RejectionStreak(), 0)
    assert refused(first, 2 * S).n == 2
    assert refused(first, 2 * S + 1_000_000).n == 1


@pytest.mark.parametrize(
    ("dt_s", "growth_m"),
    [(0.0, 0.0), (0.1, 0.2), (0.25, 0.5), (0.3, 0.6), (1.0, 0.6)],
)
@pytest.mark.parametrize("sigmas_m", [(0.01, 0.01), (0.3, 0.4)])
def test_how_far_two_refusals_may_differ(dt_s: float, growth_m: float, sigmas_m: tuple[float, float]) -> None:
    """Four sigmas of their difference, what the belief may have drifted between them, and a fiftieth of the offset."""
    first = refused(RejectionStreak(), 0, 0.0, sigma_m=sigmas_m[0], z=1.0)
    for factor, n in ((0.999, 2), (1.001, 1)):
        # The limit holds at the offset of the second look: step = base + 0.02 |offset|, offset = (step, 0, 1).
        base = 4.0 * math.hypot(*sigmas_m) + growth_m
        step = base
        for _ in range(30):
            step = base + 0.02 * math.hypot(step, 1.0)
        found = refused(first, round(dt_s * S), factor * step, sigma_m=sigmas_m[1], z=1.0)
        assert found.n == n, (factor, step)


def test_a_belief_of_few_sightings_is_overthrown_by_one_more_than_they_were() -> None:
    for agreed in range(3):
        assert not oracle.should_reset(RejectionStreak(n=agreed), agreed, OPTIONS)
        assert oracle.should_reset(RejectionStreak(n=agreed + 1), agreed, OPTIONS)


def test_a_belief_of_three_or_more_is_overthrown_by_count_and_time_alone() -> None:
    options = structs.replace(OPTIONS, reopen_count=5, reopen_s=0.6)
    row = RejectionStreak(n=5, since=0, last=600_000_000)
    assert oracle.should_reset(row, 3, options)
    assert oracle.should_reset(row, 1000, options)
    assert not oracle.should_reset(row._replace(n=4), 3, options)
    assert not oracle.should_reset(row._replace(last=590_000_000), 3, options)
    assert not oracle.should_reset(RejectionStreak(n=4, since=0, last=0), 3, options), (
        "four refusals do for three sightings no longer"
    )
