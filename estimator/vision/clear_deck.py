"""Detect things on the pad by colours that neither its paints nor light explain.

Each frame is read in cells of the pad where the drawing knows the paint. The light of a cell is compared with the median of its
paint in the same frame. Shade changes all channels by one factor, and the sky's blue in it changes blue against red. Water, haze
and veiling light add some white, and the paint still shows. All of these are left out of the difference, and so is a slow plane
over each paint. The rest is averaged on the pad for about a second: noise, glint and whatever moves over the pad fade, and
things that lie there stay. A patch that differs by far more than the paint differs from itself is something on the pad.

Something in the colour of the paint under it shows only where it hides other paint, and something grey on grey or white paint
does not: it looks like shade. A grey camera sees nothing here.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between
from estimator.core.abi import TEMPLATE_ONE
from estimator.vision.camera import Camera
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detect.template import BLURS_M, F32, STEP_M, template
from estimator.vision.detection import PadCheck, PadThing
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.srgb import LINEAR_LIGHT, linear_light

ACROSS = 48
"""Cells across the disc: 1.6 cm on a pad of 78 cm."""
_PAINTS = 3
"""Paints that are compared: lettering, ring and arrowhead, and disc, in the order of `template`."""
_PURE, _LEAK = 0.9, 0.03
"""Least coverage of a cell by one paint at which the drawing knows it, blurred as the frame is. Second: the most light of other
paints in it, as a share of its own."""
_CELL_PX_LEAST = 1.2
"""Width of a cell in the frame below which it is too far away."""
_LEAST_CELLS = 10
"""Least number of cells of a paint in view."""
_PERIOD_S, _AVERAGE_S, LASTS_S = 0.2, 1.0, 10.0
"""Time between two frames that are read, of the average, and for which a cell that has left the view counts, s."""
_ENOUGH = 3.0
"""Frames' weight in the average from which on a cell counts."""
_BRIGHT = 250
"""Value of a pixel from which on a channel is clipped."""
_WHITE_MOST, _PURER = 2.0, 0.8
"""Most white light added to a paint, in its own light, where the paint still shows. Second: the share of white in a paint's
median that may be such light."""
_SKY_MOST = 0.3
"""Largest change of blue against red that shade makes, of the paint's light."""
_LEAST, _SPREADS = 0.17, 6.0
"""Difference of a cell that is none of the paint: of the paint's light, and in spreads of the paint's own cells."""
_CELLS_LEAST, _SHARP = 14, 0.7
"""Least number of cells of something on the pad, and how far the difference falls within two cells of its rim, of its largest:
glare and puddles end softly."""

_DECK_LIGHT = np.full(3, 0.3)
"""Light of the deck about the pad, 1 for white."""
_NONE = 1e3
"""Difference of a cell that is not known."""
_LIGHT = LINEAR_LIGHT.astype(np.float32)
_MAD = 1.4826


@dataclass(frozen=True, slots=True, eq=False)
class DeckMemory:
    """Average of the differences on the pad."""

    at: MonoNs
    total: F32
    """Weighted sum of the differences, (cells, 3) of the paint's light."""
    weight: F32
    """Weight of the frames in it, (cells,)."""
    seen_at: F64
    """Seconds of the newest reading of each cell, (cells,); -inf before."""
    check: PadCheck


@lru_cache(maxsize=8)
def _cells(pad: Pad) -> tuple[F64, NDArray[np.int64]]:
    """Return the cells' centres within the disc, (cells, 2) m, and their numbers in the square of `ACROSS` by `ACROSS`."""
    step = 2.0 * pad.disc_radius_m / ACROSS
    side = (np.arange(ACROSS) + 0.5) * step - pad.disc_radius_m
    x, y = np.meshgrid(side, side, indexing="ij")
    inside = np.flatnonzero(np.hypot(x, y).ravel() < pad.disc_radius_m)
    return np.stack([x.ravel(), y.ravel()], axis=1)[inside], inside


@lru_cache(maxsize=16)
def _known(pad: Pad, blur: int) -> NDArray[np.int8]:
    """Return the paint of each cell, (cells,), at one of `BLURS_M`; -1 where the drawing does not know it."""
    maps, colours = template(pad).coverage[blur], pad.markings.colours
    at = np.rint(_cells(pad)[0] / STEP_M).astype(int) + len(maps) // 2
    share = maps[at[:, 0], at[:, 1]] / float(TEMPLATE_ONE)
    light = np.linalg.norm([*(linear_light(rgb) for rgb in (colours.h, colours.ring, colours.disc)), _DECK_LIGHT], axis=1)
    own = share[:, :_PAINTS].argmax(axis=1)
    most = share[np.arange(len(own)), own]
    leak = share @ light - most * light[own]
    return np.where((most >= _PURE) & (leak <= _LEAK * light[own]), own, -1).astype(np.int8)


