"""The comparison of past forecasts with what happened, and what it is worth for the next, in numpy: the core's oracle."""

import math
from itertools import pairwise

import numpy as np

from estimator.contracts.geometry import F64
from tests.estimator.ekf.belief import HORIZONS_S, IssuedForecast, Skill

PERIOD_S = 0.5
"""Interval between forecasts, and between comparisons, s."""
_MEMORY_S = 60.0
"""Time constant with which old comparisons fade, s."""
_PRIOR = 0.8
"""The factor for a forecast much shorter than a period of the waves, before the first comparison."""
_PRIOR_COUNT, _PRIOR_COUNT_FAR = 20.0, 100.0
"""The number of comparisons that the prior weighs: the first, plus the second times (horizon / period)^4. A wave that passes once
is over before its forecasts can be compared, so beyond a period the prior decides."""

_CLAIMED_COUNT = 8.0
"""The number of comparisons that the claimed variance weighs; those of neighbouring instants miss alike."""


def unknown() -> Skill:
    """Return the skill before the first comparison."""
    return Skill((), np.zeros(3), np.zeros((3, 5, 2)), np.zeros((3, 5, 2)), np.zeros((3, 5, 2)))


def due(skill: Skill, t: int) -> bool:
    """Return whether the next forecast is to be made at `t` (ns)."""
    return not skill.issued or t - skill.issued[-1].t >= PERIOD_S * 1e9


def compared(skill: Skill, t: int, now: F64, ahead: F64) -> Skill:
    """Return the skill after comparing the present motion with earlier forecasts of it, with a new forecast added.

    Args:
        skill: the skill so far.
        t: the present instant, ns.
        now: (5, 2) present displacement and rate by direction.
        ahead: (3, 5, 2) new forecast of displacement and rate by horizon and direction.
    """
    issued = skill.issued
    fade = math.exp(-(t - issued[-1].t) * 1e-9 / _MEMORY_S) if issued else 1.0
    n, product, square, came = fade * skill.n, fade * skill.product, fade * skill.square, fade * skill.came
    for k, horizon in enumerate(HORIZONS_S.tolist()):
        # Sightings are irregular in time: interpolate between the two forecasts that were made before and after `then`.
        then = t - round(horizon * 1e9)
        for a, b in pairwise(issued):
            if a.t <= then < b.t and b.t - a.t <= 2e9 * PERIOD_S:
                weight = (then - a.t) / (b.t - a.t)
                f = (1.0 - weight) * a.waves[k] + weight * b.waves[k]
                n[k] += 1.0
                product[k] += f * now
                square[k] += f * f
                came[k] += now * now
    kept = tuple(one for one in issued if t - one.t <= (HORIZONS_S[-1] + 2.0 * PERIOD_S) * 1e9)
    return Skill((*kept, IssuedForecast(t, ahead)), n, product, square, came)


def prior_factor(horizons_s: F64, w_rad_s: F64) -> F64:
    """Return the factor, 0..1, before the first comparison, (H, 5): it falls with the part of a period that a forecast spans.

    Args:
        horizons_s: (H,) horizons, s.
        w_rad_s: (5,) frequency of the waves by direction.
    """
    return np.asarray(_PRIOR * np.exp(-(_periods(horizons_s, w_rad_s) ** 2)))


def factor(skill: Skill, horizons_s: F64, w_rad_s: F64) -> F64:
    """Return the factor, 0..1, by which to scale a forecast, (H, 5, 2) by horizon, direction and displacement or rate.

    It is 1 at horizon 0 and constant beyond the longest compared horizon.

    Args:
        skill: the past comparisons.
        horizons_s: (H,) horizons, s.
        w_rad_s: (5,) frequency of the waves by direction.
    """
    n = skill.n[:, None, None]
    prior = prior_factor(HORIZONS_S, w_rad_s)[..., None]
    weight = (_PRIOR_COUNT + _PRIOR_COUNT_FAR * _periods(HORIZONS_S, w_rad_s) ** 4)[..., None]
    slope = skill.product / np.maximum(skill.square, 1e-12)
    known = np.clip((weight * prior + n * slope) / (weight + n), 0.0, 1.0)
    knots, at = np.concatenate([[0.0], HORIZONS_S]), np.concatenate([np.ones((1, 5, 2)), known])
    i = np.clip(np.searchsorted(knots, horizons_s, side="right") - 1, 0, knots.size - 2)
    part = np.minimum((horizons_s - knots[i]) / (knots[i + 1] - knots[i]), 1.0)[:, None, None]
    return np.asarray((1.0 - part) * at[i] + part * at[i + 1])


def missed(skill: Skill, horizons_s: F64, w_rad_s: F64, claimed: F64) -> F64:
    """Return the variance of a forecast, (H, 5, 2): the claimed one, or a larger one as far as past misses show it.

    Args:
        skill: the past comparisons.
        horizons_s: (H,) horizons, s.
        w_rad_s: (5,) frequency of the waves by direction.
        claimed: (H, 5, 2) variance that the forecast claims.
    """
    f, n = factor(skill, HORIZONS_S, w_rad_s), skill.n[:, None, None]
    squares = skill.came - 2.0 * f * skill.product + f**2 * skill.square
    rms = np.sqrt(np.maximum(squares, 0.0) / np.where(n > 0.0, n, math.inf))
    knots = np.concatenate([[0.0], HORIZONS_S])
    at = np.concatenate([np.zeros((1, 5, 2)), rms])
    between = np.stack([[np.interp(horizons_s, knots, at[:, k, r]) for r in range(2)] for k in range(5)])
    after = np.clip(np.searchsorted(HORIZONS_S, horizons_s, side="right"), 0, HORIZONS_S.size - 1)
    trust = (skill.n / (_CLAIMED_COUNT + skill.n))[after][:, None, None]
    return np.asarray(claimed + trust * np.maximum(between.transpose(2, 0, 1) ** 2 - claimed, 0.0))


def _periods(horizons_s: F64, w_rad_s: F64) -> F64:
    """Return the (H, 5) horizons in periods of the waves."""
    return np.asarray(horizons_s[:, None] * w_rad_s / math.tau)
