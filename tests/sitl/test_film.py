"""Frames one after the other: automatics that lag, a driven exposure, a link that loses packets, a renderer of its own."""

import math
from itertools import pairwise

import cv2
import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray

from drivers.camera.exposure import TARGET, ExposureDrive, ExposureSetting, Metered
from drivers.camera.exposure_governor import ExposureGovernor, meter_inside
from drivers.camera.options import ExposureOptions
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.film import Adjusted, Automatics, Film, SimulatedExposure, Taken, VideoLink, adjust, taken_with
from sitl.camera.light import Light, Sensor
from sitl.camera.render_worker import render_worker
from sitl.camera.settings import VideoSettings
from sitl.camera.surroundings import Surroundings
from sitl.emulators.autopilots.body import Body
from sitl.scenario.scenario import load
from sitl.world import stage
from tests.sitl.images import PLAIN, pad, shot
from tests.support.plain_light import FLAT

U8 = NDArray[np.uint8]
LAG = Automatics(exposure_lag_s=0.5, balance_lag_s=1.0)
OFF = Automatics()
LOSSY = VideoSettings(800.0, loss=0.1)


def film(light: Light = FLAT, automatics: Automatics = LAG, link: VideoSettings = VideoSettings(), seed: int = 3) -> Film:  # noqa: B008
    return Film(Renderer(PLAIN, pad("thesis"), Surroundings(), light, Sensor()), automatics, link, seed)


def shots(n: int, height_m: float = 1.5) -> list[Exposure]:
    return [replace(shot(height_m, (0.004 * i, 0.0)), t_s=4.0 + i / 30.0) for i in range(n)]


def frames(film: Film, n: int) -> list[U8]:
    return [film.render(s, np.random.default_rng(i)) for i, s in enumerate(shots(n))]


def test_the_exposure_follows_the_whole_picture_with_its_time_constant() -> None:
    bright, dark = (np.full((36, 64, 3), v, np.uint8) for v in (210, 40))
    after, settled = (adjust(Automatics(exposure_lag_s=0.5), Adjusted(0.0), bright, 0.5, at_once=at_once) for at_once in (0, 1))
    assert settled.ev < -1.5
    assert after.ev == pytest.approx(settled.ev * (1.0 - math.exp(-1.0)), rel=1e-6)
    assert adjust(Automatics(exposure_lag_s=0.5), Adjusted(0.0), dark, 0.5).ev > 0.5
    day, dusk = (frames(film(replace(FLAT, daylight_ev=ev)), 1)[-1].astype(float) for ev in (0.0, -4.5))
    assert dusk.mean() == pytest.approx(day.mean(), rel=0.05)
    assert dusk[40:60, 40:80].std() > 1.5 * day[40:60, 40:80].std()


def test_white_balance_takes_the_picture_for_grey() -> None:
    # Under lamps of 3000 K the fixed balance shows a red picture, the automatic a grey one.
    warm = replace(FLAT, colour_temperature_k=3000.0)
    fixed, follows = (frames(film(warm, Automatics(0.5, 0.02, lag)), 2)[-1].mean(axis=(0, 1)) for lag in (0.0, 1.0))
    assert fixed[2] / fixed[0] > 1.5
    assert follows[2] / follows[0] == pytest.approx(1.0, abs=0.1)


def test_a_link_without_loss_shows_the_frame_and_lost_packets_smear_and_freeze_it() -> None:
    lossy = VideoSettings(1000.0, loss=0.3)
    clear, whole, lost, again = (frames(film(FLAT, OFF, v), 10) for v in (VideoSettings(), VideoSettings(1000.0), lossy, lossy))
    other = frames(film(FLAT, OFF, lossy, seed=4), 10)

    def off(a: list[U8], b: list[U8]) -> float:
        return float(np.mean([np.abs(x.astype(float) - y).mean() for x, y in zip(a, b, strict=True)]))

    assert off(whole, clear) < 4.0
    assert off(lost, clear) > 1.5 * off(whole, clear)
    assert off(lost, again) == 0.0 < off(lost, other)
    link = VideoLink(VideoSettings(1000.0, loss=0.99, burst_packets=200.0), 64, 48, 1)
    seen = [link.send(np.full((48, 64, 3), v, np.uint8)) for v in range(0, 250, 10)]
    assert all(np.array_equal(a, b) for a, b in pairwise(seen[5:])), "where nothing arrives the picture stands still"


