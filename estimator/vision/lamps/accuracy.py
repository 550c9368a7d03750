"""How accurately a pad can be measured by its lamps."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.lamp import Lamp, places_of

CENTRE_PX = 0.1
"""Assumed standard deviation of the centre of a lamp's spot."""
_RESOLVED_PX = 3.0
"""Least distance of two lamps that are two spots."""


@dataclass(frozen=True, slots=True)
class LampAccuracy:
    """The Cramer-Rao bound of one frame from straight above, its tilt known."""

    height_m: float
    lamps: int
    """Number of lamps in view."""
    spots: int
    """Number of spots that they make in the frame."""
    lateral_m: float
    """Standard deviation along the worse direction."""
    range_m: float
    yaw_rad: float
    """All three are infinite with fewer than two spots."""


def lamp_accuracy(lamps: tuple[Lamp, ...], camera: Camera, height_m: float) -> LampAccuracy:
    """Return what one frame tells from a height over the pad's centre, by spots whose centres are known to `CENTRE_PX`."""
    focal_px = 0.5 * (camera.fx + camera.fy)
    places = places_of(lamps)
    uv = focal_px / height_m * places
    # The top of the frame is ahead: x of the pad is up, y to the right.
    seen = (np.abs(uv[:, 0]) < 0.5 * camera.height) & (np.abs(uv[:, 1]) < 0.5 * camera.width)
    spots = _resolved(uv[seen])
    if len(spots) < 2:
        return LampAccuracy(height_m, int(seen.sum()), len(spots), math.inf, math.inf, math.inf)
    scale, none = focal_px / height_m, np.zeros(len(spots))
    along = np.stack([none + scale, none, -spots[:, 0] / height_m, -spots[:, 1]], axis=1)
    across = np.stack([none, none + scale, -spots[:, 1] / height_m, spots[:, 0]], axis=1)
    J = np.concatenate([along, across])
    cov = np.linalg.inv(J.T @ J) * CENTRE_PX**2
    lateral_m = math.sqrt(float(np.linalg.eigvalsh(cov[:2, :2])[-1]))
    return LampAccuracy(height_m, int(seen.sum()), len(spots), lateral_m, math.sqrt(cov[2, 2]), math.sqrt(cov[3, 3]))


def _resolved(uv: F64) -> F64:
    """Return the middles of the spots that lamps at these places make, (S, 2) px: those nearer than can be resolved are one."""
    spots: list[list[F64]] = []
    for place in uv:
        near = next((spot for spot in spots if any(np.linalg.norm(place - other) < _RESOLVED_PX for other in spot)), None)
        if near is None:
            spots.append([place])
        else:
            near.append(place)
    return np.array([np.mean(spot, axis=0) for spot in spots]).reshape(-1, 2)
