"""Make courses of commanded and reported lean and descent, from which a response is identified."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from companion.guidance.law.response_fit import STEP_S, FlightCourse
from estimator.contracts.commands import Command, Lean, Velocity
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2

_GAP_S = 0.25
"""Longest time between two commands or two reports, s: between those of late cycles it is unknown what was flown."""
_SETTLING_S = 1.2
"""Time after which the response to what came before the first command is over, s."""


class Track(NamedTuple):
    """Values at instants, oldest first; nan where there is none."""

    t_s: F64
    """(n,), counted from anywhere, the same for both tracks of a course."""
    values: F64
    """(n, axes)."""


def track(rows: Sequence[tuple[float, ...]]) -> Track:
    """Return the track of rows of an instant and its values."""
    table = np.array(rows, dtype=float)
    return Track(table[:, 0], table[:, 1:])


def asked_lean(command: Command | None) -> tuple[float, float]:
    """Return the tilt that a command requests as an acceleration, m/s^2 forward and right; nan if it requests none."""
    if not isinstance(command, Lean):
        return math.nan, math.nan
    forward, right = (command.a_level + command.trim_level).tolist()
    return forward, right


def asked_descent(command: Command | None) -> float:
    """Return the vertical speed that a command requests, m/s down; nan if it requests none."""
    return float(command.v_level[2]) if isinstance(command, Lean | Velocity) else math.nan


def reported_lean(R_ned_body: Rotation) -> tuple[float, float]:
    """Return a reported tilt as the acceleration that hovering thrust gives with it, m/s^2 forward and right."""
    roll, pitch, _ = R_ned_body.rpy_rad
    return -G_M_S2 * math.tan(pitch), G_M_S2 * math.tan(roll) / math.cos(pitch)


def course_of(asked: Track, reported: Track, stamp_sigma_s: float = 0.0, drifts: int = 0) -> FlightCourse | None:
    """Return the course of two tracks from the first command on; None if they do not overlap.

    Args:
        asked: commands, at the instants of their decision.
        reported: samples, at the instants of their measurement.
        stamp_sigma_s, drifts: of the course.
    """
    if min(asked.t_s.size, reported.t_s.size) < 2:
        return None
    first, last = max(asked.t_s[0], reported.t_s[0]), min(asked.t_s[-1], reported.t_s[-1])
    n = int((last - first) / STEP_S)
    if n < 2:
        return None
    grid = first + STEP_S * np.arange(n + 1)
    y = np.column_stack([np.interp(grid[:-1], reported.t_s, one) for one in reported.values.T])
    u = _held(asked, grid)
    known = np.asarray(np.isfinite(u).all(axis=1))
    u = np.where(known[:, None], u, y)
    after = np.maximum(1, np.searchsorted(reported.t_s, grid[:-1]))
    fresh = reported.t_s[after] - reported.t_s[after - 1] <= _GAP_S
    settled = round(_SETTLING_S / STEP_S)
    since = np.arange(n) - np.maximum.accumulate(np.where(known, -1, np.arange(n)))
    return FlightCourse(u, y, known & fresh & (since > settled), stamp_sigma_s, drifts)


def joined(courses: Sequence[FlightCourse]) -> FlightCourse | None:
    """Return one course of several flights; None if there is none. Each begins with a part that is not compared."""
    if not courses:
        return None
    parts = [np.concatenate([of[k] for of in courses]) for k in range(3)]
    return courses[0]._replace(asked=parts[0], reported=parts[1], counts=parts[2])


def _held(asked: Track, grid: F64) -> F64:
    """Return the mean command over each step of a grid that ends before the last command.

    A command in the middle of a step keeps its instant.
    """
    t, length = asked.t_s, np.diff(asked.t_s)
    values = np.where((length <= _GAP_S)[:, None], asked.values[:-1], math.nan)
    area = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(np.nan_to_num(values) * length[:, None], axis=0)])
    out = np.column_stack([np.diff(np.interp(grid, t, one)) / STEP_S for one in area.T])
    missing = np.interp(grid, t, np.append(0.0, np.cumsum(np.isnan(values).any(axis=1))))
    out[np.diff(missing) > 0.0] = math.nan
    return out
