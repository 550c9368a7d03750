"""Commanded and reported motion of a vehicle in a recording, from which its response is identified."""

import itertools
import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct, field

from companion.base.mission import State
from companion.base.observer import Decision
from companion.guidance.law.response_fit import FlightCourse
from companion.guidance.law.response_watch import asked_descent, asked_lean, course_of, joined, reported_lean, track
from companion.guidance.operator.arbiter import BY_HAND
from companion.recording.reading import Recording
from estimator.contracts.commands import Command, Velocity
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, BodyVelocity, Imu

_APART_S = 5.0
"""A longer time without a command parts two flights, s."""
_STEP_MAX_S = 0.1
_ON_DECK = frozenset({State.PRESS.value, State.DOWN.value, State.LANDED.value, State.LANDED_BY_OTHERS.value})
"""Phases in which the deck holds the vehicle."""


class FlownCourses(Struct, frozen=True):
    """The courses of a recording."""

    tilt: FlightCourse | None
    climb: FlightCourse | None
    by_accelerometer: bool
    """True if the vertical speed is the integral of the accelerometer, because the vehicle reports none."""
    leans: int
    """Number of commands that request a tilt."""
    velocities: int
    """Number of commands that request a velocity over the ground."""


class _Flight(Struct):
    """One stretch of commands without a long pause."""

    asked: list[tuple[float, float, float]] = field(default_factory=list)
    down: list[tuple[float, float]] = field(default_factory=list)
    lean: list[tuple[float, float, float]] = field(default_factory=list)
    v_down: list[tuple[float, float]] = field(default_factory=list)
    a_down: list[tuple[float, float]] = field(default_factory=list)


def flown_courses(recording: Recording) -> FlownCourses:
    """Return the courses of every flight in a recording, joined."""
    flights = [_Flight()]
    sigmas: list[float] = []
    leans = velocities = 0
    commanded_s, attitude = -math.inf, None
    for event in recording.events():
        if isinstance(event, Decision):
            t = event.at * 1e-9
            # By hand the speeds are steps with long rests, through which an integrated accelerometer drifts.
            command = None if event.phase in _ON_DECK or event.phase == BY_HAND else event.command
            asked = asked_lean(command)
            leans += math.isfinite(asked[0])
            velocities += isinstance(event.command, Velocity)
            if math.isfinite(asked_descent(command)):
                if t - commanded_s > _APART_S and math.isfinite(commanded_s):
                    flights.append(_Flight())
                commanded_s = t
            _note(flights[-1], t, command)
        elif isinstance(event, Attitude):
            attitude = event.R_ned_body
            flights[-1].lean.append((event.stamp.measured_at * 1e-9, *reported_lean(attitude)))
            sigmas.append(event.stamp.sigma_s)
        elif isinstance(event, Imu) and attitude is not None:
            flights[-1].a_down.append((event.stamp.measured_at * 1e-9, float(attitude.matrix[2] @ event.f_body) + G_M_S2))
        elif isinstance(event, BodyVelocity) and float(event.cov_level[2, 2]) < 1e-3 * UNKNOWN_VAR:
            flights[-1].v_down.append((event.stamp.measured_at * 1e-9, float(event.v_level[2])))
    sigma_s = float(np.mean(sigmas)) if sigmas else 0.0
    by_accelerometer = not any(flight.v_down for flight in flights)
    tilt = [c for flight in flights if (c := _course(flight.asked, flight.lean, sigma_s, 0)) is not None]
    climb = []
    for flight in flights:
        reported = _integral(flight.a_down) if by_accelerometer else flight.v_down
        if (c := _course(flight.down, reported, sigma_s, 2 if by_accelerometer else 0)) is not None:
            climb.append(c)
    return FlownCourses(joined(tilt), joined(climb), by_accelerometer, leans, velocities)


def _note(flight: _Flight, t: float, command: Command | None) -> None:
    flight.asked.append((t, *asked_lean(command)))
    flight.down.append((t, asked_descent(command)))


def _course(
    asked: Sequence[tuple[float, ...]], reported: Sequence[tuple[float, ...]], sigma_s: float, drifts: int
) -> FlightCourse | None:
    if not asked or not reported:
        return None
    reported = sorted(reported)
    if drifts:
        # Without a command an integrated accelerometer drifts away from any possible command.
        commanded = [row[0] for row in asked if all(map(math.isfinite, row))] or [math.inf]
        asked, reported = ([row for row in rows if commanded[0] <= row[0] <= commanded[-1]] for rows in (asked, reported))
    return course_of(track(asked), track(reported), sigma_s, drifts) if asked and reported else None


def _integral(rows: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the vertical speed less an unknown drift, m/s down, of instants and accelerations; a gap adds nothing."""
    v, out = 0.0, [(rows[0][0], 0.0)] if rows else []
    for (before, a), (t, b) in itertools.pairwise(rows):
        if t - before > 0.0:
            v += 0.5 * (a + b) * min(_STEP_MAX_S, t - before)
            out.append((t, v))
    return out
