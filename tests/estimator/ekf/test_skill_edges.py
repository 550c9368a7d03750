"""The native core learns the sea and compares past forecasts with what came as the numpy oracle does, at the edges."""

import numpy as np
import pytest

from estimator.core.abi import MEMBERS
from estimator.ekf import deck_motion_bank
from estimator.ekf.deck_motion_bank import IssuedForecast, Skill
from tests.estimator.ekf import flown
from tests.estimator.ekf.hand import MS, TOOLS, T, learned
from tests.estimator.ekf.oracle import bank as oracle
from tests.estimator.ekf.test_core import same_sea


@pytest.mark.parametrize("var", [0.99e5, 1e5, 1.01e5])
def test_a_direction_is_unseen_from_a_variance_on(var: float) -> None:
    y, noise = np.array([3.0, -2.0, 5.0, 0.1, -0.2]), TOOLS
    seen = np.array([1e-4, var, 1e-4, var, 1e-4])
    ours, expected = deck_motion_bank.unknown(), oracle.unknown()
    for t in (T, T + 200 * MS):
        ours = flown.observe(ours, t, y, seen, noise, 2.0)
        expected = oracle.observe(expected, t, y, seen, noise.carrying, 2.0)
        same_sea(ours, expected)


@pytest.mark.parametrize("best", [0, 1, MEMBERS - 1])
def test_the_best_member_sets_the_scale_whichever_it_is(best: int) -> None:
    log_weight = np.full((5, MEMBERS), -4.0)
    log_weight[:, best] = 3.0
    before = learned(t=T - 200 * MS)._replace(log_weight=log_weight)
    nothing_seen, noise = np.full(5, 1e6), TOOLS
    after = flown.observe(before, T, np.zeros(5), nothing_seen, noise, 2.0)
    same_sea(after, oracle.observe(before, T, np.zeros(5), nothing_seen, noise.carrying, 2.0))
    assert np.all(after.log_weight.argmax(axis=1) == best)
    assert np.all(after.log_weight.max(axis=1) == 0.0)


@pytest.mark.parametrize(
    ("ages_ns", "compared", "issued"),
    [
        ((600 * MS,), 0, 2),
        ((500 * MS,), 0, 2),
        ((500 * MS - 1,), 0, 1),
        ((1500 * MS, 900 * MS), 1, 3),
        ((1500 * MS, 1000 * MS), 0, 3),
        ((1500 * MS, 1000 * MS, 500 * MS), 1, 4),
        ((1500 * MS, 500 * MS), 1, 3),
        ((1500 * MS + 1, 500 * MS), 0, 3),
        ((1900 * MS, 500 * MS), 0, 3),
        ((4000 * MS, 3200 * MS, 2500 * MS), 1, 4),
        ((4000 * MS + 1, 3200 * MS, 2500 * MS), 1, 3),
        ((9000 * MS,), 0, 1),
    ],
)
def test_forecasts_are_compared_issued_and_dropped_at_their_ages(ages_ns: tuple[int, ...], compared: int, issued: int) -> None:
    """The counts are of the pairs compared with a look and of the forecasts kept, the new one included."""
    rng = np.random.default_rng(len(ages_ns))
    reported = tuple([IssuedForecast(T - age, rng.normal(size=(3, 5, 2))) for age in ages_ns])
    known = Skill(reported, rng.uniform(5.0, 9.0, 3), rng.normal(size=(3, 5, 2)), *rng.uniform(1.0, 2.0, (2, 3, 5, 2)))
    before = learned(t=T - 300 * MS)._replace(skill=known)
    y, var, noise = rng.normal(size=5), np.full(5, 1e-4), TOOLS
    after = flown.observe(before, T, y, var, noise, 2.0)
    same_sea(after, oracle.observe(before, T, y, var, noise.carrying, 2.0))
    assert len(after.skill.issued) == issued
    if issued > 1 or ages_ns[0] > 4000 * MS:
        faded = np.exp(-ages_ns[-1] / 60e9) * known.n
        assert np.sum(after.skill.n - faded) == pytest.approx(compared)
