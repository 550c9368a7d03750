"""Draw the deck about the pad as seen from straight above, and remember what was found there."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between
from estimator.core.library import CORE
from estimator.vision.camera.pose import PadPose
from estimator.vision.detect.pyramid import U8, FrameView
from estimator.vision.detection import NearThing
from estimator.vision.native import checked, image_of

_LEVEL_MOST = 3  # Smallest size of the frame that is read: of smaller ones too much is lost where the frame ends
MOVED_LASTS_S = 10.0
"""Time for which what moves counts, s."""
STANDING_LASTS_S = 60.0
"""Time for which what stands counts, s. It is measured on the way down alone; a drone that waits must not forget it."""


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


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """The newest thing that was found, and how often it was shown."""

    thing: NearThing | None = None
    at: MonoNs | None = None
    """Exposure of the newest frame that showed it."""
    shown: int = 0
    """Number of readings that showed it."""
    missed: int = 0
    """Number of those since that showed its place without it."""

    def near(self, at: MonoNs) -> NearThing | None:
        """Return what was found lately."""
        if self.thing is None or self.at is None:
            return None
        lasts_s = STANDING_LASTS_S if self.thing.height_m > 0.0 else MOVED_LASTS_S
        return self.thing if seconds_between(self.at, at) <= lasts_s else None

    def without(self, most: int) -> Finding:
        """Return it after a reading of its place that does not show it; nothing after so many."""
        missed = self.missed + 1
        return replace(self, missed=missed) if missed < most else Finding(shown=self.shown, missed=missed)


def is_shown(thing: NearThing, shown: U8, step_m: float) -> bool:
    """Return whether a picture from above, of pixels of a size, shows the place on the deck where a thing was found."""
    x, y = (round(of_m / step_m) + (len(shown) - 1) // 2 for of_m in (thing.forward_m, thing.right_m))
    return 0 <= x < len(shown) and 0 <= y < len(shown) and bool(shown[y, x])
