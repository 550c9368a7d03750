"""Find the H marking from its strokes, if the disc's outline is out of the frame or occluded.

In a plane parallel to the pad the H has two perpendicular directions and strokes of one width. The directions follow from the
gradients (four times their angles agree), and the width from the commonest run of white along either direction. With both known,
correlation with the H at one size and two headings gives its position. All of this runs on a frame a quarter the size, in the
native core (`estimator/core/vision/search/strokes.c`).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, start_of
from estimator.core.records import record
from estimator.vision.camera import Camera
from estimator.vision.detect.guesses import Guess, guesses_of
from estimator.vision.detect.heading import marks_are_bright
from estimator.vision.detect.plane import Plane
from estimator.vision.native import address, packed_camera, pixels
from estimator.vision.pad import Pad

_ROOM, _STROKES = CORE.function("search_strokes_room"), CORE.function("search_strokes")
_WORDS = size_of("search_guess")
_R_CAM_PLANE = places_of("strokes_image")["R_cam_plane"]

MOST = 8
"""Largest number of places of the H."""
_MARGIN_M = 0.035
"""Width of the disc around the H that counts as background."""


def h_markings(px: NDArray[np.uint8], step: int, camera: Camera, pad: Pad, plane: Plane, most: int = MOST) -> list[Guess]:
    """Return the likeliest positions of the H, best first; their headings are known up to 180 degrees.

    A guess's `drawing` is the mean of the marks' mask on the H minus the mean around it, halved, -1..1.

    Args:
        px: the frame, `step` times smaller than the camera's.
    """
    start, stride = pixels(px)
    image = _image((px.shape[1], px.shape[0], stride), step, marks_are_bright(pad), plane.known).copy()
    image[_R_CAM_PLANE] = plane.R_cam_plane.ravel()
    scratch, out = np.empty(_ROOM(start_of(image)), np.float32), np.empty((most, _WORDS))
    n = _STROKES(
        address(packed_camera(camera)), start_of(image), address(_packed(pad)), start, start_of(scratch), most,
        start_of(out),
    )  # fmt: skip
    return guesses_of(out[:n])


@lru_cache(maxsize=16)
def _image(size: tuple[int, int, int], step: int, bright: bool, plane_known: bool) -> F64:
    """Return the core's `strokes_image` without the plane.

    Args:
        size: width, height and bytes from row to row.
    """
    return record("strokes_image", {
        "width": size[0], "height": size[1], "stride": size[2], "step": step, "bright": bright, "plane_known": plane_known,
    })  # fmt: skip


@lru_cache(maxsize=16)
def _packed(pad: Pad) -> F64:
    marks = pad.markings
    words = record("pad_strokes", {
        "length_m": marks.h_length_m, "width_m": marks.h_width_m, "leg_m": marks.leg_width_m, "bar_m": marks.bar_width_m,
        "margin_m": _MARGIN_M,
    })  # fmt: skip
    words.setflags(write=False)
    return words
