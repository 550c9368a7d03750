"""A reflection of the sun on the distant pad: light that is added to it, flat in the middle and soft at the rim.

What it adds is modelled beside the paints, so that it pulls at no edge: where it is and how wide is found among a few places by
how much of the residuals it explains, and followed from one linearisation to the next by its slopes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.drawing import F32
from estimator.vision.pad import Pad

_RADII = (0.35, 0.6, 0.9)
"""Of the disc's radius: half of the light is there."""
_LEAST_GAIN = 0.35
"""Of the residuals' squares that a reflection has to explain."""
_MOST_MOVED = 0.15
"""Of the disc's radius, by one linearisation."""
CLIPPED = 0.9
"""Light over which a sensor's pixel, smoothed, may hold less than there was."""
COLUMNS = 4


@dataclass(frozen=True, slots=True)
class GlareBlob:
    """On the pad, m."""

    x: float
    y: float
    radius: float

    def columns(self, x: F32, y: F32) -> F64:
        """(4, N) its light at places (N,), 1 in the middle, and the change of it with x, y and the radius, a metre each."""
        dx, dy = x - self.x, y - self.y
        q = (dx * dx + dy * dy) / self.radius**2
        light = np.exp(-math.log(2.0) * q * q)
        steep = light * q * (4.0 * math.log(2.0) / self.radius**2)
        return np.array([light, steep * dx, steep * dy, steep * q * self.radius], float)

    def moved(self, amplitudes: F64, pad: Pad) -> GlareBlob:
        """Followed, by the (4,) amplitudes of its columns."""
        if not amplitudes[0] > 0.0:
            return self
        limit = _MOST_MOVED * pad.disc_radius_m
        dx, dy, wider = np.clip(amplitudes[1:] / amplitudes[0], -limit, limit)
        radius = min(max(self.radius + float(wider), 0.2 * pad.disc_radius_m), 1.5 * pad.disc_radius_m)
        return GlareBlob(self.x + float(dx), self.y + float(dy), radius)


@lru_cache(maxsize=4)
def _tried(pad: Pad) -> tuple[GlareBlob, ...]:
    r = pad.disc_radius_m
    rings = ((0.0, 1), (0.35, 6), (0.75, 8))
    places = [(f * r, k * math.tau / n) for f, n in rings for k in range(n)]
    return tuple(GlareBlob(d * math.cos(a), d * math.sin(a), f * r) for f in _RADII for d, a in places)


def find(x: F32, y: F32, residual: F64, weight: F64, values: F64, pad: Pad) -> GlareBlob | None:
    """The reflection that explains most of the residuals, or None where none explains much.

    Args:
        x, y: (N,) places on the pad, m.
        residual, weight: (3, N) of the light that the paints do not explain.
        values: (K, N) of the paints, which explain some of a reflection's light themselves.
    """
    w = weight.mean(axis=0)
    total = float((w * residual * residual).sum())
    tried = _tried(pad)
    light = np.stack([spot.columns(x, y)[0] for spot in tried])
    vw = values * w
    M = vw @ values.T + 1e-7 * float(w.sum()) * np.eye(len(values))
    own = light - (light @ vw.T) @ np.linalg.solve(M, values)
    size = np.maximum((own * own) @ w, 1e-3 * float((light * light @ w).max()))
    amplitude = (own * w) @ residual.T / size[:, None]
    gain = np.where(amplitude.sum(axis=1) > 0.0, (amplitude**2).sum(axis=1) * size, 0.0)
    best = int(np.argmax(gain))
    return tried[best] if gain[best] > _LEAST_GAIN * total else None
