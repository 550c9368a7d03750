"""Detect things that pass over the pad, faster than corners of them could be followed.

The deck about the pad is drawn as seen from above, in coarse cells, and compared with its slow mean (the sigma-delta background
of Manzanera & Richefeu, Pattern Recogn. Lett. 28, 2007). What lies there has the same share of that light as it had a fifth of a
second before, at the same place. The drone's own shadow, glare and drops on the lens have it at the same place in the drone's
cone, q = c + s h for a camera at height h over the place c. A patch that has neither passes. A flash and a drop that falls do so
too, but once: what few readings show from high above soon fades. A registration may be off by a cell: its light is looked for
among its neighbours.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between
from estimator.vision.camera.pose import PadPose
from estimator.vision.deck.above import Found, from_above, is_shown
from estimator.vision.deck.clear_deck import median
from estimator.vision.detect.pyramid import U8, FrameView
from estimator.vision.detect.template import F32
from estimator.vision.detection import NearThing

PASS_PERIOD_S, LOW_PERIOD_S, LOW_M = 0.19, 0.09, 1.0
"""Time between two frames that are read, and from this height down, where a thing is in view for a shorter time."""
_SINCE_S, _PASS_GAP_S = 0.15, 0.7
"""Least and most time between two that are compared, s."""
_CELL_M, _PASS_MESH, _REACH_M = 0.04, 4, 0.5
"""Size of a cell, of the mesh on which cells are drawn, in cells, and what is read beyond the disc."""
_STEP = 4
"""Most by which the mean changes a frame, values of a pixel."""
_ONE, _FLOOR = 64, 8
"""Share of the mean's light that is all of it. Second: value added to both where it is taken: dark values are noise."""
_LEAST, _LEAST_VALUE, _NOISES = 0.25, 10.0, 4.0
"""Change that counts: of the mean's light, in values of a pixel, and in mean changes of the cell."""
_CELLS_LEAST = 8
"""Least number of cells of a thing."""
_PASSED_SURE, _PASSED_FADES = 3, 10
"""Number of readings that show what passes from which on it counts for `MOVED_LASTS_S`; below `LOW_M` one is enough. Second:
number of readings of its place without it after which one that was shown less often is nothing: a flash, or a drop that fell."""
_BOX = np.ones((3, 3), np.uint8)
_DRONE_M = 0.3
"""Half the width of the drone's shadow, which does not shrink with its cone."""


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
class PassMemory(Found):
    """The deck's slow mean, and the last readings."""

    mean: U8
    known: U8
    """Cells that the mean knows, 255."""
    noise: F32
    """Mean change of each cell, values of a pixel."""
    readings: tuple[_Reading, ...]

    @property
    def at(self) -> MonoNs:
        """Exposure of the newest frame that was read."""
        return self.readings[-1].at


def watch_passing(memory: PassMemory | None, view: FrameView, pose: PadPose, at: MonoNs) -> PassMemory:
    """Return the memory with what a frame shows of the pad, whose registered pose is `pose`, and about it."""
    since_s = math.inf if memory is None else seconds_between(memory.at, at)
    if memory is not None and 0.0 <= since_s < (LOW_PERIOD_S if pose.range_m < LOW_M else PASS_PERIOD_S):
        return memory
    light, shown = from_above(view, pose, view.pad.disc_radius_m + _REACH_M, _CELL_M, _PASS_MESH, 3)
    centre = -pose.R_cam_pad.matrix.T @ pose.t_cam_pad
    old = memory or Found()
    found, found_at, times, missed = old.found, old.found_at, old.shown, old.missed
    if memory is None or not 0.0 <= since_s <= _PASS_GAP_S:
        # Its share of a mean that is itself says nothing: a shadow that is there already would seem to come.
        now = _Reading(at, light, np.full_like(light, _ONE), np.zeros_like(shown), centre[:2], float(-centre[2]))
        noise = np.zeros(shown.shape, np.float32)
        return PassMemory(light, shown, noise, (now,), found=found, found_at=found_at, shown=times, missed=missed)
    both = ((shown > 0) & (memory.known > 0))[::2, ::2]
    bright, was = (of[::2, ::2, 1][both].astype(np.float32) + _FLOOR for of in (light, memory.mean))
    mean = cv2.convertScaleAbs(memory.mean, alpha=float(median(bright / was)) if len(was) else 1.0)  # by the exposure
    cv2.copyTo(light, cv2.bitwise_not(memory.known), mean)
    bright, usual = (np.add(of, _FLOOR, dtype=np.float32) for of in (light, mean))
    share = cv2.divide(bright, usual, scale=_ONE, dtype=cv2.CV_8U)
    now = _Reading(at, light, np.asarray(share, np.uint8), shown, centre[:2], float(-centre[2]))
    noise = memory.noise
    before = next((each for each in reversed(memory.readings) if seconds_between(each.at, at) >= _SINCE_S), None)
    if before is not None:
        change, noise = _compare(before, now, np.asarray(mean, np.uint8), noise)
        new, known = _largest(change), memory.near(at)
        if new is not None:
            times = _PASSED_SURE if now.height_m < LOW_M else 1 + (0 if known is None else times)
            found, found_at, missed = new, at, 0
        elif known is not None and times < _PASSED_SURE and is_shown(known, shown, _CELL_M):
            missed += 1
            found, found_at = (None, None) if missed >= _PASSED_FADES else (found, found_at)
    more, less = (np.minimum(off, np.uint8(_STEP)) for off in (cv2.subtract(light, mean), cv2.subtract(mean, light)))
    nearer = cv2.subtract(cv2.add(mean, more), less)
    cv2.copyTo(nearer, shown, mean)
    kept = tuple(each for each in memory.readings if seconds_between(each.at, at) < _SINCE_S)
    last = memory.readings[: len(memory.readings) - len(kept)][-1:]
    return PassMemory(
        np.asarray(mean, np.uint8), memory.known | shown, noise, (*last, *kept, now),
        found=found, found_at=found_at, shown=times, missed=missed,
    )  # fmt: skip


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
    return (values > least).astype(np.uint8), noise + np.float32(0.1) * (values - noise)


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
