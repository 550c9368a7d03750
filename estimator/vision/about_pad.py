"""Detect things about the pad: what stands out of the deck, what moves there, and what passes over it.

Each frame that is read is drawn as seen from straight above, on the deck's plane as the pad is registered. There everything that
is painted on the deck stays where it is, at the same size. Corners of an earlier such picture are followed by optical flow (Lucas
& Kanade, Proc. IJCAI 1981; Shi & Tomasi, CVPR 1994). A point z above the deck is seen where the ray through it meets the deck,
q = p + (q - c) z / h for a camera at height h over the place c: while the drone comes down, height and place follow by least
squares. What fits no place and height moves. The drone's own shadow, drops on the lens and its own feet keep their place in its
cone, q = c + r + s h, and count for nothing. So does what seems to be below the deck: the sea, mirrored things. Several corners
must agree.

A thing that moves fast over the pad is gone before corners of it could be followed. The deck about the pad is drawn as seen from
above, in coarse cells, and compared with its slow mean (the sigma-delta background of Manzanera & Richefeu, Pattern Recogn. Lett.
28, 2007). What lies there has the same share of that light as it had a fifth of a second before, at the same place. The drone's
own shadow, glare and drops on the lens have it at the same place in the drone's cone, q = c + s h for a camera at height h over
the place c. A patch that has neither passes. A flash and a drop that falls do so too, but once: what few readings show from high
above soon fades. A registration may be off by a cell: its light is looked for among its neighbours.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between
from estimator.core.library import CORE
from estimator.vision.clear_deck import LASTS_S, PERIOD_S, SurfaceMemory, is_near, median
from estimator.vision.detect.pyramid import U8, FrameView
from estimator.vision.detect.template import F32
from estimator.vision.detection import NearThing, PadCheck
from estimator.vision.native import checked, image_of
from estimator.vision.pose import PadPose

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


_GAP_S = 0.7
"""Longest time that a corner is followed across, s."""
MOVED_LASTS_S, STANDING_LASTS_S = 10.0, 60.0
"""Times for which a finding counts, s. What stands is measured on the way down alone; a drone that waits must not forget it."""
_STEP_M, _MESH = 0.016, 10
"""Size of a pixel of the picture from above, and of the mesh on which it is drawn, in such pixels."""
_FAR_PX_M, _RING_M = 0.03, 0.15
"""Size of the frame's pixels on the deck from which on it is too far away, and width of the ring that is worth a reading, m."""
_CORNERS, _APART_PX, _WINDOW = 80, 6, (13, 13)
"""Number of corners, their least distance, and the window that is followed, px."""
_BACK_PX, _MARGIN = 0.4, 8
"""Largest difference after following a corner back, and least distance from where the frame ends, px."""
_KEY_S, _LOWER, _LEFT = 5.0, 0.5, 0.4
"""Longest time that the same picture is followed, least height in that of the picture, and least share of corners left."""
_STANDS_REACH_M, _MOVES_REACH_M, _OFF_DISC = 0.8, 1.5, 1.08
"""Distances beyond the disc within which what stands out (rotor and margin) and what moves counts; the ring's start, in radii."""
_SIGMA_PX, _SIGMA_M, _SIGMA_AWAY = 0.3, 0.004, 0.003
"""Standard deviation of a corner's place on the deck: in the frame's pixels, fixed, and in parts of its distance from the pad."""
_READS, _READS_STANDS = 4, 3
"""Least number of readings of a corner, and of one that stands high."""
_STANDS_M, _STANDS_SIGMAS = 0.15, 6.0
"""Least height of what stands out, and in standard deviations."""
_FLAT_LEAST, _SIGMAS_ARE, _MAD = 12, (0.4, 1.0), 1.4826
"""Least number of corners that say what a standard deviation is worth, and between which limits."""
_ASTRAY = 2.0
"""Such a spread from which on a reading confirms nothing: in the picture that is followed the pad was registered wrongly."""
_BELOW = 0.8
"""Largest height of what stands, in parts of the camera's."""
_STAYS, _STAYS_PART, _STAYS_M = 4.0, 0.3, 0.06
"""Largest mean square that is left of a corner that stands: in variances, and of a high one more, in parts of what the height
explains, up to so many metres."""
_MOVES_M, _MOVES_TIMES = 0.12, 6.0
"""Least deviation from the best place and height that is a motion, m, and in standard deviations."""
_OWN, _OWN_M, _OWN_SIGMA_M = 1.0, 0.4, 0.3
"""Part that the drone's own shadow leaves of the deviation where it is that; how far a part of it is from its middle at most, and
the standard deviation that is assumed of that."""
_AGREE, _FOLLOWED, _CLUSTER_M, _LOST_S = 3, 2, 0.5, 1.5
"""Least number of corners that agree, and of those that are still followed, within this distance. Fourth: time for which one that
was lost agrees with others."""
_SURE, _MOVED_SURE, _FADES = 6, 2, 12
"""Number of readings that show a standing thing from which on it counts for its whole time, and of one that moves. Third: number
of readings of its place without it after which one that was shown less often is nothing. Wrongly followed corners agree once."""
_LEVEL_M, _LEVEL_PART = 0.05, 0.5
"""Largest difference in height of corners that agree, m, and in parts of it: a thing's top, a person's head and shoulders."""