@lru_cache(maxsize=16)
def _lettered(pad: Pad, blur: int) -> NDArray[np.bool_]:
    """Return which cells show lettering for the most part at one of `BLURS_M`."""
    maps = template(pad).coverage[blur]
    at = np.rint(_cells(pad)[0] / STEP_M).astype(int) + len(maps) // 2
    return np.asarray(maps[at[:, 0], at[:, 1], 0] >= 0.6 * TEMPLATE_ONE)


def checked_deck(
    memory: DeckMemory | None, view: FrameView, pose: PadPose, at: MonoNs, blur_px: float, sigma_m: float
) -> DeckMemory | None:
    """Return the memory with what a frame shows of the pad's surface.

    Args:
        pose: the registered pose of the pad in `cam`.
        at: the exposure.
        blur_px: standard deviation of the frame's blur.
        sigma_m: standard deviation of the registered place along the deck.
    """
    pyramid, camera, pad = view
    since_s = math.inf if memory is None else seconds_between(memory.at, at)
    if 0.0 <= since_s < _PERIOD_S or pyramid.monochrome:
        return memory
    px_m = pose.range_m / camera.fx
    cell_px = 2.0 * pad.disc_radius_m / ACROSS / px_m
    if cell_px < _CELL_PX_LEAST:
        return memory
    level = max(0, math.floor(math.log2(cell_px / 3.0)))
    wanted_m = 1.3 * math.hypot(px_m * math.hypot(blur_px, 0.5 * (1 << level)), sigma_m)
    blur = next((k for k, blur_m in enumerate(BLURS_M) if blur_m >= wanted_m), len(BLURS_M) - 1)
    paint = _known(pad, blur)
    difference, seen = _differences(pyramid, level, camera, pad, pose, blur)
    now_s = at * 1e-9
    if memory is None or not 0.0 <= since_s < LASTS_S:
        total, weight, seen_at = np.zeros_like(difference), np.zeros(len(paint), np.float32), np.full(len(paint), -np.inf)
    else:
        total, weight, seen_at = memory.total, memory.weight, memory.seen_at
    keep = np.where(seen, np.float32(math.exp(-min(since_s, _AVERAGE_S) / _AVERAGE_S)), np.float32(1.0))
    total = total * keep[:, None] + difference
    weight = weight * keep + seen
    seen_at = np.where(seen, now_s, seen_at)
    return DeckMemory(at, total, weight, seen_at, _judged(pad, total, weight, now_s - seen_at, at))


