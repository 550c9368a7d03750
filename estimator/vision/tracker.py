"""Track the pad in the frames of a flight, by its paint or by its lamps.

A pad with lamps is seen by them where its paint is not: the lamps come first in a dark frame, and as long as they are what shows.
A belief excludes places for both. Lamps are found and measured where the filter expects them, else anywhere in the frame; the
native core does all of it in one call (`estimator/core/vision/lamps/lamps.c`).

The first look builds the drawing's maps, the camera's rays and the tables of light: ten times as much work as any later look. A
rehearsal looks at drawn frames before the first real one; for a pad with lamps, one is drawn by day and one by night.

A pad that is followed without an attitude may leave the picture. It is known again if any other pad would have shown beside it
(`alone_in`). That search has no limit of work, and takes some times as long as an ordinary look: it is not made in each frame.
"""

import dataclasses
import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from estimator.contracts.estimates import CENTRE, UNSURE, Feature, Method, RelativeState, Sighting
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.core.abi import DL_LAMP_PAIRS_MAX
from estimator.core.library import CORE
from estimator.vision.about_pad import DeckMemory
from estimator.vision.by_paint import ExpectedPlace, by_paint, by_thesis, expected, in_camera, near_enough, read_deck, sigma_of
from estimator.vision.by_paint import TrackerMemory as TrackerMemory
from estimator.vision.camera import Camera
from estimator.vision.detect.acquire import FRESH_SEARCH
from estimator.vision.detect.template import paints_at
from estimator.vision.detection import Detection, covered
from estimator.vision.native import checked, image_of, native_prior, tracker_of, work_done
from estimator.vision.options import ColourSetName, TrackerMethod, TrackerOptions
from estimator.vision.pad import Lamp, Pad, places_of
from estimator.vision.pad_information import alike_headings, confusable_turns
from estimator.vision.pose import SIGMA_DECK_RAD, Orientation, PadPose
from estimator.vision.register.registration import sighting_in_level
from estimator.vision.rolling import at_one_instant
from estimator.vision.tracker_config import TrackerConfig as TrackerConfig
from estimator.vision.verified import SURE

_FOUND = 1
_EXPECTED_SIGMAS = 3.0
"""Standard deviations of the expected position within which the pad is expected."""
REACH_PX = 40.0
"""Largest reach about the expected position in which lamps are assigned to spots; beyond it the frame is searched for them."""
_EVERY_PX = 16
"""Sampling step of columns and rows for the test whether a frame is dark."""
_DARK = 25
"""Value of the brightest channel below which half of a dark frame's pixels lie: 0.9 % of the light that saturates the camera, in
which a paint's contrast is a few values. Of night frames from 1 m or more nearly all are, and no frame by day."""


def detect_lamps(
    frame: Frame, camera: Camera, pad: Pad, orientation: Orientation, expected: PadPose | None = None, reach_px: float = 0.0
) -> Sighting | None:
    """Return the sighting of a pad by its lamps, of method "lamps"; None if its lamps are not seen.

    Args:
        orientation: the attitude at the exposure.
        expected: where the pad is expected; if it is not seen there, or with None, the whole frame is searched.
        reach_px: how far the pad may be from there in the frame.

    Raises:
        ValueError: the frame is not of the camera's size.
    """
    px = np.ascontiguousarray(frame.px, np.uint8)
    if px.shape != (camera.height, camera.width, 3):
        raise ValueError(f"want a frame of shape {(camera.height, camera.width, 3)}, got {px.shape}")
    out, at = CORE.record("dl_found_lamps"), CORE.ffi.NULL
    if expected is not None:
        pose = (expected.R_cam_pad.matrix.ravel().tolist(), expected.t_cam_pad.tolist())
        at = CORE.ffi.new("dl_expected_lamps *", (pose, reach_px))
    prior = CORE.ffi.new("dl_tilt_prior *", native_prior(orientation))
    found = CORE.lib.dl_find_lamps(
        tracker_of(camera),
        image_of(px),
        CORE.array("dl_lamp_pattern", pattern_of(pad)),
        prior,
        at,
        CORE.array("dl_found_lamps", out),
    )
    return _sighting(frame, out, camera) if checked(found) == _FOUND else None


def _sighting(frame: Frame, seen: NDArray[Any], camera: Camera) -> Sighting:
    lit, centre = seen["uv_px"][: 2 * int(seen["lit"])].reshape(-1, 2), camera.project(seen["pose"]["t"][None])
    features = Feature("point", "lamp", lit), Feature("point", CENTRE, centre)
    return sighting_in_level(frame, seen["seen"], False, float(seen["confidence"]), features, "lamps")


