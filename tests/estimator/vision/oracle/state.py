"""The state of registration: the pad's pose and the blur, and the derivatives of a pixel's position on the pad.

Increments are written in `pad`: t -> t + R dt, R -> R exp(dr). A pixel's ray meets the pad's plane at (x, y). With the camera at
(cx, cy) and height h above the plane, and with the ray's slopes k = (x - cx) / h against the plane's normal, the derivatives of
(x, y) are polynomials in x, y and k alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera import Camera, ray_map
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from tests.estimator.vision.oracle.blurred import F32, Blurred

U8 = NDArray[np.uint8]
N_POSE = 6
N_STATE = 9
"""Number of states: dt (3) m, dr (3) rad, blur xx, xy, yy px^2."""

_PIXEL_VAR = 1.0 / 12.0
"""Variance of a square pixel along any direction, px^2."""
_MAX_BLUR_PX2 = 49.0


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationState:
    """A pose and a blur."""

    R: F64
    """`R_cam_pad`, (3, 3)."""
    t: F64
    """The pad's centre in `cam`, (3,) m."""
    blur_px2: F64
    """Covariance of the point spread, (3,) xx, xy, yy along the pad's axes, the pixel's own square included."""
    m_per_px: float
    """Reference scale of `blur_px2`; it is constant while the pose is refined."""
    depth_m: float
    """Depth at which that scale holds."""

    @staticmethod
    def of(pose: PadPose, camera: Camera, blur_px: float, depth_m: float) -> RegistrationState:
        """Build a state; `depth_m` is the depth of the part of the pad that is in view."""
        var = blur_px**2 + _PIXEL_VAR
        scale = depth_m / (0.5 * (camera.fx + camera.fy))
        return RegistrationState(pose.R_cam_pad.matrix, pose.t_cam_pad, np.array([var, 0.0, var]), scale, depth_m)

    @property
    def pose(self) -> PadPose:
        # One Newton step to the nearest rotation suffices: a product of a few rotations is off only by rounding.
        return PadPose(Rotation(self.R @ (1.5 * np.eye(3) - 0.5 * self.R.T @ self.R)), self.t)

    @property
    def blur_m2(self) -> tuple[float, float, float]:
        xx, xy, yy = (self.blur_px2 * self.m_per_px**2).tolist()
        return xx, xy, yy

    @property
    def sigma_px(self) -> float:
        """Standard deviation of the point spread with the pixel, mean over directions."""
        return math.sqrt(0.5 * float(self.blur_px2[0] + self.blur_px2[2]))

    @property
    def line_of_sight(self) -> F64:
        """Slope of the ray to the pad's centre against the pad's normal, (2,)."""
        c = self.t @ self.R
        return np.asarray(c[:2] / max(float(c[2]), 0.03))

    def reduced(self, k: int, smoothing_px2: float) -> RegistrationState:
        """Return the state for pixels k times as wide, including the blur that they and a smoothing of them add."""
        added = _PIXEL_VAR * (1.0 - 1.0 / k**2) + smoothing_px2
        b = self.blur_px2 / k**2 + added * np.array([1.0, 0.0, 1.0])
        return replace(self, blur_px2=b, m_per_px=self.m_per_px * k)

    def restored(self, k: int, smoothing_px2: float) -> RegistrationState:
        """Undo `reduced`.

        The blur stays at least a pixel's, because a blur estimated in wide pixels may be less than they add.
        """
        added = _PIXEL_VAR * (1.0 - 1.0 / k**2) + smoothing_px2
        b = (self.blur_px2 - added * np.array([1.0, 0.0, 1.0])) * k**2
        return replace(self, blur_px2=_possible(b), m_per_px=self.m_per_px / k)

    def moved(self, delta: F64) -> RegistrationState:
        """Apply a (9,) increment; the blur stays a covariance no smaller than a pixel's."""
        R = self.R @ cv2.Rodrigues(delta[3:6])[0]
        return RegistrationState(
            R, self.t + self.R @ delta[:3], _possible(self.blur_px2 + delta[6:9]), self.m_per_px, self.depth_m
        )

    def footprint(self, rays: F64, pad: Pad) -> Footprint:
        """Return the positions on the pad that pixels with `rays` (N, 2), x/z and y/z, look at."""
        # Single precision is 1e-7 of the pad; the transcendental functions that follow take a third of the time in it.
        R = self.R.astype(np.float32)
        r = R[:2].T @ rays.T.astype(np.float32)
        r += R[2][:, None]
        c0, c1, c2 = (-(self.t @ self.R)).tolist()
        per = 1.0 / np.maximum(r[2], 1e-3)
        k1, k2 = r[:2] * per
        per *= -c2 / self.depth_m
        per *= per
        return Footprint(Blurred(pad, c0 - c2 * k1, c1 - c2 * k2, self.blur_m2, per), k1, k2, self.m_per_px**2)


def _possible(blur_px2: F64) -> F64:
    """Return the (3,) xx, xy, yy of the nearest covariance that is no smaller than a pixel's in any direction."""
    xx, xy, yy = blur_px2.tolist()
    if min(xx, yy) > _PIXEL_VAR and max(xx, yy) < 0.9 * _MAX_BLUR_PX2 and (xx - _PIXEL_VAR) * (yy - _PIXEL_VAR) > xy * xy:
        return blur_px2
    values, vectors = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    m = (vectors * np.clip(values, _PIXEL_VAR, _MAX_BLUR_PX2)) @ vectors.T
    return np.array([m[0, 0], m[0, 1], m[1, 1]])


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """Positions on the pad that pixels look at, and the slopes of their rays against its normal."""

    places: Blurred
    k1: F32
    k2: F32
    m2_per_px2: float

    def jacobian(self, d: F32) -> F32:
        """Convert (5, ..., N) derivatives by x, y and the blur in m^2 to (9, ..., N) derivatives by the state."""
        x, y = self.places.x, self.places.y
        out = np.empty((N_STATE, *d.shape[1:]), np.float32)
        np.negative(d[:2], out=out[:2])
        g = np.add(self.k1 * d[0], self.k2 * d[1], out=out[2])
        np.multiply(y, g, out=out[3])
        np.multiply(-x, g, out=out[4])
        np.subtract(y * d[0], x * d[1], out=out[5])
        np.multiply(d[2:], self.m2_per_px2, out=out[6:])
        return out


def pixel_rays(camera: Camera, u: NDArray[np.intp], v: NDArray[np.intp]) -> F64:
    """Return the (N, 2) rays of whole pixels."""
    if camera.distorted:
        return ray_map(camera)[v, u]
    rays = np.empty((2, len(u)))
    np.multiply(u - camera.cx, 1.0 / camera.fx, out=rays[0])
    np.multiply(v - camera.cy, 1.0 / camera.fy, out=rays[1])
    return rays.T
