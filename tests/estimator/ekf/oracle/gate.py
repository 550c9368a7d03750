"""The reset criterion for a belief that was wrong, and the recent consistency of sightings, in numpy."""

import math

import numpy as np

from estimator.contracts.geometry import F64
from estimator.ekf.options import EkfOptions
from tests.estimator.ekf.belief import RejectionStreak

_GROWTH_M_S = 2.0
"""Rate at which two sightings of the same object may come to differ because the belief drifts between them. A deck whose heave
is not learned yet moves away from the belief at 1 to 2 m/s."""
_GROWTH_MAX_M = 0.6


def extended(streak: RejectionStreak, t: int, offset_ned: F64, var_m2: float) -> RejectionStreak:
    """Return the streak with one more rejected sighting, or a new streak if the sighting contradicts the last one.

    Args:
        t: instant at which the sighting was measured, ns.
        offset_ned: (3,) measured minus predicted position, m.
        var_m2: variance of one component of the measured position.
    """
    x, y, z = offset_ned.tolist()
    fresh = RejectionStreak(1, t, t, (x, y, z), var_m2)
    if streak.n == 0 or t < streak.last:
        return fresh
    dt = (t - streak.last) * 1e-9
    step = math.dist((x, y, z), streak.offset_ned)
    limit = 4.0 * math.sqrt(var_m2 + streak.var_m2) + min(_GROWTH_M_S * dt, _GROWTH_MAX_M) + 0.02 * math.hypot(x, y, z)
    if step > limit or dt > 2.0:
        return fresh
    return RejectionStreak(streak.n + 1, streak.since, t, (x, y, z), var_m2)


def should_reset(streak: RejectionStreak, agreed: int, options: EkfOptions) -> bool:
    """Tell whether the rejection streak outweighs the belief. A belief made by few sightings is reset by few."""
    if agreed < 3:
        return streak.n > agreed
    return streak.n >= options.reopen_count and (streak.last - streak.since) * 1e-9 >= options.reopen_s


def mean_of(nis_mean: float, innov: F64, S: F64) -> float:
    """Return the recent mean after one more innovation (m,), S (m, m) widened by what a landing does not notice."""
    slight = np.where(np.arange(innov.size) < 3, 0.008, 0.01)
    nis = float(innov @ np.linalg.solve(S + np.diag(slight**2), innov))
    return nis_mean + 0.05 * (min(nis / innov.size, 20.0) - nis_mean)


def sigma_of(cov: F64) -> float:
    """Return the root of the mean variance of a (3, 3) covariance."""
    return math.sqrt(max(float(np.trace(cov)) / 3.0, 0.0))
