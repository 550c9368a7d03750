"""A low-pass filter as autopilots have it before their gyros and accelerometers."""

from __future__ import annotations

import math

import numpy as np

from estimator.contracts.geometry import F64

_ROOT = math.sqrt(2.0)


class LowPass:
    """A Butterworth filter of the second order for vectors, by the bilinear transform.

    Source: Oppenheim, Schafer, Discrete-Time Signal Processing, section 7.2.

    Args:
        start: the vector before the first step, at which it has settled.
        step_s: interval between steps.
    """

    def __init__(self, start: F64, step_s: float) -> None:
        self._step_s = step_s
        self._in, self._out = [start, start], [start, start]

    @property
    def value(self) -> F64:
        """What has passed the filter."""
        return self._out[0]

    def step(self, value: F64, cutoff_hz: float) -> None:
        """Pass one more vector; a cutoff of 0 switches the filter off."""
        passed = np.asarray(value, dtype=float)
        if cutoff_hz > 0.0:
            k = math.tan(math.pi * min(cutoff_hz * self._step_s, 0.4))
            scale = 1.0 + _ROOT * k + k * k
            gathered = k * k * (value + 2.0 * self._in[0] + self._in[1])
            passed = (gathered - 2.0 * (k * k - 1.0) * self._out[0] - (1.0 - _ROOT * k + k * k) * self._out[1]) / scale
        self._in, self._out = [value, self._in[0]], [passed, self._out[0]]
