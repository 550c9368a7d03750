"""Solve the pad's pose from image points of known places on it, given the orientations of camera and pad plane.

This corrects the thesis' pose from one image point and one image length (section 4.1.6). The rays of the points are rotated into
the level frame and intersected with the pad's plane at an unknown depth. A similarity (shift, rotation, scale) fits the drawing
to the intersections, and its scale gives the depth. In that plane a tilted image of the pad is undistorted, so neither the tilt
nor the camera's position on the body is neglected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from msgspec import Struct
from msgspec.structs import force_setattr

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Feature, Method, Sighting
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.camera.camera import Camera
from estimator.vision.options import TrackerOptions

_MIN_DOWN = 0.2  # Cosine of the flattest ray that is intersected with the deck: 78 degrees off the vertical
SIGMA_LEVEL_ASSUMED_RAD = math.radians(5.0)
"""Standard deviation of roll and pitch of a vehicle without a measured attitude: what a multicopter reaches against a breeze. It
costs 9 cm per metre of height.
"""


class PadPose(Struct, frozen=True, eq=False):
    """The pose of the pad in `cam`: `p_cam = R_cam_pad @ p_pad + t_cam_pad`.

    Raises:
        ValueError: `t_cam_pad` is not a finite (3,) vector.
    """

    R_cam_pad: Rotation
    t_cam_pad: F64
    """The pad's centre in `cam`, (3,) m."""

    def __post_init__(self) -> None:
        t = np.array(self.t_cam_pad, dtype=float)
        if t.shape != (3,) or not all(map(math.isfinite, t.tolist())):
            raise ValueError(f"t_cam_pad needs a finite (3,) vector, got {self.t_cam_pad!r}")
        t.setflags(write=False)
        force_setattr(self, "t_cam_pad", t)

    @property
    def range_m(self) -> float:
        """Distance from the lens to the pad's centre, metres."""
        return math.sqrt(float(self.t_cam_pad.dot(self.t_cam_pad)))

    def px_of(self, length_m: float, camera: Camera) -> float:
        """Return the length in the frame, px, of something at the pad that faces the camera."""
        return camera.fx * length_m / float(self.t_cam_pad[2])

    def points(self, p_pad: F64) -> F64:
        """Transform (N, 3) points from `pad` to `cam`, m."""
        return np.asarray(p_pad @ self.R_cam_pad.matrix.T + self.t_cam_pad)

    def rays(self) -> F64:
        """Return the matrix, (3, 3), that takes a place on the pad, x, y and 1, to its ray, times its depth."""
        return np.column_stack([self.R_cam_pad.matrix[:, :2], self.t_cam_pad])

    def turned(self, yaw_rad: float) -> PadPose:
        """Return the pose at the same position with the drawing turned about the pad's own z axis by `yaw_rad`."""
        return PadPose(self.R_cam_pad @ Rotation.from_rpy(0.0, 0.0, yaw_rad), self.t_cam_pad)


SIGMA_DECK_RAD = TrackerOptions().deck_tilt_sigma_rad
"""Standard deviation of roll and pitch of a deck that is assumed level: a supply vessel's in a slight sea (data: waves/FACTS.md
gives 1..4 degrees).
"""