def _differences(
    pyramid: Pyramid, level: int, camera: Camera, pad: Pad, pose: PadPose, blur: int
) -> tuple[F32, NDArray[np.bool_]]:
    """Return the difference of each cell from its paint, (cells, 3) of the paint's light, and which cells were read."""
    xy, paint = _cells(pad)[0], _known(pad, blur)
    R = pose.R_cam_pad.matrix
    uv = camera.project(xy @ R[:, :2].T + pose.t_cam_pad)
    px, scale = pyramid[level], 1.0 / (1 << level)
    on_level = ((uv + 0.5) * scale - 0.5).astype(np.float32)
    values = cv2.remap(px, on_level[None], np.empty(0, np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
    h, w = px.shape[:2]
    shown = (on_level > 1.0).all(axis=1)
    shown &= (on_level[:, 0] < w - 2.0) & (on_level[:, 1] < h - 2.0)
    seen, letters = shown & (paint >= 0) & (values.max(axis=1) < _BRIGHT), shown & _lettered(pad, blur)
    light, out = _LIGHT[values], np.zeros((len(xy), 3), np.float32)
    cells = [np.flatnonzero(seen & (paint == one)) for one in range(_PAINTS)]
    if np.count_nonzero(letters) < _LEAST_CELLS:
        return out, np.zeros_like(seen)
    own = [np.median(light[of], axis=0) for of in (np.flatnonzero(letters), *cells) if len(of) >= _LEAST_CELLS]
    white = max(own, key=lambda bgr: float(bgr.sum()), default=np.ones(3, np.float32))
    for of in cells:
        if len(of) < _LEAST_CELLS:
            seen[of] = False
            continue
        out[of] = _from_paint(light[of], (xy[of] / pad.disc_radius_m).astype(np.float32), white)
    return out, seen


def _from_paint(light: F32, place: F32, white: F32) -> F32:
    """Return what is left of cells' light, (N, 3), beside their paint, shade, water and a slow plane, of the paint's light.

    Args:
        white: light of white, (3,), in any unit.
    """
    own = np.median(light, axis=0)
    size = float(np.linalg.norm(own)) + 1e-6
    white = white / (float(np.linalg.norm(white)) + 1e-6)
    pale = own / size + _WHITE_MOST * white
    # The median may be of wet paint: dry paint then has less white, as much as its channels leave.
    axis = own / size - _PURER * float((own / size / np.maximum(white, 1e-3)).min()) * white
    pale, axis = pale / float(np.linalg.norm(pale)), axis / (float(np.linalg.norm(axis)) + 1e-6)
    left = light / size
    # The nearest light between the paint's own and a paler one, of any size.
    along, paler, cos = left @ axis, left @ pale, float(axis @ pale)
    of_pale = (paler - cos * along) / max(1e-6, 1.0 - cos * cos)
    of_own = along - cos * of_pale
    of_own, of_pale = (
        np.where(of_pale < 0.0, along, np.where(of_own < 0.0, 0.0, of_own)),
        np.where(of_pale < 0.0, 0.0, np.where(of_own < 0.0, paler, of_pale)),
    )
    left = left - of_own[:, None] * axis - of_pale[:, None] * pale
    sky = own * np.array([1.0, 0.0, -1.0], np.float32) / size
    sky = sky - (sky @ axis) * axis
    power = float(sky @ sky)
    if power > 1e-6:
        left = left - np.clip(left @ sky / power, -_SKY_MOST, _SKY_MOST)[:, None] * sky
    rows = np.concatenate([np.ones((len(place), 1), np.float32), place], axis=1)
    slow = np.zeros((3, 3), np.float32)
    slow[0] = np.median(left, axis=0)
    for _ in range(2):
        rest = left - rows @ slow
        off = np.abs(rest).max(axis=1)
        near = off <= 3.0 * _MAD * np.median(off)
        few = rows[near]
        slow = np.linalg.solve(few.T @ few + 1e-3 * np.eye(3, dtype=np.float32), few.T @ left[near])
    return np.asarray(left - rows @ slow, np.float32)


def _judged(pad: Pad, total: F32, weight: F32, age_s: F64, at: MonoNs) -> PadCheck:
    """Return what the averages say."""
    counts, paint = (weight >= _ENOUGH) & (age_s <= LASTS_S), _known(pad, 0)
    share = float(np.count_nonzero(counts & (paint >= 0))) / max(1, int(np.count_nonzero(paint >= 0)))
    mean = np.linalg.norm(total, axis=1) / np.maximum(weight, 1e-6)
    odd = np.zeros(len(mean), bool)
    for one in range(_PAINTS):
        of = counts & (paint == one)
        if np.count_nonzero(of) >= _LEAST_CELLS:
            odd |= of & (mean > max(_LEAST, _SPREADS * float(np.median(mean[of]))))
    return PadCheck(at, share, _largest(pad, odd, np.where(counts & (paint >= 0), mean, _NONE).astype(np.float32)))


def _largest(pad: Pad, odd: NDArray[np.bool_], mean: F32) -> PadThing | None:
    """Return the largest patch of cells that differ; None if none is large enough and ends sharply.

    Args:
        odd: cells that differ, (cells,).
        mean: differences, (cells,); `_NONE` where there is none.
    """
    if np.count_nonzero(odd) < _CELLS_LEAST:
        return None
    square, off = np.zeros((ACROSS, ACROSS), np.uint8), np.full((ACROSS, ACROSS), _NONE, np.float32)
    np.put(square, _cells(pad)[1], odd)
    np.put(off, _cells(pad)[1], mean)
    falls = off - cv2.erode(off, np.ones((5, 5), np.uint8))
    # Edges of the drawing, which no cell knows, divide what lies across them.
    joined = cv2.morphologyEx(square, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    count, labels, _, _ = cv2.connectedComponentsWithStats(joined, connectivity=8)
    sizes = np.bincount(labels[square > 0], minlength=count)
    sizes[0] = 0
    best = int(sizes.argmax())
    of = (labels == best) & (square > 0)
    if sizes[best] < _CELLS_LEAST or float(falls[of].max()) < _SHARP * float(off[of].max()):
        return None
    rows, columns = np.nonzero(labels == best)
    step = 2.0 * pad.disc_radius_m / ACROSS
    wide = max(int(np.ptp(rows)), int(np.ptp(columns))) + 1
    middle = [(0.5 * (int(side.min()) + int(side.max())) + 0.5) * step - pad.disc_radius_m for side in (rows, columns)]
    return PadThing(wide * step, middle[0], middle[1])
