"""Register the pad where the filter expects it, else where a search finds it, and verify it there."""

from __future__ import annotations

import dataclasses
import math
from types import MappingProxyType

import numpy as np
from msgspec import structs

from estimator.contracts.estimates import Method, RelativeState, Sighting
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.detect import verification
from estimator.vision.detect.acquire import FRESH_SEARCH, PadCandidate, SearchMemory, align_at, search
from estimator.vision.detect.guesses import Plane, heading
from estimator.vision.detect.pose_about import pose_about
from estimator.vision.detect.pyramid import FrameView
from estimator.vision.detect.template import LEARNED_AT, fade
from estimator.vision.detect.verification import calibrate
from estimator.vision.detection import Detection, Opinions, agree
from estimator.vision.learned.second_opinion import WORTH_ASKING
from estimator.vision.pad.information import alike_headings
from estimator.vision.register.doubts import nearest_of_four
from estimator.vision.register.registration import RegistrationOptions
from estimator.vision.register.sighting import sighting_of_look
from estimator.vision.register.verified import CLOSE, CODED_PX, ROUGH, SURE, Verified, verify
from estimator.vision.thesis.detection import detect
from estimator.vision.thesis.segmentation import COLOUR_SETS
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.expected import ExpectedPlace, expected, in_camera, near_enough, sigma_of
from estimator.vision.track.memory import _WORTH_ANOTHER, Now, Registered, Seen
from estimator.vision.track.read_deck import _COVER_SURE, COVER_NS

_CLOSE_PX = 1.0
"""Largest standard deviation of the expected position in the frame at which registration starts directly from it."""
_SEARCHED = 0.75
"""Share of a frame's work at which a search ends: the rest is for the registration of a candidate."""
_CANDIDATES = 2
"""Number of candidates of acquisition that are registered, those after the first while the frame's work lasts."""
WORTH_A_TRY = 0.03
"""Score of a candidate of acquisition, or of a drawing at a method's pose, below which it is not registered."""
EXPECTED_SIGMAS = 3.0
"""Standard deviations of the expected position within which a candidate of acquisition counts as expected."""
_SMALL_PX, _LEAST_ABOUT = 15.0, 0.12
"""Radius of the disc, px, below which a pad that the estimate did not lead to is searched some pixels about its place.

The least fraction of the variance that the drawing must explain there: of pads in glare or half covered it is 0.16 or more.
"""


def rays_of(pose: PadPose) -> F64:
    """Return the matrix, (3, 3), that takes a place on the pad, x, y and 1, to its ray, times its depth."""
    return np.column_stack([pose.R_cam_pad.matrix[:, :2], pose.t_cam_pad])


def by_thesis(tracker: TrackerConfig, frame: Frame, attitude: Attitude | None) -> Detection:
    """Return what the thesis' methods detect."""
    o = tracker.options
    return detect(frame, attitude, tracker.camera, tracker.pad, COLOUR_SETS[o.colours], sigma_deck_rad=o.deck_tilt_sigma_rad)


