"""Haze, lamps, glint, the mast's shadow and water on the lens: each does to the light what its setting promises."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from sitl.camera.camera import Renderer
from sitl.camera.drops import Drop, Drops, wet_lens
from sitl.camera.light import FULL_SCALE, Light, Mast
from sitl.camera.render.light import Lamps
from sitl.camera.surroundings import Deck, Surroundings
from tests.sitl.images import PLAIN, WHITE, pad, project, shot
from tests.support.plain_light import FLAT, IDEAL

OVER = shot(2.0)
CENTRE = tuple(np.round(project(PLAIN, OVER, np.zeros((1, 3)))[0]).astype(int))
BIG = Surroundings(Deck(30.0, 30.0, (0.0, 0.0)))


def light_of(light: Light, lamps: Lamps | None = None, drops: Drops | None = None) -> F64:
    painted = pad("thesis", disc=WHITE, ring=WHITE, h=WHITE)
    return Renderer(PLAIN, painted, BIG, light, IDEAL, lamps, drops).radiance(OVER).astype(float)


def at_centre(image: F64) -> F64:
    return np.asarray(image[CENTRE[1], CENTRE[0], ::-1])


def test_haze_takes_contrast_with_the_distance_and_adds_its_own_light() -> None:
    hazy = at_centre(light_of(replace(FLAT, visibility_m=20.0)))
    left = 0.02 ** (2.0 / 20.0)
    assert hazy == pytest.approx([0.8 * left + 0.55 * (1.0 - left)] * 3, abs=0.01)
    assert np.array_equal(light_of(replace(FLAT, visibility_m=math.inf)), light_of(FLAT))


def test_daylight_in_stops_and_floodlights_add_up_on_the_pad() -> None:
    dark = replace(FLAT, daylight_ev=-6.0, exposure_ev=5.0)
    assert at_centre(light_of(dark)) == pytest.approx([0.4] * 3, abs=2e-3)
    white = Lamps(floods=3, flood_level=2.0**-6, flood_temperature_k=6500.0)
    lit = light_of(dark, white)
    assert at_centre(lit) == pytest.approx([0.8] * 3, abs=0.01)
    assert at_centre(light_of(dark, replace(white, flood_temperature_k=2700.0)))[0] > 1.1 * at_centre(lit)[0]
    # Under a lamp the deck is brighter than in the pad's middle, against the same deck without lamps.
    near = replace(white, floods=1, flood_distance_m=0.8, flood_height_m=0.5)
    foot = np.round(project(PLAIN, OVER, np.array([[0.8, 0.0, 0.0]]))[0]).astype(int)
    gain = light_of(dark, near)[..., 1] / light_of(dark)[..., 1]
    assert gain[foot[1], foot[0]] > 1.5 * gain[CENTRE[1], CENTRE[0]]


def test_small_lamps_shine_where_they_stand() -> None:
    lamps = Lamps(pad_lamps=6, pad_lamps_radius_m=0.7, pad_lamps_level=2.0)
    added = (light_of(replace(FLAT, daylight_ev=-8.0, exposure_ev=8.0), lamps) - light_of(FLAT))[..., 1]
    ring = 0.7 * np.array([[math.cos(a), math.sin(a), 0.0] for a in np.arange(6) * math.tau / 6])
    for u, v in np.round(project(PLAIN, OVER, ring)).astype(int):
        assert added[v - 1 : v + 2, u - 1 : u + 2].max() > 1.0
    assert abs(at_centre(added[..., None])).max() < 0.05


def test_the_glint_lies_where_the_deck_mirrors_the_sun() -> None:
    light = replace(FLAT, sun_elevation_rad=math.radians(75.0), sun_azimuth_rad=0.7)
    wet = replace(light, wetness=0.5)
    spot = (light_of(replace(wet, glint=2.0)) - light_of(wet))[..., 1]
    e, a = light.sun_elevation_rad, light.sun_azimuth_rad
    to_sun = OVER.R_ned_pad.matrix.T @ np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), -math.sin(e)])
    p_cam = OVER.R_ned_pad.matrix.T @ (OVER.p_body_ned + OVER.R_ned_body @ PLAIN.T_body_cam.t - OVER.p_pad_ned)
    # The ray that comes from the sun and is mirrored in z = 0 reaches the camera from this point.
    mirrored = p_cam + np.array([to_sun[0], to_sun[1], -to_sun[2]]) * (-p_cam[2] / -to_sun[2])
    at = project(PLAIN, OVER, np.array([[mirrored[0], mirrored[1], 0.0]]))[0]
    yy, xx = np.nonzero(spot > 0.3)
    assert np.hypot(xx.mean() - at[0], yy.mean() - at[1]) < 12.0
    assert np.array_equal(light_of(replace(light, glint=2.0)), light_of(light)), "a dry deck does not mirror"


def test_the_mast_s_shadow_falls_away_from_the_sun() -> None:
    sun = replace(FLAT, sun_elevation_rad=math.radians(45.0), sun_azimuth_rad=0.7 + math.pi / 2)
    # The pad's arrow points to 0.7 rad: the sun stands to its right, and the shadow of a mast at (0, 1) crosses the pad.
    dark = 1.0 - light_of(replace(sun, mast=Mast(3.0, (0.0, 1.0), 0.6)))[..., 1] / light_of(sun)[..., 1]
    in_it, beside = np.round(project(PLAIN, OVER, np.array([[0.0, -0.1, 0.0], [0.5, -0.1, 0.0]]))).astype(int)
    assert dark[in_it[1], in_it[0]] == pytest.approx(0.6, abs=0.02)
    assert abs(dark[beside[1], beside[0]]) < 0.01


def test_drops_fall_stay_and_run_off_the_same_whatever_was_requested_before() -> None:
    drops = Drops(rain_per_s=2.0, spray_per_s=0.2, stays_s=3.0, seed=5)
    later = drops.present(33.3, 640, 360)
    assert [len(drops.present(t, 640, 360)) > 0 for t in np.arange(0.0, 60.0, 5.0)].count(True) > 8
    assert drops.present(33.3, 640, 360) == later
    assert replace(drops, seed=6).present(33.3, 640, 360) != later
    numbers = [len(drops.present(float(t), 640, 360)) for t in range(200)]
    assert np.mean(numbers) == pytest.approx((2.0 + 0.2 * 12) * 3.0, rel=0.25)
    # A drop stays where it fell, then only goes down.
    tracks: dict[float, list[float]] = {}
    for t in np.arange(0.0, 12.0, 0.1):
        for drop in Drops(rain_per_s=0.3, stays_s=3.0, seed=1).present(float(t), 640, 360):
            tracks.setdefault(round(drop.radius / 0.65, 0), []).append(drop.y)
    assert any(len(track) > 10 for track in tracks.values())


def test_a_drop_blurs_its_patch_and_nothing_else() -> None:
    fine = (np.indices((360, 640)).sum(axis=0) % 2 * 4000).astype(np.int16)
    light = np.ascontiguousarray(np.repeat(fine[..., None], 3, axis=2))
    before = light.copy()
    wet_lens(light, [Drop(300.0, 150.0, 20.0), Drop(-500.0, 50.0, 20.0)])
    assert light[145:155, 295:305].std() < 0.2 * before[145:155, 295:305].std()
    away = np.hypot(*(np.indices((360, 640)) - np.array([150, 300])[:, None, None])) > 30
    assert np.array_equal(light[away], before[away])
    assert light.min() >= 0
    assert light.max() <= 4 * FULL_SCALE


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Light(visibility_m=0.0), "visibility_m"),
        (lambda: Lamps(floods=1, flood_height_m=0.0), "lamps"),
        (lambda: Drops(rain_per_s=-1.0), "drops"),
        (lambda: Drops(radius_px=0.0), "radius_px"),
    ],
)
def test_impossible_weather_is_refused(make: object, text: str) -> None:
    assert callable(make)
    with pytest.raises(BadInput, match=text):
        make()
