"""Track the pad in the frames of a flight, by its paint or by its lamps.

A pad with lamps is seen by them where its paint is not: the lamps come first in a dark frame, and as long as they are what shows.
A belief excludes places for both.
"""

import dataclasses
from types import MappingProxyType

from msgspec.structs import replace

from estimator.contracts.estimates import Method, RelativeState, Sighting
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.believed import BelievedPlace, expected, near_enough, sigma_of
from estimator.vision.by_paint import TrackerMemory as TrackerMemory
from estimator.vision.by_paint import by_paint, by_thesis
from estimator.vision.detection import Detection
from estimator.vision.rolling import at_one_instant
from estimator.vision.tracker_config import TrackerConfig as TrackerConfig
from estimator.vision.verified import SURE

_LAMPS_WORK = 3.0
"""Work of a search for lamps, in the unit of `TrackerConfig.search_work`, of which it leaves the paint's the rest."""


def track(
    tracker: TrackerConfig, memory: TrackerMemory, frame: Frame, attitude: Attitude | None, belief: RelativeState | None = None
) -> tuple[Detection, TrackerMemory]:
    """Detect the pad in one frame and return the detection and the new memory. This function is pure.

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
        return by_paint(tracker, memory, frame, attitude, belief)
    # Few pads have lamps, and the start of the others need not wait for it.
    from estimator.vision.lamp_sighting import by_lamps, is_dark

    first = memory.lit or not tracker.pad.is_identifiable_by_paint or is_dark(frame)
    lit = by_lamps(tracker, memory, frame, attitude, belief) if first else None
    seen, left = Detection(None, None, MappingProxyType({})), memory
    if tracker.pad.is_identifiable_by_paint and not _is_sure(lit):
        rest = dataclasses.replace(tracker, search_work=tracker.search_work - _LAMPS_WORK) if first else tracker
        seen, left = by_paint(rest, memory, frame, attitude, belief)
        if not first and not _is_sure(seen.selected):
            lit = by_lamps(tracker, memory, frame, attitude, belief)
    if lit is None or (seen.selected is not None and seen.selected.confidence >= lit.confidence):
        return seen, dataclasses.replace(left, lit=False)
    methods = MappingProxyType[Method, Sighting | None]({**seen.methods, "lamps": lit})
    if BelievedPlace.of(belief, frame, tracker, memory.alike_yaw_rad).excludes(lit):
        return replace(seen, methods=methods, elsewhere=lit), dataclasses.replace(left, lit=memory.lit)
    return Detection(lit, "lamps", methods, seen.opinions, seen.elsewhere), dataclasses.replace(left, lit=_is_sure(lit))


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
