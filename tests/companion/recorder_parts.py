"""Samples and frames for the recorder's tests."""

from pathlib import Path

import numpy as np

from companion.base.observer import ProcessedFrame
from companion.recording.mcap_file import About
from companion.recording.reading import open_recording
from companion.settings.load import camera_model
from estimator.contracts.estimates import Verdict
from estimator.contracts.samples import Imu, Sample
from tests.fly import sim_settings
from tests.make import frame, imu, processed_frame

CAMERA = camera_model(sim_settings())
ABOUT = About({"flight": {"kind": "test"}})


def numbered_imu(at_s: float) -> Imu:
    return imu(at_s, (0.0, 0.0, at_s))


def numbered_frame(at_s: float, seq: int) -> ProcessedFrame:
    px = np.full((CAMERA.height, CAMERA.width, 3), seq % 256, np.uint8)
    return processed_frame(frame(at_s, seq, px), verdict=Verdict.NO_ATTITUDE)


def samples_of(path: Path) -> list[Sample]:
    return [event for event in open_recording([path]).events() if isinstance(event, Imu)]