class Orientation(Struct, frozen=True, eq=False):
    """The orientations of camera and pad plane in `level`, and their uncertainty."""

    roll_rad: float
    pitch_rad: float
    cov_tilt: F64
    """Covariance of roll and pitch, (2, 2) rad^2."""
    sigma_deck_rad: float
    measured: bool
    """False if the vehicle is merely assumed level."""

    @staticmethod
    def of(attitude: Attitude | None, sigma_deck_rad: float = SIGMA_DECK_RAD) -> Orientation:
        """Return the orientation from the attitude at the exposure; without one assume a level vehicle with a wide covariance."""
        if attitude is None:
            return Orientation(0.0, 0.0, np.eye(2) * SIGMA_LEVEL_ASSUMED_RAD**2, sigma_deck_rad, False)
        roll, pitch, _ = attitude.R_ned_body.rpy_rad
        # Euler-angle kinematics: the effect of a small rotation in `body` on roll and pitch. Fossen 2011, eq. 2.28.
        t = math.tan(max(-1.4, min(1.4, pitch)))
        J = np.array([[1.0, math.sin(roll) * t, math.cos(roll) * t], [0.0, math.cos(roll), -math.sin(roll)]])
        return Orientation(roll, pitch, J @ attitude.cov_body @ J.T, sigma_deck_rad, True)

    @property
    def R_level_body(self) -> Rotation:
        return Rotation.from_rpy(self.roll_rad, self.pitch_rad, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class OrientedCamera:
    """A camera in a known orientation. It maps pixels to the level plane at unit depth below the camera, and back."""

    camera: Camera
    orientation: Orientation
    R_level_cam: F64 = field(init=False)

    def __post_init__(self) -> None:
        R = self.orientation.R_level_body.matrix @ self.camera.T_body_cam.R.matrix
        object.__setattr__(self, "R_level_cam", R)

    def plane(self, uv_px: F64) -> F64:
        """Map (N, 2) px to (N, 2) forward and right over down; nan where the ray does not point down."""
        r = _homogeneous(self.camera.rays(uv_px)) @ self.R_level_cam.T
        down = np.where(r[:, 2] > _MIN_DOWN * np.linalg.norm(r, axis=1), r[:, 2], np.nan)
        return np.asarray(r[:, :2] / down[:, None])

    def pixels(self, plane: F64) -> F64:
        """Map (N, 2) forward and right over down to (N, 2) px; nan behind the lens."""
        return self.camera.project(_homogeneous(np.asarray(plane, dtype=float)) @ self.R_level_cam)


class Marks(Struct, frozen=True, eq=False):
    """Image points of known places on the pad, and the modes of their errors."""

    uv_px: F64
    """Image points, (P, 2)."""
    pad_xy_m: F64
    """Places of the points on the pad, (P, 2): forward along the arrow, and to starboard."""
    modes_px: F64
    """Independent error modes, (M, P, 2), each one standard deviation large. Together they give the points' covariance."""
    yaw_known: bool = True
    yaw_ambiguous: bool = False


def point_modes(sigma_px: F64) -> F64:
    """Convert (P,) px sigmas of independent isotropic errors to the (2P, P, 2) modes of `Marks`."""
    n = len(sigma_px)
    modes = np.zeros((2 * n, n, 2))
    i = np.arange(n)
    modes[2 * i, i, 0] = sigma_px
    modes[2 * i + 1, i, 1] = sigma_px
    return modes


class Fix(Struct, frozen=True, eq=False):
    """A pose and its covariance."""

    d_body_pad_level: F64
    yaw_rad: float
    cov: F64
    """Covariance of [forward, right, down, yaw], (4, 4)."""


def solve(marks: Marks, view: OrientedCamera) -> Fix | None:
    """Solve the pose of the pad; return None if the points do not determine one.

    The points fail if a ray misses the deck or all points coincide. The covariance is the sum over all error modes (image points,
    roll and pitch, tilt of the deck) of each mode's effect on the result, to second order, evaluated at plus and minus one
    standard deviation.
    """
    camera, orientation = view.camera, view.orientation
    modes = marks.modes_px
    m, p = modes.shape[:2]
    if p < 2:
        return None
    rays = camera.rays(marks.uv_px)
    right, below = np.array([0.5, 0.0]), np.array([0.0, 0.5])
    jac_u = camera.rays(marks.uv_px + right) - camera.rays(marks.uv_px - right)
    jac_v = camera.rays(marks.uv_px + below) - camera.rays(marks.uv_px - below)
    ray_modes = modes[:, :, :1] * jac_u + modes[:, :, 1:] * jac_v

    n = 1 + 2 * (m + 4)
    all_rays = np.broadcast_to(_homogeneous(rays), (n, p, 3)).copy()
    all_rays[1 : 1 + m, :, :2] += ray_modes
    all_rays[1 + m : 1 + 2 * m, :, :2] -= ray_modes
    tilt = np.zeros((n, 4))
    k = 1 + 2 * m
    tilt_modes = _modes_of(orientation.cov_tilt)
    tilt[k : k + 2, :2], tilt[k + 2 : k + 4, :2] = tilt_modes, -tilt_modes
    tilt[k + 4 : k + 6, 2:], tilt[k + 6 : k + 8, 2:] = (
        np.eye(2) * orientation.sigma_deck_rad,
        -np.eye(2) * orientation.sigma_deck_rad,
    )
    R_level_body = _roll_pitch(orientation.roll_rad + tilt[:, 0], orientation.pitch_rad + tilt[:, 1])
    R_level_deck = _roll_pitch(tilt[:, 2], tilt[:, 3])
    out = _similarity(all_rays, R_level_body, R_level_deck, marks.pad_xy_m, camera)
    if not np.all(np.isfinite(out)):
        return None

    plus = np.concatenate([out[1 : 1 + m], out[k : k + 2], out[k + 4 : k + 6]])
    minus = np.concatenate([out[1 + m : 1 + 2 * m], out[k + 2 : k + 4], out[k + 6 : k + 8]])
    first, second = 0.5 * (plus - minus), 0.5 * (plus + minus) - out[0]
    for part in (first, second):
        part[:, 3] = np.remainder(part[:, 3] + math.pi, math.tau) - math.pi
    # A Gaussian error e moves f by first * e + second * e^2, and the mean of e^4 is 3. Tilt shortens the height only through the
    # second-order term.
    cov = first.T @ first + 3.0 * (second.T @ second)
    axis = _roll_pitch(np.array([orientation.roll_rad]), np.array([orientation.pitch_rad]))[0] @ camera.T_body_cam.R.matrix[:, 2]
    # A focal length that is too long makes the depth too large by the same share.
    away_m = camera.focal_sigma * float(axis @ out[0, :3])
    cov[:3, :3] += away_m**2 * np.outer(axis, axis)
    return Fix(out[0, :3], wrap_pi(float(out[0, 3])), 0.5 * (cov + cov.T))


def sighting(frame: Frame, method: Method, marks: Marks, fix: Fix, confidence: float, features: tuple[Feature, ...]) -> Sighting:
    """Convert a fix to a sighting. A heading that the marks do not show becomes None and carries no information."""
    cov = fix.cov.copy()
    yaw: float | None = fix.yaw_rad
    if not marks.yaw_known:
        yaw = None
        cov[3, :] = cov[:, 3] = 0.0
        cov[3, 3] = UNKNOWN_YAW_VAR
    elif marks.yaw_ambiguous and yaw is not None:
        # The thesis names the one of the two headings that lies nearer to the arrow, in (-90, 90] degrees; so does this.
        yaw = yaw if -math.pi / 2 < yaw <= math.pi / 2 else wrap_pi(yaw + math.pi)
    return Sighting(
        frame.stamp, frame.seq, method, fix.d_body_pad_level, yaw, marks.yaw_known and marks.yaw_ambiguous,
        cov, float(np.clip(confidence, 0.0, 1.0)), None, features,
    )  # fmt: skip


def _similarity(rays: F64, R_level_body: F64, R_level_deck: F64, pad_xy: F64, camera: Camera) -> F64:
    """Map (n, P, 3) rays and (n, 3, 3) orientations to (n, 4) forward, right, down, yaw; nan where no similarity exists."""
    R_deck_cam = R_level_deck.transpose(0, 2, 1) @ R_level_body @ camera.T_body_cam.R.matrix
    r = rays @ R_deck_cam.transpose(0, 2, 1)
    down = np.where(r[:, :, 2] > _MIN_DOWN * np.linalg.norm(r, axis=2), r[:, :, 2], np.nan)
    q = r[:, :, :2] / down[:, :, None]
    centre_q, centre_p = q.mean(axis=1), pad_xy.mean(axis=0)
    dq, dp = q - centre_q[:, None, :], pad_xy - centre_p
    spread = float(np.sum(dp * dp))
    if spread <= 0.0:
        return np.full((len(rays), 4), np.nan)
    a = np.sum(dq[:, :, 0] * dp[:, 0] + dq[:, :, 1] * dp[:, 1], axis=1) / spread
    b = np.sum(dq[:, :, 1] * dp[:, 0] - dq[:, :, 0] * dp[:, 1], axis=1) / spread
    scale = np.hypot(a, b)
    depth = 1.0 / np.where(scale > 1e-6, scale, np.nan)
    shift = centre_q - np.stack([a * centre_p[0] - b * centre_p[1], b * centre_p[0] + a * centre_p[1]], axis=1)
    d_cam_pad = np.concatenate([shift * depth[:, None], depth[:, None]], axis=1)
    d_level = np.einsum("nij,nj->ni", R_level_deck, d_cam_pad) + R_level_body @ camera.T_body_cam.t
    arrow = np.einsum("nij,nj->ni", R_level_deck[:, :, :2], np.stack([a, b], axis=1))
    return np.concatenate([d_level, -np.arctan2(arrow[:, 1], arrow[:, 0])[:, None]], axis=1)


def _modes_of(cov: F64) -> F64:
    """Return rows whose outer products sum to the covariance. A singular covariance is allowed."""
    values, vectors = np.linalg.eigh(cov)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))).T)


def _roll_pitch(roll: F64, pitch: F64) -> F64:
    """Return the (n, 3, 3) rotations Ry(pitch) Rx(roll)."""
    cr, sr, cp, sp, zero = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.zeros_like(roll)
    rows = [[cp, sp * sr, sp * cr], [zero, cr, -sr], [-sp, cp * sr, cp * cr]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _homogeneous(xy: F64) -> F64:
    return np.concatenate([xy, np.ones((len(xy), 1))], axis=1)


def tilt_axes(prior: Orientation) -> F64:
    """Return the (3, 2) axes in `level` about which an error of roll and of pitch turns the body."""
    return np.array([[math.cos(prior.pitch_rad), 0.0], [0.0, 1.0], [-math.sin(prior.pitch_rad), 0.0]])
