"""Gauss-Newton steps of registration with the priors: tilt from the attitude and a nearly level deck."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation, roll_pitch, tilt_axes
from tests.estimator.vision.oracle.state import N_STATE, RegistrationState

_FREE_ROTATION_RAD = math.pi / math.sqrt(3.0)
"""Standard deviation of an angle that is completely unknown."""
WEAK_BLUR_PX2 = 3.0
"""Standard deviation of the prior of the blur's covariance about its start; it holds the blur if no edge shows it."""


@dataclass(frozen=True, slots=True, eq=False)
class TiltTarget:
    """The pad's normal as predicted by the attitude and a nearly level deck."""

    normal_cam: F64
    cov_cam: F64
    """Covariance of the small rotation between prediction and truth, (3, 3) rad^2; only the part across the normal matters."""

    @staticmethod
    def of(prior: Orientation, camera: Camera) -> TiltTarget:
        R_cam_level = (roll_pitch(prior) @ camera.T_body_cam.R.matrix).T
        axes = R_cam_level @ tilt_axes(prior)
        cov = axes @ prior.cov_tilt @ axes.T + np.eye(3) * max(prior.sigma_deck_rad, 1e-5) ** 2
        return TiltTarget(R_cam_level[:, 2], cov)

    def information(self, R: F64) -> tuple[F64, F64]:
        """Return (2, 2) information on rotations about the pad's x and y, and the (2,) rotation that meets the prediction."""
        across = R[:, :2]
        n0, n1 = (self.normal_cam @ across).tolist()
        (a, b), (_, d) = (across.T @ self.cov_cam @ across).tolist()
        per = 1.0 / (a * d - b * b)
        return np.array([[d * per, -b * per], [-b * per, a * per]]), np.array([-n1, n0])


def depth_in_view(pose: PadPose, camera: Camera) -> float:
    """Return the depth of the pad's plane at the part of it that is in the frame, metres."""
    t = pose.t_cam_pad
    if t[2] > 0.05:
        uv = np.minimum(np.maximum(camera.project(t[None]), 0.0), (camera.width - 1.0, camera.height - 1.0))
    else:
        uv = np.array([[camera.cx, camera.cy]])
    ray = np.array([*camera.rays(uv)[0], 1.0])
    n = pose.R_cam_pad.matrix[:, 2]
    down = float(n @ ray)
    depth = float(n @ t) / down if abs(down) > 0.05 else float(np.linalg.norm(t))
    return max(depth, 0.03)


class Solver:
    """Gauss-Newton with priors; it keeps the values that the weak priors are centred on."""

    def __init__(self, state: RegistrationState, tilt: TiltTarget | None, pad: Pad, distant: bool = False) -> None:
        self._distant = distant
        self._tilt = tilt
        self._blur = state.blur_px2
        free = np.zeros(N_STATE)
        free[:3] = (3.0 * float(np.linalg.norm(state.t))) ** -2
        free[3:6] = _FREE_ROTATION_RAD**-2
        free[6:] = WEAK_BLUR_PX2**-2
        self._free = np.diag(free)
        self._reach_m = min(pad.disc_radius_m, 0.6 * state.depth_m)

    def prior(self, state: RegistrationState) -> tuple[F64, F64]:
        """Return the (9, 9) information and the (9,) gradient of the priors."""
        H, g = self._free.copy(), np.zeros(N_STATE)
        g[6:] = (self._blur - state.blur_px2) * WEAK_BLUR_PX2**-2
        if self._tilt is not None:
            A, target = self._tilt.information(state.R)
            H[3:5, 3:5] += A
            g[3:5] += A @ target
        return H, g

    def step(
        self, state: RegistrationState, H: F64, g: F64, limit_px: float, blur_too: bool = True
    ) -> tuple[RegistrationState, float]:
        """Return the next state and the motion in the frame, px; a step beyond the limit is shortened."""
        H0, g0 = self.prior(state)
        if blur_too:
            delta = _solved(H + H0, g + g0)
        else:
            delta = np.zeros(N_STATE)
            delta[:6] = _solved((H + H0)[:6, :6], (g + g0)[:6])
        moved = self.moved_px(state, delta)
        if moved > limit_px:
            delta = delta * (limit_px / moved)
        return state.moved(delta), moved

    def moved_px(self, state: RegistrationState, delta: F64) -> float:
        reach = self._reach_m
        # From afar a tilt shortens the image only by its change against the line of sight.
        lever = reach * (reach / state.depth_m + 0.1)
        x, y, z, rx, ry, rz = map(float, delta[:6])
        if self._distant:
            # Along the line of sight nothing moves in the frame but the size.
            x, y = (np.array([x, y]) - z * state.line_of_sight).tolist()
        parts = (math.hypot(x, y), abs(z) * reach / state.depth_m, lever * math.hypot(rx, ry), reach * abs(rz))
        return max(parts) / state.m_per_px

    def covariance(self, state: RegistrationState, H: F64) -> F64:
        return inverse(H + self.prior(state)[0])


def inverse(M: F64) -> F64:
    """Return the inverse of a symmetric positive matrix; the method is as in `_solved`."""
    ok, out = cv2.invert(M, flags=cv2.DECOMP_CHOLESKY)
    return np.asarray(out if ok else np.linalg.inv(M), float)


def _solved(H: F64, g: F64) -> F64:
    """Solve by Cholesky, for which OpenCV has a fraction of numpy's overhead; by elimination if that fails."""
    ok, x = cv2.solve(H, g[:, None], flags=cv2.DECOMP_CHOLESKY)
    return np.asarray(x[:, 0] if ok else np.linalg.solve(H, g), float)


def difference(a: RegistrationState, b: RegistrationState) -> F64:
    """Return the (9,) increment from a to b, which must be close to one another."""
    (_, xy, xz), (yx, _, yz), (zx, zy, _) = (a.R.T @ b.R).tolist()
    out = np.empty(N_STATE)
    out[:3] = (b.t - a.t) @ a.R
    out[3:6] = 0.5 * (zy - yz), 0.5 * (xz - zx), 0.5 * (yx - xy)
    out[6:] = b.blur_px2 - a.blur_px2
    return out
