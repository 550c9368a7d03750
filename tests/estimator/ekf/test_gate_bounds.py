"""The gate's numbers, each at its edge: from which side a row of refusals counts, a belief is overthrown or called consistent."""

import numpy as np
import pytest
from msgspec import structs
from scipy.special import chdtri

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import F64
from estimator.ekf import EkfOptions, gate
from estimator.ekf.params import FilterParams
from estimator.ekf.state import POS_REL, RejectionStreak
from tests.estimator.ekf import flown
from tests.estimator.ekf.hand import belief, diagonal, params, sighting, under

S = 1_000_000_000
OPTIONS = EkfOptions()


@pytest.mark.parametrize("probability", [0.01, 1e-3, 1e-4])
@pytest.mark.parametrize("dof", range(1, 10))
def test_an_honest_measurement_exceeds_its_gate_as_often_as_claimed(probability: float, dof: int) -> None:
    assert gate.nis_max(probability, dof) == pytest.approx(chdtri(dof, probability), abs=6e-4)


@pytest.mark.parametrize(("off_m", "wanted"), [(0.006, True), (0.03, False)])
def test_close_to_the_deck_no_sighting_contradicts_by_less_than_a_landing_notices(off_m: float, wanted: bool) -> None:
    """Six millimetres are six sigmas of a sighting that claims a millimetre. They would end a commit within some cycles."""
    b = belief(x=under(), P=diagonal(d=1e-6), agreed=10, nis_mean=1.0)
    for n in range(8):
        seen = sighting(b.x[POS_REL] + [off_m if n % 2 else -off_m, 0.0, 0.0], t=b.t, var=1e-6)
        after, outcome = flown.fuse_sighting(b, seen, params(reopen_count=1000))
        assert outcome.nis is not None
        assert outcome.nis / 3 > 2.0, "by what they claim each of them contradicts"
        b = b._replace(nis_mean=after.nis_mean)
    assert gate.consistent(b.nis_mean) is wanted


def flown_streak(streak: RejectionStreak, t: int, offset_ned: F64, var_m2: float) -> RejectionStreak:
    """Return the core's streak after one more sighting that its gate rejects."""
    b = belief(t=t, x=under(), P=diagonal(), rejections=streak)
    seen = sighting(b.x[POS_REL] + offset_ned, t=t, var=var_m2)
    after, outcome = flown.fuse_sighting(b, seen, params(reopen_count=1000))
    assert outcome.verdict is Verdict.GATED
    return after.rejections


def flown_reset(streak: RejectionStreak, agreed: int, options: EkfOptions) -> bool:
    """Return whether the core's belief is reset by a sighting that makes the streak this one."""
    n, since, last, *_ = streak
    before = RejectionStreak(n - 1, since, last, (3.0, 0.0, 0.0), 1e-4) if n > 1 else RejectionStreak()
    b = belief(t=streak.last, x=under(), P=diagonal(), agreed=agreed, rejections=before)
    after, outcome = flown.fuse_sighting(b, sighting((3.0, 0.0, 2.0), t=streak.last), FilterParams(options))
    assert (outcome.verdict is Verdict.FUSED) is (after.agreed == 1 and after.rejections.n == 0)
    return outcome.verdict is Verdict.FUSED


def offset(x: float, z: float) -> F64:
    """Return an offset with this many metres sideways, most of them to the east."""
    return np.array([0.6 * x, 0.8 * x, z])


def test_a_row_begins_goes_on_and_keeps_its_beginning() -> None:
    first = flown_streak(RejectionStreak(), 5 * S, offset(0.5, 0.25), 1e-4)
    assert first == RejectionStreak(1, 5 * S, 5 * S, pytest.approx((0.3, 0.4, 0.25)), pytest.approx(1e-4))
    second = flown_streak(first, 6 * S, offset(0.5, 0.25), 4e-4)
    assert second == RejectionStreak(2, 5 * S, 6 * S, pytest.approx((0.3, 0.4, 0.25)), pytest.approx(4e-4))
    assert flown_streak(second, 6 * S, offset(0.5, 0.25), 1e-4).n == 3, "two of one instant"
    assert flown_streak(second, 6 * S - 1, offset(0.5, 0.25), 1e-4).n == 1, "an older one begins anew"


def test_a_belief_of_few_sightings_is_overthrown_by_one_more_than_they_were() -> None:
    for agreed in range(1, 3):
        assert not flown_reset(RejectionStreak(n=agreed), agreed, OPTIONS)
    for agreed in range(3):
        assert flown_reset(RejectionStreak(n=agreed + 1), agreed, OPTIONS)


def test_a_belief_of_three_or_more_is_overthrown_by_count_and_time_alone() -> None:
    options = structs.replace(OPTIONS, reopen_count=5, reopen_s=0.6)
    row = RejectionStreak(n=5, since=0, last=600_000_000)
    assert flown_reset(row, 3, options)
    assert flown_reset(row, 1000, options)
    assert not flown_reset(row._replace(n=4), 3, options)
    assert not flown_reset(row._replace(last=590_000_000), 3, options)
    half = structs.replace(options, reopen_s=0.5)
    assert flown_reset(row._replace(last=500_000_000), 3, half)
    assert not flown_reset(RejectionStreak(n=4, since=0, last=0), 3, options), "four refusals do for three sightings no longer"