@lru_cache(maxsize=8)
def pattern_of(pad: Pad) -> NDArray[Any]:
    """Return the core's `dl_lamp_pattern`."""
    places, pairs = places_of(pad.lamps), tried_pairs(pad.lamps)
    return CORE.record(
        "dl_lamp_pattern", lamps=len(pad.lamps), pairs=len(pairs), pair=pairs, x_m=places[:, 0], y_m=places[:, 1],
        radius_m=[lamp.radius_m for lamp in pad.lamps], size_sigma_m=pad.size_sigma_m,
    )  # fmt: skip


def tried_pairs(lamps: Sequence[Lamp]) -> NDArray[np.int64]:
    """Return the pairs of lamps that a search tries, (P, 2): near the pad only the inner lamps are in view.

    They are those that are the farthest apart among all lamps, and as many among the inner half.
    """
    places = places_of(lamps)
    order = np.argsort(np.linalg.norm(places - np.median(places, axis=0), axis=1))
    inner = order[: max(3, len(places) // 2)]
    return np.array([*_farthest(places, range(len(places))), *_farthest(places, inner.tolist())])


def _farthest(places: F64, among: Sequence[int]) -> list[tuple[int, int]]:
    pairs = sorted(combinations(among, 2), key=lambda pair: -float(np.linalg.norm(places[pair[0]] - places[pair[1]])))
    return pairs[: DL_LAMP_PAIRS_MAX // 2]


def by_lamps(
    tracker: TrackerConfig, memory: TrackerMemory, frame: Frame, attitude: Attitude | None, belief: RelativeState | None
) -> Sighting | None:
    """Return the sighting of a pad by its lamps; None if they are not seen."""
    orientation, start, reach_px = Orientation.of(attitude, tracker.options.deck_tilt_sigma_rad), None, 0.0
    if belief is not None and attitude is not None:
        start = expected(belief, attitude, tracker.camera, memory.alike_yaw_rad)
        if start is not None and start.t_cam_pad[2] > 0.05:
            reach_px = _EXPECTED_SIGMAS * sigma_of(belief) * tracker.camera.fx / float(start.t_cam_pad[2])
    near = start is not None and 0.0 < reach_px < REACH_PX
    return detect_lamps(frame, tracker.camera, tracker.pad, orientation, start if near else None, reach_px)


_RADII = 5.0
"""Height of the drawn view in radii of the pad's disc: all of the pad fits into any camera's frame."""
_AT = Stamp(MonoNs(0), MonoNs(0), 0.001, "sim")
_NO_STAMP = Stamp(MonoNs(0), MonoNs(0), 0.0, "arrival")
_DECK, _H, _ORANGE, _DISC, _BLACK = (110, 105, 100), (235, 235, 235), (30, 120, 230), (60, 130, 50), (20, 20, 20)
"""Colours of deck and paints, BGR; fiducials are dark on light."""


def rehearse(tracker: TrackerConfig) -> Detection:
    """Search a frame that is drawn for this camera and pad, then track the pad in it. No memory of it is kept.

    Returns:
        The second detection of the pad's paint.
    """
    for kept in (alike_headings, confusable_turns):  # the first frame in doubt would wait for them
        kept(tracker.pad)
    if tracker.pad.lamps:
        _seen_twice(tracker, drawn_lamps(tracker.camera, tracker.pad))
    return _seen_twice(tracker, drawn(tracker.camera, tracker.pad))


def _seen_twice(tracker: TrackerConfig, px: NDArray[np.uint8]) -> Detection:
    frame = Frame(_AT, 0, px)
    # The camera's axes are those of `ned` while it looks straight down with the top of its image to the west.
    attitude = Attitude(_AT, tracker.camera.T_body_cam.R.inv, 1e-4 * np.eye(3))
    searched, memory = track(tracker, TrackerMemory(), frame, attitude)
    seen = searched.selected
    if seen is None:
        return searched
    still, cov = np.zeros(3), 1e-4 * np.eye(7)
    estimate = RelativeState(_AT.measured_at, "ekf", seen.d_body_pad_level, still, seen.yaw_rad, cov, _AT.measured_at, True)
    return track(tracker, memory, frame, attitude, estimate)[0]


def drawn(camera: Camera, pad: Pad) -> NDArray[np.uint8]:
    """Return the pad, (height, width, 3) BGR, as the camera sees it straight below, without distortion."""
    height_m = _RADII * pad.disc_radius_m
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    xy_m = height_m * np.stack([(u.ravel() - camera.cx) / camera.fx, (v.ravel() - camera.cy) / camera.fy], axis=1)
    h_marking, ring, arrow, disc = paints_at(xy_m, pad)
    px = np.full((camera.width * camera.height, 3), _DECK, np.uint8)
    h_bgr, disc_bgr = (_BLACK, _H) if pad.markings.fiducials else (_H, _DISC)
    for mask, colour in ((disc, disc_bgr), (ring | arrow, _ORANGE), (h_marking, h_bgr)):
        px[mask] = colour
    return np.asarray(cv2.GaussianBlur(px.reshape(camera.height, camera.width, 3), (0, 0), 0.8), np.uint8)


def drawn_lamps(camera: Camera, pad: Pad) -> NDArray[np.uint8]:
    """Return the pad's lamps in the dark, (height, width, 3) BGR, as the camera sees them straight below, without distortion."""
    height_m = _RADII * pad.disc_radius_m
    px = np.zeros((camera.height, camera.width, 3), np.uint8)
    for x_m, y_m in places_of(pad.lamps).tolist():
        centre = round(camera.cx + camera.fx * x_m / height_m), round(camera.cy + camera.fy * y_m / height_m)
        cv2.circle(px, centre, 2, (255, 255, 255), -1)
    return np.asarray(cv2.GaussianBlur(px, (0, 0), 0.8), np.uint8)


def track(
    tracker: TrackerConfig, memory: TrackerMemory, frame: Frame, attitude: Attitude | None, belief: RelativeState | None = None
) -> tuple[Detection, TrackerMemory]:
    """Detect the pad in one frame and read the deck there; return the detection and the new memory. Arguments as for `sight`."""
    return read_deck(*sight(tracker, memory, frame, attitude, belief))


def sight(
    tracker: TrackerConfig, memory: TrackerMemory, frame: Frame, attitude: Attitude | None, belief: RelativeState | None = None
) -> tuple[Detection, TrackerMemory]:
    """Detect the pad in one frame and return the detection and the new memory. This function is pure.

    Nobody who waits for the pad's place waits for what lies about it: `read_deck` reads that afterwards. A memory in which
    it was not read forgets the frame.

    Args:
        attitude: the attitude at the exposure. With None the vehicle is assumed level, and the covariance grows accordingly.
        belief: the belief about the pad at the exposure. With None, or without a heading, the whole frame is searched.

    Raises:
        ValueError: the frame is not of the camera's size.
    """
    frame = _of_one_instant(tracker, memory, frame, attitude, belief)
    if tracker.options.method == "thesis":
        return by_thesis(tracker, frame, attitude), memory
    if not tracker.pad.lamps:
        return _painted(tracker, memory, frame, attitude, belief)
    began = work_done()
    # In the dark lamps show rather than paint.
    lamps = memory.lit or not tracker.pad.is_identifiable_by_paint
    first = lamps or bool(np.median(frame.px[::_EVERY_PX, ::_EVERY_PX].max(axis=2)) < _DARK)
    lit = by_lamps(tracker, memory, frame, attitude, belief) if first else None
    seen, left = Detection(None, None, MappingProxyType({})), memory
    if tracker.pad.is_identifiable_by_paint and not _is_sure(lit):
        rest = dataclasses.replace(tracker, search_work=tracker.search_work - 1e-6 * (work_done() - began)) if first else tracker
        seen, left = _painted(rest, memory, frame, attitude, belief)
        if not first and not _is_sure(seen.selected):
            lit = by_lamps(tracker, memory, frame, attitude, belief)
    if lit is None or (seen.selected is not None and seen.selected.confidence >= lit.confidence):
        return seen, dataclasses.replace(left, lit=False)
    methods = MappingProxyType[Method, Sighting | None]({**seen.methods, "lamps": lit})
    if ExpectedPlace.of(belief, frame, tracker, memory.alike_yaw_rad).excludes(lit):
        return replace(seen, methods=methods, elsewhere=covered(lit)), dataclasses.replace(left, lit=memory.lit)
    return Detection(covered(lit), "lamps", methods, seen.opinions, seen.elsewhere), dataclasses.replace(left, lit=_is_sure(lit))


def _painted(
    tracker: TrackerConfig, memory: TrackerMemory, frame: Frame, attitude: Attitude | None, belief: RelativeState | None
) -> tuple[Detection, TrackerMemory]:
    """Detect the pad by its paint, and a reversible one in reversed light, too: first in that which it was last seen in."""
    if not tracker.pad.reversible:
        return by_paint(tracker, memory, frame, attitude, belief)
    both = (frame, replace(frame, px=cv2.bitwise_not(frame.px)))
    half = dataclasses.replace(tracker, search_work=0.5 * tracker.search_work)
    seen, left = by_paint(half, memory, both[memory.reversed], attitude, belief)
    left = dataclasses.replace(left, reversed=memory.reversed)
    if _is_sure(seen.selected):
        return seen, left
    other, left_other = by_paint(
        half, TrackerMemory(deck=DeckMemory(memory.deck.surface)), both[not memory.reversed], attitude, belief
    )
    said, said_other = (0.0 if of.selected is None else of.selected.confidence for of in (seen, other))
    # A search that was ended by its work goes on in the next frame; after a whole one the other light is searched first.
    turns = said_other > said or (said_other == said and left.search is FRESH_SEARCH)
    left = dataclasses.replace(left_other, reversed=not memory.reversed) if turns else left
    return (other if said_other > said else seen), left


def _is_sure(seen: Sighting | None) -> bool:
    return seen is not None and seen.confidence >= SURE


def _of_one_instant(
    tracker: TrackerConfig, memory: TrackerMemory, frame: Frame, attitude: Attitude | None, belief: RelativeState | None
) -> Frame:
    """Return the frame without the readout of a rolling shutter; as it is where the pad's place is hardly known."""
    if tracker.motion is None or belief is None or attitude is None:
        return frame
    if not near_enough(belief, sigma_of(belief), tracker.pad, memory.alike_yaw_rad):
        return frame
    about = expected(belief, attitude, tracker.camera, memory.alike_yaw_rad)
    return frame if about is None else replace(frame, px=at_one_instant(frame.px, tracker.camera, about, tracker.motion))


_COVERED = 1.3
"""Radius, in radii of the disc, of what is covered of a pad to look for another one."""
_DOUBTFUL, _SEEN = 0.05, 0.5
"""Confidences from which something may be another pad, and from which it is one."""
_RIM = _COVERED * np.stack([np.cos(a := np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)), np.sin(a), 0.0 * a], axis=1)


def alone_in(tracker: TrackerConfig, memory: TrackerMemory, frame: Frame, attitude: Attitude, pad: Sighting) -> F64 | None:
    """Search a frame for a second pad; return which part of the deck shows none.

    Args:
        memory: of the look that saw the pad.
        pad: the one that was seen.

    Returns:
        Corners, (4, 2) m in `level`, within which all of a pad's disc is in the frame; empty if a second pad is there, and None
        if that is in doubt or if too little of the deck is in the frame.
    """
    camera, radius_m = tracker.camera, tracker.pad.disc_radius_m
    R_level_body = attitude.R_ned_body.without_heading()
    pose = in_camera(pad.d_body_pad_level, pad.yaw_rad or 0.0, R_level_body, camera)
    corners = _shown(camera, attitude, pad.d_body_pad_level.item(2), pose.disc_px(camera, tracker.pad))
    if corners is None:
        return None
    rim = pose.points(radius_m * _RIM)
    if rim[:, 2].min() < 0.05:
        return None
    uv, px = np.round(camera.project(rim)).astype(np.int32), frame.px.copy()
    u, v = np.clip(uv, 0, (camera.width - 1, camera.height - 1)).T
    cv2.fillConvexPoly(px, uv, np.median(px[v, u], axis=0).tolist())  # with the deck's colour: else it would be a disc again
    whole = dataclasses.replace(tracker, search_work=math.inf)
    other = sight(whole, dataclasses.replace(memory, search=FRESH_SEARCH), replace(frame, px=px), attitude)[0].selected
    if other is None or other.confidence < _DOUBTFUL:
        return corners
    if math.dist(other.d_body_pad_level[:2], pad.d_body_pad_level[:2]) < tracker.integrity.pads_apart_m:
        return None  # what is left of the same one, where the edge of the frame cut it and its place is off
    return None if other.confidence < _SEEN else np.empty((0, 2))


def _shown(camera: Camera, attitude: Attitude, down_m: float, inset_px: float) -> F64 | None:
    """Return the corners on the deck of a frame that is smaller by an inset on each side; None if nothing is left of it."""
    u, v = (np.array([inset_px, size - 1.0 - inset_px]) for size in (camera.width, camera.height))
    if u[1] <= u[0] or v[1] <= v[0]:
        return None
    uv = np.array([(u[0], v[0]), (u[1], v[0]), (u[1], v[1]), (u[0], v[1])])
    R_level_body = attitude.R_ned_body.without_heading().matrix
    rays = np.column_stack([camera.rays(uv), np.ones(4)]) @ (R_level_body @ camera.T_body_cam.R.matrix).T
    origin = R_level_body @ camera.T_body_cam.t
    if rays[:, 2].min() < 0.1:
        return None
    return np.asarray(origin[:2] + rays[:, :2] * ((down_m - origin[2]) / rays[:, 2:]))


class PadTracker:
    """Find the pad in the images of one camera, with a memory of its own. It learns the colours of the paint as it goes.

    Args:
        camera: intrinsics and mount of the camera.
        pad: the drawing of the pad, in metres.
        method: "registration" aligns the drawing, "thesis" takes the thesis' three methods, "fused" combines all four by
            covariance, at three times the cost.
        colours: the colour limits of the thesis' methods: "simulator", "indoor" or "outdoor".
        min_confidence: a find with less confidence (0..1) counts as none.
        sigma_deck_rad: one standard deviation of the deck's roll and pitch, rad.

    Raises:
        TypeError: `camera` is no Camera, or `pad` no Pad.
        ValueError: there is no such method or colours, `min_confidence` is outside 0..1, or `sigma_deck_rad` is outside 0 to
            30 degrees.
    """

    def __init__(
        self,
        camera: Camera,
        pad: Pad,
        *,
        method: TrackerMethod = "registration",
        colours: ColourSetName = "indoor",
        min_confidence: float = UNSURE,
        sigma_deck_rad: float = SIGMA_DECK_RAD,
    ) -> None:
        for given, kind in ((camera, Camera), (pad, Pad)):
            if not isinstance(given, kind):
                raise TypeError(f"PadTracker(camera, pad) takes a {kind.__name__}, got a {type(given).__name__}")
        if not 0.0 <= min_confidence <= 1.0:
            raise ValueError(f"min_confidence must lie in 0..1, got {min_confidence!r}")
        self._config = TrackerConfig(camera, pad, TrackerOptions(method, colours, math.degrees(sigma_deck_rad)))
        self._memory = TrackerMemory()
        self._min_confidence = min_confidence
        self._seq = 0
        self._detection: Detection | None = None

    @property
    def detection(self) -> Detection | None:
        """The result of every method for the newest image, at any confidence; None before the first image."""
        return self._detection

    def track(
        self,
        image: NDArray[Any],
        *,
        stamp: Stamp | None = None,
        attitude: Attitude | None = None,
        expected: RelativeState | None = None,
    ) -> Sighting | None:
        """Find the pad in one image.

        Args:
            image: (H, W, 3) uint8, BGR as OpenCV reads it, or (H, W) or (H, W, 1) of a mono camera. The caller must not write to
                it during the call.
            stamp: the instant of the exposure; the sighting carries it. Needed only where sightings go into an estimator.
            attitude: the vehicle's attitude at the exposure. None takes the vehicle as level, and the covariance grows to match.
            expected: the expected place of the pad at the exposure, from `RelativeEstimator.at`. The search then begins there,
                which is faster; it is used only together with `attitude`. None searches the whole image.

        Returns:
            The pad's position from the body's origin in `level` (m forward, right, down), the heading, their covariance and the
            confidence; None when the pad is not found. Where the expected place hardly shows it, this may be a pad in a place
            that a fresh `expected` excludes: an estimator refuses that one as `Verdict.ELSEWHERE`.

        Raises:
            TypeError: `stamp` is no Stamp.
            ValueError: the image is no (H, W, 3), (H, W, 1) or (H, W) uint8 array, or not of the camera's size.
        """
        if stamp is not None and not isinstance(stamp, Stamp):
            raise TypeError(f"stamp must be a Stamp, got a {type(stamp).__name__}")
        camera = self._config.camera
        pixels = np.asarray(image)[...]  # a view: Frame makes its array read-only, and the caller's stays writable
        if pixels.shape[:2] != (camera.height, camera.width):
            raise ValueError(f"the camera's images are {camera.width}x{camera.height} px, got an array of shape {pixels.shape}")
        if pixels.ndim == 2 or (pixels.ndim == 3 and pixels.shape[2] == 1):
            pixels = np.repeat(pixels.reshape(*pixels.shape[:2], 1), 3, axis=2)
        frame = Frame(stamp or _NO_STAMP, self._seq, pixels)
        self._seq += 1
        self._detection, self._memory = track(self._config, self._memory, frame, attitude, expected)
        for found in (self._detection.selected, self._detection.elsewhere):
            if found is not None and found.confidence >= self._min_confidence:
                return found
        return None
