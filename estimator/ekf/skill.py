"""Forecast skill: compare past wave forecasts with what happened and scale new forecasts accordingly.

A sea with two wave systems is no single oscillator, so the member of the bank that fits the recent motion best may forecast the
next seconds badly, with full amplitude. The regression slope of the observed on the forecast motion is the factor that minimises
the squared error. What the scaled forecasts have missed nonetheless widens the bands of the next ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64

HORIZONS_S = np.array([1.0, 2.0, 3.0])


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
    came: F64
    """(3, 5, 2) faded sum of the squared motion that came."""
