"""Find circles: by the votes of edges for their centres, and pads of some pixels by their area.

The first finds the pad's disc and ring in any light, without colour. A pad of 12 to 40 px across that is seen obliquely has too
few pixels for its edges to tell the centre. It differs from its surroundings as a whole: its area tells the centre, and the
ellipse of the area's second moments tells the tilt. The native core finds both.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.abi import SEARCH_BLOCK
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, start_of
from estimator.core.records import record
from estimator.vision.camera import Camera
from estimator.vision.detect.plane import Plane
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.native import address, packed_camera, pixels

U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]

_ROOM, _CIRCLES = CORE.function("search_room"), CORE.function("search_circles")
_WORDS, _AT = size_of("search_circle"), places_of("search_circle")
_RADIUS, _SUPPORT = _AT["radius"].start, _AT["support"].start
_R_CAM_PLANE = places_of("search_image")["R_cam_plane"]
_EDGES = 0.4
"""Most edges of an image, per pixel. Two neighbours are seldom both a ridge of the gradient."""


@dataclass(frozen=True, slots=True)
class Radii:
    """Radii that are searched for at one size of the frame, px of that size for a pad that faces the camera."""

    least_px: float
    ratio: float
    count: int


@dataclass(frozen=True, slots=True, eq=False)
class EdgeCircle:
    """A circle of edges in a plane at unit distance."""

    words: F64
    """The core's structure `search_circle`, with the edges on its outline."""

    @property
    def centre(self) -> F64:
        """(2,)."""
        return self.words[_AT["centre"]]

    @property
    def radius(self) -> float:
        return self.words.item(_RADIUS)

    @property
    def support(self) -> float:
        """Fraction of the outline with an edge."""
        return self.words.item(_SUPPORT)

    @property
    def bright_inside(self) -> bool:
        return bool(self.words.view(np.int64)[_AT["bright_inside"].start])


def edge_circles(
    grey: U8,
    step: int,
    camera: Camera,
    plane: Plane,
    radii: Radii,
    most: int,
    margin_px: int = 0,
    *,
    only_bright: bool = False,
) -> list[EdgeCircle]:
    """Return the circles with the most edges, most prominent first.

    Args:
        grey: the frame, `step` times smaller than the camera's, (h, w).
        most: the largest number of circles.
        margin_px: how far beyond the frame's edge centres may lie, px of `grey`.
        only_bright: look only for circles that are brighter inside.
    """
    h, w = grey.shape
    image = _image(w, h, grey.strides[0], margin_px, step).copy()
    image[_R_CAM_PLANE] = plane.R_cam_plane.ravel()
    scratch = np.empty(_ROOM(start_of(image)), np.float32)
    out = np.empty((most, _WORDS))
    rays = _corner_rays(camera.lens, step, w, h)
    found = _CIRCLES(
        start_of(image),
        address(grey, np.uint8),
        address(rays, np.float32),
        start_of(_radii(radii, most, radii.least_px * step / camera.fx, only_bright)),
        start_of(scratch),
        start_of(out),
    )
    return [EdgeCircle(words) for words in out[:found]]


@lru_cache(maxsize=16)
def _image(width: int, height: int, stride: int, margin_px: int, step: int) -> F64:
    """Return the core's `search_image` without the plane."""
    return record("search_image", {
        "width": width, "height": height, "stride": stride, "room": round(_EDGES * width * height), "margin": margin_px,
        "step": step,
    })  # fmt: skip


@lru_cache(maxsize=16)
def _radii(radii: Radii, most: int, least: float, only_bright: bool) -> F64:
    """Return the core's `search_radii`."""
    return record("search_radii", {
        "radii": radii.count, "most": most, "only_bright": only_bright, "least": least, "ratio": radii.ratio,
    })  # fmt: skip


@lru_cache(maxsize=16)
def _corner_rays(camera: Camera, step: int, width: int, height: int) -> F32:
    """Return the rays of the corners of the blocks, (rows + 1, columns + 1, 2)."""
    u, v = (np.arange(-(-side // SEARCH_BLOCK) + 1) * SEARCH_BLOCK for side in (width, height))
    uv: F64 = np.stack(np.meshgrid(u, v), axis=2).reshape(-1, 2).astype(float)
    rays = camera.rays(np.asarray((uv + 0.5) * step - 0.5)).reshape(len(v), len(u), 2).astype(np.float32)
    rays.setflags(write=False)
    return rays


_BLOBS_ROOM, _BLOBS = CORE.function("search_blobs_room"), CORE.function("search_blobs")
_NOISE, _BLOB_R_CAM_PLANE = (places_of("blob_image")[name] for name in ("noise", "R_cam_plane"))
_MOST_BLOBS = 16
"""Largest number of blobs. Of 280 pads at 10 and 15 m in any light nine in ten are among the first eight."""
_NOISE_LEFT = 0.5 * 255.0
"""Noise of the half-size image per noise of the frame, values of a pixel."""


def blob_circles(pyramid: Pyramid, camera: Camera, plane: Plane, most: int = _MOST_BLOBS) -> list[EdgeCircle]:
    """Return the outlines of what stands out, most prominent first, as circles of edges.

    Their `support` is the fraction of the area of an ellipse with the same moments that is filled.
    """
    half, full = pyramid[1], pyramid[0]
    (half_start, half_stride), (full_start, full_stride) = pixels(half), pixels(full)
    image = _blob_image(
        (half.shape[1], half.shape[0], half_stride), (full.shape[1], full.shape[0], full_stride), pyramid.monochrome, most
    )
    image = image.copy()
    image[_NOISE], image[_BLOB_R_CAM_PLANE] = _NOISE_LEFT * pyramid.noise, plane.R_cam_plane.ravel()
    scratch, out = np.empty(_BLOBS_ROOM(start_of(image)), np.float32), np.empty((most, _WORDS))
    n = _BLOBS(address(packed_camera(camera)), start_of(image), half_start, full_start, start_of(scratch), start_of(out))
    return [EdgeCircle(words) for words in out[:n]]


@lru_cache(maxsize=16)
def _blob_image(half: tuple[int, int, int], full: tuple[int, int, int], grey: bool, most: int) -> F64:
    """Return the core's `blob_image` without noise and plane.

    Args:
        half, full: width, height and bytes from row to row.
    """
    return record("blob_image", {
        "width": half[0], "height": half[1], "stride": half[2], "full_width": full[0], "full_height": full[1],
        "full_stride": full[2], "grey": grey, "most": most,
    })  # fmt: skip
