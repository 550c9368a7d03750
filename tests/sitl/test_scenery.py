"""Everything around the pad: whole frames from anywhere, the same bits for the same seed, and no pad where none is."""

import math
from functools import cache
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from estimator.contracts.geometry import Rotation
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import Light
from sitl.camera.projection import F32, lens_of
from sitl.camera.render.pad import smear
from sitl.camera.surroundings import Decal, DecalKind, Deck, Surroundings
from sitl.sea.sea import SEA_STATES, Waves
from sitl.vessel.seakeeping import FERRY, SUPPLY_SHIP
from sitl.vessel.vessel import Mooring, Vessel
from tests.sitl.images import BENT, PLAIN, pad, project, shot
from tests.support.plain_light import FLAT, IDEAL

AFLOAT = tuple(Decal(kind, (2.0 * i, -3.0 * i), 1.5, 0.4 * i) for i, kind in enumerate(get_args(DecalKind)))
FULL_SCENE = Surroundings(Deck.of(FERRY, 0.3), Waves.draw(SEA_STATES[4], 2), AFLOAT, wake_speed_m_s=3.0)


@cache
def renderers() -> list[Renderer]:
    return [Renderer(c, pad("printed"), FULL_SCENE, Light(glare=0.5, wetness=0.5)) for c in (PLAIN, BENT)]


def scene(around: Surroundings, s: Exposure, painted: bool = False) -> F32:
    return Renderer(PLAIN, pad("thesis") if painted else None, around, FLAT, IDEAL).radiance(s)


def test_the_same_shot_and_seed_give_the_same_bits_from_a_new_renderer_too() -> None:
    moving = replace(shot(2.0), v_body_ned=np.array([1.0, 0.5, 0.2]), w_body=np.array([0.1, 0.0, 0.5]))
    first, second = (Renderer(BENT, pad("thesis"), FULL_SCENE) for _ in range(2))
    a = first.render(moving, np.random.default_rng(11))
    first.render(shot(0.4), np.random.default_rng(1))
    assert np.array_equal(a, first.render(moving, np.random.default_rng(11))), "no memory of frames between"
    assert np.array_equal(a, second.render(moving, np.random.default_rng(11)))
    assert not np.array_equal(a, first.render(moving, np.random.default_rng(12)))


@given(
    which=st.deferred(lambda: st.sampled_from(renderers())),
    p=st.tuples(st.floats(-30, 30), st.floats(-30, 30), st.floats(-40, 1)),
    rpy=st.tuples(st.floats(-3.2, 3.2), st.floats(-1.5, 1.5), st.floats(-3.2, 3.2)),
    pad_rpy=st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-3.2, 3.2)),
    v=st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(-20, 20)),
)
@settings(max_examples=60)
def test_an_image_comes_from_anywhere_in_any_attitude(which, p, rpy, pad_rpy, v):
    at = np.array([0.0, 0.0, -0.6])
    s = Exposure(3.0, Rotation.from_rpy(*rpy), np.array(p), Rotation.from_rpy(*pad_rpy), at, v_body_ned=np.array(v))
    image = which.render(s, np.random.default_rng(0))
    assert (image.shape, image.dtype) == ((360, 640, 3), np.uint8)
    assert np.all(np.isfinite(which.radiance(s)))


@pytest.mark.parametrize("height_m", [0.2, 0.06, 0.02, 0.0, -0.02])
def test_standing_on_the_pad_and_a_little_under_it_still_gives_an_image(height_m: float) -> None:
    for renderer in renderers():
        assert np.all(np.isfinite(renderer.radiance(shot(height_m))))


def test_the_pad_is_hidden_from_below() -> None:
    s = shot(2.0)
    flipped = replace(s, p_body_ned=s.p_body_ned + np.array([0.0, 0.0, 4.0]), R_ned_body=Rotation.from_rpy(math.pi, 0.0, 0.0))
    assert np.array_equal(scene(Surroundings(), flipped, painted=True), scene(Surroundings(), flipped))


