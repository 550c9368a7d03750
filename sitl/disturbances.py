"""The random disturbances of the vehicle: gusts, drifting attitude errors, optical-flow noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimator.contracts.geometry import F64
from sitl.airframe import Avionics
from sitl.algebra import Num, Vec

_CHANNELS = 7
_BLOCK = 256


@dataclass(frozen=True, slots=True)
class Wind:
    """Steady wind with gusts, uniform around the vehicle.

    Each component of the gust is a first-order Gauss-Markov process, whose spectrum is Dryden's longitudinal one
    (MIL-F-8785C, 3.7.1.2) with a correlation time of length scale over airspeed.
    """

    v_ned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity of the steady air in ned, m/s."""
    gust_sigma_m_s: float = 0.0
    """Sigma of each horizontal component; the vertical component has half of it."""
    gust_time_s: float = 2.0


class Disturbances:
    """Random processes of one vehicle, or of B; each starts in its steady state and is exact for any step length.

    Args:
        seeds: one for each vehicle; each draws from its own generator, so that it meets the same alone and in a batch.
        single: numbers are floats instead of (B,) arrays.
    """

    def __init__(self, wind: Wind, avionics: Avionics, step_s: float, seeds: list[np.random.SeedSequence], single: bool) -> None:
        self._noise = Noise(seeds, single)
        start, bias = self._noise.next(), self._noise.next()
        av = avionics
        self._gust = _Memory(wind.gust_sigma_m_s, wind.gust_time_s, step_s)
        self._flow = _Memory(av.flow_noise_sigma_m_s, av.flow_noise_time_s, step_s)
        self._drift = _Memory(av.tilt_drift_sigma_rad, av.tilt_drift_time_s, step_s)
        s = self._gust.sigma
        self.gust: Vec = (s * start[0], s * start[1], 0.5 * s * start[2])
        """Velocity of the gust in ned, m/s."""
        self.flow: tuple[Num, Num] = (self._flow.sigma * start[3], self._flow.sigma * start[4])
        """Error of the optical flow forward and right, m/s."""
        self._tilt_bias = (av.tilt_bias_sigma_rad * bias[0], av.tilt_bias_sigma_rad * bias[1])
        self._tilt_drift: tuple[Num, Num] = (self._drift.sigma * start[5], self._drift.sigma * start[6])

    @property
    def tilt(self) -> tuple[Num, Num]:
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
    """Standard normal numbers, `_CHANNELS` a step, drawn in blocks for speed."""

    def __init__(self, seeds: list[np.random.SeedSequence], single: bool) -> None:
        self._rngs = [np.random.Generator(np.random.PCG64(s)) for s in seeds]
        self._single = single
        self._block: list[list[float]] | F64 = []
        self._i = _BLOCK

    def next(self) -> Sequence[Num] | F64:
        """Each a float or (B,)."""
        if self._i == _BLOCK:
            self._i = 0
            if self._single:
                self._block = self._rngs[0].standard_normal((_BLOCK, _CHANNELS)).tolist()
            else:
                self._block = np.stack([rng.standard_normal((_BLOCK, _CHANNELS)) for rng in self._rngs], axis=-1)
        row = self._block[self._i]
        self._i += 1
        return row
