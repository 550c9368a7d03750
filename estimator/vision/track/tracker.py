"""Track the pad in the frames of a flight, by its paint or by its lamps.

A pad with lamps is seen by them where its paint is not: the lamps come first in a dark frame, and as long as they are what shows.
A belief excludes places for both.
"""

import dataclasses
import math
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from estimator.contracts.estimates import UNSURE, Method, RelativeState, Sighting
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.tables import imported
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import SIGMA_DECK_RAD
from estimator.vision.camera.rolling import at_one_instant
from estimator.vision.deck.memory import DeckMemory
from estimator.vision.detect.acquire import FRESH_SEARCH
from estimator.vision.detection import Detection, covered
from estimator.vision.native import work_done
from estimator.vision.options import ColourSetName, TrackerMethod, TrackerOptions
from estimator.vision.pad.pad import Pad
from estimator.vision.register.verified import SURE
from estimator.vision.track.by_paint import by_paint
from estimator.vision.track.config import THESIS
from estimator.vision.track.config import TrackerConfig as TrackerConfig
from estimator.vision.track.expected import ExpectedPlace, expected, near_enough, sigma_of
from estimator.vision.track.lamps import by_lamps
from estimator.vision.track.memory import TrackerMemory as TrackerMemory
from estimator.vision.track.read_deck import read_deck

_EVERY_PX = 16  # Sampling step of columns and rows for the test whether a frame is dark
_DARK = 25
"""Value of the brightest channel below which half of a dark frame's pixels lie: 0.9 % of the light that saturates the camera, in
which a paint's contrast is a few values. Of night frames from 1 m or more nearly all are, and no frame by day."""
_NO_STAMP = Stamp(MonoNs(0), MonoNs(0), 0.0, "arrival")


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
        found: Detection = imported(THESIS).by_thesis(tracker, frame, attitude)
        return found, memory
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
        BadInput: the method is one of the thesis', which are not installed.
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
