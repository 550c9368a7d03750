"""Gusts, drifting attitude errors, optical-flow noise."""

from __future__ import annotations

import math

import numpy as np

from sitl.vehicle.airframe import Avionics
from sitl.vehicle.disturbances import Wind
from tests.sitl.oracle.algebra import Vec


class Disturbances:
    """Random processes of one vehicle; each starts in its steady state and is exact for any step length."""

    def __init__(self, wind: Wind, avionics: Avionics, step_s: float, seed: np.random.SeedSequence) -> None:
        self._noise = Noise(seed)
        start, bias = self._noise.next(), self._noise.next()
        av = avionics
        self._gust = _Memory(wind.gust_sigma_m_s, wind.gust_time_s, step_s)
        self._flow = _Memory(av.flow_noise_sigma_m_s, av.flow_noise_time_s, step_s)
        self._drift = _Memory(av.tilt_drift_sigma_rad, av.tilt_drift_time_s, step_s)
        s = self._gust.sigma
        self.gust: Vec = (s * start[0], s * start[1], 0.5 * s * start[2])
        """Velocity of the gust in ned, m/s."""
        self.flow: tuple[float, float] = (self._flow.sigma * start[3], self._flow.sigma * start[4])
        """Error of the optical flow forward and right, m/s."""
        self._tilt_bias = (av.tilt_bias_sigma_rad * bias[0], av.tilt_bias_sigma_rad * bias[1])
        self._tilt_drift: tuple[float, float] = (self._drift.sigma * start[5], self._drift.sigma * start[6])

    @property
    def tilt(self) -> tuple[float, float]:
        """Error of the drone's own roll and pitch, rad."""
        return (self._tilt_bias[0] + self._tilt_drift[0], self._tilt_bias[1] + self._tilt_drift[1])

    def step(self) -> None:
        n = self._noise.next()
        if self._gust.sigma > 0.0:
            a, b = self._gust.keep, self._gust.fresh
            g = self.gust
            self.gust = (a * g[0] + b * n[0], a * g[1] + b * n[1], a * g[2] + 0.5 * b * n[2])
        a, b = self._flow.keep, self._flow.fresh
        self.flow = (a * self.flow[0] + b * n[3], a * self.flow[1] + b * n[4])
        a, b = self._drift.keep, self._drift.fresh
        self._tilt_drift = (a * self._tilt_drift[0] + b * n[5], a * self._tilt_drift[1] + b * n[6])


class _Memory:
    """Factors of x' = keep x + fresh n for a standard deviation and a correlation time."""

    def __init__(self, sigma: float, time_s: float, step_s: float) -> None:
        self.sigma = sigma
        self.keep = math.exp(-step_s / time_s)
        self.fresh = sigma * math.sqrt(1.0 - self.keep**2)


class Noise:
    """Standard normal numbers, seven a step, drawn in blocks."""

    def __init__(self, seed: np.random.SeedSequence) -> None:
        self._rng = np.random.Generator(np.random.PCG64(seed))
        self._block: list[list[float]] = []

    def next(self) -> list[float]:
        if not self._block:
            self._block = self._rng.standard_normal((256, 7)).tolist()[::-1]
        return self._block.pop()
