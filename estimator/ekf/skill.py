"""Forecast skill: compare past wave forecasts with what happened and scale new forecasts accordingly.

A sea with two wave systems is no single oscillator, so the member of the bank that fits the recent motion best may forecast the
next seconds badly, with full amplitude. The regression slope of the observed on the forecast motion is the factor that minimises
the squared error.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64

HORIZONS_S = np.array([1.0, 2.0, 3.0])
_PRIOR = 0.8
"""The factor for a forecast much shorter than a period of the waves, before the first comparison."""
_PRIOR_COUNT, _PRIOR_COUNT_FAR = 20.0, 100.0
"""The number of comparisons that the prior weighs: the first, plus the second times (horizon / period)^4. A wave that passes once
is over before its forecasts can be compared, so beyond a period the prior decides."""


class IssuedForecast(NamedTuple):
    """The forecast that was made at one instant."""

    t: int
    """Instant of the forecast, ns."""
    waves: F64
    """(3, 5, 2) displacement and rate by horizon and direction (m, m/s; rad, rad/s for roll and pitch)."""


class Skill(NamedTuple):
    """The sums over past comparisons, which fade with time."""

    issued: tuple[IssuedForecast, ...]
    """The forecasts whose longest horizon has not passed yet, oldest first."""
    n: F64
    """(3,) faded number of comparisons by horizon."""
    product: F64
    """(3, 5, 2) faded sum of forecast times observed motion."""
    square: F64
    """(3, 5, 2) faded sum of the squared forecast motion."""


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


def _periods(horizons_s: F64, w_rad_s: F64) -> F64:
    """Return the (H, 5) horizons in periods of the waves."""
    return np.asarray(horizons_s[:, None] * w_rad_s / math.tau)
