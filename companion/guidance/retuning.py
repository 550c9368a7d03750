"""Gains for a response that a flight has found: as stiff as the margins allow for all that the flight leaves possible."""

import math
from functools import lru_cache

import numpy as np
from msgspec import structs

from companion.base.response_in_use import TiltShape
from companion.guidance.margins import keeps_margins
from companion.settings.response import TiltResponse, within
from estimator.contracts.geometry import F64

_SOFTER = (1.0, 1.25, 1.6, 2.0, 2.6, 10.0 / 3.0)
"""Factors by which the place may weigh less; the last one is that of a response which is only assumed."""
_FREQUENCY_STEP, _DAMPING_STEP = 0.05, 0.1
"""Steps in which shapes are distinguished, as natural logarithms."""


def shaped(given: TiltResponse, frequency: float, damping: float) -> TiltResponse:
    """Return the response of a file with another frequency and damping, by factors."""
    w, z = within(given.frequency_rad_s * frequency, given.damping * damping)
    return structs.replace(given, frequency_rad_s=w, damping=z)


def shape_of(given: TiltResponse, found: F64, cov: F64) -> TiltShape:
    """Return the shape to fly by.

    Args:
        given: the response of the vehicle's file.
        found: logarithms of the factors of frequency and damping, (2,).
        cov: covariance of these, (2, 2).
    """
    steps = np.array([_FREQUENCY_STEP, _DAMPING_STEP])
    frequency, damping = np.exp(steps * np.round(found / steps)).tolist()
    shape = TiltShape(frequency, damping, sigma=max(0.01, round(math.sqrt(float(cov[0, 0])), 2)))
    return shape._replace(softer=_softer(given, shape))


@lru_cache(maxsize=256)
def _softer(given: TiltResponse, shape: TiltShape) -> float:
    """Return the least factor that keeps the margins with the vehicle as it was found and as slow as gains assume it."""
    assumed = shaped(given, shape.slow, shape.damping)
    believed = assumed, shaped(given, min(1.0, shape.frequency), shape.damping)
    return next((one for one in _SOFTER[:-1] if keeps_margins(assumed, believed, one)), _SOFTER[-1])
