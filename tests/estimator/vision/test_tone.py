"""The tone curve that is learnt on a tracked pad's edges."""

import math

import numpy as np
import pytest

from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from estimator.vision.srgb import LINEAR_LIGHT, light_of_tone
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track
from sitl.camera.light import Sensor
from tests.support.pad_views import Stage


def curve_of(tone: str) -> np.ndarray:
    """Return the value, (256,), that a camera gives in place of each value of sRGB."""
    light = 2.5 * LINEAR_LIGHT if tone == "clipped" else LINEAR_LIGHT
    own = {"linear": 0.0}.get(tone, 1.0)
    return np.interp(light, light_of_tone(own), np.arange(256)).round().astype(np.uint8)


@pytest.mark.parametrize(("tone", "steps", "within_mm"), [("srgb", {0}, 0.1), ("linear", {-9, -10}, 0.2), ("clipped", {0}, 0.3)])
def test_a_track_learns_the_tone(camera: Camera, pad: Pad, tone: str, steps: set[int], within_mm: float) -> None:
    stage, memory, off_mm = Stage(camera, pad, sensor=Sensor(exposure_s=0.0)), TrackerMemory(), list[float]()
    tracker, curve = TrackerConfig(camera, pad), curve_of(tone)
    for k in range(20):
        view, ns = stage.view(1.0), MonoNs(10**9 + 310_000_000 * k)
        stamp, cov = Stamp(ns, ns, 0.0, "sim"), np.diag([1e-6] * 3 + [0.01] * 3 + [4e-4])
        belief = RelativeState(ns, "ekf", view.d_body_pad_level, np.zeros(3), view.yaw_rad, cov, ns, True)
        attitude = Attitude(stamp, Rotation.from_rpy(view.roll_rad, view.pitch_rad, 0.0), np.eye(3) * 1e-8)
        seen, memory = track(tracker, memory, Frame(stamp, k, curve[view.px]), attitude, belief)
        assert seen.selected is not None
        off_mm.append(1e3 * (math.dist(seen.selected.d_body_pad_level, (0, 0, 0)) - math.dist(view.d_body_pad_level, (0, 0, 0))))
    assert memory.tone.steps in steps
    assert abs(np.median(off_mm[-8:])) < within_mm
    assert tone != "linear" or abs(np.median(off_mm[:2])) > 0.5
    _, memory = track(tracker, memory, Frame(stamp, 20, np.zeros_like(view.px)), None)
    assert memory.tone.steps in {min(0, step + 1) for step in steps}
