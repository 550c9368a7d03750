"""Guess poses from lettering: from the strokes of an H, and from the connected components of lettering on the bare deck.

The H is found by its strokes if the disc's outline is out of the frame or occluded. In a plane parallel to the pad it has two
perpendicular directions and strokes of one width. The directions follow from the gradients (four times their angles agree), and
the width from the commonest run of white along either direction. With both known, correlation with the H at one size and two
headings gives its position. All of this runs on a frame a quarter the size, in the native core
(`estimator/core/vision/search/strokes.c`).

A pad of lettering alone has neither circle nor disc. The share that its lettering fills of its convex hull is the same at any
heading, size and tilt, and sorts components out; area and centroid give the place, and the drawing the heading.
"""

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.library import CORE
from estimator.vision.camera import Camera
from estimator.vision.detect.guesses import Guess, guesses_of
from estimator.vision.detect.heading import heading
from estimator.vision.detect.plane import Plane
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.native import checked, image_of, tracker_of
from estimator.vision.pad import Pad

U8 = NDArray[np.uint8]

_LEVELS = (0, 2)
"""Sizes of the frame that are looked at: for strokes up to some 25 px and 100 px wide."""
_WINDOW_PX = 41
"""Side of the neighbourhood that a pixel is compared with."""
_STANDS_OUT = 7.0
"""Least difference from the neighbourhood's mean, 8-bit."""
_LEAST_AREA_PX = 60.0
_FILLED = 0.3
"""Largest difference of the logarithm of a component's share of its hull from the drawing's."""
_TRIED = 8
"""Largest number of components whose heading is searched."""
_HEADING_PX = 28.0
"""Smallest radius of the pad in the frame that a heading is searched in."""


class _Component(NamedTuple):
    contour_px: F64
    """Its outline in the whole frame, (N, 2)."""
    off: float
    """How far its share of its hull is from the drawing's, by the logarithm."""


def lettering_blobs(pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane) -> list[Guess]:
    """Return guesses from components of a frame that resemble the lettering of a pad on the bare deck."""
    found = [c for level in _LEVELS for c in _components(pyramid[level], 1 << level, pad)]
    guesses = []
    for component in sorted(found, key=lambda c: c.off)[:_TRIED]:
        guess = _guess(component, pyramid, camera, pad, plane)
        if guess is not None:
            guesses.append(guess)
    return guesses


def _components(px: U8, step: int, pad: Pad) -> Iterator[_Component]:
    """Yield the components that fill as much of their hull as the lettering does and lie within the frame."""
    grey = cv2.cvtColor(px, cv2.COLOR_BGR2GRAY)
    sign = 1 if pad.markings.is_bright else -1
    mean = cv2.blur(grey, (_WINDOW_PX, _WINDOW_PX))
    mask = np.asarray(sign * (grey.astype(np.int16) - mean) > _STANDS_OUT, np.uint8)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    h, w = grey.shape
    share = _shape(pad)[1]
    for contour in contours:
        if len(contour) < 30:
            continue
        # A contour runs through the middles of the outermost pixels: half a pixel is missing all around.
        area = cv2.contourArea(contour) + 0.5 * cv2.arcLength(contour, True)
        x, y, wide, high = cv2.boundingRect(contour)
        if area < _LEAST_AREA_PX or x <= 1 or y <= 1 or x + wide >= w - 1 or y + high >= h - 1:
            continue
        hull = cv2.convexHull(contour)
        off = abs(math.log(area / (cv2.contourArea(hull) + 0.5 * cv2.arcLength(hull, True)) / share))
        if off < _FILLED:
            at = contour.reshape(-1, 2).astype(float)
            centre = at.mean(axis=0)
            outward = (at - centre) * (1.0 + math.sqrt(area / max(cv2.contourArea(contour), 1.0)) - 1.0) + centre
            yield _Component((outward + 0.5) * step - 0.5, off)


def _guess(component: _Component, pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane) -> Guess | None:
    at = plane.places(camera, component.contour_px).astype(np.float32)
    if not np.isfinite(at).all():
        return None
    of = cv2.moments(at.reshape(-1, 1, 2))
    if abs(of["m00"]) < 1e-9:
        return None
    centre = np.array([of["m10"], of["m01"]]) / of["m00"]
    flat = plane.pose(centre, math.sqrt(abs(of["m00"])), math.sqrt(_shape(pad)[0]))
    radius_px = flat.disc_px(camera, pad)
    level = max(0, math.floor(math.log2(max(radius_px, 1.0) / _HEADING_PX)))
    best = heading(pyramid[level], 1 << level, camera, pad, flat)
    if best is None:
        return None
    R, t = flat.R_cam_pad.matrix.ravel().tolist(), flat.t_cam_pad.tolist()
    return Guess(R, t, best.turn_rad, best.score, best.score, plane.known)


@lru_cache(maxsize=8)
def _shape(pad: Pad) -> tuple[float, float]:
    """Return the lettering's area, m^2, and its share of its convex hull."""
    outline = pad.markings.letters[0].corners().astype(np.float32).reshape(-1, 1, 2)
    area = cv2.contourArea(outline)
    return area, area / cv2.contourArea(cv2.convexHull(outline))


MOST = 8
"""Largest number of places of the H."""


def h_markings(px: NDArray[np.uint8], step: int, camera: Camera, pad: Pad, plane: Plane, most: int = MOST) -> list[Guess]:
    """Return the likeliest positions of the H, best first; their headings are known up to 180 degrees.

    A guess's `drawing` is the mean of the marks' mask on the H minus the mean around it, halved, -1..1.

    Args:
        px: the frame, `step` times smaller than the camera's.
    """
    how = CORE.ffi.new("dl_stroke_search *", {
        "step": step, "bright": pad.markings.is_bright, "plane_known": plane.known, "most": most,
        "R_cam_plane": plane.R_cam_plane.ravel().tolist(),
    })  # fmt: skip
    out = np.empty(most, CORE.dtype("search_guess"))
    n = CORE.lib.dl_search_strokes(tracker_of(camera, pad), image_of(px), how, CORE.array("search_guess", out, most))
    return guesses_of(out[: checked(n)])
