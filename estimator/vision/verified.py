"""Register the drawing from a start pose and verify it there: what a pad's sighting and its confidence come from."""

import math
from dataclasses import dataclass, replace

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.detect.alignment import SIGMA_TILT_FREE_RAD, SIGMA_TILT_RAD, UNCUT
from estimator.vision.detect.covered import COVERED_LOG_ODDS, align_uncovered
from estimator.vision.detect.paint import FRESH, PaintMemory
from estimator.vision.detect.pyramid import View
from estimator.vision.drawing import EdgeKind
from estimator.vision.pad_information import confusable_turns
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.fiducial_cells import cells_log_odds
from estimator.vision.register.fit_verification import confidence
from estimator.vision.register.letter_alone import letter_log_odds
from estimator.vision.register.look import Looked, look
from estimator.vision.register.registration import RegistrationOptions
from estimator.vision.register.turned import heading_z_scores

SURE = 0.5
"""Confidence from which on a pose is the pad's."""
CLOSE, ROUGH = RegistrationOptions(coarse=False), RegistrationOptions(coarse=True)
CODED_PX = 0.12
"""Sigma of the place of a patch of a frame that a codec predicted. H.264 gives motion by quarters of a pixel: that leaves 0.07
px; 1.6 times that, as what it leaves goes on from frame to frame while each frame counts as a measurement of its own."""
_CERTAIN = 0.9
"""Confidence from which on it is not tried whether something covers a part of the pad."""
_RINGLESS_LOG_ODDS = -4.0
"""Prior where the ring does not show beside what covers the pad: an H on something green, whose lack of a ring the line hides."""
_WORTH_TURNING = 1e-4
"""Confidence from which on the heading of a registration matters: its place may be the pad's then."""
_DECIDED, _UNDECIDED_LOG_ODDS = 4.0, -12.0
"""Standard deviations from which on the comparison decides a heading, and the log-odds of a pose whose heading is undecided. On
rendered frames from 0.5 to 20 m, in plain light, haze, grey and half covered, none was wrong by more than 3.0.
"""
_STEPS = 4
"""Steps of the alignment with what is not covered."""
_STRAYS, _STRAYS_PX = 0.03, 0.3
"""Change of the distance from its start, as a fraction and by that of pixels of the radius, and of the place as a fraction of
the radius, from which on a registration has strayed: what covers a part of a disc in its own shade pulls the edges there, and the
rest of the pad still fits."""


@dataclass(frozen=True, slots=True, eq=False)
class Verified:
    """What a look found, and how sure it is that this is the pad."""

    found: Looked
    confidence: float
    """0..1."""
    cut: F64 | None = None
    """The line beyond which something covers the pad, (3,); see `alignment.UNCUT`."""
    prior_log_odds: float = 0.0
    """The prior that the confidence holds."""


def verified(
    view: View,
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
    if not turns:
        return _verified_at(view, start, orientation, options, prior_log_odds, cut, paint)
    z = _heading_z_scores(view, start, turns)
    start = start.turned(min(z, key=z.__getitem__)) if min(z.values()) < -_DECIDED else start
    best = _verified_at(view, start, orientation, options, prior_log_odds, cut, paint)
    if best is None or best.confidence < _WORTH_TURNING:
        return best
    z = _heading_z_scores(view, best.found.pose, turns)
    if min(z.values()) < 0.0:
        turned, near = best.found.pose.turned(min(z, key=z.__getitem__)), replace(options, coarse=False)
        of, prior = UNCUT if best.cut is None else best.cut, best.prior_log_odds
        best = _of_visible(view.as_seen(), turned, orientation, near, prior, of, paint) or best
        z = _heading_z_scores(view, best.found.pose, turns)
    doubt = min(1.0, max(0.0, 1.0 - min(z.values()) / _DECIDED))
    return replace(best, confidence=confidence(_log_odds(best.confidence) + _UNDECIDED_LOG_ODDS * doubt)) if doubt else best


def _log_odds(of_confidence: float) -> float:
    return math.log(max(of_confidence, 1e-13) / max(1.0 - of_confidence, 1e-13))


def _heading_z_scores(view: View, pose: PadPose, turns: tuple[float, ...]) -> dict[float, float]:
    return heading_z_scores(view.pyramid[0], view.camera, view.as_seen().pad, pose, turns)


def _verified_at(
    view: View,
    start: PadPose,
    orientation: Orientation,
    options: RegistrationOptions,
    prior_log_odds: float,
    cut: F64 | None,
    paint: PaintMemory,
) -> Verified | None:
    """Register the drawing from a start pose and verify it there, at its heading alone."""
    best, strayed, view = None, False, view.as_seen()
    if cut is None:
        best = _of_visible(view, start, orientation, options, prior_log_odds, UNCUT, paint)
        strayed = best is not None and _strays(best.found, start, view, searched=prior_log_odds <= 0.0)
        if (best is not None and best.confidence >= _CERTAIN and not strayed) or not view.pad.markings.is_searched_by_parts:
            return best
        sigma_rad = SIGMA_TILT_RAD if orientation.measured else SIGMA_TILT_FREE_RAD
        uncovered = align_uncovered(view, start, sigma_rad, _STEPS)
        if uncovered is None:
            return best
        start, cut = uncovered[0].pose, uncovered[1]
    near = replace(options, coarse=False)
    other = _of_visible(view, start, orientation, near, prior_log_odds + COVERED_LOG_ODDS, cut, paint)
    if best is None or other is None:
        return best or other
    stayed = strayed and other.confidence >= SURE and not _strays(other.found, start, view, searched=prior_log_odds <= 0.0)
    return other if stayed or other.confidence > best.confidence else best


def _strays(found: Looked, start: PadPose, view: View, searched: bool) -> bool:
    """Return whether a registration is so much nearer or farther than its start that something else has pulled it.

    Args:
        searched: whether the start was aligned with the frame: then its place counts, too.
    """
    disc_radius_m = view.pad.disc_radius_m
    radius_px = view.camera.fx * disc_radius_m / start.range_m
    most = _STRAYS + _STRAYS_PX / radius_px
    moved = float(np.linalg.norm(found.pose.t_cam_pad / found.range_m - start.t_cam_pad / start.range_m))
    return abs(found.range_m / start.range_m - 1.0) > most or (searched and moved * start.range_m > most * disc_radius_m)


def _of_visible(
    view: View,
    start: PadPose,
    orientation: Orientation,
    options: RegistrationOptions,
    prior_log_odds: float,
    cut: F64,
    paint: PaintMemory,
) -> Verified | None:
    """Register what lies on this side of a cut, and verify the drawing there."""
    tracked = prior_log_odds > 0.0
    found = look(view, start, orientation, options, tracked=tracked, cut=cut, paint=paint)
    if found is None:
        return None
    odds = found.log_odds + prior_log_odds
    if cut is not UNCUT and not found.edges[EdgeKind.RING].seen:
        odds += _RINGLESS_LOG_ODDS
    if view.pad.markings.fiducials:
        odds += cells_log_odds(view.pyramid[0], view.camera, view.pad, found.registration())
    elif view.pad.markings.is_letter_alone:
        odds += letter_log_odds(found.registration(), tracked)
    return Verified(found, confidence(odds), None if cut is UNCUT else cut, prior_log_odds)
