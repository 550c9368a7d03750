"""Search a frame for the pattern of a pad's lamps, with no idea where it is.

Seen level, the pad's plane is a similarity of the drawing: two spots that are two lamps tell place, height and heading. Every
pair of spots is tried as every one of some pairs of lamps, and each of these poses is asked how many spots it explains.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import OrientedCamera
from tests.estimator.vision.oracle.lamps.spots import Spots

SPOTS = 18
"""The brightest so many spots are paired."""
_PAIRS = 10
"""Pairs of lamps that are tried among the outer lamps, and as many among the inner ones: near the pad only these are in view."""
_LOWEST_M, _HIGHEST_M = 0.1, 40.0
"""Heights of the camera that are tried."""
_REACH_PX, _CLOSE_PX = 2.5, 1.5
"""Largest distance of a lamp from its spot in a pose that two spots tell, and of a lamp of a small pattern."""
_SMALL_PX = 30.0
"""Largest distance of a small pattern's lamps from its centre, along the worse axis of the pad."""
_MARGIN = 4
"""Cells of the table of spots beyond the outermost: what lies there is near none of them."""
_KEPT = 6

C128 = NDArray[np.complex128]


def search(spots: Spots, lamps_m: F64, view: OrientedCamera) -> list[PadPose]:
    """Return poses of the pad that two spots tell, those that explain the most spots first.

    Args:
        lamps_m: places of the lamps on the pad, (L, 2) m.
    """
    q = _complex(view.plane(spots.uv_px[:SPOTS]))
    q = q[np.isfinite(q)]
    if len(q) < 3:
        return []
    lamps = _complex(lamps_m)
    pairs = tried(tuple(map(tuple, lamps_m.tolist())))
    i, j = (at.ravel() for at in np.nonzero(~np.eye(len(q), dtype=bool)))
    k, m = pairs.T
    by = (q[j] - q[i])[:, None] / (lamps[m] - lamps[k])[None]
    start = q[i][:, None] - by * lamps[k][None]
    height = 1.0 / np.maximum(np.abs(by), 1e-9)
    kept = np.flatnonzero((height > _LOWEST_M) & (height < _HIGHEST_M))
    by, start = by.ravel()[kept], start.ravel()[kept]
    explained = _explained(q, lamps, by, start, view.camera.fx)
    found: list[PadPose] = []
    for at in np.argsort(-explained, kind="stable"):
        if len(found) == _KEPT or explained[at] < 3:
            break
        pose = _pose(complex(by[at]), complex(start[at]), view)
        if all(np.linalg.norm(pose.t_cam_pad - other.t_cam_pad) > 0.02 * pose.range_m or _turned(pose, other) for other in found):
            found.append(pose)
    return found


def _explained(q: C128, lamps: C128, by: C128, start: C128, focal_px: float) -> NDArray[np.int64]:
    """Return how many different spots each pose explains.

    Which spot lies within reach of a place is read from a table with a cell for each pixel's width.
    """
    column, row = np.rint(q.real * focal_px), np.rint(q.imag * focal_px)
    left, top = column.min() - _MARGIN, row.min() - _MARGIN
    width, height = (int(x.max() - x.min()) + 2 * _MARGIN + 1 for x in (column, row))
    table = np.zeros((2, width, height), np.int64)
    around = np.arange(-math.ceil(_REACH_PX), math.ceil(_REACH_PX) + 1)
    away2 = around[:, None] ** 2 + around[None] ** 2
    for n, (c, r) in enumerate(zip((column - left).astype(int), (row - top).astype(int), strict=True)):
        for of, reach_px in zip(table, (_REACH_PX, _CLOSE_PX), strict=True):
            of[np.ix_(c + around, r + around)] |= np.where(away2 <= reach_px**2, np.int64(1) << n, 0)
    at = (start[:, None] + by[:, None] * lamps[None]) * focal_px
    i = np.clip(np.rint(at.real - left), 0, width - 1).astype(np.int64)
    j = np.clip(np.rint(at.imag - top), 0, height - 1).astype(np.int64)
    size_px = np.abs(by) * max(float(np.abs(lamps.real).max()), float(np.abs(lamps.imag).max())) * focal_px
    small = (size_px < _SMALL_PX).astype(np.int64)[:, None]
    bits = np.bitwise_or.reduce(table.reshape(2, -1)[small, i * height + j], axis=1)
    return np.asarray(np.bitwise_count(bits), np.int64)


@lru_cache(maxsize=8)
def tried(places: tuple[tuple[float, ...], ...]) -> NDArray[np.int64]:
    """Return pairs of lamps, (P, 2): the farthest apart among all of them, and among the inner half."""
    lamps = np.array(places)
    order = np.argsort(np.linalg.norm(lamps - np.median(lamps, axis=0), axis=1))
    inner = order[: max(3, len(lamps) // 2)]
    return np.array([*_farthest(lamps, range(len(lamps))), *_farthest(lamps, inner.tolist())])


def _farthest(lamps: F64, among: Sequence[int]) -> list[tuple[int, int]]:
    pairs = sorted(combinations(among, 2), key=lambda pair: -float(np.linalg.norm(lamps[pair[0]] - lamps[pair[1]])))
    return pairs[:_PAIRS]


def _complex(places: F64) -> C128:
    """Return forward and right as one complex number each: a turn clockwise, seen from above, is a factor."""
    return np.asarray(places[:, 0] + 1j * places[:, 1])


def _pose(by: complex, start: complex, view: OrientedCamera) -> PadPose:
    height = 1.0 / abs(by)
    t_level = height * np.array([start.real, start.imag, 1.0])
    R = view.R_level_cam.T @ Rotation.from_rpy(0.0, 0.0, math.atan2(by.imag, by.real)).matrix
    return PadPose(Rotation(R), view.R_level_cam.T @ t_level)


def _turned(a: PadPose, b: PadPose) -> bool:
    return a.R_cam_pad.angle_to(b.R_cam_pad) > 0.1
