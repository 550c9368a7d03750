"""The pads of twenty users, and how far vision trusts in one."""

import math
from pathlib import Path

import numpy as np
import pytest

from companion.settings.load import read_toml
from companion.tools.pad_price import CAMERA
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.pad.pad import Pad
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track

USERS = sorted((Path(__file__).parents[1] / "pads_of_users").glob("*.toml"))
STAMP = Stamp(MonoNs(0), MonoNs(0), 0.001, "sim")


def user_s(name: str) -> Pad:
    """Return a pad of a user."""
    return Pad.from_mapping(read_toml(next(p for p in USERS if p.stem == name)))


def trust(pad: Pad, px: np.ndarray, at: PadPose | None = None, camera: Camera = CAMERA) -> float:
    """Return the confidence in a pad without an attitude; where its pose is given, its range is found to 3 %."""
    found = track(TrackerConfig(camera, pad), TrackerMemory(), Frame(STAMP, 0, px), None)[0].selected
    assert found is None or at is None or math.hypot(*found.d_body_pad_level) == pytest.approx(at.range_m, rel=0.03)
    return 0.0 if found is None else found.confidence
