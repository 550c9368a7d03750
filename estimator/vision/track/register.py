"""Register the pad where the filter expects it, else where a search finds it, and verify it there."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64
from estimator.vision.camera.pose import PadPose
from estimator.vision.detect.acquire import FRESH_SEARCH, SearchMemory, align_at, search
from estimator.vision.detect.guesses import Plane
from estimator.vision.detect.pose_about import pose_about
from estimator.vision.detect.template import LEARNED_AT, fade
from estimator.vision.detect.verification import TRACKED_LOG_ODDS, calibrate, confidence
from estimator.vision.detection import Opinions
from estimator.vision.pad.information import alike_headings
from estimator.vision.register.doubts import nearest_of_four
from estimator.vision.register.registration import RegistrationOptions
from estimator.vision.register.sighting import sighting_of_look
from estimator.vision.register.verified import CLOSE, CODED_PX, ROUGH, SURE, Verified, verify
from estimator.vision.track.expected import EXPECTED_SIGMAS, ExpectedPlace, expected, near_enough, sigma_of
from estimator.vision.track.memory import WORTH_ANOTHER, Now, Registered, Seen

_CLOSE_PX = 1.0  # Largest standard deviation of the expected position in the frame at which registration starts directly from it
NEAREST_M = 0.05
"""Least depth of a pose that is registered."""
_SEARCHED = 0.75  # Share of a frame's work at which a search ends: the rest is for the registration of a candidate
_CANDIDATES = 2  # Number of candidates of acquisition that are registered, those after the first while the frame's work lasts
WORTH_A_TRY = 0.03
"""Score of a candidate of acquisition, or of a drawing at a method's pose, below which it is not registered."""
_COVER_SURE = 0.9  # Least confidence and agreement of what is seen beside a cover that was found before
_SMALL_PX = 15.0  # Radius of the disc below which a pad that the estimate did not lead to is searched some pixels about its place
_WORTH_ASKING = 0.1  # Confidence of the verification below which no second opinion is used: no pad is seen there anyway
_LEAST_ABOUT = 0.12
"""Least fraction of the variance that the drawing must explain there: of pads in glare or half covered it is 0.16 or more."""


def register(now: Now, belief: RelativeState | None, place: ExpectedPlace) -> tuple[Seen, SearchMemory]:
    """Register where the belief expects the pad, else where a search finds it; return the best, and what the search leaves."""
    start, best, suspect = _start_of(now, belief), Seen(), False
    if start is not None and start.pose.t_cam_pad[2] > NEAREST_M:
        best, suspect = _from_belief(now, start, place)
    if best.is_sure and (best.agrees or not suspect):
        return best, FRESH_SEARCH
    return _from_search(now, start, place, best, suspect)


class _Start(NamedTuple):
    """The pose that the belief predicts."""

    pose: PadPose
    sigma_m: float
    """Standard deviation of its position along the worst direction."""

    def is_near(self, pose: PadPose) -> bool:
        """Return whether a pose counts as expected."""
        return float(np.linalg.norm(pose.t_cam_pad - self.pose.t_cam_pad)) < EXPECTED_SIGMAS * self.sigma_m


def _start_of(now: Now, belief: RelativeState | None) -> _Start | None:
    """Return the pose to start from; None if the belief is not certain enough."""
    if belief is None or now.attitude is None:
        return None
    sigma_m, alike_yaw_rad = sigma_of(belief), now.memory.alike_yaw_rad
    if not near_enough(belief, sigma_m, now.tracker.pad, alike_yaw_rad):
        return None
    pose = expected(belief, now.attitude, now.tracker.camera, alike_yaw_rad)
    return None if pose is None else _Start(pose, sigma_m)


