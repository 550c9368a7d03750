"""Find the planes in which an ellipse in the frame is a circle, for a vehicle that does not tell its attitude."""

from __future__ import annotations

import math

import cv2
import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.detect.plane import Plane

_LEAST_FACING = math.cos(math.radians(38.0))
"""Smallest cosine between the pad's normal and the camera's axis: 25 degrees of tilt plus an error."""
_FEWEST = 12
_SHORTEST, _LONGEST = 1.04, 3.0
"""Ratios of an ellipse's axes: below the first it is a circle that faces the camera, within what its edges tell."""


def tilted_circles(outline_px: F64, camera: Camera) -> list[tuple[Plane, F64, float]]:
    """Return the at most two planes in which an outline, (N, 2) px, is a circle; with its centre and radius there."""
    xy = camera.rays(outline_px)
    if len(xy) < _FEWEST:
        return []
    (cx, cy), (d1, d2), angle = cv2.fitEllipseDirect((xy * 1e3).astype(np.float32))
    if not (math.isfinite(d1 + d2 + cx + cy) and 0 < min(d1, d2) * _SHORTEST < max(d1, d2) < _LONGEST * min(d1, d2)):
        return []
    out = []
    for normal in circle_normals(np.array([cx, cy]) * 1e-3, np.array([d1, d2]) * 0.5e-3, math.radians(angle)):
        if normal[2] < _LEAST_FACING:
            continue
        plane = Plane.facing(normal)
        places = plane.places(camera, outline_px)
        if np.isfinite(places).all():
            out.append((plane, *_circle(places)))
    return [found for found in out if math.isfinite(found[2])]


def circle_normals(centre: F64, half_axes: F64, angle_rad: float) -> list[F64]:
    """Return the (3,) normals in `cam`, away from the lens, of the planes in which a circle projects to this ellipse.

    Args:
        centre: (2,) centre of the ellipse at unit depth.
        half_axes: (2,) half axes there; the first lies at `angle_rad` from the x axis.

    Source: Kanatani and Liu, 3D interpretation of conics and orthogonality, CVGIP 58 (1993), eq. 19.
    """
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    rot = np.array([[c, -s], [s, c]])
    A = rot @ np.diag(half_axes**-2.0) @ rot.T
    b = -A @ centre
    Q = np.block([[A, b[:, None]], [b[None, :], np.array([[centre @ A @ centre - 1.0]])]])
    values, vectors = np.linalg.eigh(Q)
    l3, l2, l1 = values
    if not l3 < 0.0 < l2 <= l1:
        return []
    out = []
    for sign in (1.0, -1.0) if l1 - l2 > 1e-9 * l1 else (1.0,):
        n = math.sqrt((l1 - l2) / (l1 - l3)) * sign * vectors[:, 2] + math.sqrt((l2 - l3) / (l1 - l3)) * vectors[:, 0]
        out.append(np.asarray(n if n[2] > 0 else -n))
    return out


def _circle(places: F64) -> tuple[F64, float]:
    """Fit a circle by least squares on its equation (Kasa, A circle fitting procedure and its error analysis, 1976)."""
    mean = places.mean(axis=0)
    x, y = (places - mean).T
    z = x * x + y * y
    xx, xy, yy = float(x @ x), float(x @ y), float(y @ y)
    bx, by = 0.5 * float(x @ z), 0.5 * float(y @ z)
    det = xx * yy - xy * xy
    if det < 1e-18:
        return mean, math.nan
    cx, cy = (bx * yy - by * xy) / det, (by * xx - bx * xy) / det
    return mean + np.array([cx, cy]), math.sqrt(cx * cx + cy * cy + float(z.mean()))
