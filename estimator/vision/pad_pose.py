"""Where the pad is in the camera's own coordinates: what acquisition hands over and registration starts from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimator.contracts.geometry import F64, Rotation


@dataclass(frozen=True, slots=True, eq=False)
class PadPose:
    """The pad in `cam`: `p_cam = R_cam_pad @ p_pad + t_cam_pad`.

    Raises:
        ValueError: a place that is not a finite (3,) vector.
    """

    R_cam_pad: Rotation
    t_cam_pad: F64
    """(3,) m, the pad's centre."""

    def __post_init__(self) -> None:
        t = np.array(self.t_cam_pad, dtype=float)
        if t.shape != (3,) or not np.isfinite(t).all():
            raise ValueError(f"t_cam_pad needs a finite (3,) vector, got {self.t_cam_pad!r}")
        t.setflags(write=False)
        object.__setattr__(self, "t_cam_pad", t)

    @property
    def range_m(self) -> float:
        """Distance from the lens to the pad's centre."""
        return float(np.linalg.norm(self.t_cam_pad))

    def points(self, p_pad: F64) -> F64:
        """(N, 3) m in `pad` to (N, 3) m in `cam`."""
        return np.asarray(p_pad @ self.R_cam_pad.matrix.T + self.t_cam_pad)

    def turned(self, yaw_rad: float) -> PadPose:
        """The same place, the drawing turned about the pad's own z axis."""
        return PadPose(self.R_cam_pad @ Rotation.from_rpy(0.0, 0.0, yaw_rad), self.t_cam_pad)