def register(now: Now, belief: RelativeState | None, place: ExpectedPlace) -> tuple[Seen, SearchMemory]:
    """Register where the belief expects the pad, else where a search finds it; return the best, and what the search leaves."""
    camera, pad, attitude, alike_yaw_rad = now.tracker.camera, now.tracker.pad, now.attitude, now.memory.alike_yaw_rad
    left, best, suspect = FRESH_SEARCH, Seen(), False
    start: PadPose | None = None
    sigma_m = math.inf if belief is None else sigma_of(belief)
    if belief is not None and attitude is not None and near_enough(belief, sigma_m, pad, alike_yaw_rad):
        start = expected(belief, attitude, camera, alike_yaw_rad)
        if start is not None and start.t_cam_pad[2] > 0.05:
            options = CLOSE if sigma_m * camera.fx < _CLOSE_PX * start.t_cam_pad[2] else ROUGH
            tracked = verification.TRACKED_LOG_ODDS
            cover, beside = now.memory.cover, None
            if cover is not None and 0 <= now.frame.stamp.measured_at - cover[1] < COVER_NS:
                cut = np.asarray(np.linalg.solve(rays_of(start).T, cover[0]))
                beside = _register_from(now, start, CLOSE, tracked, cut, searched=False)
            if beside is None or min(beside.sighting.confidence, beside.agreement) < _COVER_SURE:
                beside = _register_from(now, start, options, tracked, searched=False)
            best = best.having(beside, place)
            suspect = options is ROUGH and best.tracked is not None and best.tracked.agreement < _WORTH_ANOTHER
            if suspect:
                # The whole drawing, blurred, draws from farther away than edges do.
                aligned = align_at(start, now.orientation.measured, now.view)
                if aligned is not None and aligned.score >= WORTH_A_TRY:
                    best = best.having(_register_from(now, aligned.pose, CLOSE, tracked, searched=False), place)
            by_parts = pad.markings.is_searched_by_parts and not pad.markings.is_letter_alone
            if not best.is_sure and by_parts and start.px_of(pad.disc_radius_m, camera) < _SMALL_PX:
                plane = Plane.of(camera, attitude.R_ned_body.without_heading())
                about = pose_about(now.view.as_seen(), plane, start)
                if about is not None and about[1] >= _LEAST_ABOUT:
                    best = best.having(_register_from(now, about[0], CLOSE, tracked, searched=False), place)
    if not best.is_sure or (suspect and not best.agrees):
        R_level_body = None if attitude is None else attitude.R_ned_body.without_heading()
        found = search(now.view, R_level_body, now.memory.paint, now.memory.search, budget=_SEARCHED * now.tracker.search_work)
        left = found.memory
        for number, candidate in enumerate(found.candidates[:_CANDIDATES]):
            # One that is none of the pad takes ten floors and more to be refused, beside what covers it, too.
            if candidate.score < WORTH_A_TRY or (number > 0 and now.view.pyramid.work > now.tracker.search_work):
                break
            off_m = math.inf if start is None else float(np.linalg.norm(candidate.pose.t_cam_pad - start.t_cam_pad))
            prior = verification.TRACKED_LOG_ODDS if off_m < EXPECTED_SIGMAS * sigma_m else 0.0
            pose = candidate.pose
            if pad.markings.is_letter_alone and alike_headings(pad) == 4:
                R_level_cam = now.orientation.R_level_body.matrix @ camera.T_body_cam.R.matrix
                pose = nearest_of_four(pose, R_level_cam, alike_yaw_rad or 0.0)
            best = best.having(_register_from(now, pose, CLOSE, prior, candidate.cut), place)
            if best.is_sure and (best.agrees or not suspect):
                break
    return best, left


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
            aligned = _register_from(now, candidate.pose, CLOSE)
        methods[method] = structs.replace(
            cue, confidence=0.0 if aligned is None else min(cue.confidence, aligned.sighting.confidence)
        )
        best = best.having(aligned, place)
    return structs.replace(thesis, methods=MappingProxyType(methods)), best


def _align_cue(view: FrameView, cue: Sighting, orientation: Orientation) -> PadCandidate | None:
    """Align the drawing at a cue's pose. A cue without a heading is aligned at the heading that fits best."""
    flat = in_camera(cue.d_body_pad_level, cue.yaw_rad or 0.0, orientation.R_level_body, view.camera)
    if flat.t_cam_pad[2] < 0.05:
        return None
    if cue.yaw_rad is None:
        found = heading(view, flat)
        if found is None:
            return None
        flat = flat.turned(found.turn_rad)
    return align_at(flat, orientation.measured, view)


def _register_from(
    now: Now,
    start: PadPose,
    options: RegistrationOptions,
    prior_log_odds: float = 0.0,
    cut: F64 | None = None,
    *,
    searched: bool = True,
) -> Registered | None:
    """Register from a start pose and verify the drawing at the result; arguments as for `verify`.

    Args:
        searched: whether the start comes from a search or a cue and not from the belief: then the second opinion is used.
    """
    if now.frame.coded:
        options = dataclasses.replace(options, coded_px=CODED_PX)
    paint = now.memory.paint
    of = verify(now.view, start, now.orientation, options, prior_log_odds, cut, paint)
    if of is None:
        return None
    opinions = _second_opinion(now, of) if searched else None
    # The network can only lower a confidence.
    sure = of.confidence if opinions is None else min(of.confidence, opinions.learned)
    learned = fade(paint) if sure < SURE else of.found.paint() if sure >= LEARNED_AT else paint
    # A letter alone tells too little to be surer than its bound.
    said = sure if now.tracker.pad.markings.is_letter_alone else calibrate(sure)
    return Registered(sighting_of_look(now.frame, of.found, said), learned, of.found, opinions, of.cut)


def _second_opinion(now: Now, of: Verified) -> Opinions | None:
    """Return both opinions on a registration; None if the second opinion is not used or sees too little of the pad."""
    network = now.tracker.second_opinion
    if network is None or of.confidence < WORTH_ASKING:
        return None
    log_odds = network.log_odds(*now.view, of.found.pose, of.cut)
    return None if log_odds is None else Opinions(of.confidence, verification.confidence(log_odds))
