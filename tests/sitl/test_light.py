"""Light, sensor and noise: what the settings promise is what the frame shows."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from sitl.camera.camera import Renderer
from sitl.camera.light import FULL_SCALE, Development, Light, Sensor, counts, linear_from_srgb, planck_rgb
from tests.sitl.images import PLAIN, WHITE, pad, project, shot
from tests.support.plain_light import FLAT, IDEAL

OVER = shot(1.0)
STEP = 1.0 / FULL_SCALE
"""Light is kept in steps of this."""
CENTRE = tuple(np.round(project(PLAIN, OVER, np.zeros((1, 3)))[0]).astype(int))


def white_light(light: Light, sensor: Sensor = IDEAL) -> F64:
    """(3,) red, green, blue light on the middle of a pad painted white all over."""
    image = Renderer(PLAIN, pad("thesis", disc=WHITE, ring=WHITE, h=WHITE), None, light, sensor).radiance(OVER)
    return image[CENTRE[1], CENTRE[0], ::-1].astype(float)


def test_white_paint_is_at_four_fifths_of_full_scale_and_a_stop_doubles_it() -> None:
    assert white_light(FLAT) == pytest.approx([0.8] * 3, abs=STEP)
    assert white_light(replace(FLAT, exposure_ev=-2.0)) == pytest.approx([0.2] * 3, abs=STEP)
    assert white_light(replace(FLAT, exposure_ev=2.0)) == pytest.approx([3.2] * 3, abs=STEP)


def test_low_colour_temperatures_are_red_high_ones_blue_and_a_camera_that_follows_sees_white() -> None:
    red, _, blue = white_light(replace(FLAT, colour_temperature_k=3000.0))
    assert red > 1.3 * 0.8
    assert blue < 0.6 * 0.8
    red, _, blue = white_light(replace(FLAT, colour_temperature_k=9000.0))
    assert red < 0.9 * 0.8
    assert blue > 1.1 * 0.8
    assert white_light(replace(FLAT, colour_temperature_k=3000.0, balanced_for_k=None)) == pytest.approx([0.8] * 3, abs=STEP)


def test_planck_is_near_the_known_whites() -> None:
    # CIE illuminant A is 2856 K: linear sRGB (1, 0.449, 0.117) of chromaticity (0.4476, 0.4074); D65 is near 6500 K.
    assert planck_rgb(2856.0) == pytest.approx([1.0, 0.449, 0.117], abs=0.02)
    assert planck_rgb(6500.0) == pytest.approx([1.0, 0.98, 0.98], abs=0.04)


def test_a_white_balance_error_scales_its_channel() -> None:
    assert white_light(replace(FLAT, white_balance=(1.2, 1.0, 0.8))) == pytest.approx([0.96, 0.8, 0.64], abs=STEP)


def test_vignetting_takes_its_share_in_the_corners_and_nothing_in_the_middle() -> None:
    with_it, without = (Renderer(PLAIN, None, None, replace(FLAT, vignetting=v), IDEAL).radiance(OVER) for v in (0.3, 0.0))
    ratio = with_it / without
    assert ratio[0, 0] == pytest.approx([0.7] * 3, abs=1e-3)
    assert ratio[180, 320] == pytest.approx([1.0] * 3, abs=1e-3)


def test_glare_covers_a_third_of_the_disc() -> None:
    p = pad("thesis")
    with_it, without = (Renderer(PLAIN, p, None, replace(FLAT, glare=g), IDEAL).radiance(OVER) for g in (2.0, 0.0))
    added = with_it[..., 1] - without[..., 1]
    spot = (added > 0.8).sum()
    disc = math.pi * np.sum((project(PLAIN, OVER, p.circle(p.disc_radius_m, 4))[0] - CENTRE) ** 2)
    assert spot / disc == pytest.approx(1 / 3, abs=0.05)
    assert added.max() == pytest.approx(1.6, rel=0.01)
    at = project(PLAIN, OVER, np.array([[0.12, 0.08, 0.0]]))[0]
    yy, xx = np.nonzero(added > 0.8)
    assert np.hypot(xx.mean() - at[0], yy.mean() - at[1]) < 1.0


def test_the_drone_s_shadow_falls_away_from_the_sun_by_its_height() -> None:
    light = replace(FLAT, drone_shadow=0.5, sun_elevation_rad=math.radians(75.0), sun_azimuth_rad=1.0)
    low = shot(2.0)
    with_it, without = (Renderer(PLAIN, None, None, replace(light, drone_shadow=d), IDEAL).radiance(low) for d in (0.5, 0.0))
    dark = 1.0 - (with_it / without)[..., 1]
    assert dark.max() == pytest.approx(0.5, abs=0.02)
    assert np.all(dark > -1e-3)
    # Along the sun's rays from the body to the pad's plane, by hand.
    sun = np.array([math.cos(light.sun_elevation_rad) * math.cos(1.0), math.cos(light.sun_elevation_rad) * math.sin(1.0), 0.0])
    sun[2] = -math.sin(light.sun_elevation_rad)
    n = low.R_ned_pad.matrix[:, 2]
    s = n @ (low.p_body_ned - low.p_pad_ned) / (n @ sun)
    where = low.R_ned_pad.matrix.T @ (low.p_body_ned - s * sun - low.p_pad_ned)
    at = project(PLAIN, low, where[None])[0]
    yy, xx = np.nonzero(dark > 0.25)
    assert 60 < at[0] < 580, "the whole shadow is in the frame"
    assert np.hypot(xx.mean() - at[0], yy.mean() - at[1]) < 4.0


def test_wet_paint_is_darker_and_has_puddles_that_mirror_the_sky() -> None:
    black = pad("thesis", disc=(0, 0, 0))
    wet = Renderer(PLAIN, black, None, replace(FLAT, wetness=0.8), IDEAL).radiance(OVER)
    near = wet[CENTRE[1] - 60 : CENTRE[1] + 60, CENTRE[0] - 60 : CENTRE[0] + 60, 1]
    assert near.max() > 0.03
    assert near.min() < 0.01
    assert white_light(replace(FLAT, wetness=1.0))[1] < 0.72


def test_wear_has_its_deviation_and_keeps_the_mean() -> None:
    p = pad("thesis", disc=WHITE, ring=WHITE, h=WHITE)
    image = Renderer(PLAIN, p, None, replace(FLAT, wear=0.1), IDEAL).radiance(shot(0.3))[..., 1] / 0.8
    assert image.mean() == pytest.approx(1.0, abs=0.08)
    assert 0.04 < image.std() < 0.12


def test_noise_has_shot_and_read_parts_and_no_bias() -> None:
    sensor = Sensor(psf_sigma_px=0.0, full_well_e=5000.0, read_noise_e=10.0)
    development = Development(FLAT, sensor)
    rng = np.random.default_rng(3)
    for level in (0.05, 0.2, 0.6):
        images = [development.sensor_image(counts(np.full((360, 640, 3), level, np.float32)), rng) for _ in range(6)]
        values = linear_from_srgb(np.stack(images))
        expected = math.sqrt(level / 5000.0 + (10.0 / 5000.0) ** 2)
        assert values.std() == pytest.approx(expected, rel=0.06)
        assert values.mean() == pytest.approx(level, rel=0.01)
        # Frames are independent of each other.
        a, b = (v - v.mean() for v in values[:2])
        assert abs((a * b).mean()) < 0.02 * expected**2


def test_srgb_blending_moves_the_half_way_crossing_and_linear_does_not() -> None:
    # The same edge pixel, half covered: linear light gives 188, the mean of values 128.
    p = pad("thesis", h=WHITE)
    values = {}
    for blend in ("linear", "srgb"):
        light = replace(FLAT, exposure_ev=math.log2(1.25))
        image = Renderer(PLAIN, p, None, light, replace(IDEAL, blend=blend)).render(shot(10.0), np.random.default_rng(0))
        values[blend] = image[CENTRE[1] - 20 : CENTRE[1] + 21, CENTRE[0] - 20 : CENTRE[0] + 21, 1].astype(float)
    part = (values["srgb"] > 20) & (values["srgb"] < 235) & (np.hypot(*np.mgrid[-20:21, -20:21]) < 7)
    assert part.sum() > 5
    assert np.all(values["linear"][part] > values["srgb"][part] + 5)


@pytest.mark.parametrize(
    ("bad", "text"),
    [
        ({"colour_temperature_k": 500.0}, "colour_temperature_k must lie in 1700..25000 K"),
        ({"white_balance": (1.0, 0.0, 1.0)}, "white_balance gains must be positive"),
        ({"wetness": 1.5}, "wetness must lie in 0..1"),
        ({"glare": -1.0}, "glare 0 or more"),
        ({"sun_elevation_rad": 0.0}, "sun_elevation_rad"),
    ],
)
def test_light_out_of_range_is_refused(bad: dict[str, float], text: str) -> None:
    with pytest.raises(BadInput, match=text):
        Light(**bad)
