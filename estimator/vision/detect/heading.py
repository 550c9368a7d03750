"""Correlate the drawing at all headings at once: how much of a candidate's image the positions of the paints explain.

The frame is sampled in polar cells around the candidate's centre. For a given heading every cell belongs to one paint. The score
is the fraction of the variance between the paints (one-way analysis of variance). The native core computes it
(`estimator/core/vision/search/heading.c`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.library import CORE
from estimator.vision.camera import Camera
from estimator.vision.native import checked, image_of, native_pose, tracker_of
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose

U8 = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Heading:
    """The best heading of the drawing at a candidate, and its score."""

    turn_rad: float
    """Angle by which the candidate's pose is to be turned about its own z axis."""
    score: float
    """Fraction of the variance explained, 0..1, reduced if a paint lies on the wrong side of another."""
    arrow: float
    """Advantage over the heading 180 degrees away, as a fraction of the variance."""
    in_view: float
    """Fraction of the disc's area that is inside the frame and not at the disc's edge."""


def heading(px: U8, step: int, camera: Camera, pad: Pad, pose: PadPose, side: F64 | None = None) -> Heading | None:
    """Return the best heading of the drawing at a pose; None if hardly any of it is in view.

    Args:
        px: the frame, `step` times smaller than the camera's.
        side: (2,) unit direction in x and y of `pose`: only this half of the disc is used, because the other is covered.
    """
    out, half = CORE.ffi.new("dl_polar_fit *"), CORE.ffi.NULL if side is None else CORE.array("double", np.array(side, float), 2)
    found = CORE.lib.dl_search_heading(tracker_of(camera, pad), image_of(px), step, native_pose(pose), half, out)
    return Heading(out.turn_rad, out.score, out.arrow, out.in_view) if checked(found) else None
