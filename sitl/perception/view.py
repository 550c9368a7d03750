"""The true view of the camera at one exposure: the pad's pose, and the conditions on which its detection depends."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad

_POINTS = 61
"""Number of places on the disc that are tested for being in the image: the fraction is known to 2 %."""
_GOLDEN_RAD = math.pi * (3.0 - math.sqrt(5.0))


class View(NamedTuple):
    """The pad as the camera sees it, and what makes that hard or easy."""

    R_cam_pad: F64
    """(3, 3)."""
    t_cam_pad: F64
    """(3,) m, the pad's centre."""
    height_m: float
    """Distance of the lens from the pad's plane; negative on the far side of it."""
    shown: float
    """Fraction of the disc's area that lies within the image, 0..1."""
    tilt_rad: float
    """Angle between the optical axis and the pad's normal."""


class Viewer:
    """Makes views through one camera of one pad."""

    def __init__(self, camera: Camera, pad: Pad) -> None:
        self._camera = camera
        # Vogel's spiral covers a disc evenly.
        n = np.arange(_POINTS) + 0.5
        radius, angle = pad.disc_radius_m * np.sqrt(n / _POINTS), n * _GOLDEN_RAD
        self._disc = np.stack([radius * np.cos(angle), radius * np.sin(angle)])
        self._radius_m = pad.disc_radius_m
        self._R_cam_body = np.ascontiguousarray(camera.T_body_cam.R.matrix.T)
        self._p_cam_body = self._R_cam_body.dot(camera.T_body_cam.t)
        self._size = np.array([[camera.width - 0.5], [camera.height - 0.5]])

    def view(self, R_ned_body: F64, d_body_pad_ned: F64, R_ned_pad: F64) -> View:
        """Return the view of a camera on a body.

        Args:
            R_ned_body: (3, 3).
            d_body_pad_ned: (3,) m from the body's origin to the pad's centre.
            R_ned_pad: (3, 3).
        """
        R_cam_ned = self._R_cam_body.dot(R_ned_body.T)
        R = R_cam_ned.dot(R_ned_pad)
        t = R_cam_ned.dot(d_body_pad_ned) - self._p_cam_body
        normal = R[:, 2]
        return View(R, t, float(normal.dot(t)), self._shown(R, t), math.acos(max(-1.0, min(1.0, float(normal[2])))))

    def _shown(self, R: F64, t: F64) -> float:
        if self._wholly(*t.tolist()):
            return 1.0
        p = R[:, :2].dot(self._disc) + t[:, None]
        ahead = p[2] > 1e-3
        if not ahead.any():
            return 0.0
        camera = self._camera
        if camera.distorted:
            uv = camera.project(p.T).T
        else:
            z = np.where(ahead, p[2], 1.0)
            uv = np.array([camera.fx * p[0] / z + camera.cx, camera.fy * p[1] / z + camera.cy])
        inside = ((uv > -0.5) & (uv < self._size)).all(axis=0) & ahead
        return float(np.count_nonzero(inside)) / _POINTS

    def _wholly(self, x: float, y: float, z: float) -> bool:
        """Return whether a ball around the pad's centre, which holds the whole disc, lies within the image of a plain lens."""
        camera, r = self._camera, self._radius_m
        nearest = z - r
        if camera.distorted or nearest < 1e-2:
            return False
        return (
            camera.fx * (x - r) / nearest + camera.cx > -0.5
            and camera.fx * (x + r) / nearest + camera.cx < camera.width - 0.5
            and camera.fy * (y - r) / nearest + camera.cy > -0.5
            and camera.fy * (y + r) / nearest + camera.cy < camera.height - 0.5
        )