def test_frames_requested_late_or_never_change_no_other() -> None:
    dusk = replace(FLAT, daylight_ev=-3.0)
    one_by_one, late = (film(dusk, link=LOSSY) for _ in range(2))
    straight = [one_by_one.order(s, np.random.default_rng(i))() for i, s in enumerate(shots(6))]
    made = [late.order(s, np.random.default_rng(i)) for i, s in enumerate(shots(6))]
    assert np.array_equal(made[5](), straight[5])
    assert np.array_equal(made[2](), straight[2])


def test_a_process_of_its_own_makes_the_same_pictures() -> None:
    cv2.setNumThreads(1)  # as in a flight: a fork while OpenCV's threads work could leave a lock behind
    with render_worker(film(link=LOSSY)) as worker:
        if worker is None:
            pytest.skip("a single processor")
        theirs = [worker.order(s, np.random.default_rng(i)) for i, s in enumerate(shots(4))]
        assert all(np.array_equal(image(), own) for image, own in zip(theirs, frames(film(link=LOSSY), 4), strict=True))


def above(body: Body, height_m: float) -> tuple[Exposure, F64]:
    """Return the view from over the pad, and the pad's outline in it, (N, 2) px."""
    pad, camera = body.vessel.pad_at(0.0), body.camera
    p_body_ned = pad.p_ned - np.array([0.2, 0.1, height_m])
    p_body = body.pad.circle(body.pad.disc_radius_m, 24) @ pad.R_ned.T + pad.p_ned - p_body_ned
    outline = camera.project((p_body - camera.T_body_cam.t) @ camera.T_body_cam.R.matrix)
    return Exposure(0.0, Rotation.identity(), p_body_ned, Rotation(pad.R_ned), pad.p_ned), outline


def test_on_a_dark_sea_the_camera_clips_the_lit_pad_and_the_service_does_not() -> None:
    scenario, options = load("lit_deck"), ExposureOptions(mode="pad")
    body = Body(scenario, 3, 0.005)
    view, outline = above(body, 9.0)
    made = stage.film(scenario, stage.renderer(scenario, body.waves, body.vessel, 7), 7)

    def metered(px: U8) -> Metered:
        found = meter_inside(px, outline)
        assert found is not None
        return found

    own = [made.render(replace(view, t_s=n / 30.0), np.random.default_rng(n)) for n in range(3)]
    assert metered(own[-1]).saturated > 0.5
    drive, number = ExposureDrive(options.settle_frames), 0
    camera = SimulatedExposure(drive, ExposureSetting(0.02, 16.0), 1 / 30, 6500.0, lambda: number)
    governor, found = ExposureGovernor(options, drive), []
    for number in range(1, 50):
        px = made.render(view, np.random.default_rng(number), camera.expose())
        governor.on_frame(Frame(Stamp(MonoNs(number), MonoNs(number), 0.0, "sim"), number, px), outline, 0.0)
        found.append(metered(px))
    assert found[0].saturated > 0.5
    assert all(each.saturated < 0.03 and 0.7 * TARGET < each.level < 1.4 * TARGET for each in found[-8:])


def test_a_change_shows_two_frames_later() -> None:
    drive = ExposureDrive(4)
    camera = SimulatedExposure(drive, ExposureSetting(0.008, 1.0), 1 / 30, 6500.0, lambda: 5)
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
