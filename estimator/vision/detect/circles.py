"""Fit circles on the deck to the outlines of regions, robust against anything else in the outline.

Rays are intersected with a plane parallel to the assumed pad, in which a tilted pad is a circle again. If the tilt is unknown the
plane faces the camera, and the tolerance covers the distortion of a circle by 25 degrees of tilt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera import Camera
from estimator.vision.pad_pose import PadPose

_POINTS = 90
_MIN_POINTS = 7
_MIN_ARC_RAD = 0.9
_SPREADS = (1 / 3, 1 / 4, 1 / 6, 1 / 9)
"""Distances along the outline between the three points of a trial circle, as fractions of its length."""
_TRIALS = 30
_TOLERANCE, _TOLERANCE_FREE = 0.025, 0.06
"""Tolerances as fractions of the radius, with the tilt known and unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A plane at unit distance from the lens, assumed parallel to the pad."""

    R_cam_plane: F64
    """Rotation (3, 3) whose z axis is the plane's normal, away from the lens."""
    known: bool
    """False if the plane merely faces the camera."""

    @staticmethod
    def of(camera: Camera, R_level_body: Rotation | None) -> Plane:
        """Return the plane of a level deck under a vehicle of known roll and pitch, or one facing the lens."""
        if R_level_body is None:
            return Plane(np.eye(3), False)
        return Plane(camera.T_body_cam.R.matrix.T @ R_level_body.matrix.T, True)

    @staticmethod
    def facing(normal_cam: F64) -> Plane:
        """Return the plane with this unit normal, turned as little as possible from the camera's axes."""
        axis = np.cross([0.0, 0.0, 1.0], normal_cam)
        s, c = float(np.linalg.norm(axis)), float(normal_cam[2])
        turn = axis * (math.atan2(s, c) / s) if s > 1e-9 else np.zeros(3)
        return Plane(Rotation.from_rotvec(turn).matrix, True)

    def places(self, camera: Camera, uv_px: F64) -> F64:
        """Map (N, 2) px to (N, 2) positions on the plane; nan where the ray misses it."""
        xy = camera.rays(uv_px)
        p = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) @ self.R_cam_plane
        return np.asarray(p[:, :2] / np.where(p[:, 2] > 0.15, p[:, 2], np.nan)[:, None])

    def pose(self, centre: F64, radius: float, radius_m: float) -> PadPose:
        """Return the pose of a pad whose circle of `radius_m` appears as this circle."""
        depth = radius_m / radius
        return PadPose(Rotation(self.R_cam_plane), self.R_cam_plane @ np.array([centre[0] * depth, centre[1] * depth, depth]))


@dataclass(frozen=True, slots=True, eq=False)
class Circle:
    """A circle in a plane at unit distance."""

    centre: F64
    radius: float
    fraction: float
    """Fraction of the outline's points that lie on the circle."""
    arc_rad: float
    """Arc of the circle that these points cover."""
    on: np.ndarray[tuple[int], np.dtype[np.bool_]]
    """Mask of the points that the circle was fitted to."""


def circles(places: F64, least_radius: float, tolerance: float, most: int = 2) -> list[Circle]:
    """Return the circles with the most outline points, at most `most`, by RANSAC-like trials of three points each.

    Args:
        places: (N, 2) in order along the outline.
        least_radius: smaller circles are taken for noise.
        tolerance: as a fraction of the radius.
    """
    places = places[np.isfinite(places).all(axis=1)]
    if len(places) > _POINTS:
        places = places[np.linspace(0, len(places) - 1, _POINTS).astype(int)]
    out: list[Circle] = []
    left = places
    for _ in range(most):
        found = _best(left, least_radius, tolerance)
        if found is None:
            break
        out.append(found)
        left = left[~found.on]
        if len(left) < max(_MIN_POINTS, len(places) // 4):
            break
    return out


def _best(places: F64, least_radius: float, tolerance: float) -> Circle | None:
    n = len(places)
    if n < _MIN_POINTS:
        return None
    start = np.linspace(0, n, _TRIALS, endpoint=False).astype(int)
    i = np.tile(start, len(_SPREADS))
    gap = np.repeat([max(1, round(s * n)) for s in _SPREADS], _TRIALS)
    a, b, c = places[i], places[(i + gap) % n], places[(i + 2 * gap) % n]
    centres, radii = _through(a, b, c)
    # The shortest arc's chord is 0.87 radii. A radius larger than the outline allows means a straight line.
    largest = 1.2 * float(np.hypot(*(places.max(axis=0) - places.min(axis=0))))
    ok = np.isfinite(radii) & (radii > least_radius) & (radii < largest)
    if not ok.any():
        return None
    centres, radii = centres[ok], radii[ok]
    d = np.hypot(places[None, :, 0] - centres[:, 0, None], places[None, :, 1] - centres[:, 1, None])
    width = np.maximum(tolerance * radii, 0.3 * least_radius)[:, None]
    score = np.clip(1.0 - np.abs(d - radii[:, None]) / width, 0.0, None).sum(axis=1)
    k = int(np.argmax(score))
    centre, radius = centres[k], float(radii[k])
    on = np.abs(d[k] - radius) < width[k]
    for _ in range(2):
        if on.sum() < 4:
            return None
        centre, radius = _fit(places[on])
        if not least_radius < radius < largest:
            return None
        d_on = np.abs(np.hypot(places[:, 0] - centre[0], places[:, 1] - centre[1]) - radius)
        on = d_on < max(tolerance * radius, 0.3 * least_radius)
    angles = np.sort(np.arctan2(places[on, 1] - centre[1], places[on, 0] - centre[0]))
    if len(angles) < _MIN_POINTS - 1:
        return None
    gaps = np.diff(angles, append=angles[0] + math.tau)
    arc = math.tau - float(gaps[gaps > 0.35].sum())
    if arc < _MIN_ARC_RAD:
        return None
    return Circle(centre, radius, float(on.mean()), arc, on)


def _through(a: F64, b: F64, c: F64) -> tuple[F64, F64]:
    """Return the circles through three points each: (N, 2) centres and (N,) radii; nan for collinear points."""
    p, q = b - a, c - a
    cross = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    pp, qq = (p * p).sum(axis=1), (q * q).sum(axis=1)
    safe = np.where(np.abs(cross) > 1e-4 * np.maximum(pp, qq), 2.0 * cross, np.nan)
    u = np.stack([q[:, 1] * pp - p[:, 1] * qq, p[:, 0] * qq - q[:, 0] * pp], axis=1) / safe[:, None]
    return a + u, np.hypot(u[:, 0], u[:, 1])


def _fit(p: F64) -> tuple[F64, float]:
    """Fit a circle by least squares on its equation (Kasa, A circle fitting procedure and its error analysis, 1976)."""
    mean = p.mean(axis=0)
    x, y = (p - mean).T
    z = x * x + y * y
    A = np.array([[np.dot(x, x), np.dot(x, y)], [np.dot(x, y), np.dot(y, y)]])
    det = A[0, 0] * A[1, 1] - A[0, 1] ** 2
    if det < 1e-18:
        return mean, math.nan
    bx, by = 0.5 * np.dot(x, z), 0.5 * np.dot(y, z)
    cx, cy = (bx * A[1, 1] - by * A[0, 1]) / det, (by * A[0, 0] - bx * A[0, 1]) / det
    return mean + np.array([cx, cy]), math.sqrt(cx * cx + cy * cy + float(z.mean()))


def tolerance_of(plane: Plane) -> float:
    """Return the tolerance, as a fraction of the radius, for outlines intersected with this plane."""
    return _TOLERANCE if plane.known else _TOLERANCE_FREE
