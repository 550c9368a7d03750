"""Detect what stands out of the deck about the pad, and what moves there.

Each frame that is read is drawn as seen from straight above, on the deck's plane as the pad is registered. There everything that
is painted on the deck stays where it is, at the same size. Corners of an earlier such picture are followed by optical flow (Lucas
& Kanade, Proc. IJCAI 1981; Shi & Tomasi, CVPR 1994). A point z above the deck is seen where the ray through it meets the deck,
q = p + (q - c) z / h for a camera at height h over the place c: while the drone comes down, height and place follow by least
squares. What fits no place and height moves. The drone's own shadow, drops on the lens and its own feet keep their place in its
cone, q = c + r + s h, and count for nothing. So does what seems to be below the deck: the sea, mirrored things. Several corners
must agree.
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between
from estimator.vision.camera.pose import PadPose
from estimator.vision.deck.above import Found, from_above, is_shown
from estimator.vision.deck.clear_deck import PERIOD_S, median
from estimator.vision.detect.pyramid import U8, FrameView
from estimator.vision.detection import NearThing

_GAP_S = 0.7
"""Longest time that a corner is followed across, s."""
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


@dataclass(frozen=True, slots=True, eq=False)
class AroundMemory(Found):
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


def shows_ring(view: FrameView, pose: PadPose) -> bool:
    """Return whether enough of what is about the pad is in the frame, and near enough, to be read."""
    camera, rim_m = view.camera, _OFF_DISC * view.pad.disc_radius_m
    corner_m = pose.range_m * math.hypot(camera.width / camera.fx, camera.height / camera.fy) / 2.0
    return corner_m >= rim_m + _RING_M and pose.range_m <= _FAR_PX_M * camera.fx


def watch_around(memory: AroundMemory | None, view: FrameView, pose: PadPose, at: MonoNs) -> AroundMemory:
    """Return the memory with what a frame shows about the pad, whose registered pose is `pose`."""
    since_s = math.inf if memory is None else seconds_between(memory.at, at)
    if memory is not None and (0.0 <= since_s < PERIOD_S or not shows_ring(view, pose)):
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
        elif known is not None and times < (_SURE if known.height_m > 0.0 else _MOVED_SURE) and is_shown(known, shown, _STEP_M):
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
