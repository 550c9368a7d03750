"""How much of a forecast of the waves comes true: each is kept until its time has come, and compared with what came.

A sea of two systems is no single oscillator, so the member of the bank that explains the last moments best may foretell the next
seconds badly, at full height. The slope of what came over what was foretold is the share that makes the squared error least.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64

HORIZONS_S = np.array([1.0, 2.0, 3.0])
PERIOD_S = 0.5
"""Forecasts are made and compared this often."""
_MEMORY_S = 60.0
_PRIOR, _PRIOR_COUNT = 0.7, 20.0
"""The share before anything was compared, and how many comparisons it weighs as much as."""


class IssuedForecast(NamedTuple):
    """What was foretold at one instant."""

    t: int
    """ns"""
    waves: F64
    """(3, 5, 2) by horizon and direction: displacement and rate."""


class Skill(NamedTuple):
    """Sums over the comparisons, fading."""

    told: tuple[IssuedForecast, ...]
    """Oldest first; those whose longest horizon has not come yet."""
    n: F64
    """(3,) comparisons by horizon."""
    product: F64
    """(3, 5, 2) of what was foretold and what came."""
    square: F64
    """(3, 5, 2) of what was foretold."""


def unknown() -> Skill:
    """Return a skill that nothing was compared for."""
    return Skill((), np.zeros(3), np.zeros((3, 5, 2)), np.zeros((3, 5, 2)))


def due(skill: Skill, t: int) -> bool:
    """Return whether the next forecast is to be made at `t` (ns)."""
    return not skill.told or t - skill.told[-1].t >= PERIOD_S * 1e9


def compared(skill: Skill, t: int, now: F64, ahead: F64) -> Skill:
    """Compare what came with what was foretold for now.

    Args:
        t: ns.
        now: (5, 2) displacement and rate by direction.
        ahead: (3, 5, 2) the same foretold from here on, by horizon.
    """
    told = skill.told
    fade = math.exp(-(t - told[-1].t) * 1e-9 / _MEMORY_S) if told else 1.0
    n, product, square = fade * skill.n, fade * skill.product, fade * skill.square
    for k, horizon in enumerate(HORIZONS_S.tolist()):
        # Looks come at any time: the value for now lies between those of the two forecasts around it.
        then = t - round(horizon * 1e9)
        for a, b in pairwise(told):
            if a.t <= then < b.t and b.t - a.t <= 2e9 * PERIOD_S:
                share = (then - a.t) / (b.t - a.t)
                f = (1.0 - share) * a.waves[k] + share * b.waves[k]
                n[k] += 1.0
                product[k] += f * now
                square[k] += f * f
    kept = tuple(one for one in told if t - one.t <= (HORIZONS_S[-1] + 2.0 * PERIOD_S) * 1e9)
    return Skill((*kept, IssuedForecast(t, ahead)), n, product, square)


def share(skill: Skill, horizons_s: F64) -> F64:
    """(H, 5, 2) share of a forecast to be kept, 0 to 1; all of it for now, that of the longest horizon beyond it."""
    n = skill.n[:, None, None]
    slope = skill.product / np.maximum(skill.square, 1e-12)
    known = np.clip((_PRIOR_COUNT * _PRIOR + n * slope) / (_PRIOR_COUNT + n), 0.0, 1.0)
    knots, at = np.concatenate([[0.0], HORIZONS_S]), np.concatenate([np.ones((1, 5, 2)), known])
    i = np.clip(np.searchsorted(knots, horizons_s, side="right") - 1, 0, knots.size - 2)
    part = np.minimum((horizons_s - knots[i]) / (knots[i + 1] - knots[i]), 1.0)[:, None, None]
    return np.asarray((1.0 - part) * at[i] + part * at[i + 1])
