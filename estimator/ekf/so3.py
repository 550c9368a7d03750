"""Rotations as plain (3, 3) arrays, where the checks of `Rotation` cost too much."""

import math

import numpy as np

from estimator.contracts.geometry import F64

Vec3 = tuple[float, float, float]
"""A vector in Python floats: numpy's calls on three numbers take several times as long."""


def heading(m: F64) -> float:
    """Return the heading, rad: the direction of the first axis seen from above, the yaw of `from_rpy`."""
    return math.atan2(float(m[1, 0]), float(m[0, 0]))


def about_down(angle_rad: float) -> F64:
    """Return the rotation (3, 3) by an angle about the down axis, Rz(angle)."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
