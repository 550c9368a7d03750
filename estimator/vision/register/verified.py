"""Register the drawing from a start pose and verify it there: what a pad's sighting and its confidence come from."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.detect.alignment import COVERED_LOG_ODDS, SIGMA_TILT_FREE_RAD, SIGMA_TILT_RAD, UNCUT, align_uncovered
from estimator.vision.detect.pyramid import FrameView
from estimator.vision.detect.template import FRESH, PaintMemory
from estimator.vision.detect.verification import confidence, support_log_odds
from estimator.vision.pad.drawing import EdgeKind
from estimator.vision.pad.information import confusable_turns
from estimator.vision.register.doubts import LETTER_MOST, cells_log_odds, letter_log_odds
from estimator.vision.register.headings import heading_z_scores
from estimator.vision.register.registration import Registration, RegistrationOptions, look

SURE = 0.5
"""Confidence from which a pose is the pad's."""
CLOSE, ROUGH = RegistrationOptions(coarse=False), RegistrationOptions(coarse=True)
CODED_PX = 0.12
"""Sigma of the place of a patch of a frame that a codec predicted. H.264 gives motion by quarters of a pixel: that leaves 0.07
px; 1.6 times that, as what it leaves goes on from frame to frame while each frame counts as a measurement of its own."""
_CERTAIN = 0.9  # Confidence from which it is not tried whether something covers a part of the pad
_RINGLESS_LOG_ODDS = -4.0
"""Prior where the ring does not show beside what covers the pad: an H on something green, whose lack of a ring the line hides."""
_WORTH_TURNING = 1e-4  # Confidence from which the heading of a registration matters: its place may be the pad's then
_DECIDED = 4.0
"""Standard deviations from which the comparison decides a heading.

On rendered frames from 0.5 to 20 m, in plain light, haze, grey and half covered, none was wrong by more than 3.0.
"""
_UNDECIDED_LOG_ODDS = -12.0  # Log-odds of a pose whose heading is undecided
_STEPS = 4  # Steps of the alignment with what is not covered
_STRAYS, _STRAYS_PX = 0.03, 0.3
"""Changes from its start at which a registration has strayed.

They are of the distance, as a fraction and by that of pixels of the radius, and of the place, as a fraction of the radius. A
cover over a part of a disc in its own shade pulls the edges there, and the rest of the pad still fits.
"""

_HALVED, _LESS_HALVED = 0.6, 0.1
"""Share of a distant pad's pixels that agree, below which a shade is looked for, and how much more of the rest has to."""


@dataclass(frozen=True, slots=True, eq=False)
class Verified:
    """Verified find, with the confidence that it is this pad."""

    found: Registration
    confidence: float
    """0..1."""
    cut: F64 | None = None
    """The line beyond which something covers the pad, (3,); see `alignment.UNCUT`."""
    prior_log_odds: float = 0.0
    """The prior that the confidence holds."""


