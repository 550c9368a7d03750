"""Draw the deck about the pad as seen from straight above, where everything painted on it stays where it is."""

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.vision.detect.pyramid import FrameView
from estimator.vision.pad_pose import PadPose

U8 = NDArray[np.uint8]
_LEVEL_MOST = 3
"""Smallest size of the frame that is read: of smaller ones too much is lost where the frame ends."""


def from_above(view: FrameView, pose: PadPose, reach_m: float, step_m: float, mesh: int) -> tuple[U8, U8]:
    """Return the deck about the pad, (N, N, 3), x to the right and y down, and where the frame shows it, (N, N), 255.

    Args:
        pose: the registered pose of the pad in `cam`.
        reach_m: least distance from the pad's centre along each axis that is drawn.
        step_m: size of a pixel; the pad's centre is the middle one.
        mesh: distance of the points that are projected, in pixels.
    """
    nodes = math.ceil(reach_m / (mesh * step_m))
    side = np.arange(-nodes, nodes + 1) * mesh * step_m
    x, y = np.meshgrid(side, side)
    points = pose.points(np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1))
    ahead = points[:, 2] > 0.05
    uv = np.where(ahead[:, None], view.camera.project(np.where(ahead[:, None], points, 1.0)), -1e4)
    level = min(_LEVEL_MOST, math.floor(math.log2(max(1.0, step_m * view.camera.fx / pose.range_m))))
    px = view.pyramid[level]
    on_level = ((uv + 0.5) / (1 << level) - 0.5).astype(np.float32).reshape(len(side), len(side), 2)
    fine = cv2.remap(on_level, *_between(nodes, mesh), cv2.INTER_LINEAR)
    above = cv2.remap(px, fine, np.empty(0, np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    h, w = px.shape[:2]
    return np.asarray(above, np.uint8), np.asarray(cv2.inRange(fine, (1.0, 1.0), (w - 2.0, h - 2.0)), np.uint8)


@lru_cache(maxsize=8)
def _between(nodes: int, mesh: int) -> tuple[NDArray[np.int16], NDArray[np.uint16]]:
    """Return the places of the pixels between the points that are projected, as OpenCV's fixed-point maps."""
    at = np.linspace(0.0, 2.0 * nodes, 2 * nodes * mesh + 1, dtype=np.float32)
    fixed, part = cv2.convertMaps(*np.meshgrid(at, at), cv2.CV_16SC2)
    return np.asarray(fixed, np.int16), np.asarray(part, np.uint16)
