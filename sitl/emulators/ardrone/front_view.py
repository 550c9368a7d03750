"""Render the view of the drone's forward camera at sea: sky, horizon, water. No pad is ever in it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation

HALF_WIDTH_TAN = 0.81
"""Tangent of half the horizontal field of view of the 92 degree (diagonal) lens."""

_SKY_HIGH, _SKY_LOW = np.array([205.0, 160.0, 110.0]), np.array([235.0, 222.0, 205.0])
_SEA_NEAR, _SEA_FAR = np.array([80.0, 60.0, 30.0]), np.array([130.0, 112.0, 85.0])


_GRAIN = np.random.default_rng(0).normal(0.0, 3.0, (1024, 1024, 1)).astype(np.float32)
_STEP = 331, 197
"""How far the grain moves from one frame to the next, px."""


def front_view(R_ned_body: Rotation, width: int = 640, height: int = 360, number: int = 0) -> NDArray[np.uint8]:
    """(height, width, 3) BGR: the horizon where roll and pitch put it, colours shaded by the angle from it.

    Args:
        number: of the frame. Each has its own noise, which gives its code the length of a real one's.
    """
    scale = 2.0 * HALF_WIDTH_TAN / width
    y = (np.arange(width) - (width - 1) / 2) * scale
    z = (np.arange(height) - (height - 1) / 2) * scale
    down = R_ned_body.matrix[2]
    below: F64 = (down[0] + down[1] * y[None, :] + down[2] * z[:, None]) / np.sqrt(1 + y[None, :] ** 2 + z[:, None] ** 2)
    shade = np.clip(np.abs(below) * 3.0, 0.0, 1.0)[..., None]
    sky = _SKY_LOW + (_SKY_HIGH - _SKY_LOW) * shade
    sea = _SEA_FAR + (_SEA_NEAR - _SEA_FAR) * shade
    top, left = number * _STEP[0] % (1024 - height), number * _STEP[1] % (1024 - width)
    noisy = np.where(below[..., None] > 0.0, sea, sky) + _GRAIN[top : top + height, left : left + width]
    return np.asarray(noisy.clip(0.0, 255.0), dtype=np.uint8)
