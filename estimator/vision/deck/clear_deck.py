"""Detect things on the pad by colours that neither its paints nor light explain.

Each frame is read in cells of the pad where the drawing knows the paint. The light of a cell is compared with the median of its
paint in the same frame. Shade changes all channels by one factor, and the sky's blue in it changes blue against red. Water, haze
and veiling light add some white, and the paint still shows. All of these are left out of the difference, and so is a slow plane
over each paint. The rest is averaged on the pad for about a second: noise, glint and whatever moves over the pad fade, and
things that lie there stay. A patch that differs by far more than the paint differs from itself is something on the pad.

Something in the colour of the paint under it hides the markings that it lies across: each marking's contrast with the ground
about it is measured too, as a share of what the whole marking shows. Light adds to a marking and its ground alike, and shade
leaves the same share of both. What has the paint's own hue and hides no marking looks like shade. A grey camera sees nothing.
"""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between
from estimator.core.library import CORE
from estimator.vision.camera.pose import PadPose
from estimator.vision.deck.cells import ACROSS, PAINTS, cells_of, known_paints, markings_in, shares_of
from estimator.vision.detect.pyramid import FrameView
from estimator.vision.detect.template import BLURS_M, F32
from estimator.vision.detection import PadCheck, PadThing
from estimator.vision.native import checked
from estimator.vision.pad.pad import Pad
from estimator.vision.srgb import LINEAR_LIGHT

_CELL_PX_LEAST = 1.2  # Width of a cell in the frame below which it is too far away
_LEAST_CELLS = 10  # Least number of cells of a paint in view
PERIOD_S = 0.24
"""Time between two frames that are read, s."""
_AVERAGE_S = 1.0  # Time constant of the average, s
LASTS_S = 10.0
"""Time for which a cell that has left the view counts, s."""
_ENOUGH = 3.0  # Frames' weight in the average from which on a cell counts
_BRIGHT = 245  # Value of a pixel from which on a channel is clipped, or its neighbour is
_LEAST = 0.17  # Least difference of a cell that is none of the paint, of the paint's light
_SPREADS = 6.0  # Such a difference in spreads of the paint's own cells
_CELLS_LEAST = 14  # Least number of cells of something on the pad
_SHARP = 0.7  # Part of its largest difference that is lost within two cells of its rim: glare and puddles end softly
_ABOUT = 7  # Width of the square, in cells, in which a marking's ground is looked for
_GROUND_CELLS = 4  # Least number of ground cells about a marking
_DARKEST = 0.1  # Deepest shade, in parts of the ground's usual light
_UNEVEN = 0.15  # Spread of the ground's light about a marking, in its contrast, from which on its ground is not known
_HIDDEN = 0.25  # Contrast of a marking, in parts of that of the whole, below which something hides it
_HIDDEN_CELLS = 5  # Least number of such cells
_SEEN_OFTEN = 2.0  # Frames' weight from which on a cell's contrast counts
_HIDES_M = 0.15  # Width of a place in which something may lie unseen, m
_HIDES = 0.6  # Share of the ground of such a place that is clipped
_NONE = 1e3  # Difference of a cell that is not known
_LIGHT = LINEAR_LIGHT.astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMemory:
    """Average of the differences on the pad."""

    at: MonoNs
    total: F32
    """Weighted sum of the differences, (cells, 3) of the paint's light."""
    weight: F32
    """Weight of the frames in it, (cells,)."""
    seen_at: F64
    """Seconds of the newest reading of each cell, (cells,); -inf before."""
    glare_at: F64
    """Seconds of the newest frame in which a cell of the ground was clipped, (cells,); -inf before."""
    marks: F32
    """Weighted sums over frames, (cells, 3): contrast of a marking, contrast of the whole marking, and the frames' weight."""
    check: PadCheck


def is_near(view: FrameView, pose: PadPose) -> bool:
    """Return whether the pad's cells are large enough in a frame, and in colour, to be read."""
    return not view.pyramid.monochrome and 2.0 * view.pad.disc_radius_m / ACROSS * view.camera.fx >= _CELL_PX_LEAST * pose.range_m


