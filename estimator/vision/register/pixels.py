"""What is known of a camera's pixels beforehand: the ray of each, and the light of each value."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.srgb import LINEAR_LIGHT

U8 = NDArray[np.uint8]


@lru_cache(maxsize=8)
def ray_map(camera: Camera) -> NDArray[np.float64]:
    """Return (H, W, 2) x/z, y/z of every pixel of a camera with distortion; the result is cached."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
    return camera.rays(np.stack([u.ravel(), v.ravel()], axis=1)).reshape(camera.height, camera.width, 2)


@lru_cache(maxsize=2)
def light_table(gamma: bool) -> F64:
    """Return the linear light, (256,) 0..1, of a pixel's value: of sRGB, or the value itself without gamma."""
    return LINEAR_LIGHT if gamma else np.asarray(np.arange(256) / 255.0)
