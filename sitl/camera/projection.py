"""Project the world's planes and polygons into one frame."""

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.camera.camera import Camera
from sitl.core.abi import DL_CELL_PX
from sitl.core.library import SIM

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

SHIFT = 6
"""Fractional bits of the vertices for OpenCV's drawing: 1/64 px."""

_NEAR_M = 0.002
"""Least distance at which anything is drawn, m; `Camera.project` refuses points nearer than half of it."""

FAR_M = 1e5
"""Distance beyond which a plane is not followed."""

_FAR_PX = 8000.0
"""Largest coordinate of a vertex, px. OpenCV clips polygons to the frame reliably only if their fixed-point coordinates fit into
32 bits."""


class Lens:
    """The viewing ray of every pixel of a camera, precomputed, and the projection of polygons through the same lens."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        h, w = camera.height, camera.width
        v, u = np.mgrid[0:h, 0:w].reshape(2, -1).astype(float)
        uv = np.stack([u, v], axis=1)
        rays = camera.rays(uv)
        self.rays: F32 = rays.reshape(h, w, 2).astype(np.float32)
        self.jacobian: F32 = _ray_change(camera, rays).reshape(h, w, 2, 2).astype(np.float32)
        """Change of the ray for one pixel to the right and one down, (H, W, 2, 2)."""
        at = [DL_CELL_PX * np.arange(-1, -(-size // DL_CELL_PX) + 1) + (DL_CELL_PX - 1) / 2 for size in (w, h)]
        middles = np.stack(np.meshgrid(*at), axis=-1).reshape(-1, 2)
        self.coarse: F32 = camera.rays(middles).reshape(len(at[1]), -1, 2).astype(np.float32)
        """Rays of the middles of cells of 8 x 8 pixels, with one cell more on each side than the frame has, (R, C, 2)."""
        self._coarse = SIM.array("float", self.coarse)
        ring = [*self.coarse[0], *self.coarse[-1], *self.coarse[1:-1, 0], *self.coarse[1:-1, -1]]
        self.border_rays: F64 = np.array(ring[::4], dtype=float)
        """Rays around the frame, a little outside it, (N, 2)."""
        low, high = rays.min(axis=0), rays.max(axis=0)
        margin = 0.15 * (high - low)
        low, high = low - margin, high + margin
        self._planes = np.array(
            [
                [0.0, 0.0, 1.0],
                [1.0, 0.0, -low[0]], [-1.0, 0.0, high[0]],
                [0.0, 1.0, -low[1]], [0.0, -1.0, high[1]],
            ]
        )  # fmt: skip
        self._bent = camera.distorted
        self.corner_rays = rays.reshape(h, w, 2)[[0, 0, -1, -1], [0, -1, 0, -1]]

    def plane_from_ray(self, cam_from_plane: F64) -> F64 | None:
        """Return the homography from (x/z, y/z, 1) of a ray to (x, y, 1) on a plane, up to a factor positive before the camera.

        Args:
            cam_from_plane: (3, 3) columns: the plane's x and y axes, unit vectors, and its origin in m, written in `cam`.

        Returns:
            The homography (3, 3), or None if the camera lies in the plane to within a millimetre.
        """
        if abs(np.linalg.det(cam_from_plane)) < 1e-3:
            return None
        return np.asarray(np.linalg.inv(cam_from_plane))

    def plane_at(self, R_cam_plane: F64, t_cam_plane: F64) -> F64 | None:
        """Return `plane_from_ray` for the plane's rotation (3, 3) and its origin (3,) m, both in `cam`."""
        p = R_cam_plane.T.dot(t_cam_plane)
        return _plane_from_ray(R_cam_plane.T, p) if abs(float(p[2])) >= 1e-3 else None

    def cells(self, plane_from_ray: F64, most: float = FAR_M) -> F32:
        """Return where the rays of `coarse` meet a plane, (R, C, 2), limited to +-`most`."""
        rows, columns = self.coarse.shape[:2]
        places = np.empty((rows, columns, 2), np.float32)
        H = np.ascontiguousarray(plane_from_ray, dtype=np.float64)
        plane = SIM.array("double", H, 9)
        SIM.lib.dl_sim_render_meet(rows * columns, self._coarse, plane, most, SIM.array("float", places))
        return places

    def meet(self, plane_from_ray: F64, part: tuple[slice, slice] | None = None) -> F32:
        """Return where the rays of a part of the frame, or of all of it, meet a plane, (h, w, 2): `coarse`, interpolated.

        At ten degrees of tilt it is right to 0.002 px. Beyond the horizon it is meaningless, within 100 km.
        """
        rows, cols = part if part is not None else (slice(0, self.camera.height), slice(0, self.camera.width))
        whole, y, x = self._around(plane_from_ray, rows, cols, 1)
        return whole[y : y + rows.stop - rows.start, x : x + cols.stop - cols.start]

    def meet_halves(self, plane_from_ray: F64, part: tuple[slice, slice]) -> F32:
        """Return `meet` at the middles of squares of 2 x 2 pixels, (h / 2, w / 2, 2), for even starts and even sizes."""
        rows, cols = part
        whole, y, x = self._around(plane_from_ray, rows, cols, 2)
        return whole[y : y + (rows.stop - rows.start) // 2, x : x + (cols.stop - cols.start) // 2]

    def spread(self, cells: F32) -> F32:
        """Return values of the cells of `coarse`, (R, C) or (R, C, 2), for every pixel, (H, W) or (H, W, 2)."""
        c = self.camera
        size = (cells.shape[1] * DL_CELL_PX, cells.shape[0] * DL_CELL_PX)
        whole = cv2.resize(cells, size, interpolation=cv2.INTER_LINEAR)[
            DL_CELL_PX : DL_CELL_PX + c.height, DL_CELL_PX : DL_CELL_PX + c.width
        ]
        return np.ascontiguousarray(whole, dtype=np.float32)

    def _around(self, plane_from_ray: F64, rows: slice, cols: slice, coarser: int) -> tuple[F32, int, int]:
        """Return where rays meet a plane, a little more than the part, and the row and column at which the part begins."""
        r0, r1 = rows.start // DL_CELL_PX, -(-rows.stop // DL_CELL_PX) + 2
        c0, c1 = cols.start // DL_CELL_PX, -(-cols.stop // DL_CELL_PX) + 2
        places = cv2.perspectiveTransform(np.ascontiguousarray(self.coarse[r0:r1, c0:c1]), plane_from_ray)
        np.clip(places, -FAR_M, FAR_M, out=places)
        cell = DL_CELL_PX // coarser
        whole = cv2.resize(places, ((c1 - c0) * cell, (r1 - r0) * cell), interpolation=cv2.INTER_LINEAR)
        y, x = rows.start // coarser - (r0 - 1) * cell, cols.start // coarser - (c0 - 1) * cell
        return np.asarray(whole, dtype=np.float32), y, x

    def _straight(self, p: F64) -> F64 | None:
        """Return (N, 2) px for a lens without distortion, or None if a point is behind it or too far out for OpenCV."""
        z = p[:, 2]
        if z.min() < _NEAR_M:
            return None
        c = self.camera
        uv = p[:, :2] / z[:, None] * (c.fx, c.fy) + (c.cx, c.cy)
        return uv if max(uv.max(), -uv.min()) < _FAR_PX else None

    def outline(self, points_cam: F64, steps: int = 1) -> F64:
        """Return the polygon (N, 3) m in `cam` as (M, 2) px, cut to a little more than the frame; M is 0 if nothing is left.

        Args:
            points_cam: vertices of the polygon.
            steps: number of pieces into which each edge is divided where the lens bends straight lines.
        """
        p = np.asarray(points_cam, dtype=float)
        if not self._bent:
            uv = self._straight(p)
            if uv is not None:
                return uv
        planes = self._planes
        side = p @ planes.T - (_NEAR_M, 0.0, 0.0, 0.0, 0.0)
        if np.any(side.max(axis=0) < 0):
            return np.empty((0, 2))
        if np.any(side < 0):
            p = _cut(p, planes)
            if len(p) == 0:
                return np.empty((0, 2))
        if steps > 1 and self._bent and len(p) < 24:
            f = np.arange(steps)[:, None] / steps
            p = (p[:, None] * (1.0 - f) + np.roll(p, -1, axis=0)[:, None] * f).reshape(-1, 3)
        return self.camera.project(p)


def planes_from_rays(poses: Sequence[tuple[F64, F64]]) -> F64:
    """Return `Lens.plane_from_ray` of planes whose rotations (3, 3) and origins (3,) m in `cam` these are, (N, 3, 3)."""
    return np.array([_plane_from_ray(R.T, R.T.dot(t)) for R, t in poses])


def _plane_from_ray(axes: F64, p: F64) -> F64:
    """Return the homography (3, 3) from rays to a plane with these axes as rows, (3, 3) in `cam`, and its origin at p along them.

    The inverse of a matrix whose columns are axes x and y and the origin p_x x + p_y y + p_z z has the rows x - p_x / p_z z,
    y - p_y / p_z z and z / p_z.
    """
    out: F64 = np.array(axes)
    out[2] /= p[2]
    out[0] -= p[0] * out[2]
    out[1] -= p[1] * out[2]
    return out


def _ray_change(camera: Camera, rays: F64) -> F64:
    """Return the inverse of the distortion's derivative at rays (N, 2) divided by the focal lengths, (N, 2, 2)."""
    per_px = np.array([1.0 / camera.fx, 1.0 / camera.fy])
    if not camera.distorted:
        return np.broadcast_to(np.diag(per_px), (len(rays), 2, 2))
    step = 1e-5
    dx, dy = np.array([step, 0.0]), np.array([0.0, step])
    bend = np.stack([camera.distort(rays + d) - camera.distort(rays - d) for d in (dx, dy)], axis=-1) / (2 * step)
    return np.asarray(np.linalg.inv(bend) * per_px)


@lru_cache(maxsize=8)
def lens_of(camera: Camera) -> Lens:
    """Return the lens of a camera object, computed once."""
    return Lens(camera)


def _cut(polygon: F64, planes: F64) -> F64:
    """Return the part of a polygon (N, 3) on the positive side of every plane through the origin.

    Source: Sutherland & Hodgman, Reentrant polygon clipping, CACM 17(1), 1974.
    """
    p = polygon
    for i, plane in enumerate(planes):
        d = p @ plane - (_NEAR_M if i == 0 else 0.0)
        if np.all(d >= 0):
            continue
        q, e = np.roll(p, -1, axis=0), np.roll(d, -1)
        crosses = (d >= 0) != (e >= 0)
        t = np.where(crosses, d / np.where(crosses, d - e, 1.0), 0.0)
        both = np.stack([p, p + t[:, None] * (q - p)], axis=1).reshape(-1, 3)
        p = both[np.stack([d >= 0, crosses], axis=1).reshape(-1)]
        if len(p) < 3:
            return np.empty((0, 3))
    return p


def fixed_point(uv_px: F64) -> I32:
    """Return OpenCV's fixed-point vertices with `SHIFT` fractional bits for (N, 2) px."""
    return np.round(uv_px * (1 << SHIFT)).astype(np.int32)