def test_the_deck_s_edge_is_where_opencv_projects_it() -> None:
    deck = Deck(4.0, 2.0, (0.5, 0.1), pad_yaw_rad=0.4)
    high = shot(6.0)
    on_deck, sea = scene(Surroundings(deck), high), scene(Surroundings(None), high)
    c, s = math.cos(0.4), math.sin(0.4)
    in_pad = np.c_[deck.outline() @ np.array([[c, -s], [s, c]]), np.zeros(4)]
    inside, outside = (project(PLAIN, high, in_pad.mean(axis=0) + f * (in_pad - in_pad.mean(axis=0))) for f in (0.97, 1.03))
    for uv in np.round(inside).astype(int):
        assert np.abs(on_deck[uv[1], uv[0]] - sea[uv[1], uv[0]]).max() > 0.01
    brightness = [on_deck[v, u].mean() for u, v in np.round(outside).astype(int)]
    assert max(brightness) < 0.12, "the sea and the hull's side are darker than the deck"


def test_waves_move_the_sea_and_calm_water_differs_from_rough() -> None:
    high, rough = shot(12.0), Surroundings(None, Waves.draw(SEA_STATES[5], 1))
    a, b = scene(rough, high), scene(rough, replace(high, t_s=high.t_s + 0.5))
    assert np.abs(a - b).mean() > 1e-3
    assert a[..., 1].std() > 1.2 * scene(Surroundings(None), high)[..., 1].std()


def test_every_decal_shows_on_deck_and_afloat() -> None:
    above = shot(6.0)
    for deck, on, at in ((Deck(), "deck", (0.0, 0.0)), (None, "sea", (3.0, -2.0))):
        bare = scene(Surroundings(deck), above)
        for kind in get_args(DecalKind):
            with_it = scene(Surroundings(deck, decals=(Decal(kind, at, 0.8, on=on),)), above)  # type: ignore[arg-type]
            assert (np.abs(with_it - bare).max(axis=2) > 0.02).sum() > 200, (kind, on)


def test_the_vessel_s_pad_is_where_its_image_shows_it() -> None:
    # Vessel, shot and frame together: the pad stays in the middle of a camera that follows it.
    waves = Waves.draw(SEA_STATES[1], 4)
    vessel = Vessel(SUPPLY_SHIP, waves, heading_rad=1.0, speed_m_s=2.0, mooring=Mooring(), seeds=4)
    for t in (0.0, 30.0):
        at, body = vessel.pad_at(t), Rotation.from_rpy(0.0, 0.0, 1.0)
        p_body = at.p_ned - np.array([0, 0, 3.0]) - body @ PLAIN.T_body_cam.t
        s = Exposure(t, body, p_body, Rotation(at.R_ned), at.p_ned, at.v_ned, np.zeros(3), at.v_ned)
        blue, green, red = np.moveaxis(scene(Surroundings(Deck.of(SUPPLY_SHIP), waves), s, painted=True), 2, 0)
        yy, xx = np.nonzero((green > 0.045) & (red < 0.022) & (blue < 0.022))
        assert np.hypot(xx.mean() - 319.5, yy.mean() - 179.5) < 2.0


@pytest.mark.parametrize("way", [(3.0, 1.0), (-9.0, 4.0), (2.0, -21.0), (30.0, 1.0)])
def test_a_smear_is_as_long_as_the_way_and_moves_nothing(way: tuple[float, float]) -> None:
    lens, at_m = lens_of(PLAIN), np.array([0.0, 0.0, 5.0])
    dot = np.zeros((PLAIN.height, PLAIN.width, 4), np.uint16)
    dot[PLAIN.height // 2, PLAIN.width // 2] = 60000
    off_m = np.array([5.0 * way[0] / PLAIN.fx, 5.0 * way[1] / PLAIN.fy, 0.0])
    ends = [(np.eye(3), at_m + s * off_m) for s in (-0.5, 0.5)]
    seen = smear(dot, lens, (np.eye(3), at_m), ends)[..., 0].astype(float)
    mass = np.where(seen > 200, seen, 0.0)
    y, x = np.mgrid[: PLAIN.height, : PLAIN.width]
    at = np.array([(mass * x).sum(), (mass * y).sum()]) / mass.sum() - (PLAIN.width // 2, PLAIN.height // 2)
    assert np.abs(at).max() < 0.6
    along = np.array(way) / math.hypot(*way)
    off = (x - PLAIN.width // 2 - at[0]) * along[0] + (y - PLAIN.height // 2 - at[1]) * along[1]
    deviation = math.sqrt((mass * off**2).sum() / mass.sum())
    assert deviation == pytest.approx(math.hypot(math.hypot(*way) / math.sqrt(12.0), 0.4), rel=0.15)
    assert mass.sum() == pytest.approx(60000, rel=0.1)
