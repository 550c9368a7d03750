"""Which spots of a frame are which lamps of a pad at a pose, and what speaks for and against it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.lamp import Lamp, places_of
from estimator.vision.pad_pose import PadPose
from tests.estimator.vision.oracle.lamps.spots import Spots

_ALONE, _SHARED = 0.06, 0.35
"""Part of a spot's radius by which its centre may differ from that of the one lamp, or of the lamps, in it, beyond the reach."""
_INSET_PX, _INSET_RADII = 5.0, 2.0
"""A lamp this near to the frame's edge, and so many of its radii, need not show: its spot may be cut."""
_ABOUT = 1.2
"""Radius of the pad's surroundings over that of the outermost lamp: other spots in them speak against the pad."""


@dataclass(frozen=True, slots=True, eq=False)
class Assignment:
    """The lamps of a pad at a pose, and the spots that they make. Lamps that the frame does not resolve make one spot."""

    lamp: NDArray[np.int64]
    """Lamps that have a spot, (M,)."""
    spot: NDArray[np.int64]
    """The spot of each, (M,): several lamps may have the same."""
    expected: int
    """Number of separate spots that the lamps in view would make."""
    strangers: int
    """Number of spots about the pad that no lamp explains."""
    area_px2: float
    """Area of the pad's surroundings in the frame."""

    @property
    def groups(self) -> int:
        """Number of spots that lamps explain."""
        return len(np.unique(self.spot))


def assign(spots: Spots, lamps: Sequence[Lamp], pose: PadPose, camera: Camera, reach_px: float) -> Assignment:
    """Assign the lamps in view to the nearest spots.

    Args:
        lamps: the pad's.
        reach_px: largest distance of a lamp from its spot's centre, or of the lamps that share a spot from it on average.
    """
    lamps_m = places_of(lamps)
    at = pose.points(np.pad(lamps_m, ((0, 0), (0, 1))))
    uv = camera.project(at)
    radius_px = camera.fx * np.array([lamp.radius_m for lamp in lamps]) / np.maximum(at[:, 2], 0.02)
    inset = (_INSET_PX + _INSET_RADII * radius_px)[:, None]
    inside = np.all((uv > inset) & (uv < np.array([camera.width, camera.height]) - 1.0 - inset), axis=1)
    seen = np.flatnonzero(inside)
    if not len(seen):
        return Assignment(seen, seen, 0, 0, 1.0)
    away = np.linalg.norm(uv[seen, None] - spots.uv_px[None], axis=2)
    nearest = away.argmin(axis=1)
    close = away[np.arange(len(seen)), nearest] <= reach_px + spots.radius_px[nearest]
    lamp, spot = seen[close], nearest[close]
    good = np.zeros(len(lamp), bool)
    for s in np.unique(spot):
        mine = spot == s
        off = float(np.linalg.norm(uv[lamp[mine]].mean(axis=0) - spots.uv_px[s]))
        good |= mine & (off <= reach_px + (_ALONE if mine.sum() == 1 else _SHARED) * spots.radius_px[s])
    lamp, spot = lamp[good], spot[good]
    about, area = _about(spots, lamps_m, pose, camera)
    strangers = int(np.count_nonzero(about)) - int(np.count_nonzero(about[np.unique(spot)]))
    return Assignment(lamp, spot, _separate(uv[seen], lamp, spot, seen), max(0, strangers), area)


def _separate(uv_seen: F64, lamp: NDArray[np.int64], spot: NDArray[np.int64], seen: NDArray[np.int64]) -> int:
    """Return how many spots the lamps in view would make: those that share one count once, and each without one that is apart."""
    found = np.isin(seen, lamp)
    made = len(np.unique(spot))
    if found.all():
        return made
    if not found.any():
        return len(seen)
    missing, others = uv_seen[~found], uv_seen[found]
    apart = np.linalg.norm(missing[:, None] - others[None], axis=2).min(axis=1)
    return made + int(np.count_nonzero(apart > 6.0))


def _about(spots: Spots, lamps_m: F64, pose: PadPose, camera: Camera) -> tuple[NDArray[np.bool_], float]:
    """Return which spots lie about the pad, and the area of that part of the frame, px^2."""
    middle = 0.5 * (lamps_m.min(axis=0) + lamps_m.max(axis=0))
    reach_m = _ABOUT * float(np.linalg.norm(lamps_m - middle, axis=1).max())
    centre = pose.points(np.append(middle, 0.0)[None])[0]
    if centre[2] <= 0.02:
        return np.zeros(len(spots), bool), 1.0
    uv, radius = camera.project(centre[None])[0], camera.fx * reach_m / centre[2]
    width = max(1.0, min(uv[0] + radius, camera.width) - max(uv[0] - radius, 0.0))
    height = max(1.0, min(uv[1] + radius, camera.height) - max(uv[1] - radius, 0.0))
    return np.linalg.norm(spots.uv_px - uv, axis=1) < radius, float(np.pi / 4.0 * width * height)
