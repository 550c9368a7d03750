"""Rotations and rigid transforms between named frames, places on the Earth, and heights by pressure.

Frames: `ned` local level north-east-down; `body` forward-right-down; `level` body without roll and pitch, same heading;
`cam` x right, y down, z forward; `gimbal` x ahead through the lens, y right, z down in the image; `pad` x along the arrow, y to
starboard of it, z into the deck.
A value called `R_a_b` or `T_a_b` takes coordinates of b to a, so neighbours cancel: `R_ned_cam = R_ned_body @ R_body_cam`.

Source: NIMA TR8350.2, Department of Defense World Geodetic System 1984, 3rd ed., chapter 3 (the ellipsoid); Hofmann-Wellenhof,
Lichtenegger and Wasle, GNSS, section 8.2 (ellipsoidal to Cartesian coordinates, local level frame); Bowring, Transformation from
spatial to geographical coordinates, Survey Review 23 (1976) 323 (the way back).
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from typing import overload

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike, NDArray

F64 = NDArray[np.float64]
_THRICE = 3.0 * np.eye(3)
DOUBLE = np.dtype(np.float64)
_TWO, _THREE, _NINE = struct.Struct("2d"), struct.Struct("3d"), struct.Struct("9d")
_new, _set = object.__new__, object.__setattr__
SEMI_MAJOR_M = 6_378_137.0  # Semi-major axis of the ellipsoid of WGS 84
FLATTENING = 1.0 / 298.257223563  # Flattening of the ellipsoid of WGS 84
_E2 = FLATTENING * (2.0 - FLATTENING)  # Square of its first eccentricity
_MINOR_M = SEMI_MAJOR_M * (1.0 - FLATTENING)  # Its semi-minor axis


def wrap_pi(angle_rad: float) -> float:
    """Return the same angle in (-pi, pi]; nan and infinities give nan."""
    if not math.isfinite(angle_rad):
        return math.nan
    wrapped = math.remainder(angle_rad, math.tau)
    return math.pi if wrapped == -math.pi else wrapped


def rotated(v: F64, angle_rad: float) -> F64:
    """Return a vector of the level plane, (2,), turned clockwise seen from above.

    By a body's heading, forward and right of it become north and east.
    """
    return np.array(rotated_xy(v, angle_rad))


def rotated_xy(v: F64, angle_rad: float) -> tuple[float, float]:
    """Return the two numbers of `rotated`, for what comes hundreds of times a second."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    x, y = v.tolist()[:2]
    return c * x - s * y, s * x + c * y


def skew(v: ArrayLike) -> F64:
    """(3, 3) matrix of the cross product: `skew(a) @ b == np.cross(a, b)`."""
    x, y, z = np.asarray(v, dtype=float)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def fixed_vector(x: float, y: float, z: float) -> F64:
    """Return a read-only array, (3,), for samples that come hundreds of times a second. `np.array` takes three times as long."""
    return np.frombuffer(_THREE.pack(x, y, z))


def fixed_pair(x: float, y: float) -> F64:
    """Return a read-only array, (2,); as `fixed_vector`."""
    return np.frombuffer(_TWO.pack(x, y))


def fixed_matrix(*rows: float) -> F64:
    """Return a read-only array, (3, 3), of nine numbers, row by row; as `fixed_vector`."""
    return np.ndarray((3, 3), DOUBLE, _NINE.pack(*rows))


def own_array(value: F64) -> F64:
    """Return the numbers as a read-only array that nobody else can write to: the value itself if it is one, else a copy."""
    if type(value) is np.ndarray and value.dtype is DOUBLE:
        base: object = value.base
        if type(base) is bytes:  # nobody can write to these
            return value
        if not value.flags.writeable:
            while type(base) is np.ndarray and not base.flags.writeable:
                base = base.base
            if base is None or type(base) is bytes:
                return value
    a = np.array(value, dtype=float)
    a.setflags(write=False)
    return a


def rpy_matrix(roll_rad: float, pitch_rad: float, yaw_rad: float) -> F64:
    """Return Rz(yaw) Ry(pitch) Rx(roll), (3, 3) and read-only. `Rotation.from_rpy` is the checked form.

    Source: Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., eq. 2.31.
    """
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    return fixed_matrix(
        cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,
        sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,
        -sp, cp * sr, cp * cr,
    )  # fmt: skip


def orthonormalised(m: F64) -> F64:
    """Return (3, 3) after one Newton step towards the nearest rotation, which stops drift over long products (Higham 1986)."""
    return np.asarray(0.5 * m.dot(_THRICE - m.T.dot(m)))


