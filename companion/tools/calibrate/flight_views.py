"""A recorded flight for its calibration: poses of the pad, rotation by the gyro, attitude, commanded and reported motion."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from msgspec import Struct, field

from companion.base.mission import State
from companion.base.observer import Decision
from companion.guidance.law.flown_course import asked_descent, asked_lean, course_of, joined, reported_lean, track
from companion.guidance.law.response_fit import FlightCourse
from companion.guidance.operator.arbiter import BY_HAND
from companion.recording.reading import RecordedFrame, Recording
from companion.settings.model import VisionSettings
from estimator.contracts.commands import Command, Velocity
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64, skew
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, BodyVelocity, GimbalAttitude, Imu
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation, tilt_axes

_APART_S = 5.0
"""A longer time without a command parts two flights, s."""
_STEP_MAX_S = 0.1  # longest step over which a velocity is integrated
_ON_DECK = frozenset({State.PRESS.value, State.DOWN.value, State.LANDED.value, State.LANDED_BY_OTHERS.value})
"""Phases in which the deck holds the vehicle."""
GYRO_RATE_LEAST_HZ = 40.0
"""Rate of the gyro that a calibration needs (docs/cameras.md)."""
TILT_SIGMA_MAX_RAD = math.radians(2.0)
"""A pose whose tilt is known worse than this says nothing of the mount."""
_NEIGHBOURS_S = 0.25
"""Longest time between the frames before and after a view whose rate of place is used."""
VIEWS_LEAST = 100
"""Views that a calibration needs."""
VIEWS_MOST = 600
"""Views that are used. More of a minute add hardly anything: the errors of neighbours are alike."""
_STEPS = 30  # steps of the search at most
_SAME = 1e-13  # change of a step that ends it


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


@dataclass(frozen=True, slots=True, eq=False)
class FlightViews:
    """The recorded flight as arrays; instants are seconds after the first sample of the gyro."""

    camera: Camera
    """The camera that the flight was recorded with."""
    t: F64
    """(N,) s, stamps of the sightings."""
    R_cam_pad: F64
    """(N, 3, 3)."""
    t_cam_pad: F64
    """(N, 3) m."""
    cov: F64
    """(N, 3, 3) rad^2, of a small rotation of the pad written in `cam`."""
    t_gyro: F64
    """(G,) s."""
    w_body: F64
    """(G, 3) rad/s."""
    t_attitude: F64
    """(A,) s."""
    R_ned_body: F64
    """(A, 3, 3)."""
    sigma_tilt_rad: float
    """Standard deviation of roll and pitch as the attitude's source claims it."""
    stamps_ns: tuple[int, ...] = ()
    """Stamps of the sightings, as recorded; empty for views that no recording holds."""
    speed_cam: F64 | None = None
    """(N, 3) m/s, rate of `t_cam_pad`; nan where the frames before and after do not show the pad."""
    readout_s: float = 0.0
    """The readout time that the poses are those of; in a recording it is the camera's."""
    by_readout: F64 | None = None
    """(N, 3) rad/s in `cam`: how a pose turns with each second of readout more; None if that is not known."""


def flight_views(recording: Recording) -> FlightViews:
    """Read a recording.

    Raises:
        BadInput: it does not hold its camera and settings, too few poses of the pad, no attitude, or a gyro that is too slow.
    """
    camera = recording.camera()
    if camera is None:
        raise BadInput(f"{recording.name}: does not hold its camera; record the flight with decklander")
    settings = recording.settings()
    sigma_deck_rad = (VisionSettings() if settings is None else settings.vision).deck_tilt_sigma_rad
    seen: dict[float, tuple[F64, F64, F64]] = {}
    measured: set[int] = set()
    gyro: dict[float, F64] = {}
    attitude: dict[float, F64] = {}
    tilt_var: list[float] = []
    for event in recording.events():
        if isinstance(event, RecordedFrame):
            detection, levelled_by = event.detection(), event.attitude
            sighting = None if detection is None else detection.methods.get("registration")
            if sighting is None or levelled_by is None or sighting.yaw_ambiguous or sighting.yaw_rad is None:
                continue
            pose = camera_pose(sighting, camera, Orientation.of(levelled_by, sigma_deck_rad))
            if pose is not None and float(np.diag(pose.cov)[3:].max()) < TILT_SIGMA_MAX_RAD**2:
                measured.add(int(event.stamp.measured_at))
                seen[event.stamp.measured_at * 1e-9] = pose.R_cam_pad, pose.t_cam_pad, pose.cov[3:, 3:]
        elif isinstance(event, GimbalAttitude):
            raise BadInput(f"{recording.name}: its camera hangs on a gimbal, which has no mount to calibrate")
        elif isinstance(event, Imu):
            gyro[event.stamp.measured_at * 1e-9] = event.w_body
        elif isinstance(event, Attitude):
            attitude[event.stamp.measured_at * 1e-9] = event.R_ned_body.matrix
            tilt_var.append(float(event.cov_body[0, 0]))
    _check(recording.name, len(seen), sorted(gyro), len(attitude))
    t0 = min(gyro)
    t, poses = _sorted(seen, t0)
    t_gyro, w = _sorted(gyro, t0)
    t_attitude, R = _sorted(attitude, t0)
    inside = (t > max(t_gyro[0], t_attitude[0]) + 0.3) & (t < min(t_gyro[-1], t_attitude[-1]) - 0.3)
    kept = np.flatnonzero(inside)
    kept = kept[:: max(1, math.ceil(kept.size / VIEWS_MOST))]
    if kept.size < VIEWS_LEAST:
        raise BadInput(
            f"{recording.name}: only {kept.size} views of the pad lie within the gyro's samples; record the whole flight"
        )
    moving = _speeds(t, np.array([pose[1] for pose in poses]))[kept]
    stamps = tuple(sorted(ns for ns in measured))
    R_cam_pad, t_cam_pad, cov = (np.array(part) for part in zip(*(poses[i] for i in kept), strict=True))
    sigma_tilt_rad = math.sqrt(float(np.median(tilt_var)))
    return FlightViews(
        camera, t[kept], R_cam_pad, t_cam_pad, cov, t_gyro, np.array(w), t_attitude, np.array(R), sigma_tilt_rad,
        tuple(stamps[i] for i in kept), moving, camera.readout_s,
    )  # fmt: skip


