"""Flights over a pad, without the simulator: a camera of known mount and delay, a gyro and an attitude with errors."""

import math
from pathlib import Path
from types import MappingProxyType

import numpy as np

from companion.base.observer import ProcessedFrame
from companion.parts.recorder.setup import about, recorder_to_file
from companion.settings.load import camera_model
from companion.settings.model import Settings
from companion.tools.calibrate.flight_views import FlightViews
from companion.tools.calibrate.gyro_attitude import exp, exps, interpolated, logs, transposed
from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import F64, Rotation, Transform
from estimator.contracts.samples import Attitude, Frame, Imu
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.detection import Detection
from estimator.vision.register.sighting import sighting_of

GYRO_HZ, VIEW_HZ = 100.0, 10.0
LEVEL_SIGMA_RAD = math.radians(0.5)


def camera(rpy_deg: tuple[float, float, float] = (0.0, 0.0, 90.0)) -> Camera:
    """Return a camera of 640x360 px with this mount."""
    mount = Transform(Rotation.from_rpy(*(math.radians(a) for a in rpy_deg)), np.zeros(3))
    return Camera(640, 360, 374.67, 374.67, 319.5, 179.5, np.zeros(5), mount)


def flight(
    seed: int,
    turned_rad: F64,
    later_s: float,
    *,
    seconds: float = 50.0,
    lean_deg: float = 6.0,
    turn_deg: float = 120.0,
    deck_deg: float = 0.0,
) -> FlightViews:
    """Return a flight by hand whose camera is turned from its file, and whose frames show the world later than they say.

    Args:
        lean_deg: amplitude of roll and pitch.
        turn_deg: how far it turns about the vertical, there and back, every 20 s.
        deck_deg: amplitude of the pad's own roll and pitch.
    """
    rng = np.random.default_rng(seed)
    fine = np.arange(0.0, seconds, 1.0 / (4.0 * GYRO_HZ))
    roll, pitch = (_swing(rng, fine, math.radians(lean_deg)) for _ in range(2))
    yaw = math.radians(turn_deg) * 0.5 * (1.0 - np.cos(math.tau * fine / 20.0)) + _swing(rng, fine, math.radians(1.0))
    R_fine = _attitudes(roll, pitch, yaw)
    t_gyro, R = fine[::4], R_fine[::4]
    before, after = R_fine[3:-4:4], R_fine[5::4]
    n = min(before.shape[0], after.shape[0])
    w = np.zeros((t_gyro.size, 3))
    w[1 : n + 1] = logs(transposed(before[:n]) @ after[:n]) / (2.0 * (fine[1] - fine[0]))
    w += rng.normal(0.0, 0.01, 3) + rng.normal(0.0, 0.02, w.shape)
    level = np.r_[rng.normal(0.0, LEVEL_SIGMA_RAD, 2), 0.0]
    wander = np.stack([_markov(rng, t_gyro, math.radians(0.3), 1.0), _markov(rng, t_gyro, math.radians(0.3), 1.0),
                       _markov(rng, t_gyro, math.radians(1.5), 6.0)], axis=1)  # fmt: skip
    reported = exps(wander) @ R @ exp(level)
    at = np.round(np.arange(1.0, seconds - 1.0, 1.0 / VIEW_HZ) * 4.0 * GYRO_HZ).astype(int)
    swing = np.sin(math.tau * fine[at] / 7.0), np.sin(math.tau * fine[at] / 5.0 + 1.0), 0.0 * at
    deck = math.radians(deck_deg) * np.stack(swing, axis=1)
    R_pad = exps(deck) @ exp(np.array([0.03, -0.02, 0.7]))
    sigma = np.radians(np.array([0.06, 0.06, 0.05]))
    of = camera()
    R_body_cam = exp(turned_rad) @ of.T_body_cam.R.matrix
    seen = transposed(R_fine[at] @ R_body_cam) @ R_pad
    seen = exps(rng.normal(0.0, 1.0, (at.size, 3)) * sigma) @ seen
    cov = np.tile(np.diag(sigma**2), (at.size, 1, 1))
    t_cam_pad = np.tile([0.0, 0.0, 3.0], (at.size, 1))
    return FlightViews(of, fine[at] - later_s, seen, t_cam_pad, cov, t_gyro, w, t_gyro, reported, LEVEL_SIGMA_RAD)


