"""Rotations and vectors in plain floats."""

from __future__ import annotations

import math

Vec = tuple[float, float, float]


def where(flag: bool, yes: float, no: float) -> float:
    return yes if flag else no


def clip(x: float, low: float, high: float) -> float:
    return low if x < low else high if x > high else x


def rotation_of(q: tuple[float, float, float, float]) -> tuple[Vec, Vec, Vec]:
    """Return the rows of R_a_b for a unit Hamilton quaternion (w, x, y, z)."""
    w, x, y, z = q
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def rotate(rows: tuple[Vec, Vec, Vec], v: Vec) -> Vec:
    """Return R v."""
    a, b, c = rows
    x, y, z = v
    return (a[0] * x + a[1] * y + a[2] * z, b[0] * x + b[1] * y + b[2] * z, c[0] * x + c[1] * y + c[2] * z)


def inverse_rotate(rows: tuple[Vec, Vec, Vec], v: Vec) -> Vec:
    """Return R^T v."""
    a, b, c = rows
    x, y, z = v
    return (a[0] * x + b[0] * y + c[0] * z, a[1] * x + b[1] * y + c[1] * z, a[2] * x + b[2] * y + c[2] * z)


def cross(a: Vec, b: Vec) -> Vec:
    """Return the cross product of two vectors."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def product(p: tuple[float, float, float, float], q: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """Return the Hamilton product: q_a_c from q_a_b and q_b_c."""
    a, b, c, d = p
    w, x, y, z = q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def quaternion_of_rpy(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return the unit quaternion (w, x, y, z) of Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, sr, cp, sp = math.cos(0.5 * roll), math.sin(0.5 * roll), math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def rpy_of(rows: tuple[Vec, Vec, Vec]) -> Vec:
    """Return (roll, pitch, yaw), rad, of the rows of Rz(yaw) Ry(pitch) Rx(roll)."""
    a, b, c = rows
    return math.atan2(c[1], c[2]), math.asin(clip(-c[0], -1.0, 1.0)), math.atan2(b[0], a[0])