def _speeds(t: F64, places: F64) -> F64:
    """Return the rate of a place between the frames before and after each, (N, 3); nan where there is a gap."""
    out = np.full_like(places, np.nan)
    apart = t[2:] - t[:-2]
    near = np.flatnonzero(apart < _NEIGHBOURS_S)
    out[near + 1] = (places[near + 2] - places[near]) / apart[near, None]
    return out


def _sorted(by_time: dict[float, Any], t0: float) -> tuple[F64, list[Any]]:
    times = sorted(by_time)
    return np.array(times) - t0, [by_time[t] for t in times]


def _check(name: str, poses: int, gyro: list[float], attitudes: int) -> None:
    if poses < VIEWS_LEAST:
        raise BadInput(
            f"{name}: the pad's full pose was found in {poses} frames, and {VIEWS_LEAST} are needed; fly at 1 to 5 m over the "
            'whole pad, with vision.method "registration" or "fused"'
        )
    if attitudes < VIEWS_LEAST:
        raise BadInput(f"{name}: holds {attitudes} attitudes of the vehicle; its driver has to report them")
    rate_hz = 0.0 if len(gyro) < 2 else (len(gyro) - 1) / (gyro[-1] - gyro[0])
    if rate_hz < GYRO_RATE_LEAST_HZ:
        raise BadInput(
            f"{name}: the gyro came at {rate_hz:.0f} Hz, and {GYRO_RATE_LEAST_HZ:.0f} Hz are needed; ask the autopilot for more"
        )


_QUARTER_TURN = -np.array([[0.0, 1.0], [-1.0, 0.0]])


class CameraPose(NamedTuple):
    """The pad as the camera alone saw it; neither the attitude nor the mount is in it."""

    R_cam_pad: F64
    """(3, 3)."""
    t_cam_pad: F64
    """(3,) m."""
    cov: F64
    """(6, 6): [t_cam_pad (m), small rotation of the pad written in `cam` (rad)]."""


def camera_pose(sighting: Sighting, camera: Camera, orientation: Orientation) -> CameraPose | None:
    """Return the pose that `sighting_of` made this sighting of; None without a full pose.

    A sighting is levelled by the attitude and by a share of what the pad's normal says against it. Both are undone.

    Args:
        camera, orientation: the same that the sighting was made with.
    """
    if sighting.pose6 is None:
        return None
    axes, C = tilt_axes(orientation), orientation.cov_tilt
    A = _QUARTER_TURN @ axes[:2]
    gain = C @ A.T @ np.linalg.inv(A @ C @ A.T + (orientation.sigma_deck_rad**2 + 1e-12) * np.eye(2))
    R_level_pad = sighting.pose6.R_level_pad.matrix
    turn, normal = _undone(R_level_pad[:, 2], axes @ gain)
    R_level_body = orientation.R_level_body.matrix
    before = R_level_body @ camera.T_body_cam.R.matrix
    R_level_cam = turn @ before
    d = sighting.d_body_pad_level
    t = R_level_cam.T @ (d - turn @ (R_level_body @ camera.T_body_cam.t))

    # The sighting's errors are J (pose, attitude left) with the attitude's share through `back`: see `sighting_of`.
    to_attitude = np.zeros((6, 2))
    to_attitude[:3], to_attitude[3:] = -skew(d) @ axes, axes
    M = np.zeros((6, 6))
    M[:3, :3] = M[3:, 3:] = R_level_cam
    M[:, 3:] += to_attitude @ (gain @ (-skew(normal) @ R_level_cam)[:2])
    own = sighting.pose6.cov - to_attitude @ (C - gain @ A @ C) @ to_attitude.T
    back = np.linalg.inv(M)
    cov = back @ own @ back.T
    return CameraPose(R_level_cam.T @ R_level_pad, t, 0.5 * (cov + cov.T))


def _undone(turned: F64, axes_gain: F64) -> tuple[F64, F64]:
    """Return the turn that the attitude's share of the normal made, and the normal before it, by a fixed point."""
    normal = turned
    turn = np.eye(3)
    for _ in range(_STEPS):
        turn = np.asarray(cv2.Rodrigues(axes_gain @ normal[:2])[0])
        again = turn.T @ turned
        if float(np.abs(again - normal).max()) < _SAME:
            break
        normal = again
    return turn, normal
