"""Find circles: by the votes of edges for their centres, and pads of some pixels by their area.

The first finds the pad's disc and ring in any light, without colour. A pad of 12 to 40 px across that is seen obliquely has too
few pixels for its edges to give the centre. It differs from its surroundings as a whole: its area gives the centre, and
the ellipse of the area's second moments gives the tilt. The native core finds both.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.abi import DL_SEARCH_BLOCK
from estimator.core.library import CORE
from estimator.vision.camera import Camera
from estimator.vision.detect.plane import Plane
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.native import checked, image_of, tracker_of

U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]

_MOST_AREAS = 16
"""Largest number of outlines of areas. Of 280 pads at 10 and 15 m in any light nine in ten are among the first eight."""


@dataclass(frozen=True, slots=True)
class Radii:
    """Radii that are searched for at one size of the frame, px of that size for a pad that faces the camera."""

    least_px: float
    ratio: float
    count: int


@dataclass(frozen=True, slots=True, eq=False)
class EdgeCircle:
    """A circle of edges in a plane at unit distance."""

    record: NDArray[Any]
    """The core's structure `dl_circle`, an array of one, with the edges on its outline."""

    @property
    def centre(self) -> F64:
        """(2,)."""
        return np.asarray(self.record["centre"][0])

    @property
    def radius(self) -> float:
        return float(self.record["radius"].item())

    @property
    def support(self) -> float:
        """Fraction of the outline with an edge."""
        return float(self.record["support"].item())

    @property
    def bright_inside(self) -> bool:
        return bool(self.record["bright_inside"].item())


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
    how = CORE.ffi.new("dl_circle_search *", {
        "step": step, "margin": margin_px, "radii": radii.count, "most": most, "only_bright": only_bright,
        "least": radii.least_px * step / camera.fx, "ratio": radii.ratio, "R_cam_plane": plane.R_cam_plane.ravel().tolist(),
    })  # fmt: skip
    out, rays = np.empty(most, CORE.dtype("dl_circle")), _corner_rays(camera.optics, step, w, h)
    found = CORE.lib.dl_search_circles(
        tracker_of(camera), CORE.ffi.NULL, image_of(grey), CORE.array("float", rays), how, CORE.array("dl_circle", out, most)
    )
    return _each(out, found)


@lru_cache(maxsize=16)
def _corner_rays(camera: Camera, step: int, width: int, height: int) -> F32:
    """Return the rays of the corners of the blocks, (rows + 1, columns + 1, 2)."""
    u, v = (np.arange(-(-side // DL_SEARCH_BLOCK) + 1) * DL_SEARCH_BLOCK for side in (width, height))
    uv: F64 = np.stack(np.meshgrid(u, v), axis=2).reshape(-1, 2).astype(float)
    rays = camera.rays(np.asarray((uv + 0.5) * step - 0.5)).reshape(len(v), len(u), 2).astype(np.float32)
    rays.setflags(write=False)
    return rays


def blob_circles(pyramid: Pyramid, camera: Camera, plane: Plane, most: int = _MOST_AREAS) -> list[EdgeCircle]:
    """Return the outlines of what stands out, most prominent first, as circles of edges.

    Their `support` is the fraction of the area of an ellipse with the same moments that is filled.
    """
    pyramid[1]
    how = CORE.ffi.new("dl_circle_search *", {
        "most": most, "grey": pyramid.monochrome, "R_cam_plane": plane.R_cam_plane.ravel().tolist()
    })  # fmt: skip
    out, none = np.empty(most, CORE.dtype("dl_circle")), CORE.ffi.NULL
    found = CORE.lib.dl_search_circles(tracker_of(camera), pyramid.native, none, none, how, CORE.array("dl_circle", out, most))
    return _each(out, found)


def _each(out: NDArray[Any], found: int) -> list[EdgeCircle]:
    return [EdgeCircle(out[i : i + 1]) for i in range(checked(found))]