def _from_belief(now: Now, start: _Start, place: ExpectedPlace) -> tuple[Seen, bool]:
    """Return the best registrations about the expected pose, and whether they may be on other edges that look alike."""
    camera, pad = now.tracker.camera, now.tracker.pad
    close = start.sigma_m * camera.fx < _CLOSE_PX * start.pose.t_cam_pad[2]
    beside = _beside_cover(now, start.pose)
    if beside is None or min(beside.sighting.confidence, beside.agreement) < _COVER_SURE:
        beside = register_from(now, start.pose, CLOSE if close else ROUGH, TRACKED_LOG_ODDS, searched=False)
    best = Seen().having(beside, place)
    suspect = not close and best.tracked is not None and best.tracked.agreement < WORTH_ANOTHER
    if suspect:
        # The whole drawing, blurred, draws from farther away than edges do.
        aligned = align_at(start.pose, now.orientation.measured, now.view)
        if aligned is not None and aligned.score >= WORTH_A_TRY:
            best = best.having(register_from(now, aligned.pose, CLOSE, TRACKED_LOG_ODDS, searched=False), place)
    by_parts = pad.markings.is_searched_by_parts and not pad.markings.is_letter_alone
    if not best.is_sure and by_parts and start.pose.px_of(pad.disc_radius_m, camera) < _SMALL_PX:
        best = best.having(_about(now, start.pose), place)
    return best, suspect


def _beside_cover(now: Now, start: PadPose) -> Registered | None:
    """Register beside what covered a part of the pad lately; None if nothing did."""
    cover = now.memory.cover_at(now.at)
    if cover is None:
        return None
    cut = np.asarray(np.linalg.solve(start.rays().T, cover[0]))
    return register_from(now, start, CLOSE, TRACKED_LOG_ODDS, cut, searched=False)


def _about(now: Now, start: PadPose) -> Registered | None:
    """Register a small pad some pixels about its expected place; None if the drawing explains too little there."""
    assert now.attitude is not None
    plane = Plane.of(now.tracker.camera, now.attitude.R_ned_body.without_heading())
    about = pose_about(now.view.as_seen(), plane, start)
    if about is None or about[1] < _LEAST_ABOUT:
        return None
    return register_from(now, about[0], CLOSE, TRACKED_LOG_ODDS, searched=False)


def _from_search(now: Now, start: _Start | None, place: ExpectedPlace, best: Seen, suspect: bool) -> tuple[Seen, SearchMemory]:
    """Register candidates of a search of the whole frame; return the best, and what the search leaves."""
    R_level_body = None if now.attitude is None else now.attitude.R_ned_body.without_heading()
    work = now.tracker.search_work
    found = search(now.view, R_level_body, now.memory.paint, now.memory.search, budget=_SEARCHED * work)
    for number, candidate in enumerate(found.candidates[:_CANDIDATES]):
        # One that is none of the pad takes ten floors and more to be refused, beside what covers it, too.
        if candidate.score < WORTH_A_TRY or (number > 0 and now.view.pyramid.work > work):
            break
        prior = TRACKED_LOG_ODDS if start is not None and start.is_near(candidate.pose) else 0.0
        best = best.having(register_from(now, _of_four(now, candidate.pose), CLOSE, prior, candidate.cut), place)
        if best.is_sure and (best.agrees or not suspect):
            break
    return best, found.memory


def _of_four(now: Now, pose: PadPose) -> PadPose:
    """Return a pose as it is; of a letter that looks the same in four headings at that nearest to the remembered one."""
    camera, pad = now.tracker.camera, now.tracker.pad
    if not (pad.markings.is_letter_alone and alike_headings(pad) == 4):
        return pose
    R_level_cam = now.orientation.R_level_body.matrix @ camera.T_body_cam.R.matrix
    return nearest_of_four(pose, R_level_cam, now.memory.alike_yaw_rad or 0.0)


def register_from(
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
    if network is None or of.confidence < _WORTH_ASKING:
        return None
    log_odds = network.log_odds(*now.view, of.found.pose, of.cut)
    return None if log_odds is None else Opinions(of.confidence, confidence(log_odds))
