"""The part that drives a camera's exposure: it meters where the pad is believed to be, and heeds how the vehicle turns."""

import logging
from typing import Any, cast

import numpy as np
import pytest
from msgspec import structs

from companion.base.health import Health
from companion.guidance.pilot import Pilot, make_pilot
from companion.service.vehicle_parts import ExposurePart, vehicle_parts
from companion.settings.load import from_mapping
from companion.settings.model import CameraSettings
from drivers.camera.exposure import TARGET, ExposureDrive, ExposureRange, ExposureSetting
from drivers.camera.options import ExposureOptions
from drivers.clock import SystemClock
from estimator.contracts.estimates import RelativeState
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from tests.make import attitude, estimate, imu, processed_frame, stamp_at

SETTINGS = from_mapping(
    {
        "vehicle": {"kind": "mavlink", "links": "udpin://127.0.0.1:0"},
        "camera": {"file": "sim", "source": "v4l2", "device": "Test camera", "exposure": {"mode": "pad"}},
        "pad": {"file": "thesis"},
    },
    "test",
)
PILOT = make_pilot(SETTINGS)
HEIGHT_M, AHEAD_M = 3.0, 0.6
PERIOD_NS = 33_333_333


class BelievingPilot:
    """Believes that the pad is ahead of the vehicle, or nothing."""

    def __init__(self, tracked: bool) -> None:
        self.tracked = tracked
        self.camera: Camera = PILOT.camera
        self.pad: Pad = PILOT.pad
        self.estimator = self

    def at(self, now: MonoNs) -> RelativeState | None:
        if not self.tracked:
            return None
        return estimate(now * 1e-9, (AHEAD_M, 0.0, HEIGHT_M), sigma=1.0)


class Scene:
    """A pad in the middle of the upper half of the frame, and a sea that is ten times as bright."""

    def __init__(self, white_per_ms: float, tracked: bool = True) -> None:
        self.white_per_ms, self.number = white_per_ms, 0
        self.drive = ExposureDrive(settle_frames=1)
        self.drive.opened(ExposureRange(1e-4, 0.026, 8.0), ExposureSetting(0.008, 1.0))
        self.part = ExposurePart(ExposureOptions(mode="pad"), cast("Pilot", BelievingPilot(tracked)))
        self.part.attach(self.drive)
        camera = PILOT.camera
        v, u = np.mgrid[: camera.height, : camera.width]
        pad_v = camera.cy - camera.fy * (AHEAD_M - camera.T_body_cam.t[0]) / HEIGHT_M
        self.inside = np.hypot(u - camera.cx, v - pad_v) < 1.1 * camera.fx * PILOT.pad.disc_radius_m / HEIGHT_M

    def run(self, frames: int, w_body: float = 0.0) -> ExposureSetting:
        for _ in range(frames):
            held = self.drive.held
            assert held is not None
            self.number += 1
            stamp = stamp_at(self.number * PERIOD_NS)
            self.part.on_sample(imu(stamp, (0.0, w_body, 0.0)))
            white = self.white_per_ms * 1e3 * held.product_s
            light = np.where(self.inside, white, 10.0 * white)
            grey = np.round(255.0 * np.clip(light, 0.0, 1.0) ** (1 / 2.2)).astype(np.uint8)
            frame = Frame(stamp, self.number, np.repeat(grey[..., None], 3, axis=2), held.exposure_s, held.gain)
            self.part.on_frame(processed_frame(frame, own=attitude(stamp)))
            if (wanted := self.drive.take()) is not None:
                self.drive.changed(wanted, self.number, self.number)
        assert self.drive.held is not None
        return self.drive.held


def test_the_pad_is_metered_and_not_the_bright_sea_around_it() -> None:
    scene = Scene(0.2)
    held = scene.run(60)
    assert scene.white_per_ms * 1e3 * held.product_s == pytest.approx(TARGET, rel=0.25)
    counted = scene.part.counted()
    assert (counted["frames_pad"], counted["frames_search"], counted["frames_dark"]) == (60, 0, 0)
    assert (counted["exposure_ms"], counted["gain"]) == (round(1e3 * held.exposure_s, 3), round(held.gain, 2))


def test_without_a_belief_the_whole_picture_is_metered() -> None:
    scene = Scene(0.2, tracked=False)
    scene.run(60)
    assert scene.part.counted()["frames_search"] == 60


def test_a_vehicle_that_turns_gets_short_exposures_and_gain_in_their_place() -> None:
    scene = Scene(0.05)
    still = scene.run(60)
    turning = scene.run(30, w_body=0.8)
    assert turning.exposure_s * PILOT.camera.fx * 0.8 <= 1.5 < still.exposure_s * PILOT.camera.fx * 0.8
    assert turning.product_s == pytest.approx(still.product_s, rel=0.05)
    assert scene.run(200).exposure_s > 1.8 * turning.exposure_s


def test_a_pad_too_dark_for_the_camera_is_counted_and_reported_once(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    scene = Scene(1e-4)
    scene.run(300)
    assert scene.part.counted()["frames_dark"] > 200
    assert caplog.text.count("stops too dark at 20.0 ms and gain 8.0, which the motion and the camera limit") == 1
    scene.white_per_ms = 0.2
    scene.run(60)
    assert caplog.text.count("the pad is rightly exposed again") == 1


def test_the_service_has_the_part_where_the_settings_ask_for_it() -> None:
    own = structs.replace(SETTINGS, camera=CameraSettings("sim", source="v4l2", device="Test camera"))
    for settings, there in ((SETTINGS, True), (own, False)):
        health = Health(SystemClock())
        parts: Any = vehicle_parts(settings, PILOT, health, SystemClock())
        assert any(isinstance(observer, ExposurePart) for observer in parts.observers) is there
        assert ("exposure" in health.snapshot().counters) is there
