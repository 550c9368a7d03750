"""Rotations as plain (3, 3) arrays: the exponential map of SO(3), its inverse and derivatives."""

import math

import numpy as np

from estimator.contracts.geometry import F64, skew
from tests.estimator.ekf.belief import Vec3


def exp(v: F64) -> F64:
    """Return the rotation (3, 3) by the rotation vector `v` (3,), rad: the exponential map of SO(3), by Rodrigues' formula."""
    x, y, z = v.tolist()
    return rotation_by(x, y, z)


def rotation_by(x: float, y: float, z: float) -> F64:
    """Return `exp` of a rotation vector that is given in Python floats."""
    t2 = x * x + y * y + z * z
    if t2 < 1e-8:
        a, b = 1.0 - t2 / 6.0, 0.5 - t2 / 24.0
    else:
        t = math.sqrt(t2)
        a, b = math.sin(t) / t, (1.0 - math.cos(t)) / t2
    xy, xz, yz = b * x * y, b * x * z, b * y * z
    ax, ay, az = a * x, a * y, a * z
    return np.array(
        [
            [1.0 - b * (y * y + z * z), xy - az, xz + ay],
            [xy + az, 1.0 - b * (x * x + z * z), yz - ax],
            [xz - ay, yz + ax, 1.0 - b * (x * x + y * y)],
        ]
    )


def log(m: F64) -> F64:
    """Return the rotation vector (3,), rad: the inverse of `exp` for angles below pi; at pi it has one of the two signs."""
    return np.array(rotation_vector(m))


def rotation_vector(m: F64) -> Vec3:
    """Return `log` of a rotation (3, 3) in Python floats."""
    (a, b, c), (d, e, f), (g, h, i) = m.tolist()
    sx, sy, sz = 0.5 * (h - f), 0.5 * (c - g), 0.5 * (d - b)
    s = math.sqrt(sx * sx + sy * sy + sz * sz)
    cosine = 0.5 * (a + e + i - 1.0)
    if s < 1e-6:
        if cosine > 0.0:
            return sx, sy, sz
        # Near half a turn the antisymmetric part vanishes: the axis is the largest column of R + I.
        column = m + np.eye(3)
        axis = column[:, int(np.argmax(np.diag(column)))]
        x, y, z = (math.pi * axis / np.linalg.norm(axis)).tolist()
        return x, y, z
    k = math.atan2(s, cosine) / s
    return k * sx, k * sy, k * sz


def left_jacobian(v: F64) -> F64:
    """Return the left Jacobian (3, 3) of SO(3): `exp(v + dv) == exp(left_jacobian(v) @ dv) @ exp(v)` to first order in `dv`.

    Source: Sola, Deravat, Atchuthan, A micro Lie theory for state estimation in robotics, 2018, eq. 145.
    """
    x, y, z = v.tolist()
    t2 = x * x + y * y + z * z
    k = skew(v)
    if t2 < 1e-6:
        return np.asarray(np.eye(3) + 0.5 * k + (k @ k) / 6.0)
    t = math.sqrt(t2)
    return np.asarray(np.eye(3) + (1.0 - math.cos(t)) / t2 * k + (t - math.sin(t)) / (t2 * t) * (k @ k))


def heading_row(m: F64) -> F64:
    """Return the derivative (3,) of the heading of `m` with respect to a small rotation in m's outer frame."""
    c, s, down = float(m[0, 0]), float(m[1, 0]), float(m[2, 0])
    flat = max(c * c + s * s, 1e-12)
    return np.array([-down * c / flat, -down * s / flat, 1.0])


def heading(m: F64) -> float:
    """Return the heading, rad: the direction of the first axis seen from above, the yaw of `from_rpy`."""
    return math.atan2(float(m[1, 0]), float(m[0, 0]))


def about_down(angle_rad: float) -> F64:
    """Return the rotation (3, 3) by an angle about the down axis, Rz(angle)."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