def check_surface(
    memory: SurfaceMemory | None, view: FrameView, pose: PadPose, at: MonoNs, blur_px: float, sigma_m: float
) -> SurfaceMemory | None:
    """Return the memory with what a frame shows of the pad's surface.

    Args:
        pose: the registered pose of the pad in `cam`.
        at: the exposure.
        blur_px: standard deviation of the frame's blur.
        sigma_m: standard deviation of the registered place along the deck.
    """
    pyramid, camera, pad = view
    since_s = math.inf if memory is None else seconds_between(memory.at, at)
    if 0.0 <= since_s < PERIOD_S or not is_near(view, pose):
        return memory
    px_m = pose.range_m / camera.fx
    cell_px = 2.0 * pad.disc_radius_m / ACROSS / px_m
    level = max(0, math.floor(math.log2(cell_px / 3.0)))
    px, points = pyramid[level], pose.points(cells_of(pad)[0])
    on_level = ((camera.project(points) + 0.5) / (1 << level) - 0.5).astype(np.float32)
    values = cv2.remap(px, on_level[None], np.empty(0, np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
    (h, w), (u, v) = px.shape[:2], on_level.T
    shown = (u > 1.0) & (v > 1.0) & (u < w - 2.0) & (v < h - 2.0)
    blur_m = math.hypot(px_m * math.hypot(blur_px, 0.5 * (1 << level)), sigma_m)
    return _after(memory if 0.0 <= since_s < LASTS_S else None, pad, np.asarray(values, np.uint8), shown, blur_m, at)


def _after(
    memory: SurfaceMemory | None, pad: Pad, values: NDArray[np.uint8], shown: NDArray[np.bool_], blur_m: float, at: MonoNs
) -> SurfaceMemory:
    """Return the memory with the cells' values, (cells, 3)."""
    blur = next((k for k, each_m in enumerate(BLURS_M) if each_m >= 1.3 * blur_m), len(BLURS_M) - 1)
    nearest = int(np.abs(np.log(BLURS_M) - math.log(max(blur_m, 1e-4))).argmin())
    bright = np.maximum(np.maximum(values[:, 0], values[:, 1]), values[:, 2]) >= _BRIGHT
    clear = shown & (cv2.dilate(_square(pad, bright), np.ones((3, 3), np.uint8)).ravel()[cells_of(pad)[1]] == 0)
    light = _LIGHT.take(values)
    difference, seen = _differences(light, clear, pad, blur)
    contrast = _contrasts(light, clear, pad, nearest)
    now_s = at * 1e-9
    if memory is None:
        memory = SurfaceMemory(
            at, np.zeros_like(difference), np.zeros(len(values), np.float32), np.full(len(values), -np.inf),
            np.full(len(values), -np.inf), np.zeros_like(contrast), PadCheck(at, 0.0),
        )  # fmt: skip
    fades = np.float32(math.exp(-min(seconds_between(memory.at, at), _AVERAGE_S) / _AVERAGE_S))
    keep = np.where(seen, fades, np.float32(1.0))
    total, weight = memory.total * keep[:, None] + difference, memory.weight * keep + seen
    marks = memory.marks * np.where(contrast[:, 2:] > 0, fades, np.float32(1.0)) + contrast
    seen_at = np.where(seen | (contrast[:, 2] > 0), now_s, memory.seen_at)
    # Markings are brighter: where they alone are clipped, what would hide them is seen.
    glare_at = np.where(shown & bright & (known_paints(pad, blur) == PAINTS - 1), now_s, memory.glare_at)
    check = _judge(pad, total, weight, marks, now_s - seen_at, at)
    unread = (now_s - glare_at <= LASTS_S) & ~((weight >= _ENOUGH) & (now_s - seen_at <= LASTS_S))
    return SurfaceMemory(at, total, weight, seen_at, glare_at, marks, replace(check, glare=_hiding(pad, unread)))


def _differences(light: F32, clear: NDArray[np.bool_], pad: Pad, blur: int) -> tuple[F32, NDArray[np.bool_]]:
    """Return the difference of each cell from its paint, (cells, 3) of the paint's light, and which cells were read.

    Args:
        light: of the cells, (cells, 3).
        clear: which of them are in the frame and not clipped.
    """
    xy, paint = cells_of(pad)[0][:, :2], known_paints(pad, blur)
    seen, letters = clear & (paint >= 0), clear & (shares_of(pad, blur)[:, 0] >= 0.6)
    out = np.zeros_like(light)
    cells = [np.flatnonzero(seen & (paint == one)) for one in range(PAINTS)]
    # Lettering that is hidden or clipped leaves the camera's own white.
    white = median(light[letters]) if np.count_nonzero(letters) >= _LEAST_CELLS else np.ones(3, np.float32)
    for of in cells:
        if len(of) < _LEAST_CELLS:
            seen[of] = False
            continue
        out[of] = _from_paint(light[of], (xy[of] / pad.disc_radius_m).astype(np.float32), white)
    return out, seen


def _contrasts(light: F32, clear: NDArray[np.bool_], pad: Pad, blur: int) -> F32:
    """Return each marking's contrast with its ground, that of the whole marking, and 1 for cells that were read, (cells, 3).

    Args:
        light: of the cells, (cells, 3).
        clear: which of them are in the frame and not clipped.
    """
    inside, (on_ground, hue, markings) = cells_of(pad)[1], markings_in(pad, blur)
    out, ground = np.zeros((len(light), 3), np.float32), on_ground[clear[on_ground]]
    if len(ground) < _LEAST_CELLS:
        return out
    square, paint = np.zeros((ACROSS * ACROSS, 5), np.float32), light[ground]
    square[inside[ground], :3], square[inside[ground], 3] = paint, 1.0
    square[inside[ground], 4] = np.einsum("ij,ij->i", paint, paint)
    sums = cv2.boxFilter(square.reshape(ACROSS, ACROSS, 5), -1, (_ABOUT, _ABOUT), normalize=False, borderType=cv2.BORDER_CONSTANT)
    usual, is_sharp = _median(paint @ hue) + 1e-6, BLURS_M[blur] < pad.disc_radius_m / ACROSS
    for marking in markings:
        about = sums.reshape(-1, 5)[inside[marking.at]]
        read = clear[marking.at] & (about[:, 3] >= _GROUND_CELLS)
        of, about, own = marking.at[read], about[read], marking.own[read]
        if not len(of):
            continue
        mean = np.asarray(about / about[:, 3:4], np.float32)
        spread = np.sqrt(np.maximum(0.0, mean[:, 4] - np.einsum("ij,ij->i", mean[:, :3], mean[:, :3])))
        shade = np.clip(mean[:, :3] @ hue / usual, _DARKEST, 1.0)
        shows = (light[of] - mean[:, :3]) @ marking.way
        whole = _median(shows / (own * shade), 0.8) if len(of) >= _LEAST_CELLS else 0.0
        whole = max(whole, marking.least * usual)
        even = spread < _UNEVEN * whole * shade * own
        # Beside glare the ground is a slope, which a blurred edge beside it would bend. Shadows, which end in steps, are darker.
        slopes = np.flatnonzero(~even & (shade >= 1.0) & is_sharp)
        if len(slopes):
            below, spread = _slope(square, inside[of[slopes]])
            shows[slopes] = (light[of[slopes]] - below) @ marking.way
            even[slopes] = spread < _UNEVEN * whole * own[slopes]
        out[of] = np.where(even[:, None], np.stack([shows * own / whole, shade * own * own, np.ones_like(own)], axis=1), 0.0)
    return out


def _slope(square: F32, at: NDArray[np.int64]) -> tuple[F32, F32]:
    """Return the ground's light at cells, (N, 3), by the plane through it in the square about each, and its spread about that.

    Args:
        square: light of the ground and 1, (cells of the square, 4 or more); 0 where there is no ground.
        at: numbers of the cells in it.
    """
    half = _ABOUT // 2
    off = np.mgrid[-half : half + 1, -half : half + 1].reshape(2, -1)
    row, column = at[:, None] // ACROSS + off[0], at[:, None] % ACROSS + off[1]
    near = np.where(((row >= 0) & (row < ACROSS) & (column >= 0) & (column < ACROSS)), row * ACROSS + column, 0)
    near_light, there = square[near, :3], square[near, 3]
    plane = np.column_stack([np.ones(off.shape[1]), *off]).astype(np.float32)
    # Ground on one side alone says little of the slope.
    M = (there @ (plane[:, :, None] * plane[:, None]).reshape(-1, 9)).reshape(-1, 3, 3) + np.diag([0.0, 0.5, 0.5])
    by = np.linalg.solve(M, plane.T @ near_light).astype(np.float32)
    rest = np.square(near_light - plane @ by).sum(axis=2)
    spread = np.sqrt((there * rest).sum(axis=1) / there.sum(axis=1))
    return by[:, 0], spread


def _from_paint(light: F32, place: F32, white: F32) -> F32:
    """Return what is left of cells' light, (N, 3), beside their paint, shade, water and a slow plane, of the paint's light.

    Args:
        white: light of white, (3,), in any unit.
    """
    out, spare = np.empty_like(light), np.empty(2 * len(light), np.float32)
    arrays = (CORE.array("float", each) for each in (white, out, spare))
    checked(CORE.lib.dl_paint_rest(CORE.array("float", light), CORE.array("float", place), len(light), *arrays))
    return out


def _judge(pad: Pad, total: F32, weight: F32, marks: F32, age_s: F64, at: MonoNs) -> PadCheck:
    """Return what the averages say."""
    fresh, paint = age_s <= LASTS_S, known_paints(pad, 0)
    counts = (weight >= _ENOUGH) & fresh
    share = float(np.count_nonzero(counts & (paint >= 0))) / max(1, int(np.count_nonzero(paint >= 0)))
    mean = np.sqrt(np.einsum("ij,ij->i", total, total)) / np.maximum(weight, 1e-6)
    odd = np.zeros(len(mean), bool)
    for one in range(PAINTS):
        of = counts & (paint == one)
        if np.count_nonzero(of) >= _LEAST_CELLS:
            odd |= of & (mean > max(_LEAST, _SPREADS * _median(mean[of])))
    sharp = _sharp(pad, odd, np.where(counts & (paint >= 0), mean, _NONE).astype(np.float32))
    # Together with its neighbours: strokes are painted narrower or wider than drawn, and a registration is off by part of a cell.
    square = np.zeros((ACROSS * ACROSS, 2), np.float32)
    square[cells_of(pad)[1]] = marks[:, :2]
    about = cv2.blur(square.reshape(ACROSS, ACROSS, 2), (3, 3), borderType=cv2.BORDER_CONSTANT).reshape(-1, 2)[cells_of(pad)[1]]
    hidden = fresh & (marks[:, 2] >= _SEEN_OFTEN) & (about[:, 0] < _HIDDEN * about[:, 1])
    return PadCheck(at, share, _largest(pad, sharp, _patches(pad, hidden, 3, _HIDDEN_CELLS)))


def median(of: NDArray[Any]) -> Any:
    """Return the median of numbers, or of each column: that of `np.median`, which takes five times as long for a few hundred."""
    ordered = np.sort(of, axis=0)
    return (ordered[(len(of) - 1) // 2] + ordered[len(of) // 2]) / 2


def _median(of: F32, part: float = 0.5) -> float:
    """Return the median of numbers, or the one that another part of them is below; of an even number the upper one."""
    at = min(len(of) - 1, int(part * len(of)))
    return float(np.partition(of, at)[at])


def _square(pad: Pad, of: NDArray[np.bool_]) -> NDArray[np.uint8]:
    square = np.zeros(ACROSS * ACROSS, np.uint8)
    square[cells_of(pad)[1]] = of
    return square.reshape(ACROSS, ACROSS)


def _patches(pad: Pad, of: NDArray[np.bool_], across: int, least: int) -> NDArray[np.uint8]:
    """Return the cells, (ACROSS, ACROSS), in patches of a least number, across gaps of one cell less than `across`."""
    square = _square(pad, of)
    if not square.any():
        return square
    joined = cv2.morphologyEx(square, cv2.MORPH_CLOSE, np.ones((across, across), np.uint8))
    count, labels = cv2.connectedComponents(joined, connectivity=8)
    sizes = np.bincount(labels[square > 0], minlength=count)
    return np.asarray(square * (sizes >= least)[labels], np.uint8)


def _hiding(pad: Pad, unread: NDArray[np.bool_]) -> float:
    """Return the share of the ground that was clipped whenever it was looked at; 0 unless it hides all of some place.

    Args:
        unread: cells of the ground that were clipped, (cells,).
    """
    if np.count_nonzero(unread) < _CELLS_LEAST:
        return 0.0
    ground = known_paints(pad, 0) == PAINTS - 1
    across = max(5, 2 * int(_HIDES_M * ACROSS / pad.disc_radius_m / 8.0) + 1)
    circle = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (across, across)).astype(np.float32)
    hidden, whole = (
        cv2.filter2D(_square(pad, of).astype(np.float32), -1, circle, borderType=cv2.BORDER_CONSTANT) for of in (unread, ground)
    )
    if not ((whole >= 0.25 * circle.sum()) & (hidden >= _HIDES * whole)).any():
        return 0.0
    return float(np.count_nonzero(unread)) / max(1, int(np.count_nonzero(ground)))


def _sharp(pad: Pad, odd: NDArray[np.bool_], mean: F32) -> NDArray[np.uint8]:
    """Return the cells that differ, (ACROSS, ACROSS), in patches that are large enough and end sharply.

    Args:
        odd: cells that differ, (cells,).
        mean: differences, (cells,); `_NONE` where there is none.
    """
    square = _patches(pad, odd, 5, _CELLS_LEAST)
    if not square.any():
        return square
    off = np.full((ACROSS, ACROSS), _NONE, np.float32)
    np.put(off, cells_of(pad)[1], mean)
    falls = off - cv2.erode(off, np.ones((5, 5), np.uint8))
    # Edges of the drawing, which no cell knows, divide what lies across them.
    count, labels = cv2.connectedComponents(cv2.morphologyEx(square, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)), connectivity=8)
    for one in range(1, count):
        of = (labels == one) & (square > 0)
        if of.any() and float(falls[of].max()) < _SHARP * float(off[of].max()):
            square[of] = 0
    return square


def _largest(pad: Pad, differs: NDArray[np.uint8], hidden: NDArray[np.uint8]) -> PadThing | None:
    """Return the largest thing of cells that differ or hide markings, (ACROSS, ACROSS) each; None if there are none."""
    square = differs | hidden
    if not square.any():
        return None
    # Markings are apart by as much as their ground is wide, and what hides two of them is one thing.
    joined = cv2.morphologyEx(np.pad(square, 5), cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))[5:-5, 5:-5]
    count, labels = cv2.connectedComponents(joined, connectivity=8)
    best = int(np.bincount(labels[square > 0], minlength=count).argmax())
    rows, columns = np.nonzero((labels == best) & (square > 0))
    step = 2.0 * pad.disc_radius_m / ACROSS
    wide = max(int(np.ptp(rows)), int(np.ptp(columns))) + 1
    middle = [(0.5 * (int(side.min()) + int(side.max())) + 0.5) * step - pad.disc_radius_m for side in (rows, columns)]
    return PadThing(wide * step, middle[0], middle[1])