@dataclass(frozen=True, slots=True, eq=False)
class Rotation:
    """A proper rotation matrix, checked once. `R_a_b @ v_b` gives v_a for (3,) and (N, 3) arrays alike.

    Raises:
        ValueError: not (3, 3), not finite, not orthonormal to 1e-6, or a reflection.
    """

    matrix: F64
    _rpy_rad: tuple[float, float, float] | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        m = np.array(self.matrix, dtype=float)
        if m.shape != (3, 3):
            raise ValueError(f"a rotation needs a finite (3, 3) matrix, got shape {m.shape}")
        # In plain numbers: numpy's calls on nine of them take ten times as long, and there are many rotations.
        (a, b, c), (d, e, f), (g, h, i) = m.tolist()
        if not math.isfinite(a + b + c + d + e + f + g + h + i):
            raise ValueError(f"a rotation needs a finite (3, 3) matrix, got shape {m.shape}")
        off = (
            a * a + b * b + c * c - 1.0, d * d + e * e + f * f - 1.0, g * g + h * h + i * i - 1.0,
            a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i,
        )  # fmt: skip
        if max(off) > 1e-6 or min(off) < -1e-6 or a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g) < 0.0:
            raise ValueError("a rotation matrix must be orthonormal with determinant +1")
        m.setflags(write=False)
        object.__setattr__(self, "matrix", m)

    @staticmethod
    def identity() -> Rotation:
        return Rotation(np.eye(3))

    @staticmethod
    def from_rpy(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Rotation:
        """Rz(yaw) Ry(pitch) Rx(roll), the aerospace sequence: `R_ned_body` from Euler angles.

        Source: Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., eq. 2.31.
        """
        m = rpy_matrix(roll_rad, pitch_rad, yaw_rad)
        return _rotation_by(m) if math.isfinite(roll_rad + pitch_rad + yaw_rad) else Rotation(m)

    @staticmethod
    def from_rotvec(rotvec_rad: ArrayLike) -> Rotation:
        """Return the rotation by an axis times an angle in radians (Rodrigues; the exponential map of SO(3)).

        Raises:
            ValueError: not three numbers, or not finite.
        """
        x, y, z = np.asarray(rotvec_rad, dtype=float).tolist()
        angle = math.hypot(x, y, z)
        if not math.isfinite(angle):
            raise ValueError(f"a rotation needs a finite axis times angle, got {rotvec_rad!r}")
        a = 1.0 - angle**2 / 6.0 if angle < 1e-4 else math.sin(angle) / angle
        b = 0.5 - angle**2 / 24.0 if angle < 1e-4 else (1.0 - math.cos(angle)) / angle**2
        xx, yy, zz, xy, xz, yz = b * x * x, b * y * y, b * z * z, b * x * y, b * x * z, b * y * z
        ax, ay, az = a * x, a * y, a * z
        return _rotation_by(
            fixed_matrix(1.0 - yy - zz, xy - az, xz + ay, xy + az, 1.0 - xx - zz, yz - ax, xz - ay, yz + ax, 1.0 - xx - yy)
        )

    @staticmethod
    def from_quat(wxyz: ArrayLike) -> Rotation:
        """Return the rotation of a Hamilton quaternion (w, x, y, z) of any positive length.

        Raises:
            ValueError: zero or not finite.
        """
        given = np.asarray(wxyz, dtype=float)
        w, x, y, z = q = given.tolist() if given.shape == (4,) else (0.0,) * 4
        n = math.hypot(w, x, y, z)
        if not math.isfinite(n) or n < 1e-9:
            raise ValueError(f"not a quaternion: {wxyz!r}")
        w, x, y, z = (part / n for part in q)
        return _rotation_by(
            fixed_matrix(
                1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
                2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
            )
        )  # fmt: skip

    @property
    def inv(self) -> Rotation:
        return known_rotation(self.matrix.T)

    @property
    def rpy_rad(self) -> tuple[float, float, float]:
        """(roll, pitch, yaw) of `from_rpy`; pitch in [-pi/2, pi/2]; at the gimbal lock roll is given as 0."""
        found = self._rpy_rad
        if found is None:
            # Kept, because everybody who takes an attitude requests it.
            (a, b, _), (d, e, _), (g, h, i) = self.matrix.tolist()
            pitch = math.asin(-g if -1.0 <= g <= 1.0 else math.copysign(1.0, -g))
            locked = abs(g) > 1.0 - 1e-12
            found = (0.0, pitch, math.atan2(-b, e)) if locked else (math.atan2(h, i), pitch, math.atan2(d, a))
            object.__setattr__(self, "_rpy_rad", found)
        return found

    @property
    def rotvec_rad(self) -> F64:
        """(3,) axis times angle, angle in [0, pi]; the inverse of `from_rotvec`."""
        w, x, y, z = self._quat()
        s = math.sqrt(x * x + y * y + z * z)
        scale = 2.0 if s < 1e-9 else 2.0 * math.atan2(s, w) / s
        return np.array([x * scale, y * scale, z * scale])

    @property
    def quat_wxyz(self) -> F64:
        """(4,) unit Hamilton quaternion with w >= 0 (Shepperd's choice of the largest component)."""
        return np.array(self._quat())

    def _quat(self) -> tuple[float, float, float, float]:
        (a, b, c), (d, e, f), (g, h, i) = self.matrix.tolist()
        t = a + e + i
        largest = max(t, a, e, i)
        if largest == t:
            w, x, y, z = 1 + t, h - f, c - g, d - b
        elif largest == a:
            w, x, y, z = h - f, 1 + 2 * a - t, b + d, c + g
        elif largest == e:
            w, x, y, z = c - g, b + d, 1 + 2 * e - t, f + h
        else:
            w, x, y, z = d - b, c + g, f + h, 1 + 2 * i - t
        size = math.copysign(math.sqrt(w * w + x * x + y * y + z * z), w)
        return w / size, x / size, y / size, z / size

    def without_heading(self) -> Rotation:
        """`R_level_body` of an `R_ned_body`: the same roll and pitch, yaw taken out."""
        roll, pitch, _ = self.rpy_rad
        return Rotation.from_rpy(roll, pitch, 0.0)

    @overload
    def __matmul__(self, other: Rotation) -> Rotation: ...
    @overload
    def __matmul__(self, other: F64) -> F64: ...
    def __matmul__(self, other: Rotation | F64) -> Rotation | F64:
        if isinstance(other, Rotation):
            return known_rotation(orthonormalised(self.matrix.dot(other.matrix)))
        return np.asarray(other @ self.matrix.T)

    def rotate_cov(self, cov_b: F64) -> F64:
        """(3, 3) covariance of b written in a."""
        return np.asarray(self.matrix @ cov_b @ self.matrix.T)

    def angle_to(self, other: Rotation) -> float:
        """Angle in radians of the rotation between the two."""
        return float(np.linalg.norm((self.inv @ other).rotvec_rad))


def known_rotation(matrix: F64) -> Rotation:
    """Return the rotation of a matrix that is one because it was made of checked ones. Nobody writes to the array any more."""
    matrix.setflags(write=False)
    return _rotation_by(matrix)


def _rotation_by(matrix: F64) -> Rotation:
    """Return the rotation of a read-only matrix that is known to be a rotation."""
    made = _new(Rotation)
    _set(made, "matrix", matrix)
    _set(made, "_rpy_rad", None)
    return made


@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """A rigid transform `T_a_b`: `p_a = R_a_b @ p_b + p_b_origin_a`.

    Raises:
        ValueError: a translation that is not a finite (3,) vector.
    """

    R: Rotation
    t: F64
    """(3,) m, the origin of b written in a."""

    def __post_init__(self) -> None:
        t = np.array(self.t, dtype=float)
        if t.shape != (3,) or not np.all(np.isfinite(t)):
            raise ValueError(f"a translation needs a finite (3,) vector, got {self.t!r}")
        t.setflags(write=False)
        object.__setattr__(self, "t", t)

    @staticmethod
    def identity() -> Transform:
        return Transform(Rotation.identity(), np.zeros(3))

    @property
    def inv(self) -> Transform:
        r = self.R.inv
        return Transform(r, -(r @ self.t))

    @overload
    def __matmul__(self, other: Transform) -> Transform: ...
    @overload
    def __matmul__(self, other: F64) -> F64: ...
    def __matmul__(self, other: Transform | F64) -> Transform | F64:
        if isinstance(other, Transform):
            return Transform(self.R @ other.R, self.R @ other.t + self.t)
        return np.asarray(self.R @ other + self.t)


_HEIGHT_M = (-1_000.0, 20_000.0)


class GeoPoint(Struct, frozen=True):
    """A place in WGS-84.

    Raises:
        ValueError: a coordinate is not finite or does not exist, or the height is not one of a ship or an aircraft.
    """

    latitude_rad: float
    longitude_rad: float
    height_m: float | None = None
    """Height above mean sea level; None if unknown."""

    def __post_init__(self) -> None:
        if not (abs(self.latitude_rad) <= 0.5 * math.pi and abs(self.longitude_rad) <= math.pi):
            raise ValueError(f"no such place: {self.latitude_rad} and {self.longitude_rad} rad")
        if self.height_m is not None and not _HEIGHT_M[0] <= self.height_m <= _HEIGHT_M[1]:
            raise ValueError(f"no height of a ship or an aircraft: {self.height_m} m")

    @staticmethod
    def of_degrees(latitude_deg: float, longitude_deg: float, height_m: float | None = None) -> GeoPoint:
        """Return the place of coordinates in degrees. A longitude may count on beyond 180, up to a whole turn.

        A sender whose 181 means "unknown", as that of AIS does, has to be understood before.

        Raises:
            ValueError: as for the class.
        """
        beyond = 180.0 < abs(longitude_deg) <= 360.0
        longitude_rad = math.radians(longitude_deg)
        return GeoPoint(math.radians(latitude_deg), wrap_pi(longitude_rad) if beyond else longitude_rad, height_m)

    @staticmethod
    def reported(latitude_deg: float, longitude_deg: float, height_m: float | None) -> GeoPoint:
        """Return the place that a sensor reports, without its height where that cannot be.

        Raises:
            ValueError: there is no such place.
        """
        usable = height_m is not None and _HEIGHT_M[0] <= height_m <= _HEIGHT_M[1]
        return GeoPoint.of_degrees(latitude_deg, longitude_deg, height_m if usable else None)


def ned_between(origin: GeoPoint, there: GeoPoint) -> F64:
    """Return the vector from one place to another in the local level frame of the first, (3,) m north, east, down.

    A height that one of the two does not know counts as that of the other. Heights above mean sea level stand for those above
    the ellipsoid, whose distance from it is nearly the same for both places.
    """
    at_m, there_m = origin.height_m, there.height_m
    at_m, there_m = (at_m if at_m is not None else there_m or 0.0), (there_m if there_m is not None else at_m or 0.0)
    return _level(origin).T @ (_cartesian(there, there_m) - _cartesian(origin, at_m))


def moved(origin: GeoPoint, d_ned: F64) -> GeoPoint:
    """Return the place that lies `d_ned`, (3,) m, from another in the local level frame of that one."""
    p = _cartesian(origin, origin.height_m or 0.0) + _level(origin) @ np.asarray(d_ned, dtype=float)
    x, y, z = p.tolist()
    across = math.hypot(x, y)
    beta = math.atan2(z * SEMI_MAJOR_M, across * _MINOR_M)
    lat = math.atan2(z + _E2 / (1.0 - _E2) * _MINOR_M * math.sin(beta) ** 3, across - _E2 * SEMI_MAJOR_M * math.cos(beta) ** 3)
    normal = SEMI_MAJOR_M / math.sqrt(1.0 - _E2 * math.sin(lat) ** 2)
    height = across * math.cos(lat) + z * math.sin(lat) - SEMI_MAJOR_M**2 / normal
    return GeoPoint(lat, math.atan2(y, x), None if origin.height_m is None else height)


def _cartesian(at: GeoPoint, height_m: float) -> F64:
    s, c = math.sin(at.latitude_rad), math.cos(at.latitude_rad)
    normal = SEMI_MAJOR_M / math.sqrt(1.0 - _E2 * s * s)
    across = (normal + height_m) * c
    return np.array(
        [across * math.cos(at.longitude_rad), across * math.sin(at.longitude_rad), (normal * (1.0 - _E2) + height_m) * s]
    )


def _level(at: GeoPoint) -> F64:
    """Return the axes north, east and down as columns in Earth-fixed Cartesian coordinates, (3, 3)."""
    s, c = math.sin(at.latitude_rad), math.cos(at.latitude_rad)
    sl, cl = math.sin(at.longitude_rad), math.cos(at.longitude_rad)
    return np.array([[-s * cl, -sl, -c * cl], [-s * sl, cl, -c * sl], [c, 0.0, -s]])


def height_of_pressure_m(pressure_pa: float) -> float:
    """Return the pressure altitude in metres, by the troposphere of the international standard atmosphere (ISO 2533)."""
    return float(44330.77 * (1.0 - (pressure_pa / 101325.0) ** 0.190263))


def pressure_of_height_pa(height_m: float) -> float:
    """Return the pressure at a pressure altitude, Pa: the inverse of `height_of_pressure_m`."""
    return float(101325.0 * (1.0 - height_m / 44330.77) ** (1.0 / 0.190263))
