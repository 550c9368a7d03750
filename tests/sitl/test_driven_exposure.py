"""The simulated camera whose exposure the service drives: what it gives where a camera that meters the whole picture fails."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.camera.exposure import TARGET, ExposureDrive, ExposureSetting, Metered
from drivers.camera.exposure_governor import ExposureGovernor, meter_inside
from drivers.camera.exposure_options import ExposureOptions
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp
from sitl.camera.camera import Exposure
from sitl.camera.film import Film, SimulatedExposure, Taken, taken_with
from sitl.camera.light import Light, Sensor
from sitl.emulators.autopilots.body import Body
from sitl.scenario.scenario import load
from sitl.world.stage import film, renderer

OPTIONS = ExposureOptions(mode="pad")


def above(body: Body, height_m: float) -> tuple[Exposure, F64]:
    """Return the view from over the pad, and the pad's outline in it, (N, 2) px."""
    pad = body.vessel.pad_at(0.0)
    p_body_ned = pad.p_ned - np.array([0.2, 0.1, height_m])
    shot = Exposure(0.0, Rotation.from_rpy(0.0, 0.0, 0.0), p_body_ned, Rotation(pad.R_ned), pad.p_ned)
    p_body = body.pad.circle(body.pad.disc_radius_m, 24) @ pad.R_ned.T + pad.p_ned - p_body_ned
    camera = body.camera
    return shot, camera.project((p_body - camera.T_body_cam.t) @ camera.T_body_cam.R.matrix)


def seen(px: NDArray[np.uint8], outline: F64) -> Metered:
    found = meter_inside(px, outline)
    assert found is not None
    return found


def own(made: Film, shot: Exposure, frames: int) -> NDArray[np.uint8]:
    for n in range(frames):
        px = made.render(replace(shot, t_s=n / 30.0), np.random.default_rng(n))
    return px


def test_on_a_dark_sea_the_camera_clips_the_lit_pad_and_the_service_does_not() -> None:
    scenario = load("lit_deck")
    body = Body(scenario, 3, 0.005)
    shot, outline = above(body, 9.0)
    made = film(scenario, renderer(scenario, body.waves, body.vessel, 7), 7)
    assert seen(own(made, shot, 3), outline).saturated > 0.5

    drive, number = ExposureDrive(OPTIONS.settle_frames), 0
    camera = SimulatedExposure(drive, ExposureSetting(0.02, 16.0), 1 / 30, 6500.0, lambda: number)
    governor, found = ExposureGovernor(OPTIONS, drive), []
    for number in range(1, 50):
        px = made.render(shot, np.random.default_rng(number), camera.expose())
        governor.on_frame(Frame(Stamp(MonoNs(number), MonoNs(number), 0.0, "sim"), number, px), outline, 0.0)
        found.append(seen(px, outline))
    assert found[0].saturated > 0.5
    assert all(metered.saturated < 0.03 and 0.7 * TARGET < metered.level < 1.4 * TARGET for metered in found[-8:])


def test_a_change_shows_two_frames_later() -> None:
    drive = ExposureDrive(4)
    camera = SimulatedExposure(drive, ExposureSetting(0.008, 1.0), 1 / 30, 6500.0, lambda: 5)
    assert drive.can is not None
    drive.ask(ExposureSetting(0.002, 4.0))
    shown = [camera.expose().setting for _ in range(4)]
    assert [s.exposure_s for s in shown if s is not None] == [0.008, 0.008, 0.002, 0.002]
    assert not drive.settled(9)
    assert drive.settled(10)


def test_light_counts_with_time_and_gain_and_noise_with_gain_alone() -> None:
    light, sensor = Light(), Sensor(exposure_s=0.008)
    longer, same = taken_with(light, sensor, Taken(ExposureSetting(0.016, 1.0)))
    assert (longer.exposure_ev, same.full_well_e, same.exposure_s) == (1.0, sensor.full_well_e, 0.016)
    amplified, noisy = taken_with(light, sensor, Taken(ExposureSetting(0.004, 4.0), light_fraction=0.25, white_balance_k=5000.0))
    assert amplified.exposure_ev == pytest.approx(1.0 + math.log2(0.25))
    assert (noisy.full_well_e, noisy.exposure_s, amplified.balanced_for_k) == (sensor.full_well_e / 4.0, 0.004, 5000.0)
    assert taken_with(light, sensor, Taken()) == (light, sensor)
