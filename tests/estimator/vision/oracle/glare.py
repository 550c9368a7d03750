"""Model a reflection of the sun on the distant pad: added light, flat in the middle and soft at the rim.

The added light is estimated together with the paints, so that it biases no edge. Its position and width are chosen from a few
candidates by the fraction of the residuals they explain, and then follow its gradients from one linearisation to the next.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.pad import Pad
from tests.estimator.vision.oracle.blurred import F32

_RADII = (0.35, 0.6, 0.9)
"""Radii within which half of the light lies, as fractions of the disc's radius."""
_LEAST_GAIN = 0.35
"""Smallest fraction of the squared residuals that a reflection has to explain."""
_MOST_MOVED = 0.15
"""Largest move in one linearisation, as a fraction of the disc's radius."""
CLIPPED = 0.9
"""Light above which a sensor's smoothed pixel may be clipped."""
COLUMNS = 4


@dataclass(frozen=True, slots=True)
class GlareBlob:
    """Position and width of a reflection on the pad, m."""

    x: float
    y: float
    radius: float

    def columns(self, x: F32, y: F32) -> F64:
        """Return (4, N): its light at (N,) positions, 1 in the middle, and the derivatives by x, y and the radius, per metre."""
        dx, dy = x - self.x, y - self.y
        q = (dx * dx + dy * dy) / self.radius**2
        light = np.exp(-math.log(2.0) * q * q)
        steep = light * q * (4.0 * math.log(2.0) / self.radius**2)
        return np.array([light, steep * dx, steep * dy, steep * q * self.radius], float)

    def moved(self, amplitudes: F64, pad: Pad) -> GlareBlob:
        """Return the reflection moved by the (4,) amplitudes of its columns."""
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
    """Return the reflection that explains most of the residuals; None if none explains enough.

    Args:
        x, y: (N,) positions on the pad, m.
        residual, weight: (3, N) residual light of the paints, and its weight.
        values: (K, N) regressors of the paints, which explain some of a reflection's light themselves.
    """
    w = weight.mean(axis=0)
    total = float((w * residual * residual).sum())
    tried = _tried(pad)
    light = np.stack([reflection.columns(x, y)[0] for reflection in tried])
    vw = values * w
    M = vw @ values.T + 1e-7 * float(w.sum()) * np.eye(len(values))
    own = light - (light @ vw.T) @ np.linalg.solve(M, values)
    size = np.maximum((own * own) @ w, 1e-3 * float((light * light @ w).max()))
    amplitude = (own * w) @ residual.T / size[:, None]
    gain = np.where(amplitude.sum(axis=1) > 0.0, (amplitude**2).sum(axis=1) * size, 0.0)
    best = int(np.argmax(gain))
    return tried[best] if gain[best] > _LEAST_GAIN * total else None
