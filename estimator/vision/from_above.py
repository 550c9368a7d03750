"""Draw the deck about the pad as seen from straight above, where everything painted on it stays where it is."""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.library import CORE
from estimator.vision.detect.pyramid import FrameView
from estimator.vision.native import checked, image_of
from estimator.vision.pad_pose import PadPose

U8 = NDArray[np.uint8]
_LEVEL_MOST = 3
"""Smallest size of the frame that is read: of smaller ones too much is lost where the frame ends."""


@lru_cache(maxsize=8)
def _nodes(each_side: int, apart_m: float) -> F64:
    """Return the points of the mesh, ((2 each_side + 1)^2, 3) m."""
    side = np.arange(-each_side, each_side + 1) * apart_m
    x, y = np.meshgrid(side, side)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)


def from_above(view: FrameView, pose: PadPose, reach_m: float, step_m: float, mesh: int, channels: int) -> tuple[U8, U8]:
    """Return the deck about the pad, (N, N, 3) or (N, N), x to the right and y down, and where the frame shows it, 255.

    Args:
        pose: the registered pose of the pad in `cam`.
        reach_m: least distance from the pad's centre along each axis that is drawn.
        step_m: size of a pixel; the pad's centre is the middle one.
        mesh: distance of the points that are projected, in pixels.
        channels: 3 for BGR, 1 for green.
    """
    nodes = math.ceil(reach_m / (mesh * step_m))
    points = pose.points(_nodes(nodes, mesh * step_m))
    ahead = points[:, 2] > 0.05
    uv = np.where(ahead[:, None], view.camera.project(np.where(ahead[:, None], points, 1.0)), -1e4)
    level = min(_LEVEL_MOST, math.floor(math.log2(max(1.0, step_m * view.camera.fx / pose.range_m))))
    places = ((uv + 0.5) / (1 << level) - 0.5).astype(np.float32)
    size = 2 * nodes * mesh + 1
    above = np.empty((size, size, 3) if channels == 3 else (size, size), np.uint8)
    shown = np.empty((size, size), np.uint8)
    checked(
        CORE.lib.dl_from_above(
            image_of(view.pyramid[level]), CORE.array("float", places), 2 * nodes + 1, mesh, channels,
            CORE.array("uint8_t", above), CORE.array("uint8_t", shown),
        )
    )  # fmt: skip
    return above, shown
