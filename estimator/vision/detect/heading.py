"""Correlate the drawing at all headings at once: how much of a candidate's image the positions of the paints explain.

The frame is sampled in polar cells around the candidate's centre. For a given heading every cell belongs to one paint. The score
is the fraction of the variance between the paints (one-way analysis of variance). The native core computes it
(`estimator/core/vision/search/heading.c`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.interface import size_of
from estimator.core.library import CORE, start_of
from estimator.core.records import record
from estimator.vision.camera import Camera
from estimator.vision.detect.template import polar_drawing
from estimator.vision.native import address, packed_camera, pixels
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose

U8 = NDArray[np.uint8]

_HEADING = CORE.function("search_heading")
_WORDS = size_of("polar_fit")


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
    out, words = np.empty(_WORDS), np.concatenate([pose.R_cam_pad.matrix.ravel(), pose.t_cam_pad])
    half = None if side is None else np.array(side, float)
    found = _HEADING(
        address(packed_camera(camera)), address(packed_drawing(pad)), start_of(words), step, px.shape[1], px.shape[0],
        *pixels(px), None if half is None else start_of(half), start_of(out),
    )  # fmt: skip
    return Heading(*out.tolist()) if found else None


def marks_are_bright(pad: Pad) -> bool:
    """Return whether the H is brighter than the disc."""
    return sum(pad.markings.colours.h) > sum(pad.markings.colours.disc)


@lru_cache(maxsize=8)
def packed_drawing(pad: Pad) -> F64:
    """Return the structure `polar_pad` of the core."""
    drawing = polar_drawing(pad)
    words = record("polar_pad", {
        "xy_m": drawing.xy_m, "area_inside": drawing.area_inside, "ring": drawing.ring, "h_marking": drawing.h_marking,
        "arrow": drawing.arrow, "polarity": 1.0 if marks_are_bright(pad) else -1.0,
        "radius_m": pad.disc_radius_m,
    })  # fmt: skip
    words.setflags(write=False)
    return words
