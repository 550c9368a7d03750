"""Gauss-Newton steps of registration, with what is known besides the picture: tilt from attitude and a nearly level deck."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.registration_state import N_STATE, State

_FREE_ROTATION_RAD = math.pi / math.sqrt(3.0)
"""Sigma of an angle that could be anything."""
WEAK_BLUR_PX2 = 3.0
"""Sigma of the blur's covariance about where it began: holds it where no edge shows it."""


@dataclass(frozen=True, slots=True, eq=False)
class TiltTarget:
    """The pad's normal as attitude and a nearly level deck predict it."""

    normal_cam: F64
    cov_cam: F64
    """(3, 3) rad^2 of the small rotation between prediction and truth; across the normal it is what counts."""

    @staticmethod
    def of(prior: Orientation, camera: Camera) -> TiltTarget:
        R_cam_level = (prior.R_level_body @ camera.T_body_cam.R).inv.matrix
        axes = R_cam_level @ tilt_axes(prior)
        cov = axes @ prior.cov_tilt @ axes.T + np.eye(3) * max(prior.sigma_deck_rad, 1e-5) ** 2
        return TiltTarget(R_cam_level[:, 2], cov)

    def information(self, R: F64) -> tuple[F64, F64]:
        """(2, 2) on the rotations about the pad's x and y, and the (2,) rotation that would meet the prediction."""
        n = R.T @ self.normal_cam
        cov = (R.T @ self.cov_cam @ R)[:2, :2]
        return np.asarray(np.linalg.inv(cov), float), np.array([-n[1], n[0]])


def tilt_axes(prior: Orientation) -> F64:
    """(3, 2) axes in `level` about which an error of roll and of pitch turns the body."""
    return np.array([[math.cos(prior.pitch_rad), 0.0], [0.0, 1.0], [-math.sin(prior.pitch_rad), 0.0]])


def depth_in_view(pose: PadPose, camera: Camera) -> float:
    """Depth of the pad's plane where the part of it in the picture is."""
    t = pose.t_cam_pad
    if t[2] > 0.05:
        uv = np.clip(camera.project(t[None])[0], (0.0, 0.0), (camera.width - 1.0, camera.height - 1.0))
    else:
        uv = np.array([camera.cx, camera.cy])
    ray = np.array([*camera.rays(uv[None])[0], 1.0])
    n = pose.R_cam_pad.matrix[:, 2]
    down = float(n @ ray)
    depth = float(n @ t) / down if abs(down) > 0.05 else float(np.linalg.norm(t))
    return max(depth, 0.03)


class Solver:
    """Gauss-Newton with the priors in; keeps what the weak ones are centred on."""

    def __init__(self, state: State, tilt: TiltTarget | None, pad: Pad) -> None:
        self._tilt = tilt
        self._blur = state.blur_px2
        free = np.zeros(N_STATE)
        free[:3] = (3.0 * float(np.linalg.norm(state.t))) ** -2
        free[3:6] = _FREE_ROTATION_RAD**-2
        free[6:] = WEAK_BLUR_PX2**-2
        self._free = np.diag(free)
        self._reach_m = min(pad.disc_radius_m, 0.6 * state.depth_m)

    def prior(self, state: State) -> tuple[F64, F64]:
        """(9, 9) information and (9,) gradient."""
        H, g = self._free.copy(), np.zeros(N_STATE)
        g[6:] = (self._blur - state.blur_px2) * WEAK_BLUR_PX2**-2
        if self._tilt is not None:
            A, target = self._tilt.information(state.R)
            H[3:5, 3:5] += A
            g[3:5] += A @ target
        return H, g

    def step(self, state: State, H: F64, g: F64, limit_px: float, blur_too: bool = True) -> tuple[State, float]:
        """The next state and how far it moved the picture, px; a step longer than the limit is shortened."""
        H0, g0 = self.prior(state)
        if blur_too:
            delta = np.asarray(np.linalg.solve(H + H0, g + g0), float)
        else:
            delta = np.zeros(N_STATE)
            delta[:6] = np.linalg.solve((H + H0)[:6, :6], (g + g0)[:6])
        moved = self.moved_px(state, delta)
        if moved > limit_px:
            delta = delta * (limit_px / moved)
        return state.moved(delta), moved

    def moved_px(self, state: State, delta: F64) -> float:
        reach = self._reach_m
        # Seen from afar a tilt shortens the picture by its change against the line of sight only.
        lever = reach * (reach / state.depth_m + 0.1)
        parts = (
            math.hypot(delta[0], delta[1]), abs(delta[2]) * reach / state.depth_m,
            lever * math.hypot(delta[3], delta[4]), reach * abs(delta[5]),
        )  # fmt: skip
        return float(max(parts)) / state.m_per_px

    def covariance(self, state: State, H: F64) -> F64:
        return np.asarray(np.linalg.inv(H + self.prior(state)[0]), float)


def difference(a: State, b: State) -> F64:
    """(9,) the increment from a to b, which are near one another."""
    turn = a.R.T @ b.R
    small = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return np.concatenate([a.R.T @ (b.t - a.t), small, b.blur_px2 - a.blur_px2])
