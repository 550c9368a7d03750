"""Align the whole drawing with a frame from a rough pose: pose and paints together, by Gauss-Newton on the pixels.

The frame near the pad is modelled as a mixture of four paints (H, orange, disc, surroundings). The drawing gives the coverage of
each paint in every pixel. Light is additive, so for a given pose the paints follow by linear least squares under any light. The
pose then follows the model's gradient (Lucas and Kanade 1981, as compositional alignment with the drawing as template, and
with Cauchy weights against occlusion and glare). The result is near enough for edge-based registration to start, and it holds the
inputs of the confidence classifier.

Where something covers a part of a pad, a towel, a hatch or a vehicle beside it, that is one region with a border. About the pad
this border is taken for straight, and what lies beyond it counts as little as what lies beyond the frame's edge: neither
alignment nor registration nor verification sees it. Nothing is then assumed of the hidden part, and the rest has to fit as well
as a pad at the frame's edge has to.
"""

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from estimator.contracts.geometry import F64
from estimator.core.library import CORE
from estimator.vision.camera.pose import PadPose
from estimator.vision.detect.pyramid import FrameView
from estimator.vision.detect.verification import log_odds
from estimator.vision.native import checked, native_pose, pose_of, tracker_of

UNCUT = np.zeros(3)
"""The cut that hides nothing. A cut (3,) is a line across the frame: rays (x, y) with `a x + b y + c < 0` do not count."""
UNCUT.setflags(write=False)

SIGMA_TILT_RAD = math.radians(3.0)
"""Standard deviation of the tilt between the deck and a vehicle of measured attitude."""
SIGMA_TILT_FREE_RAD = math.radians(15.0)
"""Standard deviation of the tilt if neither attitude is known."""

COVERED_LOG_ODDS = -1.0
"""Prior of a partly covered drawing, for `verification.confidence`: the line is chosen so that the
rest fits best.
"""
_TURNS = 6  # Headings in half a turn that a covered pad may have; alignment reaches half of the way to the next
_LEAST_GAIN = 0.7  # Least gain of a cover: at the true poses of 90 half-covered pads at 5 to 15 m it was 1.0 and more
_MOST_LEFT = 0.6  # Largest share of the light's variation beside it that the drawing leaves: there 0.56 was left at most


class ArrowPlace(NamedTuple):
    """The measurements at one of the two places where an arrowhead may be."""

    found: float
    """Strength of the arrowhead there times the fraction of the variation it explains, 0..1."""
    seen: float
    """Fraction of the place inside the frame; 0 if the pixels are too coarse."""
    clear: float
    """Confidence, 0..1, that only disc, ring and perhaps an arrowhead are there."""


class AlignedTemplate(Struct, frozen=True, eq=False):
    """The drawing as aligned with one frame."""

    pose: PadPose
    paints: F64
    """Linear light of H, orange, disc and surroundings, (4, 3), 0..1, in blue, green, red."""
    in_view: float
    """Fraction of the disc's area inside the frame."""
    arrow: tuple[ArrowPlace, ArrowPlace]
    """Support for the arrowhead at its place, and at the place where it would be with the drawing turned by 180 degrees."""
    features: F64
    """Inputs of the confidence classifier, in the order of `verification.FEATURES`."""

    @property
    def arrow_support(self) -> float:
        """Support for the heading, -1..1: 1 for an orange arrowhead at its place, -1 for one at the opposite place.

        The value is 0 if neither, both or nothing of the kind is in view.
        """
        fore, aft = self.arrow
        return fore.found * fore.seen - aft.found * aft.seen


def align(
    view: FrameView,
    pose: PadPose,
    sigma_tilt_rad: float,
    steps: int = 4,
    *,
    local: bool = False,
    side: F64 | None = None,
    cut: F64 = UNCUT,
) -> AlignedTemplate | None:
    """Align the drawing with the frame from a rough pose.

    Args:
        sigma_tilt_rad: standard deviation of the tilt of the start pose's normal.
        steps: number of Gauss-Newton steps; the first half uses a drawing blurred twice as much. With 0 the pose is unchanged.
        local: use the light minus its mean in the neighbourhood, against glare and shadows; the reach is a little shorter.
        side: (2,) unit direction in x and y of the pad: use only the half of the disc on this side, because the other is covered.
        cut: the line beyond which something covers the pad, (3,); see `UNCUT`.

    Returns:
        The aligned template; None if too little of the pad is in view, or if the pose diverges.
    """
    at, out = native_pose(pose), np.zeros((), CORE.dtype("dl_aligned_pad"))
    how = CORE.ffi.new("dl_alignment *", {
        "steps": steps, "local": local, "one_side": side is not None, "sigma_tilt_rad": sigma_tilt_rad, "cut": cut.tolist(),
        "side": (0.0, 0.0) if side is None else side.tolist(),
    })  # fmt: skip
    pyramid, camera, pad = view
    if not checked(CORE.lib.dl_align(tracker_of(camera, pad), pyramid.native, how, at, CORE.array("dl_aligned_pad", out))):
        return None
    found, arrow = pose_of(at) if steps > 0 else pose, out["arrow"].tolist()
    places = ArrowPlace(*arrow[:3]), ArrowPlace(*arrow[3:])
    return AlignedTemplate(found, out["paints"].reshape(4, 3), out["in_view"].item(), places, out["features"])


def cut_at(view: FrameView, pose: PadPose) -> F64 | None:
    """Return the cut beyond which something covers the pad that lies about at a pose; None if nothing seems to.

    A cut is a line across the frame; see `alignment.UNCUT`. There is always a best one unless too little of the pad is in view;
    its gain, the mean fall of the logarithm of the residuals' variance, and what the drawing leaves say what it is worth.
    """
    pyramid, camera, pad = view
    how, out = CORE.ffi.new("dl_alignment *", {"cover": 1}), CORE.ffi.new("dl_aligned_pad *")
    if not checked(CORE.lib.dl_align(tracker_of(camera, pad), pyramid.native, how, native_pose(pose), out)):
        return None
    line = out.cover
    return None if line.gain < _LEAST_GAIN or line.left > _MOST_LEFT else np.array(list(line.cut))


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
