"""Places on the Earth, the local level frame about one of them, and heights by pressure.

Source: NIMA TR8350.2, Department of Defense World Geodetic System 1984, 3rd ed., chapter 3 (the ellipsoid); Hofmann-Wellenhof,
Lichtenegger and Wasle, GNSS, section 8.2 (ellipsoidal to Cartesian coordinates, local level frame); Bowring, Transformation from
spatial to geographical coordinates, Survey Review 23 (1976) 323 (the way back).
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from estimator.contracts.geometry import F64

SEMI_MAJOR_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
_E2 = FLATTENING * (2.0 - FLATTENING)
_MINOR_M = SEMI_MAJOR_M * (1.0 - FLATTENING)
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
        """Return the place of coordinates in degrees.

        Raises:
            ValueError: as for the class.
        """
        return GeoPoint(math.radians(latitude_deg), math.radians(longitude_deg), height_m)


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
