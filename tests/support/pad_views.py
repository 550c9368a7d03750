"""Rendered frames of the pad with the pose behind them, for tests of registration."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Frame
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.pad.pad import Pad
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import Light, Sensor
from sitl.camera.surroundings import Decal, Deck, Surroundings
from tests.support.pad_images import STAMP
from tests.support.plain_light import FLAT

PLAIN = Surroundings(
    Deck(length_m=12.0, width_m=12.0), decals=(Decal("green_disc", (0.0, 0.0), 10.0, 0.0, "deck", (110, 112, 115)),)
)
"""A pad on an even grey floor."""


@dataclass(frozen=True)
class RenderedView:
    """One frame and the truth behind it."""

    px: NDArray[np.uint8]
    pose: PadPose
    roll_rad: float
    pitch_rad: float
    d_body_pad_level: F64
    yaw_rad: float
    shot: Exposure

    def orientation(self, sigma_rad: float = 1e-4, sigma_deck_rad: float = 1e-5) -> Orientation:
        return Orientation(self.roll_rad, self.pitch_rad, np.eye(2) * sigma_rad**2, sigma_deck_rad, True)

    def frame(self) -> Frame:
        return Frame(STAMP, 0, self.px)


@dataclass
class Stage:
    """A camera over a pad, seeded."""

    camera: Camera
    pad: Pad
    surroundings: Surroundings = PLAIN
    light: Light = FLAT
    sensor: Sensor = field(default_factory=lambda: Sensor(exposure_s=0.0))
    seed: int = 1

    def __post_init__(self) -> None:
        self.renderer = Renderer(self.camera, self.pad, self.surroundings, self.light, self.sensor)
        self.rng = np.random.default_rng(self.seed)

    def view(
        self, height_m: float, tilt_rad: float = math.radians(1.5), deck_rad: float = 0.0, lateral: float = 0.1,
        yaw_rad: float | None = None, v_body_ned: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> RenderedView:  # fmt: skip
        """Return the camera `height_m` over the pad and up to `lateral` times that aside (at most 12 cm below a metre)."""
        rng = self.rng
        roll, pitch = rng.normal(0.0, tilt_rad, 2)
        yaw = rng.uniform(-math.pi, math.pi) if yaw_rad is None else yaw_rad
        R_ned_pad = Rotation.identity()
        if deck_rad > 0:
            R_ned_pad = Rotation.from_rpy(rng.normal(0.0, deck_rad), rng.normal(0.0, deck_rad), 0.0)
        aside = rng.uniform(-1.0, 1.0, 2) * min(lateral * height_m, 0.12 if height_m < 1.0 else math.inf)
        return self.view_from(height_m, aside, (float(roll), float(pitch), yaw), R_ned_pad, v_body_ned)

    def view_from(
        self, height_m: float, aside: F64, rpy_rad: tuple[float, float, float], R_ned_pad: Rotation | None = None,
        v_body_ned: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> RenderedView:  # fmt: skip
        """Return the camera `height_m` over the pad and `aside`, (2,) m north and east; the deck is level by default."""
        rng, (roll, pitch, yaw) = self.rng, rpy_rad
        R_ned_body = Rotation.from_rpy(*rpy_rad)
        R_ned_pad = Rotation.identity() if R_ned_pad is None else R_ned_pad
        p_pad = np.array([0.0, 0.0, -2.0])
        p_cam = p_pad + np.array([*aside, -height_m])
        mount = self.camera.T_body_cam
        p_body = p_cam - R_ned_body.matrix @ mount.t
        shot = Exposure(0.0, R_ned_body, p_body, R_ned_pad, p_pad, v_body_ned=np.array(v_body_ned))
        R_ned_cam = R_ned_body @ mount.R
        pose = PadPose(R_ned_cam.inv @ R_ned_pad, R_ned_cam.matrix.T @ (p_pad - p_cam))
        R_level_ned = Rotation.from_rpy(0.0, 0.0, yaw).inv
        arrow = (R_level_ned @ R_ned_pad).matrix[:, 0]
        heading = -math.atan2(arrow[1], arrow[0])
        px = self.renderer.render(shot, rng)
        return RenderedView(px, pose, roll, pitch, R_level_ned.matrix @ (p_pad - p_body), heading, shot)

    def start(self, view: RenderedView, off_px: float) -> PadPose:
        """Return the truth, some pixels aside, too near or too far, and turned."""
        rng, t = self.rng, view.pose.t_cam_pad
        m_per_px = float(t[2]) / self.camera.fx
        reach = min(self.pad.disc_radius_m, 0.6 * float(t[2]))
        aside = np.array([*rng.normal(0.0, off_px, 2), 0.0]) * m_per_px
        nearer = 1.0 + rng.normal(0.0, off_px) * m_per_px / reach
        turn = rng.normal(0.0, off_px) * m_per_px / reach
        return PadPose(view.pose.R_cam_pad @ Rotation.from_rpy(0.0, 0.0, turn), t * nearer + aside)


def error(pose: PadPose, true: PadPose) -> F64:
    """(6,) of place (m) and rotation (rad), in `cam`."""
    return np.concatenate([pose.t_cam_pad - true.t_cam_pad, (pose.R_cam_pad @ true.R_cam_pad.inv).rotvec_rad])


def pad_error(pose: PadPose, true: PadPose) -> tuple[F64, float]:
    """(3,) m along the pad's axes, and rad about its normal."""
    turn = (true.R_cam_pad.inv @ pose.R_cam_pad).rotvec_rad
    return true.R_cam_pad.matrix.T @ (pose.t_cam_pad - true.t_cam_pad), float(turn[2])
