"""Detect what stands out of the deck about the pad, and what moves there.

Each frame that is read is drawn as seen from straight above, on the deck's plane as the pad is registered. There everything that
is painted on the deck stays where it is, at the same size. Corners of an earlier such picture are followed by optical flow (Lucas
& Kanade, Proc. IJCAI 1981; Shi & Tomasi, CVPR 1994). A point z above the deck is seen where the ray through it meets the deck,
q = p + (q - c) z / h for a camera at height h over the place c: while the drone comes down, height and place follow by least
squares. What fits no place and height moves. The drone's own shadow, drops on the lens and its own feet keep their place in its
cone, q = c + r + s h, and count for nothing. So does what seems to be below the deck: the sea, mirrored things. Several corners
must agree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between
from estimator.vision.camera.pose import PadPose
from estimator.vision.deck.above import Finding, from_above, is_shown
from estimator.vision.deck.clear_deck import PERIOD_S
from estimator.vision.deck.heights import CLUSTER_M, COLUMNS, STANDS_REACH_M, Heights, heights_of, reading_of
from estimator.vision.detect.pyramid import U8, FrameView
from estimator.vision.detection import NearThing

_GAP_S = 0.7  # Longest time that a corner is followed across
_STEP_M = 0.016  # Size of a pixel of the picture from above
_MESH = 10  # Size of the mesh on which that is drawn, in such pixels
_FAR_PX_M = 0.03  # Size of the frame's pixels on the deck from which on it is too far away
_RING_M = 0.15  # Width of the ring about the pad that is worth a reading
_OFF_DISC = 1.08  # Start of that ring, in radii of the disc
_MOVES_REACH_M = 1.5  # Distance beyond the disc within which what moves counts
_CORNERS = 80  # Number of corners that are followed
_APART_PX = 6  # Least distance of two corners
_QUALITY = 0.02  # Least quality of a corner, of the best one's (Shi and Tomasi)
_WINDOW = (13, 13)  # Window of a corner that is followed, px
_BACK_PX = 0.4  # Largest difference after following a corner back
_MARGIN = 8  # Least distance from where the frame ends, px
_KEY_S = 5.0  # Longest time that the same picture is followed
_LEFT = 0.4  # Least part of a picture's corners that is followed on
_GROWN_KEEPS = (0.65, 1.3)  # Heights, in parts of that of the picture, between which the picture is kept
_GROWN_FOLLOWS = (0.5, 1.5)  # Heights between which its corners can be followed at all
_ASTRAY = 2.0  # Spread about the deck from which on a reading confirms nothing: in its picture the pad was registered wrongly
_AGREE = 3  # Least number of corners that agree
_FOLLOWED = 2  # Least number of those that are still followed
_LOST_S = 1.5  # Time for which a corner that was lost agrees with others
_SURE = 6  # Number of readings that show a standing thing from which on it counts for its whole time
_MOVED_SURE = 2  # The same of one that moves
_FADES = 12
"""Readings of a place without a thing after which one that was shown less is nothing: wrongly followed corners agree once."""
_LEVEL_M = 0.05  # Largest difference in height of corners that agree
_LEVEL_PART = 0.5  # The same in parts of their height: a thing's top, a person's head and shoulders


@dataclass(frozen=True, slots=True, eq=False)
class AroundMemory:
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
    """Sums of the readings of each, (N, COLUMNS), as `heights.SUMS`."""
    of: Heights
    began: int
    """Number of corners when the picture was taken."""
    stood: F64
    """Corners that were lost and stood out of the deck, (N, 4): place (2) m, height m, and time of the loss, s."""
    finding: Finding = field(default_factory=Finding)

    def keeps_picture(self, height_m: float) -> bool:
        """Return whether enough of its picture's corners are followed, and it is not too old or too different."""
        is_young = seconds_between(self.key_at, self.at) <= _KEY_S
        return len(self.uv) > _LEFT * self.began and is_young and _lies(height_m / self.key_height_m, _GROWN_KEEPS)


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """One frame's picture of the deck from above."""

    at: MonoNs
    above: U8
    shown: U8
    below: F64
    """Place of the camera over the deck, (2,) m."""
    height_m: float
    px_m: float
    """Size of the frame's pixels on the deck."""
    disc_radius_m: float

    @staticmethod
    def of(view: FrameView, pose: PadPose, at: MonoNs) -> _Look:
        """Draw it."""
        above, shown = from_above(view, pose, view.pad.disc_radius_m + _MOVES_REACH_M, _STEP_M, _MESH, 1)
        camera = -pose.R_cam_pad.matrix.T @ pose.t_cam_pad
        px_m = pose.range_m / view.camera.fx
        return _Look(at, above, shown, camera[:2], float(-camera[2]), px_m, view.pad.disc_radius_m)

    def places(self, uv: F64) -> F64:
        """Return the places on the deck, (N, 2) m, of corners, (N, 2) px."""
        return (uv - (len(self.above) - 1) / 2) * _STEP_M

    def read(self, uv: F64) -> F64:
        """Return the sums of one reading of corners."""
        return reading_of(self.places(uv), self.below, self.height_m, self.px_m)


