"""Gains for a response that a flight has found: as stiff as the margins allow for all that the flight leaves possible."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from msgspec import structs

from companion.guidance.margins import keeps_margins
from companion.settings.response import TiltResponse
from estimator.contracts.geometry import F64

_SOFTER = (1.0, 1.25, 1.6, 2.0, 2.6, 10.0 / 3.0)
"""Factors by which the place may weigh less; the last one is that of a response which is only assumed."""
_FREQUENCY_STEP, _DAMPING_STEP = 0.05, 0.1
"""Steps in which shapes are distinguished, as natural logarithms."""
_SLOWEST_RAD_S, _FASTEST_RAD_S, _LEAST_DAMPING, _MOST_DAMPING = 1.0, 60.0, 0.2, 3.0
"""Limits of a response."""


def slow_side(frequency: float, sigma: float) -> float:
    """Return the factor on the frequency that gains are made for.

    The slow side takes phase. Gains for a faster vehicle than there is have no margin, and those of the file stand a faster one.
    """
    return min(1.0, frequency * math.exp(-sigma))


class TiltShape(NamedTuple):
    """Difference of a vehicle's tilt from its file, beside the delay: factors, and how much less the place weighs for it."""

    frequency: float = 1.0
    damping: float = 1.0
    softer: float = 1.0
    sigma: float = 0.0
    """Standard deviation of the frequency's logarithm."""

    @property
    def slow(self) -> float:
        """The factor on the frequency that gains are made for: one standard deviation slower, and never faster than the file."""
        return slow_side(self.frequency, self.sigma)


AS_FILED = TiltShape()


def shaped(given: TiltResponse, frequency: float, damping: float) -> TiltResponse:
    """Return the response of a file with another frequency and damping, by factors."""
    return structs.replace(
        given,
        frequency_rad_s=min(_FASTEST_RAD_S, max(_SLOWEST_RAD_S, given.frequency_rad_s * frequency)),
        damping=min(_MOST_DAMPING, max(_LEAST_DAMPING, given.damping * damping)),
    )


def shape_of(given: TiltResponse, found: F64, cov: F64) -> TiltShape:
    """Return the shape to fly by.

    Args:
        given: the response of the vehicle's file.
        found: logarithms of the factors of frequency and damping, (2,).
        cov: covariance of these, (2, 2).
    """
    steps = np.array([_FREQUENCY_STEP, _DAMPING_STEP])
    frequency, damping = np.exp(steps * np.round(found / steps)).tolist()
    shape = TiltShape(frequency, damping, 1.0, max(0.01, round(math.sqrt(float(cov[0, 0])), 2)))
    return shape._replace(softer=_softer(given, shape))


@lru_cache(maxsize=256)
def _softer(given: TiltResponse, shape: TiltShape) -> float:
    """Return the least factor that keeps the margins with the vehicle as it was found and as slow as gains assume it."""
    assumed = shaped(given, shape.slow, shape.damping)
    believed = assumed, shaped(given, min(1.0, shape.frequency), shape.damping)
    return next((one for one in _SOFTER[:-1] if keeps_margins(assumed, believed, one)), _SOFTER[-1])
