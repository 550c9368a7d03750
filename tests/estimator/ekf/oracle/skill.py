"""The comparison of past forecasts with what happened in numpy, against which the core's is held."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from estimator.contracts.geometry import F64
from estimator.ekf.skill import HORIZONS_S, IssuedForecast, Skill

PERIOD_S = 0.5
"""Interval between forecasts, and between comparisons, s."""
_MEMORY_S = 60.0
"""Time constant with which old comparisons fade, s."""


def unknown() -> Skill:
    """Return the skill before the first comparison."""
    return Skill((), np.zeros(3), np.zeros((3, 5, 2)), np.zeros((3, 5, 2)))


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
    n, product, square = fade * skill.n, fade * skill.product, fade * skill.square
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
    kept = tuple(one for one in issued if t - one.t <= (HORIZONS_S[-1] + 2.0 * PERIOD_S) * 1e9)
    return Skill((*kept, IssuedForecast(t, ahead)), n, product, square)
