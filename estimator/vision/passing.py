"""Detect objects passing over the pad: patches of the deck's picture that change, and not as the drone's own shadow does.

A thing that moves fast is gone before corners of it could be followed. The deck about the pad is drawn as seen from above, in
coarse cells, and compared with its slow mean (the sigma-delta background of Manzanera & Richefeu, Pattern Recogn. Lett. 28,
2007). What lies there has the same share of that light as it had a fifth of a second before, at the same place. The drone's own
shadow, glare and drops on the lens have it at the same place in the drone's cone, q = c + s h for a camera at height h over the
place c. A patch that has neither passes. A registration may be off by a cell: its light is looked for among its neighbours.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between
from estimator.vision.detect.pyramid import FrameView
from estimator.vision.detection import NearThing
from estimator.vision.from_above import from_above
from estimator.vision.pad_pose import PadPose

F32 = NDArray[np.float32]

_PERIOD_S, _SINCE_S, _GAP_S, LASTS_S = 0.09, 0.15, 0.7, 10.0
"""Time between two frames that are read, least and most between two that are compared, and for which a finding counts, s."""
_CELL_M, _MESH, _REACH_M = 0.04, 4, 0.5
"""Size of a cell, of the mesh on which cells are drawn, in cells, and what is read beyond the disc."""
_STEP = 4.0
"""Most by which the mean changes a frame, values of a pixel."""
_LEAST, _LEAST_VALUE, _NOISES = 0.25, 10.0, 4.0
"""Change that counts: of the mean's light, in values of a pixel, and in mean changes of the cell."""
_CELLS_LEAST = 8
"""Least number of cells of a thing."""
_FLOOR = 8.0
"""Added to values of a pixel where their ratios are taken: dark values are noise."""


@dataclass(frozen=True, slots=True, eq=False)
class _Reading:
    at: MonoNs
    light: F32
    """Values of the cells, (N, N, 3)."""
    share: F32
    """The same over the mean's."""
    shown: NDArray[np.uint8]
    below: F64
    """Place of the camera over the deck, (2,) m."""
    height_m: float


@dataclass(frozen=True, slots=True, eq=False)
class PassMemory:
    """The deck's slow mean, the last readings, and the newest finding."""

    mean: F32
    known: NDArray[np.uint8]
    """Cells that the mean knows, 255."""
    noise: F32
    """Mean change of each cell, values of a pixel."""
    readings: tuple[_Reading, ...]
    found: NearThing | None = None
    found_at: MonoNs | None = None

    @property
    def at(self) -> MonoNs:
        """Exposure of the newest frame that was read."""
        return self.readings[-1].at

    def near(self, at: MonoNs) -> NearThing | None:
        """Return what passed lately."""
        if self.found is None or self.found_at is None or seconds_between(self.found_at, at) > LASTS_S:
            return None
        return self.found


def passed(memory: PassMemory | None, view: FrameView, pose: PadPose, at: MonoNs) -> PassMemory:
    """Return the memory with what a frame shows of the pad, whose registered pose is `pose`, and about it."""
    since_s = math.inf if memory is None else seconds_between(memory.readings[-1].at, at)
    if memory is not None and 0.0 <= since_s < _PERIOD_S:
        return memory
    above, shown = from_above(view, pose, view.pad.disc_radius_m + _REACH_M, _CELL_M, _MESH)
    light = above.astype(np.float32)
    centre = -pose.R_cam_pad.matrix.T @ pose.t_cam_pad
    if memory is None or not 0.0 <= since_s <= _GAP_S:
        now = _Reading(at, light, np.ones_like(light), shown, centre[:2], float(-centre[2]))
        found, found_at = (None, None) if memory is None else (memory.found, memory.found_at)
        return PassMemory(light, shown, np.zeros(shown.shape, np.float32), (now,), found, found_at)
    both = ((shown > 0) & (memory.known > 0))[::2, ::2]
    green = [of[::2, ::2, 1][both] + _FLOOR for of in (light, memory.mean)]
    gain = float(np.median(green[0] / green[1])) if len(green[0]) else 1.0
    mean = np.where(memory.known[..., None] > 0, memory.mean * gain, light)
    now = _Reading(at, light, (light + _FLOOR) / (mean + _FLOOR), shown, centre[:2], float(-centre[2]))
    found, found_at, noise = memory.found, memory.found_at, memory.noise
    before = next((each for each in reversed(memory.readings) if seconds_between(each.at, at) >= _SINCE_S), None)
    if before is not None:
        change = _change(before, now, mean)
        new = _largest(change, mean, noise, view.pad.disc_radius_m)
        noise = noise + 0.1 * (change - noise)
        found, found_at = (found, found_at) if new is None else (new, at)
    mean = np.where(shown[..., None] > 0, mean + np.clip(light - mean, -_STEP, _STEP), mean).astype(np.float32)
    kept = tuple(each for each in memory.readings if seconds_between(each.at, at) < _SINCE_S)
    last = tuple(each for each in memory.readings if each not in kept)[-1:]
    return PassMemory(mean, memory.known | shown, noise, (*last, *kept, now), found, found_at)


def _change(before: _Reading, now: _Reading, mean: F32) -> F32:
    """Return by how much each cell differs from what it was, and from what the drone's cone says, (N, N) values of a pixel."""
    scale = before.height_m / max(now.height_m, 0.05)
    middle = (len(mean) - 1) / 2
    # A cell at q now had its light, if it is of the drone's cone, at c' + (q - c) h'/h.
    shift = (before.below - scale * now.below) / _CELL_M + middle * (1.0 - scale)
    to = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size = (len(mean), len(mean))
    seen = np.minimum(before.shown, now.shown)
    own_seen = cv2.warpAffine(before.shown, to, size, flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP, borderValue=0)
    own_share = cv2.warpAffine(before.share, to, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    own_light = cv2.warpAffine(before.light, to, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    level = mean + _FLOOR
    there = _off(now.share, before.share) * level
    cone = np.minimum(_most(_off(now.share, own_share) * level), _most(_off(now.light, own_light)))
    # What comes in from where nothing was read may be the drone's own.
    seen = np.minimum(seen, cv2.erode(own_seen, np.ones((3, 3), np.uint8)))
    plain = _most(np.abs(now.share - 1.0) * level)
    least = np.minimum(np.minimum(_most(there), cone), plain)
    return np.asarray(np.where(seen > 0, least, 0.0), np.float32)


def _off(now: F32, before: F32) -> F32:
    """Return how far values are off those that the cell and its neighbours had."""
    box = np.ones((3, 3), np.uint8)
    return np.asarray(np.maximum(np.maximum(now - cv2.dilate(before, box), cv2.erode(before, box) - now), 0.0), np.float32)


def _most(of: F32) -> F32:
    """Return the largest of the channels of each cell, (N, N)."""
    return np.asarray(np.maximum(np.maximum(of[..., 0], of[..., 1]), of[..., 2]), np.float32)


def _largest(change: F32, mean: F32, noise: F32, disc_radius_m: float) -> NearThing | None:
    """Return the largest patch of cells that changed."""
    limit = np.maximum(np.maximum(_LEAST * _most(mean), _LEAST_VALUE), _NOISES * noise)
    count, _, stats, middles = cv2.connectedComponentsWithStats((change > limit).astype(np.uint8), connectivity=8)
    if count < 2:
        return None
    best = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    if stats[best, cv2.CC_STAT_AREA] < _CELLS_LEAST:
        return None
    x, y = ((middles[best] - (len(mean) - 1) / 2) * _CELL_M).tolist()
    return NearThing(x, y, 0.0)
