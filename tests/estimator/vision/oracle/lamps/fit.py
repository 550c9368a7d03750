"""Fit a pad's pose to the spots that its lamps make."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from estimator.contracts.geometry import F64, known_rotation, orthonormalised, skew
from estimator.vision.camera import Camera
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation, OrientedCamera, tilt_axes
from tests.estimator.vision.oracle.lamps.pattern import Assignment
from tests.estimator.vision.oracle.lamps.spots import Spots

_STEPS = 6
_ROBUST = 3.0
"""Standard deviations of a spot at which it counts a quarter, or times the middle one's distance while that is more: another
light beside a lamp moves its centre (Geman & McClure, Statistical methods for tomographic image reconstruction, 1987)."""
_MERGED_PX = 0.15
"""Standard deviation, px, of the centre of a spot that several lamps share: they are not equally bright."""
_QUARTER_TURN = -np.array([[0.0, 1.0], [-1.0, 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class LampFit:
    """A pose of the pad, how well it is known, and how far its lamps are from their spots."""

    pose: PadPose
    cov: F64
    """(6, 6): [t_cam_pad (m), small rotation of the pad written in `cam` (rad)]."""
    off_px: F64
    """Distance of each spot from the lamps in it, (G,) px."""
    middle_sigmas: float
    """The middle one of these distances in the spots' standard deviations."""
    extent_px: float
    """Largest distance of these spots from their middle."""


def fit(
    spots: Spots,
    lamps_m: F64,
    of: Assignment,
    start: PadPose,
    camera: Camera,
    orientation: Orientation,
    size_sigma_m: float = 0.0,
) -> LampFit | None:
    """Return the pose at which the assigned lamps lie in their spots, by Gauss and Newton; None if they do not determine one.

    The attitude and a deck that is level to `Orientation.sigma_deck_rad` are a prior on the tilt, which few lamps far below
    hardly tell.

    Args:
        lamps_m: places of the lamps on the pad, (L, 2) m.
        size_sigma_m: standard deviation of the pattern's size, m at its outermost lamp.
    """
    groups = np.unique(of.spot)
    if len(groups) < 2:
        return None
    share = (of.spot[None] == groups[:, None]).astype(float)
    count = share.sum(axis=1)
    share /= count[:, None]
    focal = 0.5 * (camera.fx + camera.fy)
    sigma = np.hypot(spots.sigma_px[groups], np.where(count > 1, _MERGED_PX, 0.0)) / focal
    rays = camera.rays(spots.uv_px[groups])
    on_pad = np.pad(lamps_m[of.lamp], ((0, 0), (0, 1)))
    R, t = start.R_cam_pad.matrix, start.t_cam_pad
    R_level_cam, tilt_information = _tilt_prior(camera, orientation)
    information = np.eye(6)
    off, trust = np.zeros((len(groups), 2)), np.ones(len(groups))
    for _ in range(_STEPS):
        p = on_pad @ R.T + t
        if float(p[:, 2].min()) < 0.02:
            return None
        off = rays - share @ (p[:, :2] / p[:, 2:])
        J = np.einsum("gl,lij->gij", share, _by_pose(p, p - t))
        sigmas = np.linalg.norm(off, axis=1) / sigma
        trust = (1.0 + (sigmas / (_ROBUST * max(1.0, float(np.median(sigmas))))) ** 2) ** -2.0
        weight = trust / sigma**2
        information = np.einsum("gki,g,gkj->ij", J, weight, J)
        gradient = np.einsum("gki,g,gk->i", J, weight, off)
        normal = R_level_cam @ R[:, 2]
        T = (-skew(normal) @ R_level_cam)[:2]
        information[3:, 3:] += T.T @ tilt_information @ T
        gradient[3:] -= T.T @ tilt_information @ normal[:2]
        try:
            step = np.linalg.solve(information, gradient)
        except np.linalg.LinAlgError:
            return None
        R, t = np.asarray(cv2.Rodrigues(step[3:])[0]) @ R, t + step[:3]
    if not np.all(np.isfinite(t)) or t[2] < 0.02:
        return None
    reach = float(np.linalg.norm(lamps_m, axis=1).max())
    cov = np.linalg.inv(information)
    chi2 = float((trust * np.sum(off**2, axis=1) / sigma**2).sum()) / max(1.0, 2.0 * float(trust.sum()) - 4.0)
    cov *= max(1.0, chi2)
    cov[:3, :3] += (size_sigma_m / reach) ** 2 * np.outer(t, t)
    off_rays = np.linalg.norm(off, axis=1)
    extent = float(np.linalg.norm(rays - rays.mean(axis=0), axis=1).max())
    pose = PadPose(known_rotation(orthonormalised(R)), t)
    return LampFit(pose, 0.5 * (cov + cov.T), focal * off_rays, float(np.median(off_rays / sigma)), focal * extent)


def _by_pose(p_cam: F64, arm_cam: F64) -> F64:
    """Return how x/z and y/z of points move with the pad's place and with a small turn of it in `cam`, (L, 2, 6)."""
    x, y, z = p_cam.T
    J = np.zeros((len(p_cam), 2, 6))
    J[:, 0, 0] = J[:, 1, 1] = 1.0 / z
    J[:, 0, 2], J[:, 1, 2] = -x / z**2, -y / z**2
    a, b, c = arm_cam.T
    none = np.zeros_like(a)
    turn = np.stack([np.stack([none, c, -b], 1), np.stack([-c, none, a], 1), np.stack([b, -a, none], 1)], 1)
    J[:, :, 3:] = J[:, :, :3] @ turn
    return J


def _tilt_prior(camera: Camera, orientation: Orientation) -> tuple[F64, F64]:
    """Return `R_level_cam`, and the information on the horizontal part of the pad's normal in `level`, (2, 2) 1/rad^2."""
    A = _QUARTER_TURN @ tilt_axes(orientation)[:2]
    cov = A @ orientation.cov_tilt @ A.T + orientation.sigma_deck_rad**2 * np.eye(2)
    return OrientedCamera(camera, orientation).R_level_cam, np.asarray(np.linalg.inv(cov + 1e-8 * np.eye(2)), float)
