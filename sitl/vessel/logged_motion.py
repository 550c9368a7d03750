"""The motion of a boat in a log of NMEA 0183 sentences: places of an RTK receiver (GGA) and headings (HDT).

Such a log holds no roll and no pitch. Its height is the heave of the antenna, with the receiver's noise of about a centimetre.
"""

import math
from pathlib import Path

import numpy as np

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64

_EARTH_M = 6_371_000.0
_RTK = "4"
"""Quality of a place that is known to centimetres."""
_GAP_S = 2.0
_DAY_S = 86400.0


def read_log(path: Path, smooth_s: float) -> tuple[F64, F64]:
    """Return times (N,) from 0, s, and motion (N, 6): m north, east and down, and roll, pitch (both 0) and heading, rad.

    The longest stretch without a gap of two seconds is taken; places are about its mean.

    Args:
        smooth_s: standard deviation of a Gaussian over time that takes the receiver's noise away; 0 leaves it.

    Raises:
        BadInput: the file cannot be read, or has no such stretch of 10 s.
    """
    try:
        lines = path.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError as why:
        raise BadInput(f"{path}: not readable: {why}") from why
    places, headings, t_s = [], [], math.nan
    for line in lines:
        kind, _, rest = line.partition(",")
        cells = rest.partition("*")[0].split(",")
        try:
            if kind.endswith("GGA") and cells[5] == _RTK:
                t_s = _seconds(cells[0])
                north, east = _degrees(cells[1], cells[2]), _degrees(cells[3], cells[4])
                places.append((t_s, north, east, float(cells[8]) + float(cells[10] or 0.0)))
            elif kind.endswith("HDT") and math.isfinite(t_s):
                headings.append((t_s, math.radians(float(cells[0]))))
        except (ValueError, IndexError):
            continue  # a torn line
    stretch = _longest(np.array(places, float).reshape(-1, 4))
    if len(stretch) < 2 or stretch[-1, 0] - stretch[0, 0] < 10.0:
        raise BadInput(f"{path}: no 10 s of RTK places (GGA of quality 4) without a gap of {_GAP_S:g} s")
    t = stretch[:, 0] - stretch[0, 0]
    lat, lon = np.radians(stretch[:, 1]), np.radians(stretch[:, 2])
    eta = np.zeros((len(t), 6))
    eta[:, 0] = _EARTH_M * (lat - lat.mean())
    eta[:, 1] = _EARTH_M * math.cos(float(lat.mean())) * (lon - lon.mean())
    eta[:, 2] = -(stretch[:, 3] - stretch[:, 3].mean())
    if headings:
        at, heading = np.array(headings).T
        eta[:, 5] = np.interp(stretch[:, 0], at, np.unwrap(heading))
    return (t, eta) if smooth_s == 0.0 else _smoothed(t, eta, smooth_s)


def _seconds(hhmmss: str) -> float:
    return 3600.0 * int(hhmmss[:2]) + 60.0 * int(hhmmss[2:4]) + float(hhmmss[4:])


def _degrees(text: str, side: str) -> float:
    point = text.index(".")
    degrees = int(text[: point - 2]) + float(text[point - 2 :]) / 60.0
    return -degrees if side in ("S", "W") else degrees


def _longest(rows: F64) -> F64:
    """Return the longest stretch of ascending times without a gap."""
    if not len(rows):
        return rows
    rows = rows.copy()
    rows[:, 0] += _DAY_S * np.concatenate([[0], np.cumsum(np.diff(rows[:, 0]) < -0.5 * _DAY_S)])
    rows = rows[np.concatenate([[True], np.diff(rows[:, 0]) > 0.0])]
    cuts = np.flatnonzero(~((np.diff(rows[:, 0]) > 0.0) & (np.diff(rows[:, 0]) <= _GAP_S))) + 1
    return max(np.split(rows, cuts), key=len)


def _smoothed(t: F64, eta: F64, smooth_s: float) -> tuple[F64, F64]:
    """Return the motion at even times, averaged by a Gaussian."""
    step_s = float(np.median(np.diff(t)))
    even = np.arange(0.0, t[-1], step_s)
    reach = max(1, math.ceil(4.0 * smooth_s / step_s))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step_s / smooth_s) ** 2)
    kernel /= kernel.sum()
    columns = [np.pad(np.interp(even, t, column), reach, mode="reflect") for column in eta.T]
    return even, np.stack([np.convolve(column, kernel, mode="valid") for column in columns], axis=1)
