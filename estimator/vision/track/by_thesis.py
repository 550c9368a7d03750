"""See the pad by the thesis' methods, alone or beside its drawing; loaded where `vision.method` wants them."""

from __future__ import annotations

from types import MappingProxyType

from msgspec import structs

from estimator.contracts.estimates import Method, Sighting
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.camera.pose import Orientation
from estimator.vision.detect.acquire import PadCandidate, align_at
from estimator.vision.detect.guesses import heading
from estimator.vision.detect.pyramid import FrameView
from estimator.vision.detection import Detection, agree
from estimator.vision.register.verified import CLOSE
from estimator.vision.thesis.detection import detect
from estimator.vision.thesis.segmentation import COLOUR_SETS
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.expected import ExpectedPlace, in_camera
from estimator.vision.track.memory import Now, Seen
from estimator.vision.track.register import NEAREST_M, WORTH_A_TRY, register_from


def by_thesis(tracker: TrackerConfig, frame: Frame, attitude: Attitude | None) -> Detection:
    """Return what the thesis' methods detect."""
    o = tracker.options
    return detect(frame, attitude, tracker.camera, tracker.pad, COLOUR_SETS[o.colours], sigma_deck_rad=o.deck_tilt_sigma_rad)


def verify_cues(now: Now, thesis: Detection, best: Seen, place: ExpectedPlace) -> tuple[Detection, Seen]:
    """Verify the cues of the thesis' methods, and return them with the best registrations.

    A cue's confidence is limited to that of the drawing registered at the cue's pose, unless it agrees with a confident
    registration. The returned registrations are the best of the given ones and those started from cues.
    """
    sure = best.tracked.sighting if best.tracked is not None and best.is_sure else None
    methods: dict[Method, Sighting | None] = dict(thesis.methods)
    for method, cue in thesis.methods.items():
        if cue is None or (sure is not None and agree(cue, sure)):
            continue
        candidate = _align_cue(now.view, cue, now.orientation)
        aligned = None
        if candidate is not None and candidate.score >= WORTH_A_TRY:
            aligned = register_from(now, candidate.pose, CLOSE)
        methods[method] = structs.replace(
            cue, confidence=0.0 if aligned is None else min(cue.confidence, aligned.sighting.confidence)
        )
        best = best.having(aligned, place)
    return structs.replace(thesis, methods=MappingProxyType(methods)), best


def _align_cue(view: FrameView, cue: Sighting, orientation: Orientation) -> PadCandidate | None:
    """Align the drawing at a cue's pose. A cue without a heading is aligned at the heading that fits best."""
    flat = in_camera(cue.d_body_pad_level, cue.yaw_rad or 0.0, orientation.R_level_body, view.camera)
    if flat.t_cam_pad[2] < NEAREST_M:
        return None
    if cue.yaw_rad is None:
        found = heading(view, flat)
        if found is None:
            return None
        flat = flat.turned(found.turn_rad)
    return align_at(flat, orientation.measured, view)
