"""Find pads of some pixels by their area: what differs from its surroundings as a whole, with an ellipse for its outline.

A pad of 12 to 40 px across that is seen obliquely has too few pixels for its edges to tell the centre. Its area tells it, and
the ellipse of the area's second moments tells the tilt. The native core finds them (`estimator/core/vision/search/blobs.c`).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from estimator.contracts.geometry import F64
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, start_of
from estimator.core.records import record
from estimator.vision.camera import Camera
from estimator.vision.detect.edge_circles import EdgeCircle
from estimator.vision.detect.plane import Plane
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.native import address, packed_camera, pixels

_ROOM, _BLOBS = CORE.function("search_blobs_room"), CORE.function("search_blobs")
_WORDS = size_of("search_circle")
_NOISE, _R_CAM_PLANE = (places_of("blob_image")[name] for name in ("noise", "R_cam_plane"))
_MOST = 16
"""Largest number of blobs. Of 280 pads at 10 and 15 m in any light nine in ten are among the first eight."""
_NOISE_LEFT = 0.5 * 255.0
"""Noise of the half-size image per noise of the frame, values of a pixel."""


def blob_circles(pyramid: Pyramid, camera: Camera, plane: Plane, most: int = _MOST) -> list[EdgeCircle]:
    """Return the outlines of what stands out, most prominent first, as circles of edges.

    Their `support` is the fraction of the area of an ellipse with the same moments that is filled.
    """
    half, full = pyramid[1], pyramid[0]
    (half_start, half_stride), (full_start, full_stride) = pixels(half), pixels(full)
    image = _image(
        (half.shape[1], half.shape[0], half_stride), (full.shape[1], full.shape[0], full_stride), pyramid.monochrome, most
    )
    image = image.copy()
    image[_NOISE], image[_R_CAM_PLANE] = _NOISE_LEFT * pyramid.noise, plane.R_cam_plane.ravel()
    scratch, out = np.empty(_ROOM(start_of(image)), np.float32), np.empty((most, _WORDS))
    n = _BLOBS(address(packed_camera(camera)), start_of(image), half_start, full_start, start_of(scratch), start_of(out))
    return [EdgeCircle(words) for words in out[:n]]


@lru_cache(maxsize=16)
def _image(half: tuple[int, int, int], full: tuple[int, int, int], grey: bool, most: int) -> F64:
    """Return the core's `blob_image` without noise and plane.

    Args:
        half, full: width, height and bytes from row to row.
    """
    return record("blob_image", {
        "width": half[0], "height": half[1], "stride": half[2], "full_width": full[0], "full_height": full[1],
        "full_stride": full[2], "grey": grey, "most": most,
    })  # fmt: skip