def shows_ring(view: FrameView, pose: PadPose) -> bool:
    """Return whether enough of what is about the pad is in the frame, and near enough, to be read."""
    camera, rim_m = view.camera, _OFF_DISC * view.pad.disc_radius_m
    corner_m = pose.range_m * math.hypot(camera.width / camera.fx, camera.height / camera.fy) / 2.0
    return corner_m >= rim_m + _RING_M and pose.range_m <= _FAR_PX_M * camera.fx


def watch_around(memory: AroundMemory | None, view: FrameView, pose: PadPose, at: MonoNs) -> AroundMemory:
    """Return the memory with what a frame shows about the pad, whose registered pose is `pose`."""
    if memory is None:
        return _new_picture(_Look.of(view, pose, at), np.empty((0, 2)), np.empty((0, COLUMNS)), np.empty((0, 4)), Finding())
    since_s = seconds_between(memory.at, at)
    if 0.0 <= since_s < PERIOD_S or not shows_ring(view, pose):
        return memory
    look = _Look.of(view, pose, at)
    if not (len(memory.uv) and 0.0 <= since_s <= _GAP_S and _can_follow(memory, look)):
        return _new_picture(look, np.empty((0, 2)), np.empty((0, COLUMNS)), memory.stood, memory.finding)
    followed = _followed(memory, look)
    if followed.keeps_picture(look.height_m):
        return followed
    # Corners that stay go on in the new picture: a longer way down shows a lower thing. What moves is seen without.
    stay = followed.of.stays
    return _new_picture(look, followed.uv[stay], followed.sums[stay], followed.stood, followed.finding)


def _can_follow(memory: AroundMemory, look: _Look) -> bool:
    is_young = seconds_between(memory.key_at, look.at) < 2.0 * _KEY_S
    return is_young and _lies(look.height_m / memory.key_height_m, _GROWN_FOLLOWS)


def _lies(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] < value < limits[1]


def _followed(memory: AroundMemory, look: _Look) -> AroundMemory:
    """Return the memory with its corners as they are followed into a frame, and what they show."""
    uv, kept = _follow(memory, look.above, look.shown)
    sums = memory.sums[kept] + look.read(uv)
    of = heights_of(sums, look.disc_radius_m)
    stood = _stood(memory, kept, look.at)
    finding = _finding(memory.finding, look, of, look.places(uv), stood)
    return replace(memory, at=look.at, corners=memory.corners[kept], uv=uv, sums=sums, of=of, stood=stood, finding=finding)


def _stood(memory: AroundMemory, kept: NDArray[np.intp], at: MonoNs) -> F64:
    """Return the corners that stood and were lost lately, with those that are not among the ones kept."""
    is_lost = memory.of.stands.copy()
    is_lost[kept] = False
    rows = np.column_stack([memory.of.place[is_lost], memory.of.z[is_lost], np.full(is_lost.sum(), memory.at * 1e-9)])
    return np.concatenate([memory.stood[at * 1e-9 - memory.stood[:, 3] < _LOST_S], rows])


