"""Samples and frames for the recorder's tests."""

from pathlib import Path

import numpy as np

from companion.base.observer import ProcessedFrame
from companion.recording.mcap_file import About
from companion.recording.reading import open_recording
from companion.settings.load import camera_model
from estimator.contracts.estimates import Verdict
from estimator.contracts.samples import Frame, Imu, Sample
from estimator.contracts.time import MonoNs, Stamp
from tests.fly import sim_settings

CAMERA = camera_model(sim_settings())
ABOUT = About({"flight": {"kind": "test"}})


def numbered_imu(at_s: float) -> Imu:
    at = MonoNs(round(at_s * 1e9))
    return Imu(Stamp(at, at, 0.001, "sim"), np.array([0.0, 0.0, at_s]), np.array([0.0, 0.0, -9.81]))


def numbered_frame(at_s: float, seq: int) -> ProcessedFrame:
    at = MonoNs(round(at_s * 1e9))
    px = np.full((CAMERA.height, CAMERA.width, 3), seq % 256, np.uint8)
    return ProcessedFrame(Frame(Stamp(at, at, 0.001, "sim"), seq, px), None, None, Verdict.NO_ATTITUDE, at, at)


def samples_of(path: Path) -> list[Sample]:
    return [event for event in open_recording([path]).events() if isinstance(event, Imu)]
