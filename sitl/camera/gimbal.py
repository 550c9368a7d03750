"""A simulated gimbal: it follows its command with a lag, swings about it, and carries the camera."""

import math

import numpy as np
from msgspec.structs import replace

from estimator.contracts.geometry import F64, Rotation
from sitl.camera.camera import Exposure
from sitl.camera.settings import GimbalSettings


class SimulatedGimbal:
    """A stabilized gimbal, advanced with the physics.

    Args:
        step_s: step of the physics.
    """

    def __init__(self, settings: GimbalSettings, step_s: float) -> None:
        self.settings = settings
        self._step_s = step_s
        self._t_s = 0.0
        self._pitch_rad = self.wanted_pitch_rad = math.radians(settings.start_pitch_deg)
        self._left = False
        self.R_ned_gimbal = Rotation.from_rpy(0.0, self._pitch_rad, 0.0)
        self.w_gimbal: F64 = np.zeros(3)
        """Angular velocity (3,) in `gimbal`, rad/s."""

    def point(self, pitch_rad: float) -> None:
        """Turn to a pitch against the horizon."""
        self.wanted_pitch_rad = pitch_rad

    def step(self, R_ned_body: Rotation) -> None:
        """Advance by one step under a vehicle of this attitude."""
        s = self.settings
        self._t_s += self._step_s
        if s.leaves_at_s and not self._left and self._t_s >= s.leaves_at_s:
            self._left = True
            self.point(0.0)
        self._pitch_rad += (self.wanted_pitch_rad - self._pitch_rad) * min(self._step_s / s.lag_s, 1.0)
        phase = math.tau * s.wander_hz * self._t_s
        swing = math.radians(s.wander_deg)
        roll, pitch, yaw = R_ned_body.rpy_rad
        tilt = Rotation.from_rpy(s.leak * roll, s.leak * pitch, 0.0)
        held = Rotation.from_rpy(0.5 * swing * math.sin(0.7 * phase + 1.0), 0.0, 0.0)
        turned = Rotation.from_rpy(0.0, 0.0, yaw) @ tilt @ held
        now = turned @ Rotation.from_rpy(0.0, self._pitch_rad + swing * math.sin(phase), 0.0)
        self.w_gimbal = (self.R_ned_gimbal.inv @ now).rotvec_rad / self._step_s
        self.R_ned_gimbal = now

    def turned(self, shot: Exposure, p_body_cam: F64) -> Exposure:
        """Return the scene for a camera that is fixed on the gimbal's last axis.

        The body that the renderer knows is the gimbal, with the camera's place where the vehicle has it.

        Args:
            p_body_cam: the camera's place on vehicle and gimbal, (3,) m.
        """
        arm_ned, w_ned = shot.R_ned_body @ p_body_cam, shot.R_ned_body @ shot.w_body
        back_ned = self.R_ned_gimbal @ p_body_cam
        return replace(
            shot,
            R_ned_body=self.R_ned_gimbal,
            p_body_ned=shot.p_body_ned + arm_ned - back_ned,
            v_body_ned=shot.v_body_ned + np.cross(w_ned, arm_ned) - np.cross(self.R_ned_gimbal @ self.w_gimbal, back_ned),
            w_body=self.w_gimbal,
        )