def _finding(old: Finding, look: _Look, of: Heights, q: F64, stood: F64) -> Finding:
    """Return what is found after one more reading of corners at places on the deck, (N, 2) m."""
    new, known = _nearest_of(of, q, stood, look.disc_radius_m), old.near(look.at)
    if new is not None and (known is None or new.height_m > 0.0 or known.height_m == 0.0):
        times = old.shown if known is not None and _is_same(known, new, old.shown) else 0
        return Finding(new, look.at, max(1, times + (of.flat < _ASTRAY)))
    if known is None or old.shown >= (_SURE if known.height_m > 0.0 else _MOVED_SURE) or not is_shown(known, look.shown, _STEP_M):
        return old
    return old.without(_FADES)


def _is_same(known: NearThing, new: NearThing, times: int) -> bool:
    """Return whether a thing is the one that was shown so many times before."""
    if (known.height_m > 0.0) != (new.height_m > 0.0):
        return False
    apart_m = math.hypot(known.forward_m - new.forward_m, known.right_m - new.right_m)
    return apart_m < CLUSTER_M or times >= _SURE or new.height_m == 0.0


def _new_picture(look: _Look, uv: F64, sums: F64, stood: F64, finding: Finding) -> AroundMemory:
    """Return the memory that follows a frame's picture: corners that go on, and new ones beside them."""
    more = _corners(look.above, look.shown, look.disc_radius_m, uv)
    uv, sums = np.concatenate([uv, more]), np.concatenate([sums, look.read(more)])
    of = heights_of(sums, look.disc_radius_m)
    return AroundMemory(look.at, look.at, look.above, look.height_m, uv, uv, sums, of, len(uv), stood, finding)


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
    found = cv2.goodFeaturesToTrack(above, 3 * _CORNERS, _QUALITY, _APART_PX, mask=mask, blockSize=5)
    corners = np.empty((0, 2)) if found is None else found[:, 0].astype(float)
    far = np.hypot(*(corners - middle).T) * _STEP_M > disc_radius_m + STANDS_REACH_M
    return np.asarray(corners[np.argsort(far, kind="stable")][: max(0, _CORNERS - len(old))])


def _nearest_of(of: Heights, q: F64, stood: F64, disc_radius_m: float) -> NearThing | None:
    """Return the nearest thing that several corners agree on, with those that stood and were lost."""
    standing = np.concatenate([of.place[of.stands], stood[:, :2]]), np.concatenate([of.z[of.stands], stood[:, 2]])
    seen: list[NearThing] = []
    moving = q[of.moves], np.zeros(np.count_nonzero(of.moves))
    for (those, up), reach_m in ((standing, disc_radius_m + STANDS_REACH_M), (moving, math.inf)):
        if len(those) < _AGREE:
            continue
        # One thing has one height: corners that were followed wrongly may stand near each other, and each has its own.
        near = np.hypot(*(those[:, None] - those[None]).transpose(2, 0, 1)) < CLUSTER_M
        near &= np.abs(up[:, None] - up[None]) <= np.maximum(_LEVEL_M, _LEVEL_PART * up)[:, None]
        agree = near.sum(axis=1)
        # What was lost confirms what is followed, and nothing alone, nor one corner alone.
        followed = np.arange(len(those)) < len(those) - (len(stood) if reach_m < math.inf else 0)
        agreed = np.column_stack([those, up])
        each = near[followed & (agree >= _AGREE) & (near[:, followed].sum(axis=1) >= _FOLLOWED) & (np.hypot(*those.T) < reach_m)]
        seen += [NearThing(*np.median(agreed[these], axis=0).tolist()) for these in each]
    return min(seen, key=lambda of: of.from_centre_m, default=None)
