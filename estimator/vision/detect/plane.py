"""The plane that the pad is taken to lie in, at unit distance from the lens: a circle on the pad is a circle there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera import Camera
from estimator.vision.pad_pose import PadPose


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

    def met_by(self, xy: F64) -> F64:
        """Map (N, 2) rays to (N, 2) positions on the plane; nan where the ray misses it."""
        p = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) @ self.R_cam_plane
        return np.asarray(p[:, :2] / np.where(p[:, 2] > 0.15, p[:, 2], np.nan)[:, None])

    def pose(self, centre: F64, radius: float, radius_m: float) -> PadPose:
        """Return the pose of a pad whose circle of `radius_m` appears as this circle."""
        depth = radius_m / radius
        return PadPose(Rotation(self.R_cam_plane), self.R_cam_plane @ np.array([centre[0] * depth, centre[1] * depth, depth]))