def _attitudes(roll: F64, pitch: F64, yaw: F64) -> F64:
    zero = np.zeros_like(roll)
    parts = (np.stack(axis, axis=1) for axis in ((zero, zero, yaw), (zero, pitch, zero), (roll, zero, zero)))
    about_down, about_right, about_forward = (exps(part) for part in parts)
    return np.asarray(about_down @ about_right @ about_forward)


def _swing(rng: np.random.Generator, t: F64, amplitude: float) -> F64:
    """Return a motion of some sines of 1.5 to 5 s."""
    parts = [np.sin(math.tau * t / rng.uniform(1.5, 5.0) + rng.uniform(0.0, math.tau)) for _ in range(4)]
    return np.asarray(amplitude * 0.5 * np.sum(parts, axis=0))


def _markov(rng: np.random.Generator, t: F64, sigma: float, time_s: float) -> F64:
    keep = math.exp(-(t[1] - t[0]) / time_s)
    noise = sigma * math.sqrt(1.0 - keep * keep) * rng.standard_normal(t.size)
    out = np.empty(t.size)
    out[0] = sigma * rng.standard_normal()
    for i in range(1, t.size):
        out[i] = keep * out[i - 1] + noise[i]
    return out


def record(path: Path, of: FlightViews, settings: Settings) -> None:
    """Write a recording as the service would have made it of this flight, with the camera of the settings.

    The frames are levelled by the reported attitude at their stamps, and the samples begin a second after the clock's zero.
    """
    camera = camera_model(settings)
    cov = np.diag([LEVEL_SIGMA_RAD**2, LEVEL_SIGMA_RAD**2, math.radians(3.0) ** 2])
    reported = interpolated(of.t_attitude, of.R_ned_body, of.t)
    frames = list(zip(of.t, of.R_cam_pad, of.t_cam_pad, of.cov, reported, strict=True))
    with recorder_to_file(path, camera, about(settings, {"kind": "test"}), frames="none") as recorder:
        for t, w, R in zip(of.t_gyro, of.w_body, of.R_ned_body, strict=True):
            while frames and frames[0][0] + 0.05 < t:
                recorder.on_frame(_frame(*frames.pop(0), camera, cov))
            recorder.on_sample(Imu(_stamp(t), w, np.array([0.0, 0.0, -9.81])))
            recorder.on_sample(Attitude(_stamp(t), Rotation(R), cov))


def _frame(t: float, R_cam_pad: F64, t_cam_pad: F64, cov_R: F64, R_ned_body: F64, camera: Camera, cov: F64) -> ProcessedFrame:
    attitude = Attitude(_stamp(t), Rotation(R_ned_body), cov)
    frame = Frame(_stamp(t), round(1e3 * t), np.zeros((camera.height, camera.width, 3), np.uint8))
    cov_pose = np.zeros((6, 6))
    cov_pose[:3, :3], cov_pose[3:, 3:] = 1e-6 * np.eye(3), cov_R
    pose = PadPose(Rotation(R_cam_pad), t_cam_pad)
    one = sighting_of(frame, pose, cov_pose, camera, Orientation.of(attitude), False, 0.9)
    seen = Detection(one, "registration", MappingProxyType({"registration": one}))
    done = MonoNs(frame.stamp.received_at + 10_000_000)
    return ProcessedFrame(frame, attitude, seen, Verdict.FUSED, frame.stamp.received_at, done)


def _stamp(t: float) -> Stamp:
    return Stamp.from_seconds(1.0 + t, sigma_s=0.002, source="sim")
