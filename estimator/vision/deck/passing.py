"""Detect things that pass over the pad, faster than corners of them could be followed.

The deck about the pad is drawn as seen from above, in coarse cells, and compared with its slow mean (the sigma-delta background
of Manzanera & Richefeu, Pattern Recogn. Lett. 28, 2007). What lies there has the same share of that light as it had a fifth of a
second before, at the same place. The drone's own shadow, glare and drops on the lens have it at the same place in the drone's
cone, q = c + s h for a camera at height h over the place c. A patch that has neither passes. A flash and a drop that falls do so
too, but once: what few readings show from high above soon fades. A registration may be off by a cell: its light is looked for
among its neighbours.
"""

import math
from dataclasses import dataclass, field

import cv2
import numpy as np

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between
from estimator.vision.camera.pose import PadPose
from estimator.vision.deck.above import Finding, from_above, is_shown
from estimator.vision.deck.clear_deck import median
from estimator.vision.detect.pyramid import U8, FrameView
from estimator.vision.detect.template import F32
from estimator.vision.detection import NearThing

PASS_PERIOD_S = 0.19
"""Time between two frames that are read."""
LOW_M = 1.0
"""Height from which down a thing is in view for a shorter time, and one reading of it is enough."""
LOW_PERIOD_S = 0.09
"""Time between two frames that are read from there down."""
_SINCE_S = 0.15  # Least time between two frames that are compared
_GAP_S = 0.7  # Most time between two frames; after more the mean begins again
_CELL_M = 0.04  # Size of a cell
_MESH = 4  # Size of the mesh on which cells are drawn, in cells
_REACH_M = 0.5  # What is read beyond the disc
_STEP = 4  # Most by which the mean changes a frame, values of a pixel
_ONE = 64  # Share of the mean's light that is all of it
_FLOOR = 8  # Value added to light and mean where the share is taken: dark values are noise
_LEAST = 0.25  # Least change that counts, of the mean's light
_LEAST_VALUE = 10.0  # The same, in values of a pixel
_NOISES = 4.0  # The same, in mean changes of the cell
_SLOW = 0.1  # Weight of a frame in a cell's mean change
_CELLS_LEAST = 8  # Least number of cells of a thing
_SURE = 3  # Number of readings that show what passes from which on it counts for its whole time
_FADES = 10
"""Readings of a place without a thing after which one that was shown less often is nothing: a flash, or a drop that fell."""
_BOX = np.ones((3, 3), np.uint8)  # A cell and its neighbours
_DRONE_M = 0.3  # Half the width of the drone's shadow, which does not shrink with its cone


@dataclass(frozen=True, slots=True, eq=False)
class _Reading:
    at: MonoNs
    light: U8
    """Values of the cells, (N, N, 3)."""
    share: U8
    """The same over the mean's, in 1/64."""
    shown: U8
    below: F64
    """Place of the camera over the deck, (2,) m."""
    height_m: float


@dataclass(frozen=True, slots=True, eq=False)
class PassMemory:
    """The deck's slow mean, and the last readings."""

    mean: U8
    known: U8
    """Cells that the mean knows, 255."""
    noise: F32
    """Mean change of each cell, values of a pixel."""
    readings: tuple[_Reading, ...]
    finding: Finding = field(default_factory=Finding)

    @property
    def at(self) -> MonoNs:
        """Exposure of the newest frame that was read."""
        return self.readings[-1].at


def watch_passing(memory: PassMemory | None, view: FrameView, pose: PadPose, at: MonoNs) -> PassMemory:
    """Return the memory with what a frame shows of the pad, whose registered pose is `pose`, and about it."""
    since_s = math.inf if memory is None else seconds_between(memory.at, at)
    if memory is not None and 0.0 <= since_s < (LOW_PERIOD_S if pose.range_m < LOW_M else PASS_PERIOD_S):
        return memory
    light, shown = from_above(view, pose, view.pad.disc_radius_m + _REACH_M, _CELL_M, _MESH, 3)
    camera = -pose.R_cam_pad.matrix.T @ pose.t_cam_pad
    below, height_m = camera[:2], float(-camera[2])
    if memory is None or not 0.0 <= since_s <= _GAP_S:
        # Its share of a mean that is itself says nothing: a shadow that is there already would seem to come.
        now = _Reading(at, light, np.full_like(light, _ONE), np.zeros_like(shown), below, height_m)
        return PassMemory(
            light, shown, np.zeros(shown.shape, np.float32), (now,), Finding() if memory is None else memory.finding
        )
    mean = _mean_in(memory, light, shown)
    now = _Reading(at, light, _share_of(light, mean), shown, below, height_m)
    before = next((each for each in reversed(memory.readings) if seconds_between(each.at, at) >= _SINCE_S), None)
    noise, finding = memory.noise, memory.finding
    if before is not None:
        change, noise = _compare(before, now, mean, noise)
        finding = _finding(finding, now, _largest(change))
    kept = tuple(each for each in memory.readings if seconds_between(each.at, at) < _SINCE_S)
    last = memory.readings[: len(memory.readings) - len(kept)][-1:]
    return PassMemory(_nearer(mean, light, shown), memory.known | shown, noise, (*last, *kept, now), finding)


