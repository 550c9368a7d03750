"""Frames one after the other: automatics that lag, a link that loses packets, the same pictures whoever renders them."""

import math
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.settings.load import SHIPPED
from estimator.contracts.errors import BadInput
from sitl.camera.automatic import Adjusted, Automatics, adjust
from sitl.camera.camera import Renderer
from sitl.camera.film import Film, VideoLink, VideoLinkOptions
from sitl.camera.light import Light, Sensor
from sitl.camera.render_worker import render_worker
from sitl.camera.surroundings import Surroundings
from sitl.scenario.scenario import from_mapping, load
from sitl.world.world import World
from tests.sitl.images import PLAIN, pad, shot
from tests.support.plain_light import FLAT

U8 = NDArray[np.uint8]
LAG = Automatics(exposure_lag_s=0.5, balance_lag_s=1.0)


def film(light: Light = FLAT, automatics: Automatics = LAG, link: VideoLinkOptions | None = None, seed: int = 3) -> Film:
    return Film(Renderer(PLAIN, pad("thesis"), Surroundings(), light, Sensor()), automatics, link, seed)


def frames(film: Film, n: int, height_m: float = 1.5) -> list[U8]:
    return [
        film.render(replace(shot(height_m, (0.004 * i, 0.0)), t_s=4.0 + i / 30.0), np.random.default_rng(i)) for i in range(n)
    ]


def test_the_exposure_follows_the_whole_picture_with_its_time_constant() -> None:
    grey = Adjusted(0.0)
    bright, dark = (np.full((36, 64, 3), v, np.uint8) for v in (210, 40))
    after = adjust(Automatics(exposure_lag_s=0.5), grey, bright, 0.5)
    settled = adjust(Automatics(exposure_lag_s=0.5), grey, bright, 0.5, at_once=True)
    assert settled.ev < -1.5
    assert after.ev == pytest.approx(settled.ev * (1.0 - math.exp(-1.0)), rel=1e-6)
    assert adjust(Automatics(exposure_lag_s=0.5), grey, dark, 0.5).ev > 0.5


def test_a_frame_after_dusk_is_as_bright_as_one_by_day_and_noisier() -> None:
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
    clear = frames(film(automatics=Automatics()), 10)
    whole = frames(film(automatics=Automatics(), link=VideoLinkOptions(1000.0)), 10)
    lossy = frames(film(automatics=Automatics(), link=VideoLinkOptions(1000.0, loss=0.3)), 10)
    again = frames(film(automatics=Automatics(), link=VideoLinkOptions(1000.0, loss=0.3)), 10)
    other = frames(film(automatics=Automatics(), link=VideoLinkOptions(1000.0, loss=0.3), seed=4), 10)

    def off(a: list[U8], b: list[U8]) -> float:
        return float(np.mean([np.abs(x.astype(float) - y).mean() for x, y in zip(a, b, strict=True)]))

    assert off(whole, clear) < 4.0
    assert off(lossy, clear) > 1.5 * off(whole, clear)
    assert off(lossy, again) == 0.0
    assert off(lossy, other) > 0.0


def test_where_nothing_arrives_the_picture_stands_still() -> None:
    link = VideoLink(VideoLinkOptions(1000.0, loss=0.99, burst_packets=200.0), 64, 48, 1)
    seen = [link.send(np.full((48, 64, 3), v, np.uint8)) for v in range(0, 250, 10)]
    assert all(np.array_equal(a, b) for a, b in pairwise(seen[5:]))


def test_frames_requested_late_or_never_change_no_other() -> None:
    shots = [replace(shot(1.5, (0.01 * i, 0.0)), t_s=4.0 + i / 30.0) for i in range(6)]
    one_by_one = film(replace(FLAT, daylight_ev=-3.0), link=VideoLinkOptions(800.0, loss=0.1))
    straight = [one_by_one.order(s, np.random.default_rng(i))() for i, s in enumerate(shots)]
    late = film(replace(FLAT, daylight_ev=-3.0), link=VideoLinkOptions(800.0, loss=0.1))
    made = [late.order(s, np.random.default_rng(i)) for i, s in enumerate(shots)]
    assert np.array_equal(made[5](), straight[5])
    assert np.array_equal(made[2](), straight[2])


def test_a_process_of_its_own_makes_the_same_pictures() -> None:
    cv2.setNumThreads(1)  # as in a flight: a fork while OpenCV's threads work could leave a lock behind
    with render_worker(film(link=VideoLinkOptions(800.0, loss=0.1))) as worker:
        if worker is None:
            pytest.skip("a single processor")
        shots = [replace(shot(1.5), t_s=4.0 + i / 30.0) for i in range(4)]
        theirs = [worker.order(s, np.random.default_rng(i)) for i, s in enumerate(shots)]
        ours = film(link=VideoLinkOptions(800.0, loss=0.1))
        assert all(
            np.array_equal(image(), ours.render(s, np.random.default_rng(i)))
            for i, (image, s) in enumerate(zip(theirs, shots, strict=True))
        )


@pytest.mark.parametrize("name", ["rain", "glint", "dusk", "weak_link"])
def test_the_shipped_weather_shows_the_pad(name: str) -> None:
    assert (SHIPPED / "scenarios" / f"{name}.toml").is_file()
    world = World(load(name), 1)
    px = world.render().px
    assert px.shape == (360, 640, 3)
    assert 15.0 < px.mean() < 220.0
    assert np.array_equal(px, World(load(name), 1).render().px)


def test_bad_keys_are_named() -> None:
    for table, key, value, text in (
        ("drops", "rain_per_minute", -1.0, "drops.rain_per_minute"),
        ("video", "loss", 1.0, "video.loss"),
        ("lamps", "floods", 9, "lamps.floods"),
        ("camera", "readout_s", 0.5, "camera.readout_s"),
        ("light", "visibility_m", 1.0, "light.visibility_m"),
    ):
        with pytest.raises(BadInput, match=text):
            from_mapping({"title": "x", table: {key: value}}, "here.toml")
    with pytest.raises(BadInput, match="video: bitrate"):
        VideoLinkOptions(0.0)
