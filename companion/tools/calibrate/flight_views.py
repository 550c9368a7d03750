"""Camera data of a recorded flight: poses of the pad, rotation by the gyro, and the reported attitude."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np

from companion.recording.reading import RecordedFrame, Recording
from companion.settings.model import VisionSettings
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64, skew
from estimator.contracts.samples import Attitude, GimbalAttitude, Imu
from estimator.vision.camera import Camera
from estimator.vision.pose import Orientation, tilt_axes

GYRO_RATE_LEAST_HZ = 40.0
TILT_SIGMA_MAX_RAD = math.radians(2.0)
"""A pose whose tilt is known worse than this says nothing of the mount."""
_NEIGHBOURS_S = 0.25
"""Longest time between the frames before and after a view whose rate of place is used."""
VIEWS_LEAST, VIEWS_MOST = 100, 600
"""More views of a minute add hardly anything: the errors of neighbours are alike."""


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


_STEPS = 30
_SAME = 1e-13
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
