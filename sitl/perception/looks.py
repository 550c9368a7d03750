"""Looks out of a recording: what vision found in each frame, beside what the camera truly had before it.

A recorded sighting is turned back into what vision measured in the camera's own axes, so that the error of the vehicle's attitude,
which every sighting contains, is not counted as an error of vision: in a simulated flight it comes back by itself, from the
simulated attitude.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from companion.recorder.reading import RecordedFrame, Recording, open_recording
from companion.recorder.records import TruthRecord
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64, skew, wrap_pi
from estimator.contracts.samples import Attitude
from estimator.vision.camera import Camera
from estimator.vision.pose import SIGMA_DECK_RAD, Orientation
from estimator.vision.register.solver import roll_pitch, tilt_axes
from sitl.perception.view import View, Viewer
from sitl.scenario import Scenario, load

_ITERATIONS = 12
_HALF_TURN = math.pi / 2


class Measured(NamedTuple):
    """What registration measured, in the camera's axes."""

    error: F64
    """(6,): position less the true one over the height, then the small rotation of the pad, rad."""
    cov: F64
    """(6, 6) claimed covariance of the same."""
    turned: bool
    """Whether the heading is half a turn off; `error` is then that of the pose turned back."""
    ambiguous: bool
    """Whether registration said that the heading may be half a turn off."""


class Look(NamedTuple):
    """One look at one frame."""

    at_s: float
    view: View
    measured: Measured | None
    """None if nothing was found that may be used."""
    confidence: float
    fused: F64 | None
    """(4,): the fused sighting less that of registration, position over the height and heading; None without one."""
    fused_cov: F64 | None
    """(4, 4) claimed covariance of the fused sighting, positions over the height."""


class Source(NamedTuple):
    """One recording and the conditions that it was made in."""

    path: Path
    scenario: Scenario
    method: str
    camera: Camera
    looks: tuple[Look, ...]


def read(path: Path) -> Source:
    """Return the looks of a recording that `decklander simulate --record` made.

    Raises:
        BadInput: it holds no truth with attitudes, no camera, pad or settings, or does not name its scenario.
    """
    recording = open_recording([path])
    camera, pad, settings = recording.camera(), recording.pad(), recording.settings()
    facts = recording.metadata.get("flight", {})
    if camera is None or pad is None or settings is None or "scenario" not in facts:
        raise BadInput(f"{path}: only a recording of decklander simulate can be fitted: scenario, camera or pad is missing")
    looks = tuple(_looks(recording, Viewer(camera, pad), camera, settings.estimator.min_confidence, settings))
    if not looks:
        raise BadInput(f"{path}: holds no frame whose truth is known with attitudes; record it again with this version")
    return Source(path, load(facts["scenario"]), settings.vision.method, camera, looks)


def _looks(recording: Recording, viewer: Viewer, camera: Camera, min_confidence: float, settings: object) -> Iterator[Look]:
    truths: dict[int, TruthRecord] = {}
    frames: list[RecordedFrame] = []
    for event in recording.events():
        if isinstance(event, TruthRecord) and event.R_ned_body is not None and event.R_ned_pad is not None:
            truths[event.at_ns] = event
        elif isinstance(event, RecordedFrame) and event.record.tried is not None and event.attitude is not None:
            frames.append(event)
    for frame in frames:
        truth, attitude, detection = truths.get(frame.stamp.measured_at), frame.attitude, frame.look()
        if truth is None or attitude is None or detection is None:
            continue
        yield _look(viewer, camera, truth, attitude, detection.selected, detection.methods.get("registration"), min_confidence,
                    frame.stamp.measured_at * 1e-9)  # fmt: skip


def _look(
    viewer: Viewer,
    camera: Camera,
    truth: TruthRecord,
    attitude: Attitude,
    selected: Sighting | None,
    registered: Sighting | None,
    min_confidence: float,
    at_s: float,
) -> Look:
    R_ned_body = np.array(truth.R_ned_body).reshape(3, 3)
    R_ned_pad = np.array(truth.R_ned_pad).reshape(3, 3)
    yaw = math.atan2(R_ned_body[1, 0], R_ned_body[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    forward, right, down = truth.d_body_pad_level
    view = viewer.view(R_ned_body, np.array([c * forward - s * right, s * forward + c * right, down]), R_ned_pad)
    if selected is None or registered is None or registered.pose6 is None or selected.confidence < min_confidence:
        return Look(at_s, view, None, 0.0, None, None)
    measured = _in_camera(registered, attitude, camera, view)
    fused = fused_cov = None
    if selected.method == "fused":
        z = max(0.05, view.height_m)
        turn = 0.0
        if selected.yaw_rad is not None and registered.yaw_rad is not None:
            turn = wrap_pi(selected.yaw_rad - registered.yaw_rad)
        fused = np.append((selected.d_body_pad_level - registered.d_body_pad_level) / z, turn)
        scale = np.array([z, z, z, 1.0])
        fused_cov = selected.cov / np.outer(scale, scale)
    return Look(at_s, view, measured, selected.confidence, fused, fused_cov)


def _in_camera(registered: Sighting, attitude: Attitude, camera: Camera, view: View) -> Measured:
    """Undo `estimator.vision.register.sighting.registered_sighting`: its inputs from its result and the attitude it used."""
    pose = registered.pose6
    assert pose is not None
    orientation = Orientation.of(attitude, SIGMA_DECK_RAD)
    axes, C = tilt_axes(orientation), orientation.cov_tilt
    A = -np.array([[0.0, 1.0], [-1.0, 0.0]]) @ axes[:2]
    gain = C @ A.T @ np.linalg.inv(A @ C @ A.T + (SIGMA_DECK_RAD**2 + 1e-12) * np.eye(2))
    after = pose.R_level_pad.matrix
    normal = after[:, 2]
    turn = np.eye(3)
    for _ in range(_ITERATIONS):
        turn = cv2.Rodrigues(axes @ (gain @ normal[:2]))[0]
        normal = turn.T @ after[:, 2]
    R_level_body = roll_pitch(orientation)
    R_level_cam = turn @ R_level_body @ camera.T_body_cam.R.matrix
    d = pose.d_body_pad_level
    t = R_level_cam.T @ (d - turn @ R_level_body @ camera.T_body_cam.t)
    R = R_level_cam.T @ after
    turned = bool(np.trace(R @ view.R_cam_pad.T) < 1.0)
    if turned:
        R = R @ np.diag([-1.0, -1.0, 1.0])
    z = max(0.05, view.height_m)
    error = np.append((t - view.t_cam_pad) / z, cv2.Rodrigues(R @ view.R_cam_pad.T)[0].ravel())

    J = np.zeros((6, 8))
    J[:3, :3] = J[3:, 3:6] = R_level_cam
    J[:3, 6:] = -skew(d) @ axes
    J[3:, 6:] = axes
    back = np.zeros((2, 6))
    back[:, 3:] = gain @ (-skew(normal) @ R_level_cam)[:2]
    M = np.linalg.inv(J[:, :6] + J[:, 6:] @ back)
    left = pose.cov - J[:, 6:] @ (C - gain @ A @ C) @ J[:, 6:].T
    cov = M @ left @ M.T
    scale = np.array([z, z, z, 1.0, 1.0, 1.0])
    cov = cov / np.outer(scale, scale)
    return Measured(error, 0.5 * (cov + cov.T), turned, registered.yaw_ambiguous)