def verify(
    view: FrameView,
    start: PadPose,
    orientation: Orientation,
    options: RegistrationOptions = CLOSE,
    prior_log_odds: float = 0.0,
    cut: F64 | None = None,
    paint: PaintMemory = FRESH,
) -> Verified | None:
    """Register the drawing from a start pose and verify it there; return None if nothing is found.

    Where the whole drawing does not fit, it is tried whether something covers a part of the pad. Where no belief led to the
    place, the heading of a pad that looks nearly the same after some turns is compared with those, and doubted if that does not
    decide it.

    Args:
        orientation: the attitude at the exposure.
        prior_log_odds: for the place of the start, as for `verification.confidence`.
        cut: the line beyond which something covers the pad, (3,), if that is known; see `alignment.UNCUT`.
        paint: what is known of the paints.

    Raises:
        ValueError: the frame is not of the camera's size.
    """
    turns = confusable_turns(view.pad) if prior_log_odds <= 0.0 else ()
    seen = _Seen(view.as_seen(), orientation, options, paint, searched=prior_log_odds <= 0.0)
    if not turns:
        return seen.verify(start, prior_log_odds, cut)
    z = seen.heading_z_scores(start, turns)
    start = start.turned(min(z, key=z.__getitem__)) if min(z.values()) < -_DECIDED else start
    best = seen.verify(start, prior_log_odds, cut)
    if best is None or best.confidence < _WORTH_TURNING:
        return best
    z = seen.heading_z_scores(best.found.pose, turns)
    if min(z.values()) < 0.0:
        turned, of = best.found.pose.turned(min(z, key=z.__getitem__)), UNCUT if best.cut is None else best.cut
        best = seen.near().verify_visible(turned, best.prior_log_odds, of) or best
        z = seen.heading_z_scores(best.found.pose, turns)
    alert = min(1.0, max(0.0, 1.0 - min(z.values()) / _DECIDED))
    if not alert:
        return best
    log_odds = math.log(max(best.confidence, 1e-13) / max(1.0 - best.confidence, 1e-13))
    return replace(best, confidence=confidence(log_odds + _UNDECIDED_LOG_ODDS * alert))


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A frame in which the drawing is verified at start poses."""

    view: FrameView
    """The pad in the paints that the camera sees."""
    orientation: Orientation
    options: RegistrationOptions
    paint: PaintMemory
    searched: bool
    """True if no belief led to the place."""

    def near(self) -> _Seen:
        """Return the same for starts that are good to a pixel or two."""
        return replace(self, options=replace(self.options, coarse=False))

    def heading_z_scores(self, pose: PadPose, turns: tuple[float, ...]) -> dict[float, float]:
        return heading_z_scores(self.view.pyramid[0], self.view.camera, self.view.pad, pose, turns)

    def verify(self, start: PadPose, prior_log_odds: float, cut: F64 | None) -> Verified | None:
        """Register the drawing from a start pose and verify it there, at its heading alone."""
        if cut is not None:
            return self.near().verify_visible(start, prior_log_odds + COVERED_LOG_ODDS, cut)
        best = self.verify_visible(start, prior_log_odds, UNCUT)
        if (best is not None and self._is_settled(best, start)) or not self.view.pad.markings.is_searched_by_parts:
            return best
        sigma_rad = SIGMA_TILT_RAD if self.orientation.measured else SIGMA_TILT_FREE_RAD
        uncovered = align_uncovered(self.view, start, sigma_rad, _STEPS)
        if uncovered is None:
            return best
        beside, cut = uncovered[0].pose, uncovered[1]
        other = self.near().verify_visible(beside, prior_log_odds + COVERED_LOG_ODDS, cut)
        return best or other if best is None or other is None else self._better(best, other, start, beside)

    def _better(self, best: Verified, other: Verified, start: PadPose, beside: PadPose) -> Verified:
        """Return the find of the whole drawing, or that beside a cover, which began from another start."""
        if _is_halved(best):
            return other if other.confidence >= SURE and _inliers(other.found) > _inliers(best.found) + _LESS_HALVED else best
        stayed = self._strays(best.found, start) and other.confidence >= SURE and not self._strays(other.found, beside)
        return other if stayed or other.confidence > best.confidence else best

    def _is_settled(self, best: Verified, start: PadPose) -> bool:
        """Return whether it need not be tried whether something covers a part of the pad."""
        return best.confidence >= _CERTAIN and not (self._strays(best.found, start) or _is_halved(best))

    def _strays(self, found: Registration, start: PadPose) -> bool:
        """Return whether a registration is so much nearer or farther than its start that something else has pulled it.

        A start that was aligned with the frame counts with its place, too.
        """
        disc_radius_m, range_m, start_m = self.view.pad.disc_radius_m, found.pose.range_m, start.range_m
        most = _STRAYS + _STRAYS_PX / (self.view.camera.fx * disc_radius_m / start_m)
        if not self.searched or abs(range_m / start_m - 1.0) > most:
            return abs(range_m / start_m - 1.0) > most
        moved = float(np.linalg.norm(found.pose.t_cam_pad / range_m - start.t_cam_pad / start_m))
        return moved * start_m > most * disc_radius_m

    def verify_visible(self, start: PadPose, prior_log_odds: float, cut: F64) -> Verified | None:
        """Register what lies on this side of a cut, and verify the drawing there."""
        view, tracked = self.view, prior_log_odds > 0.0
        found = look(view, start, self.orientation, self.options, tracked=tracked, cut=cut, paint=self.paint)
        if found is None:
            return None
        support = found.record["aligned"]["support"]
        most = support_log_odds(float(support["support"]) * float(support["share"]) / view.pad.least_support)
        odds = min(found.log_odds, most) + prior_log_odds - view.pad.clutter_log_odds
        if cut is not UNCUT and not found.edges[EdgeKind.RING].seen:
            odds += _RINGLESS_LOG_ODDS
        if view.pad.markings.fiducials:
            odds += cells_log_odds(view.pyramid[0], view.camera, view.pad, found)
        elif view.pad.markings.is_letter_alone:
            odds = min(odds, LETTER_MOST) + letter_log_odds(found, tracked)
        return Verified(found, confidence(odds), None if cut is UNCUT else cut, prior_log_odds)


def _is_halved(best: Verified) -> bool:
    """Return whether a shade may lie across a distant pad."""
    return best.confidence >= SURE and _inliers(best.found) < _HALVED


def _inliers(found: Registration) -> float:
    """Return the share of a distant pad's pixels that agree with the drawing; 1 of a near pad."""
    return found.inliers if found.dense else 1.0
