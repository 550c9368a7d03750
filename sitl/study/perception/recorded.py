"""A recorded flight with its truth, and the detection samples that the error models are fitted to.

A detection sample is the detection of one frame with the true view of the camera. A recorded sighting is turned back into what
vision measured in the camera's own axes. The error of the vehicle's attitude, which every sighting contains, is so not counted as
an error of vision: in a simulated flight it comes back from the simulated attitude.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from companion.base.observer import Decision
from companion.facts.records import TruthRecord
from companion.recording.reading import RecordedFrame, open_recording
from companion.settings.model import Settings
from companion.tools.calibrate.flight_views import camera_pose
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation
from estimator.vision.pad.pad import Pad
from sitl.perception.model import View, Viewer
from sitl.scenario.scenario import Scenario, load


class Recorded(NamedTuple):
    """The content of one recording."""

    path: Path
    scenario: Scenario
    name: str
    """Scenario and seed, as the flight was requested."""
    settings: Settings
    camera: Camera
    pad: Pad
    truths: dict[int, TruthRecord]
    """True states by instant, ns."""
    frames: tuple[RecordedFrame, ...]
    """The frames in which vision searched, in order."""
    beliefs: tuple[RelativeState, ...]
    """The steering estimate at each guidance cycle that had one, in order."""


def read(path: Path, watch: Callable[[int, int], None] | None = None) -> Recorded:
    """Return what a recording of `decklander simulate --record` holds; `watch` shows how much of it is read.

    Raises:
        BadInput: it cannot be read, is of another kind, or holds no truth with attitudes; its scenario is gone.
    """
    recording = open_recording([path])
    recording.watch = watch or recording.watch
    camera, pad, settings = recording.camera(), recording.pad(), recording.settings()
    facts = recording.metadata.get("flight", {})
    if camera is None or pad is None or settings is None or facts.get("kind") != "simulate":
        raise BadInput(f"{path}: only a recording of decklander simulate knows the truth that a fit needs")
    if (level := facts.get("perception", "pixels")) != "pixels":
        raise BadInput(f"{path}: flown with --perception {level}; a fit needs what the real vision found")
    truths: dict[int, TruthRecord] = {}
    frames: list[RecordedFrame] = []
    beliefs: list[RelativeState] = []
    for event in recording.events():
        match event:
            case TruthRecord():
                truths[event.at_ns] = event
            case RecordedFrame():
                if event.record.tried is not None:
                    frames.append(event)
            case Decision():
                if event.belief is not None:
                    beliefs.append(event.belief)
            case _:
                pass
    if all(truth.R_ned_body is None for truth in truths.values()):
        raise BadInput(f"{path}: holds no true attitudes: record the flight again with this version")
    name = f"{Path(facts['scenario']).stem} {facts['seed']}"
    return Recorded(path, load(facts["scenario"]), name, settings, camera, pad, truths, tuple(frames), tuple(beliefs))


class Measured(NamedTuple):
    """The measurement of registration, in the camera's axes."""

    error: F64
    """(6,): position less the true one over the height, then the small rotation of the pad, rad."""
    cov: F64
    """(6, 6) claimed covariance of the same."""
    turned: bool
    """True if the heading is half a turn off; `error` is then that of the pose turned back."""
    ambiguous: bool
    """True if registration reported that the heading may be half a turn off."""


class DetectionSample(NamedTuple):
    """The detection of one frame and its true view."""

    at_s: float
    view: View
    measured: Measured | None
    """None if nothing was found that may be used."""
    confidence: float


def detection_samples(recorded: Recorded) -> tuple[DetectionSample, ...]:
    """Return the detection samples of a recorded flight, in order."""
    viewer = Viewer(recorded.camera, recorded.pad)
    samples = []
    for frame in recorded.frames:
        truth, attitude, detection = recorded.truths.get(frame.stamp.measured_at), frame.attitude, frame.detection()
        if truth is None or truth.R_ned_body is None or attitude is None or detection is None:
            continue
        registered = detection.methods.get("registration")
        samples.append(_sample(viewer, recorded, truth, attitude, detection.selected, registered, frame.stamp.measured_at * 1e-9))
    return tuple(samples)


def _sample(
    viewer: Viewer,
    recorded: Recorded,
    truth: TruthRecord,
    attitude: Attitude,
    selected: Sighting | None,
    registered: Sighting | None,
    at_s: float,
) -> DetectionSample:
    R_ned_body = np.array(truth.R_ned_body).reshape(3, 3)
    R_ned_pad = np.array(truth.R_ned_pad).reshape(3, 3)
    yaw = math.atan2(R_ned_body[1, 0], R_ned_body[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    forward, right, down = truth.d_body_pad_level
    view = viewer.view(R_ned_body, np.array([c * forward - s * right, s * forward + c * right, down]), R_ned_pad)
    least = recorded.settings.estimator.min_confidence
    if selected is None or registered is None or registered.pose6 is None or selected.confidence < least:
        return DetectionSample(at_s, view, None, 0.0)
    sigma_deck_rad = math.radians(recorded.settings.vision.deck_tilt_sigma_deg)
    measured = _in_camera(registered, attitude, recorded.camera, sigma_deck_rad, view)
    return DetectionSample(at_s, view, measured, selected.confidence)


def _in_camera(registered: Sighting, attitude: Attitude, camera: Camera, sigma_deck_rad: float, view: View) -> Measured:
    """Return what registration measured in the camera's axes, by undoing what made a sighting of it."""
    seen = camera_pose(registered, camera, Orientation.of(attitude, sigma_deck_rad))
    assert seen is not None
    R = seen.R_cam_pad
    turned = bool(np.trace(R @ view.R_cam_pad.T) < 1.0)
    if turned:
        R = R @ np.diag([-1.0, -1.0, 1.0])
    z = max(0.05, view.height_m)
    error = np.append((seen.t_cam_pad - view.t_cam_pad) / z, Rotation(R @ view.R_cam_pad.T).rotvec_rad)
    scale = np.array([z, z, z, 1.0, 1.0, 1.0])
    return Measured(error, seen.cov / np.outer(scale, scale), turned, registered.yaw_ambiguous)
