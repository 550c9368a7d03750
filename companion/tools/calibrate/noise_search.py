"""The sizes of a flight's errors: those under which its residuals are likeliest."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from companion.tools.calibrate.whitening import Noise
from estimator.contracts.geometry import F64

_LIMITS = {
    "view": (0.2, 50.0),
    "gyro_rad_sqrt_s": (1e-5, 0.3),
    "tilt_rad": (1e-4, 0.3),
    "tilt_s": (0.1, 30.0),
    "heading_rad": (1e-4, 1.0),
    "deck_rad": (1e-5, 0.3),
}
"""The numbers that are searched, with their ranges."""
_FACTORS = (4.0, 1.7, 1.25)
_WORTH = 0.5
"""Twice the logarithm of the likelihood that a step has to gain."""
_MOST_STEPS = 15


def likeliest(start: Noise, scores: Callable[[Sequence[Noise]], F64]) -> Noise:
    """Return the noise of the lowest score: the best of all steps of one number by a factor, again and again, coarse, then fine.

    Args:
        scores: minus twice the logarithm of the likelihood of each noise.
    """
    best, value = start, float(scores([start])[0])
    for factor in _FACTORS:
        for _ in range(_MOST_STEPS):
            near = _neighbours(best, factor)
            found = scores(near)
            i = int(np.argmin(found))
            if float(found[i]) > value - _WORTH:
                break
            best, value = near[i], float(found[i])
    return best


def _neighbours(of: Noise, factor: float) -> list[Noise]:
    out = []
    for name, (low, high) in _LIMITS.items():
        for by in (factor, 1.0 / factor):
            size = getattr(of, name) * by
            if low <= size <= high:
                out.append(of._replace(**{name: size}))
    return out
