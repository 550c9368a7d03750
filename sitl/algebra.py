"""Elementary functions that let one formula run over plain floats (one vehicle) and over (B,) arrays (many vehicles).

One vehicle in plain floats steps several times faster than numpy arrays of length one; a thousand vehicles need the arrays.
A formula that is written once over these functions cannot differ between the two.
"""

from __future__ import annotations

import math
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64

Num: TypeAlias = float | F64
"""A float, or a (B,) array: one number for each vehicle."""
Flag: TypeAlias = bool | NDArray[np.bool_]
Vec: TypeAlias = tuple[Num, Num, Num]


class MathBackend(Protocol):
    """Elementary functions over `Num`. `where` evaluates both branches."""

    def where(self, flag: Flag, yes: Num, no: Num) -> Num: ...
    def clip(self, x: Num, low: Num, high: Num) -> Num: ...
    def sqrt(self, x: Num) -> Num: ...
    def sin(self, x: Num) -> Num: ...
    def cos(self, x: Num) -> Num: ...
    def asin(self, x: Num) -> Num: ...
    def exp(self, x: Num) -> Num: ...
    def log(self, x: Num) -> Num: ...
    def atan2(self, y: Num, x: Num) -> Num: ...
    def no(self, flag: Flag) -> Flag: ...
    def any(self, flag: Flag) -> bool: ...


class Floats:
    """The backend for one vehicle: plain floats."""

    def where(self, flag: Flag, yes: Num, no: Num) -> Num:
        return yes if flag else no

    def clip(self, x: Num, low: Num, high: Num) -> Num:
        return low if x < low else high if x > high else x

    def sqrt(self, x: Num) -> Num:
        return math.sqrt(x)

    def sin(self, x: Num) -> Num:
        return math.sin(x)

    def cos(self, x: Num) -> Num:
        return math.cos(x)

    def asin(self, x: Num) -> Num:
        return math.asin(x)

    def exp(self, x: Num) -> Num:
        return math.exp(x)

    def log(self, x: Num) -> Num:
        return math.log(x)

    def atan2(self, y: Num, x: Num) -> Num:
        return math.atan2(y, x)

    def no(self, flag: Flag) -> Flag:
        return not flag

    def any(self, flag: Flag) -> bool:
        return bool(flag)


class Arrays:
    """The backend for many vehicles: (B,) arrays."""

    def where(self, flag: Flag, yes: Num, no: Num) -> Num:
        return np.where(flag, yes, no)

    def clip(self, x: Num, low: Num, high: Num) -> Num:
        return np.minimum(np.maximum(x, low), high)  # a third of np.clip's time at these sizes

    def sqrt(self, x: Num) -> Num:
        return np.asarray(np.sqrt(x))

    def sin(self, x: Num) -> Num:
        return np.asarray(np.sin(x))

    def cos(self, x: Num) -> Num:
        return np.asarray(np.cos(x))

    def asin(self, x: Num) -> Num:
        return np.asarray(np.arcsin(x))

    def exp(self, x: Num) -> Num:
        return np.asarray(np.exp(x))

    def log(self, x: Num) -> Num:
        return np.asarray(np.log(x))

    def atan2(self, y: Num, x: Num) -> Num:
        return np.asarray(np.arctan2(y, x))

    def no(self, flag: Flag) -> Flag:
        return np.logical_not(flag)

    def any(self, flag: Flag) -> bool:
        return bool(np.any(flag))


def rotation_of(q: tuple[Num, Num, Num, Num]) -> tuple[Vec, Vec, Vec]:
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


def product(p: tuple[Num, Num, Num, Num], q: tuple[Num, Num, Num, Num]) -> tuple[Num, Num, Num, Num]:
    """Return the Hamilton product: q_a_c from q_a_b and q_b_c."""
    a, b, c, d = p
    w, x, y, z = q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def quaternion_of_rpy(m: MathBackend, roll: Num, pitch: Num, yaw: Num) -> tuple[Num, Num, Num, Num]:
    """Return the unit quaternion (w, x, y, z) of Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, sr, cp, sp = m.cos(0.5 * roll), m.sin(0.5 * roll), m.cos(0.5 * pitch), m.sin(0.5 * pitch)
    cy, sy = m.cos(0.5 * yaw), m.sin(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def rpy_of(m: MathBackend, rows: tuple[Vec, Vec, Vec]) -> Vec:
    """Return (roll, pitch, yaw), rad, of the rows of Rz(yaw) Ry(pitch) Rx(roll)."""
    a, b, c = rows
    return m.atan2(c[1], c[2]), m.asin(m.clip(-c[0], -1.0, 1.0)), m.atan2(b[0], a[0])
