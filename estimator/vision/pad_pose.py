"""The pose of the pad in camera coordinates: the result of acquisition and the start of registration."""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from msgspec.structs import force_setattr

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad


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

    def disc_px(self, camera: Camera, pad: Pad) -> float:
        """Return the radius of the pad's disc in the frame as if it faced the camera, px."""
        return camera.fx * pad.disc_radius_m / float(self.t_cam_pad[2])

    def points(self, p_pad: F64) -> F64:
        """Transform (N, 3) points from `pad` to `cam`, m."""
        return np.asarray(p_pad @ self.R_cam_pad.matrix.T + self.t_cam_pad)

    def turned(self, yaw_rad: float) -> PadPose:
        """Return the pose at the same position with the drawing turned about the pad's own z axis by `yaw_rad`."""
        return PadPose(self.R_cam_pad @ Rotation.from_rpy(0.0, 0.0, yaw_rad), self.t_cam_pad)
