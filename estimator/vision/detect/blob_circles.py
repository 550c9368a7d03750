"""Find pads of some pixels by their area: what differs from its surroundings as a whole, with an ellipse for its outline.

A pad of 12 to 40 px across that is seen obliquely has too few pixels for its edges to tell the centre. Its area tells it, and
the ellipse of the area's second moments tells the tilt. The native core finds them (`estimator/core/search_blobs.c`).
"""

from __future__ import annotations

import numpy as np

from estimator.core.interface import size_of
from estimator.core.library import CORE, start_of
from estimator.core.records import record
from estimator.vision.camera import Camera
from estimator.vision.detect.edge_circles import EdgeCircle
from estimator.vision.detect.plane import Plane
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.native import address, packed_camera, pixels

_ROOM, _BLOBS = CORE.function("search_blobs_room"), CORE.function("search_blobs")
_WORDS = size_of("search_circle")
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
    image = record("blob_image", {
        "width": half.shape[1], "height": half.shape[0], "stride": half_stride, "full_width": full.shape[1],
        "full_height": full.shape[0], "full_stride": full_stride, "grey": pyramid.monochrome, "most": most,
        "noise": _NOISE_LEFT * pyramid.noise, "R_cam_plane": plane.R_cam_plane,
    })  # fmt: skip
    scratch, out = np.empty(_ROOM(start_of(image)), np.float32), np.empty((most, _WORDS))
    n = _BLOBS(
        address(packed_camera(camera)), start_of(image), half_start, full_start, address(scratch, np.float32), start_of(out)
    )
    return [EdgeCircle(words) for words in out[:n]]
