"""Find the drawing where something covers a part of the pad: a towel, a hatch, a vehicle beside it.

What covers a pad is one region with a border. About the pad this border is taken for straight, and what lies beyond it counts as
little as what lies beyond the frame's edge: neither alignment nor registration nor verification sees it. Nothing is then assumed
of the hidden part, and the rest has to fit as well as a pad at the frame's edge has to.
"""

import math

from estimator.contracts.geometry import F64
from estimator.vision.detect.alignment import AlignedTemplate, align, cover
from estimator.vision.detect.pyramid import FrameView
from estimator.vision.detect.verification import log_odds
from estimator.vision.pad_pose import PadPose

COVERED_LOG_ODDS = -1.0
"""Prior of a partly covered drawing, for `fit_verification.confidence`: the line is chosen so that the
rest fits best.
"""
_TURNS = 6
"""Headings in half a turn that a covered pad may have; alignment reaches half of the way to the next."""
_LEAST_GAIN, _MOST_LEFT = 0.7, 0.6
"""Least gain of a cover, and the largest share of the light's variation beside it that the drawing may leave. At the true poses
of 90 half-covered pads at 5 to 15 m the gain was 1.0 and more, and 0.56 was left at most.
"""


def cut_at(view: FrameView, pose: PadPose) -> F64 | None:
    """Return the cut beyond which something covers the pad that lies about at a pose; None if nothing seems to.

    A cut is a line across the frame; see `alignment.UNCUT`.
    """
    found = cover(view, pose)
    return None if found is None or found.gain < _LEAST_GAIN or found.left > _MOST_LEFT else found.cut


def align_uncovered(view: FrameView, pose: PadPose, sigma_tilt_rad: float, steps: int) -> tuple[AlignedTemplate, F64] | None:
    """Align the drawing with what nothing covers, from a rough pose; return it with the cut, None if nothing seems to be covered.

    Args:
        sigma_tilt_rad, steps: as for `alignment.align`.
    """
    cut = cut_at(view, pose)
    if cut is None:
        return None
    aligned = align(view, pose, sigma_tilt_rad, steps, local=True, cut=cut)
    if aligned is None:
        return None
    again = cut_at(view, aligned.pose)
    if again is None:
        return None
    better = align(view, aligned.pose, sigma_tilt_rad, 0, cut=again)
    return None if better is None else (better, again)


def turned_uncovered(view: FrameView, at: AlignedTemplate, cut: F64, sigma_tilt_rad: float, steps: int) -> AlignedTemplate | None:
    """Return the drawing aligned from the heading that fits best to what nothing covers; None if that is the one it has.

    What covers a half of a distant pad has more pixels than its H, and turns the heading that a guess has.
    """
    turned = [align(view, at.pose.turned(k * math.pi / _TURNS), sigma_tilt_rad, 0, cut=cut) for k in range(1, _TURNS)]
    best = max((one for one in turned if one is not None), key=lambda one: log_odds(one.features), default=None)
    if best is None or log_odds(best.features) < log_odds(at.features):
        return None
    return align(view, best.pose, sigma_tilt_rad, steps, local=True, cut=cut)