@dataclass(frozen=True, slots=True, eq=False)
class _Heights:
    """The best place and height of each corner, and what it is."""

    place: F64
    z: F64
    stays: NDArray[np.bool_]
    stands: NDArray[np.bool_]
    moves: NDArray[np.bool_]
    flat: float
    """Spread of most about the deck, in standard deviations."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Found:
    found: NearThing | None = None
    """The newest finding."""
    found_at: MonoNs | None = None
    shown: int = 0
    """Number of readings that showed the thing that was found."""
    missed: int = 0
    """Number of those since that showed its place without it."""

    def near(self, at: MonoNs) -> NearThing | None:
        """Return what was found lately."""
        if self.found is None or self.found_at is None:
            return None
        lasts_s = STANDING_LASTS_S if self.found.height_m > 0.0 else MOVED_LASTS_S
        return self.found if seconds_between(self.found_at, at) <= lasts_s else None


@dataclass(frozen=True, slots=True, eq=False)
class AroundMemory(_Found):
    """Corners about the pad, with the sums of their readings."""

    at: MonoNs
    key_at: MonoNs
    """Exposure of the picture that is followed."""
    key: U8
    """The picture itself, from above."""
    key_height_m: float
    corners: F64
    """Corners in it, (N, 2) px."""
    uv: F64
    """Their places in the last frame that was read, (N, 2) px from above."""
    sums: F64
    """(N, 16) weighted sums of each: 1, q (2), a (2), a q, a a, q q, h (q - c) (2), h h, (q - c)^2, h, q - c (2); and number of
    readings."""
    of: _Heights
    began: int
    """Number of corners when the picture was taken."""
    stood: F64
    """Corners that were lost and stood out of the deck, (N, 4): place (2) m, height m, and time of the loss, s."""


def _shows_ring(view: FrameView, pose: PadPose) -> bool:
    """Return whether enough of what is about the pad is in the frame, and near enough, to be read."""
    camera, rim_m = view.camera, _OFF_DISC * view.pad.disc_radius_m
    corner_m = pose.range_m * math.hypot(camera.width / camera.fx, camera.height / camera.fy) / 2.0
    return corner_m >= rim_m + _RING_M and pose.range_m <= _FAR_PX_M * camera.fx


def watch_around(memory: AroundMemory | None, view: FrameView, pose: PadPose, at: MonoNs) -> AroundMemory:
    """Return the memory with what a frame shows about the pad, whose registered pose is `pose`."""
    since_s = math.inf if memory is None else seconds_between(memory.at, at)
    if memory is not None and (0.0 <= since_s < PERIOD_S or not _shows_ring(view, pose)):
        return memory
    centre = -pose.R_cam_pad.matrix.T @ pose.t_cam_pad
    height_m, px_m = float(-centre[2]), pose.range_m / view.camera.fx
    above, shown = from_above(view, pose, view.pad.disc_radius_m + _MOVES_REACH_M, _STEP_M, _MESH, 1)
    found, found_at = (None, None) if memory is None else (memory.found, memory.found_at)
    times, missed = (0, 0) if memory is None else (memory.shown, memory.missed)
    uv, sums, stood = np.empty((0, 2)), np.empty((0, 16)), np.empty((0, 4)) if memory is None else memory.stood
    key_s, grown = (0.0, 0.0) if memory is None else (seconds_between(memory.key_at, at), height_m / memory.key_height_m)
    if memory is not None and len(memory.uv) and 0.0 <= since_s <= _GAP_S and key_s < 2.0 * _KEY_S and _LOWER < grown < 1.5:
        uv, kept = _follow(memory, above, shown)
        q = (uv - (len(above) - 1) / 2) * _STEP_M
        sums = memory.sums[kept] + _reading(q, centre[:2], height_m, px_m)
        is_lost = memory.of.stands.copy()
        is_lost[kept] = False
        rows = np.column_stack([memory.of.place[is_lost], memory.of.z[is_lost], np.full(is_lost.sum(), memory.at * 1e-9)])
        stood = np.concatenate([stood[at * 1e-9 - stood[:, 3] < _LOST_S], rows])
        of = _heights(sums, view.pad.disc_radius_m)
        new, known = _nearest_of(of, q, stood, view.pad.disc_radius_m), memory.near(at)
        if new is not None and (known is None or new.height_m > 0.0 or known.height_m == 0.0):
            place = known or new
            apart_m = math.hypot(place.forward_m - new.forward_m, place.right_m - new.right_m)
            again = known is not None and (known.height_m > 0.0) == (new.height_m > 0.0)
            in_place = apart_m < _CLUSTER_M or times >= _SURE or new.height_m == 0.0
            times = times if again and in_place else 0
            times = max(1, times + (of.flat < _ASTRAY))
            found, found_at, missed = new, at, 0
        elif known is not None and times < (_SURE if known.height_m > 0.0 else _MOVED_SURE) and _is_shown(known, shown, _STEP_M):
            missed += 1
            found, found_at = (None, None) if missed >= _FADES else (found, found_at)
        if len(uv) > _LEFT * memory.began and key_s <= _KEY_S and 0.65 < grown < 1.3:
            corners = memory.corners[kept]
            return replace(
                memory, at=at, corners=corners, uv=uv, sums=sums, of=of, stood=stood,
                found=found, found_at=found_at, shown=times, missed=missed,
            )  # fmt: skip
        # Corners that stay go on in the new picture: a longer way down shows a lower thing. What moves is seen without.
        uv, sums = uv[of.stays], sums[of.stays]
    more = _corners(above, shown, view.pad.disc_radius_m, uv)
    q, uv = (more - (len(above) - 1) / 2) * _STEP_M, np.concatenate([uv, more])
    sums = np.concatenate([sums, np.zeros((len(q), 16)) + _reading(q, centre[:2], height_m, px_m)])
    of = _heights(sums, view.pad.disc_radius_m)
    return AroundMemory(
        at, at, above, height_m, uv, uv, sums, of, len(uv), stood, found=found, found_at=found_at, shown=times, missed=missed
    )


def _is_shown(thing: NearThing, shown: U8, step_m: float) -> bool:
    """Return whether a picture from above, of pixels of a size, shows the place on the deck where a thing was found."""
    x, y = (round(of_m / step_m) + (len(shown) - 1) // 2 for of_m in (thing.forward_m, thing.right_m))
    return 0 <= x < len(shown) and 0 <= y < len(shown) and bool(shown[y, x])


def _follow(memory: AroundMemory, above: U8, shown: U8) -> tuple[F64, NDArray[np.intp]]:
    """Return where the memory's corners are in a picture from above, (M, 2) px, and which they are."""
    start, guess = (each.astype(np.float32)[:, None] for each in (memory.corners, memory.uv))
    flags = {"winSize": _WINDOW, "maxLevel": 2, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
    to, there, _ = cv2.calcOpticalFlowPyrLK(memory.key, above, start, guess.copy(), **flags)  # type: ignore[call-overload]
    back, again, _ = cv2.calcOpticalFlowPyrLK(above, memory.key, to, start.copy(), **flags)  # type: ignore[call-overload]
    uv = to[:, 0].astype(float)
    good = (there.ravel() > 0) & (again.ravel() > 0) & (np.abs(back - start)[:, 0].max(axis=1) < _BACK_PX)
    inside = ((uv > _MARGIN) & (uv < len(above) - _MARGIN)).all(axis=1)
    at = np.rint(np.where(inside[:, None], uv, 0.0)).astype(int)
    safe = cv2.erode(shown, np.ones((2 * _MARGIN + 1, 2 * _MARGIN + 1), np.uint8))
    kept = np.flatnonzero(good & inside & (safe[at[:, 1], at[:, 0]] > 0))
    return uv[kept], kept


def _corners(above: U8, shown: U8, disc_radius_m: float, old: F64) -> F64:
    """Return new corners in the ring about the pad, (N, 2) px from above, those near the pad first, beside the old ones."""
    middle = (len(above) - 1) // 2
    box = np.ones((2 * _MARGIN + 1, 2 * _MARGIN + 1), np.uint8)
    mask = cv2.erode(shown, box, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    cv2.circle(mask, (middle, middle), math.ceil(_OFF_DISC * disc_radius_m / _STEP_M), 0, -1)
    for x, y in np.rint(old).astype(int).tolist():
        cv2.circle(mask, (x, y), _APART_PX, 0, -1)
    found = cv2.goodFeaturesToTrack(above, 3 * _CORNERS, 0.02, _APART_PX, mask=mask, blockSize=5)
    corners = np.empty((0, 2)) if found is None else found[:, 0].astype(float)
    far = np.hypot(*(corners - middle).T) * _STEP_M > disc_radius_m + _STANDS_REACH_M
    return np.asarray(corners[np.argsort(far, kind="stable")][: max(0, _CORNERS - len(old))])


def _reading(q: F64, below: F64, height_m: float, px_m: float) -> F64:
    """Return the weighted sums, (N, 16), of one reading of corners that are seen at places on the deck, (N, 2) m."""
    sigma = np.sqrt((_SIGMA_PX * px_m) ** 2 + _SIGMA_M**2 + (_SIGMA_AWAY * np.hypot(*q.T)) ** 2)
    w, off = 1.0 / np.maximum(sigma, 1e-6) ** 2, q - below
    a = off / max(height_m, 0.05)
    rows = [
        np.ones(len(q)), *q.T, *a.T, (a * q).sum(axis=1), (a * a).sum(axis=1), (q * q).sum(axis=1),
        *(height_m * off).T, np.full(len(q), height_m**2), (off * off).sum(axis=1), np.full(len(q), height_m), *off.T,
    ]  # fmt: skip
    return np.column_stack([np.column_stack(rows) * w[:, None], np.ones(len(q))])


def _heights(sums: F64, disc_radius_m: float) -> _Heights:
    w = sums[:, 0]
    mean_q, mean_a = sums[:, 1:3] / w[:, None], sums[:, 3:5] / w[:, None]
    aa = np.maximum(1e-9, sums[:, 6] - w * np.square(mean_a).sum(axis=1))
    aq = sums[:, 5] - w * (mean_a * mean_q).sum(axis=1)
    qq = np.maximum(0.0, sums[:, 7] - w * np.square(mean_q).sum(axis=1))
    z = aq / aa
    left = np.maximum(0.0, qq - aq * aq / aa)
    reads, own = sums[:, 15], _left_by_own(sums)
    often = (reads >= _READS) & (own > _OWN * left)
    place = mean_q - z[:, None] * mean_a
    freedom = np.maximum(1.0, 2.0 * reads - 3.0)
    # Most corners lie flat: how far their heights are off says what a standard deviation is worth in this approach.
    sure, flat = np.sqrt(aa), _SIGMAS_ARE[1]
    if np.count_nonzero(often) >= _FLAT_LEAST:
        flat = float(_MAD * median(np.abs(z * sure)[often]))
    # What is high turns and grows on the way down, and its corners are followed less well. On the deck more is left than here, as
    # q = (p - c z/h) / (1 - z/h): glitter that goes its own way would seem to stand just below the camera.
    on_deck = left / np.square(np.clip(1.0 - z / np.sqrt(sums[:, 10] / w), 1.0 - _BELOW, 1.0))
    stays = on_deck < _STAYS * freedom + np.minimum(_STAYS_PART * np.maximum(0.0, aq * z), _STAYS_M**2 * w)
    stands = (
        (reads >= _READS_STANDS)
        & (own > left + _STANDS_SIGMAS**2 * freedom)
        & (z > np.maximum(_STANDS_M, float(np.clip(flat, *_SIGMAS_ARE)) * _STANDS_SIGMAS / sure))
        & stays
    )
    stands &= (np.hypot(*place.T) < disc_radius_m + _STANDS_REACH_M + _CLUSTER_M) & (z < _BELOW * np.sqrt(sums[:, 10] / w))
    moves = often & (left / w > _MOVES_M**2) & (left > _MOVES_TIMES**2 * freedom) & (z > -_STANDS_M)
    return _Heights(place, z, stays, stands, moves, flat)


def _left_by_own(sums: F64) -> F64:
    """Return what the drone's own shadow leaves of each corner's squares, (N,).

    A corner of it is seen at q = c + r + s h: the shadow keeps its size, r, while its middle, s h, comes nearer.
    """
    hh = np.maximum(sums[:, 10], 1e-9)
    own = np.maximum(0.0, sums[:, 11] - np.square(sums[:, 8:10]).sum(axis=1) / hh)
    aside = sums[:, 13:15] - (sums[:, 12] / hh)[:, None] * sums[:, 8:10]
    weight = np.maximum(0.0, sums[:, 0] - sums[:, 12] ** 2 / hh) + _OWN_SIGMA_M**-2
    within = np.hypot(*aside.T) < _OWN_M * weight
    return np.asarray(np.where(within, np.maximum(0.0, own - np.square(aside).sum(axis=1) / weight), own))


def _nearest_of(of: _Heights, q: F64, stood: F64, disc_radius_m: float) -> NearThing | None:
    """Return the nearest thing that several corners agree on, with those that stood and were lost."""
    standing = np.concatenate([of.place[of.stands], stood[:, :2]]), np.concatenate([of.z[of.stands], stood[:, 2]])
    seen: list[NearThing] = []
    moving = q[of.moves], np.zeros(np.count_nonzero(of.moves))
    for (those, up), reach_m in ((standing, disc_radius_m + _STANDS_REACH_M), (moving, math.inf)):
        if len(those) < _AGREE:
            continue
        # One thing has one height: corners that were followed wrongly may stand near each other, and each has its own.
        near = np.hypot(*(those[:, None] - those[None]).transpose(2, 0, 1)) < _CLUSTER_M
        near &= np.abs(up[:, None] - up[None]) <= np.maximum(_LEVEL_M, _LEVEL_PART * up)[:, None]
        agree = near.sum(axis=1)
        # What was lost confirms what is followed, and nothing alone, nor one corner alone.
        followed = np.arange(len(those)) < len(those) - (len(stood) if reach_m < math.inf else 0)
        agreed = np.column_stack([those, up])
        each = near[followed & (agree >= _AGREE) & (near[:, followed].sum(axis=1) >= _FOLLOWED) & (np.hypot(*those.T) < reach_m)]
        seen += [NearThing(*np.median(agreed[these], axis=0).tolist()) for these in each]
    return min(seen, key=lambda of: of.from_centre_m, default=None)


_PASS_PERIOD_S, _LOW_PERIOD_S, _LOW_M = 0.19, 0.09, 1.0
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
"""Number of readings that show what passes from which on it counts for `MOVED_LASTS_S`; below `_LOW_M` one is enough. Second:
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
class PassMemory(_Found):
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
    if memory is not None and 0.0 <= since_s < (_LOW_PERIOD_S if pose.range_m < _LOW_M else _PASS_PERIOD_S):
        return memory
    light, shown = from_above(view, pose, view.pad.disc_radius_m + _REACH_M, _CELL_M, _PASS_MESH, 3)
    centre = -pose.R_cam_pad.matrix.T @ pose.t_cam_pad
    old = memory or _Found()
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
            times = _PASSED_SURE if now.height_m < _LOW_M else 1 + (0 if known is None else times)
            found, found_at, missed = new, at, 0
        elif known is not None and times < _PASSED_SURE and _is_shown(known, shown, _CELL_M):
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


@dataclass(frozen=True, slots=True, eq=False)
class DeckMemory:
    """Memory of things on the pad and about it; a part is None before it was read."""

    surface: SurfaceMemory | None = None
    around: AroundMemory | None = None
    passing: PassMemory | None = None

    def is_due(self, at: MonoNs, view: FrameView, pose: PadPose | None) -> bool:
        """Return whether something may be read in a frame exposed then: at a sure pose, or without one the surface elsewhere."""
        each = (
            (self.surface, PERIOD_S, pose is None or is_near(view, pose)),
            (self.around, PERIOD_S, pose is not None and (self.around is None or _shows_ring(view, pose))),
            (self.passing, _LOW_PERIOD_S if pose is not None and pose.range_m < _LOW_M else _PASS_PERIOD_S, pose is not None),
        )
        return any(may and (of is None or not 0.0 <= seconds_between(of.at, at) < over_s) for of, over_s, may in each)

    def check(self, at: MonoNs) -> PadCheck | None:
        """Return what was lately seen on the pad and about it, what moves first; None if nothing was read or is there."""
        surface = None if self.surface is None or seconds_between(self.surface.at, at) > LASTS_S else self.surface.check
        there = [(near, each.at) for each in (self.around, self.passing) if each is not None and (near := each.near(at))]
        if not there:
            return surface
        near, read = min(there, key=lambda of: (of[0].height_m > 0.0, of[0].from_centre_m))
        if surface is None:
            return PadCheck(read, 0.0, None, near)
        return structs.replace(surface, at=max(surface.at, read), near=near)
