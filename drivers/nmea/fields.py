"""The fields of sentences as checked numbers, with the step of their last digit."""

import datetime
import math
import re
from decimal import Decimal
from typing import Any

import numpy as np

from estimator.contracts.geometry import F64, GeoPoint
from estimator.contracts.time import NS_PER_S

KNOT_M_S = 1852.0 / 3600.0
"""One knot, m/s."""
SPEED_MAX_KN = 102.0
"""Faster is no ship: the largest speed that AIS can state."""
COURSE_FROM_M_S = 0.3
"""Speed below which a receiver may leave the course out."""
_MINUTE_M = 1852.0
"""Length of a minute of latitude."""
_PLAIN = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:E[-+]?\d{1,2})?", re.ASCII | re.IGNORECASE)


class Refused(Exception):
    """A sentence is not taken; the text is the name of the counter."""


def checked(sentence: str) -> bool:
    """Return whether a sentence begins as one and ends with the exclusive-or of what lies between."""
    body, star, digits = sentence[1:].rpartition("*")
    if sentence[:1] not in ("$", "!") or not star or len(digits) != 2:
        return False
    check = 0
    for letter in body:
        check ^= ord(letter)
    return f"{check:02X}" == digits.upper()


def text(m: Any, where: int | str) -> str:
    """Return a field by its index or by pynmea2's name of it, empty where an older version of the standard does not have it."""
    index = type(m).name_to_idx[where] if isinstance(where, str) else where
    return str(m.data[index]).strip() if len(m.data) > index else ""


def number(value: object) -> float:
    """Return a field as a finite number.

    Raises:
        Refused: it is none, or left out.
    """
    try:
        found = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise Refused("malformed") from None
    if not math.isfinite(found):
        raise Refused("impossible")
    if isinstance(value, str) and not _PLAIN.fullmatch(value):
        raise Refused("malformed")  # Python's own notations, as 1_0
    return found


def within(cell: str, low: float, high: float) -> float | None:
    """Return a field that lies in a range, None where it is empty.

    Raises:
        Refused: it is no number, or out of range.
    """
    if not cell:
        return None
    found = number(cell)
    if not low <= found <= high:
        raise Refused("impossible")
    return found


def rounding(cell: str, unit: float = 1.0) -> float:
    """Return the standard deviation that rounding to the last digit of a number leaves, times its unit."""
    exponent = Decimal(cell).as_tuple().exponent
    return unit * 10.0 ** int(exponent) / math.sqrt(12.0)


def heading_deg(cell: str, reference: str = "T") -> float:
    """Return a true heading.

    Raises:
        Refused: it is empty, magnetic, no number or none of a compass.
    """
    found = within(cell, 0.0, 360.0)
    if found is None:
        raise Refused("no_heading")
    if reference != "T":
        raise Refused("impossible")
    return found


def time_ns(value: object) -> int:
    """Return the time of day, nanoseconds.

    Raises:
        Refused: it is left out or none.
    """
    if not isinstance(value, datetime.time):
        raise Refused("malformed")
    return (value.hour * 3600 + value.minute * 60 + value.second) * NS_PER_S + value.microsecond * 1000


def place(m: Any, height_m: float | None = None) -> tuple[GeoPoint, float]:
    """Return the place of a sentence, and the standard deviation that its digits leave, metres.

    Raises:
        Refused: there is no such place, or a part of it is left out.
    """
    for cell in (m.lat, m.lon):
        if cell and number(cell) % 100.0 >= 60.0:
            raise Refused("impossible")  # minutes of arc
    if m.lat_dir not in ("N", "S") or m.lon_dir not in ("E", "W") or not m.lat or not m.lon:
        raise Refused("malformed")
    if number(m.lat) == number(m.lon) == 0.0:
        raise Refused("no_fix")  # what a receiver that has none sends in its place
    try:
        found = GeoPoint.reported(float(m.latitude), float(m.longitude), height_m)
    except ValueError:
        raise Refused("impossible") from None
    return found, max(rounding(m.lat, _MINUTE_M), rounding(m.lon, _MINUTE_M * math.cos(found.latitude_rad)))


def velocity(speed_kn: object, course_deg: object) -> F64 | None:
    """Return the velocity over the ground, (3,) m/s in ned; None if a ship that moves reports no course.

    Raises:
        Refused: the speed is left out, or no ship's.
    """
    speed = KNOT_M_S * number(speed_kn)
    if not 0.0 <= speed <= KNOT_M_S * SPEED_MAX_KN:
        raise Refused("impossible")
    if course_deg in (None, ""):
        return np.zeros(3) if speed < COURSE_FROM_M_S else None
    course = math.radians(number(course_deg))
    if not 0.0 <= course <= 2.0 * math.pi:
        raise Refused("impossible")
    return np.array([speed * math.cos(course), speed * math.sin(course), 0.0])