def _mean_in(memory: PassMemory, light: U8, shown: U8) -> U8:
    """Return the slow mean by a frame's exposure; the frame's light in cells that the mean does not know."""
    both = ((shown > 0) & (memory.known > 0))[::2, ::2]
    bright, was = (of[::2, ::2, 1][both].astype(np.float32) + _FLOOR for of in (light, memory.mean))
    mean = cv2.convertScaleAbs(memory.mean, alpha=float(median(bright / was)) if len(was) else 1.0)
    cv2.copyTo(light, cv2.bitwise_not(memory.known), mean)
    return np.asarray(mean, np.uint8)


def _share_of(light: U8, mean: U8) -> U8:
    bright, usual = (np.add(of, _FLOOR, dtype=np.float32) for of in (light, mean))
    return np.asarray(cv2.divide(bright, usual, scale=_ONE, dtype=cv2.CV_8U), np.uint8)


def _nearer(mean: U8, light: U8, shown: U8) -> U8:
    """Bring the mean, in place, a step nearer to a frame's light where that is shown; return it."""
    more, less = (np.minimum(off, np.uint8(_STEP)) for off in (cv2.subtract(light, mean), cv2.subtract(mean, light)))
    cv2.copyTo(cv2.subtract(cv2.add(mean, more), less), shown, mean)
    return mean


def _finding(old: Finding, now: _Reading, new: NearThing | None) -> Finding:
    """Return what is found after one more reading."""
    known = old.near(now.at)
    if new is not None:
        return Finding(new, now.at, _SURE if now.height_m < LOW_M else 1 + (0 if known is None else old.shown))
    if known is None or old.shown >= _SURE or not is_shown(known, now.shown, _CELL_M):
        return old
    return old.without(_FADES)


def _compare(before: _Reading, now: _Reading, mean: U8, noise: F32) -> tuple[U8, F32]:
    """Return the cells, (N, N), that differ from what they were, and from what the drone's cone says, and the cells' noise."""
    scale = before.height_m / max(now.height_m, 0.05)
    # A cell at q now had its light, if it is of the drone's cone, at c' + (q - c) h'/h.
    shift = (before.below - scale * now.below) / _CELL_M + (len(mean) - 1) / 2 * (1.0 - scale)
    to, size = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]]), mean.shape[:2]
    linear = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    own = [np.asarray(cv2.warpAffine(of, to, size, flags=linear), np.uint8) for of in (before.share, before.light)]
    own_seen = cv2.warpAffine(before.shown, to, size, flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP)
    # What comes in from where nothing was read may be the drone's own.
    change = cv2.min(cv2.min(before.shown, now.shown), cv2.erode(own_seen, _BOX))
    level = np.minimum(mean, 255 - _FLOOR) + np.uint8(_FLOOR)
    # The cone shrinks with the height, and the drone's shadow does not: its rim is off by that much.
    rim = 1 + int(_DRONE_M * abs(scale - 1.0) / _CELL_M)
    for off in (
        *(cv2.multiply(_off(now.share, of, far), level, scale=1.0 / _ONE) for of, far in ((before.share, 1), (own[0], rim))),
        _off(now.light, own[1], rim), cv2.absdiff(now.light, mean),
    ):  # fmt: skip
        change = cv2.min(change, _most(np.asarray(off, np.uint8)))
    values = np.asarray(change, np.float32)
    least = np.maximum(np.maximum(_LEAST * _most(mean).astype(np.float32), _LEAST_VALUE), _NOISES * noise)
    return (values > least).astype(np.uint8), noise + np.float32(_SLOW) * (values - noise)


def _off(now: U8, before: U8, far: int) -> U8:
    """Return how far values are off those that the cell and its neighbours had, (N, N, 3).

    Args:
        far: distance of the neighbours, in cells, whose shade may have come here.
    """
    box = np.ones((2 * far + 1, 2 * far + 1), np.uint8)
    more, less = cv2.subtract(now, cv2.dilate(before, _BOX)), cv2.subtract(cv2.erode(before, box), now)
    return np.asarray(cv2.max(more, less), np.uint8)


def _most(of: U8) -> U8:
    """Return the largest of the channels of each cell, (N, N)."""
    blue, green, red = cv2.split(of)
    return np.asarray(cv2.max(cv2.max(blue, green), red), np.uint8)


def _largest(change: U8) -> NearThing | None:
    """Return the largest patch of cells that changed."""
    _, _, stats, middles = cv2.connectedComponentsWithStats(change, connectivity=8)
    stats[0, cv2.CC_STAT_AREA] = 0  # what did not change
    best = int(stats[:, cv2.CC_STAT_AREA].argmax())
    if stats[best, cv2.CC_STAT_AREA] < _CELLS_LEAST:
        return None
    x, y = ((middles[best] - (len(change) - 1) / 2) * _CELL_M).tolist()
    return NearThing(x, y, 0.0)
