"""GNSS receivers of vehicle and ship in one world: their places on the Earth, with errors that wander.

Source of the error model: a Gauss-Markov process of some metres over minutes and centimetres of noise, as single-frequency
receivers show; Rankin, An error model for sensor simulation: GPS and differential GPS, IEEE PLANS 1994.
"""

import math

import numpy as np

from estimator.contracts.geodesy import GeoPoint, moved
from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between

ORIGIN_DEG = (63.44, 10.40)
"""Latitude and longitude of the world's origin: off Trondheim."""
ORIGIN = GeoPoint.of_degrees(*ORIGIN_DEG, 0.0)
"""The place of the world's origin, on the still water."""
SIGMA_M = 1.5
"""Standard deviation on each horizontal axis; upward it is twice that."""
_TIME_S = 60.0
_NOISE_M = 0.05


class GnssErrors:
    """The error of one receiver.

    Args:
        seed: of its own random numbers, apart from all others of the flight.
    """

    def __init__(self, seed: list[int]) -> None:
        self._rng = np.random.default_rng(seed)
        self._wander = SIGMA_M * self._rng.standard_normal(3)
        self._at: MonoNs | None = None

    def place(self, p_ned: F64, now: MonoNs) -> GeoPoint:
        """Return the place that the receiver reports at `p_ned`, (3,) m from the world's origin."""
        since_s = 0.0 if self._at is None else seconds_between(self._at, now)
        keep = math.exp(-since_s / _TIME_S)
        self._wander = keep * self._wander + SIGMA_M * math.sqrt(1.0 - keep**2) * self._rng.standard_normal(3)
        self._at = now
        error = self._wander + _NOISE_M * self._rng.standard_normal(3)
        return moved(ORIGIN, p_ned + error * np.array([1.0, 1.0, 2.0]))
