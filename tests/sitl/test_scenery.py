"""Everything around the pad: whole frames from anywhere, the same bits for the same seed, and no pad where none is."""

import math
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import Rotation
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import Light, Sensor
from sitl.camera.surroundings import Decal, DecalKind, Deck, Surroundings
from sitl.sea.sea import SEA_STATES, SHELTERED_SLIGHT, Waves
from sitl.vessel.seakeeping import FERRY, SUPPLY_SHIP
from sitl.vessel.vessel import Mooring, Vessel
from tests.sitl.images import BENT, PLAIN, pad, project, shot
from tests.support.plain_light import FLAT, IDEAL

AFLOAT = tuple(Decal(kind, (2.0 * i, -3.0 * i), 1.5, 0.4 * i) for i, kind in enumerate(get_args(DecalKind)))
FULL_SCENE = Surroundings(Deck.of(FERRY, 0.3), Waves.draw(SEA_STATES[4], 2), AFLOAT, wake_speed_m_s=3.0)
RENDERERS = [Renderer(c, pad("printed"), FULL_SCENE, Light(glare=0.5, wetness=0.5)) for c in (PLAIN, BENT)]


def test_the_same_shot_and_seed_give_the_same_bits_from_a_new_renderer_too() -> None:
    moving = replace(shot(2.0), v_body_ned=np.array([1.0, 0.5, 0.2]), w_body=np.array([0.1, 0.0, 0.5]))
    first = Renderer(BENT, pad("thesis"), FULL_SCENE)
    second = Renderer(BENT, pad("thesis"), FULL_SCENE)
    a = first.render(moving, np.random.default_rng(11))
    first.render(shot(0.4), np.random.default_rng(1))
    assert np.array_equal(a, first.render(moving, np.random.default_rng(11))), "no memory of frames between"
    assert np.array_equal(a, second.render(moving, np.random.default_rng(11)))
    assert not np.array_equal(a, first.render(moving, np.random.default_rng(12)))


@given(
    which=st.sampled_from(RENDERERS),
    p=st.tuples(st.floats(-30, 30), st.floats(-30, 30), st.floats(-40, 1)),
    rpy=st.tuples(st.floats(-3.2, 3.2), st.floats(-1.5, 1.5), st.floats(-3.2, 3.2)),
    pad_rpy=st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-3.2, 3.2)),
    v=st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(-20, 20)),
)
@settings(max_examples=60)
def test_an_image_comes_from_anywhere_in_any_attitude(which, p, rpy, pad_rpy, v):
    s = Exposure(
        3.0, Rotation.from_rpy(*rpy), np.array(p), Rotation.from_rpy(*pad_rpy), np.array([0.0, 0.0, -0.6]), v_body_ned=np.array(v)
    )
    image = which.render(s, np.random.default_rng(0))
    assert image.shape == (360, 640, 3)
    assert image.dtype == np.uint8
    assert np.all(np.isfinite(which.radiance(s)))


@pytest.mark.parametrize("height_m", [0.2, 0.06, 0.02, 0.0, -0.02])
def test_standing_on_the_pad_and_a_little_under_it_still_gives_an_image(height_m: float) -> None:
    for renderer in RENDERERS:
        assert np.all(np.isfinite(renderer.radiance(shot(height_m))))


def test_the_pad_is_hidden_from_below_and_the_image_without_one_has_no_paint_of_it() -> None:
    below = shot(2.0)
    flipped = replace(
        below, p_body_ned=below.p_body_ned + np.array([0.0, 0.0, 4.0]), R_ned_body=Rotation.from_rpy(math.pi, 0.0, 0.0)
    )
    with_pad, without = (Renderer(PLAIN, p, Surroundings(), FLAT, IDEAL).radiance(flipped) for p in (pad("thesis"), None))
    assert np.array_equal(with_pad, without)


def test_a_deck_that_only_just_fills_the_frame_leaves_no_sea() -> None:
    # The frame's corners meet the deck within a pixel of its edge, where a quick test by its outline cannot tell.
    high = shot(2.0)
    corners = PLAIN.rays(np.array([(-0.5, -0.5), (639.5, 359.5)])) * 2.0
    length, width = np.abs(corners[1] - corners[0])[::-1]
    level = replace(high, R_ned_pad=Rotation.identity())
    grey = Deck(float(length) + 0.002, float(width) + 0.002, (0.0, 0.0), paint=(200, 200, 200))
    image = Renderer(PLAIN, None, Surroundings(grey), FLAT, IDEAL).radiance(level)
    assert image.shape == (360, 640, 3)


def test_the_deck_s_edge_is_where_opencv_projects_it() -> None:
    deck = Deck(4.0, 2.0, (0.5, 0.1), pad_yaw_rad=0.4)
    high = shot(6.0)
    on_deck, sea = (Renderer(PLAIN, None, Surroundings(d), FLAT, IDEAL).radiance(high) for d in (deck, None))
    c, s = math.cos(0.4), math.sin(0.4)
    in_pad = np.c_[deck.outline() @ np.array([[c, -s], [s, c]]), np.zeros(4)]
    inside, outside = (project(PLAIN, high, in_pad.mean(axis=0) + f * (in_pad - in_pad.mean(axis=0))) for f in (0.97, 1.03))
    for uv in np.round(inside).astype(int):
        assert np.abs(on_deck[uv[1], uv[0]] - sea[uv[1], uv[0]]).max() > 0.01
    brightness = [on_deck[v, u].mean() for u, v in np.round(outside).astype(int)]
    assert max(brightness) < 0.12, "the sea and the hull's side are darker than the deck"


def test_waves_move_the_sea_and_calm_water_differs_from_rough() -> None:
    rough = Renderer(PLAIN, None, Surroundings(None, Waves.draw(SEA_STATES[5], 1)), FLAT, IDEAL)
    high = shot(12.0)
    a, b = rough.radiance(high), rough.radiance(replace(high, t_s=high.t_s + 0.5))
    assert np.abs(a - b).mean() > 1e-3
    calm = Renderer(PLAIN, None, Surroundings(None), FLAT, IDEAL).radiance(high)
    assert a[..., 1].std() > 1.2 * calm[..., 1].std()


def test_every_decal_shows_on_deck_and_afloat() -> None:
    from_above = shot(6.0)
    bare = Renderer(PLAIN, None, Surroundings(), FLAT, IDEAL).radiance(from_above)
    open_sea = Renderer(PLAIN, None, Surroundings(None), FLAT, IDEAL).radiance(from_above)
    for kind in get_args(DecalKind):
        on_deck = Renderer(PLAIN, None, Surroundings(decals=(Decal(kind, (0.0, 0.0), 0.8, on="deck"),)), FLAT, IDEAL)
        assert (np.abs(on_deck.radiance(from_above) - bare).max(axis=2) > 0.02).sum() > 200, kind
        buoyancy = Renderer(PLAIN, None, Surroundings(None, decals=(Decal(kind, (3.0, -2.0), 0.8),)), FLAT, IDEAL)
        assert (np.abs(buoyancy.radiance(from_above) - open_sea).max(axis=2) > 0.02).sum() > 200, kind


def test_the_vessel_s_pad_is_where_its_image_shows_it() -> None:
    # Vessel, shot and frame together: the pad stays in the middle of a camera that follows it.
    waves = Waves.draw(SHELTERED_SLIGHT, 4)
    vessel = Vessel(SUPPLY_SHIP, waves, heading_rad=1.0, speed_m_s=2.0, mooring=Mooring(), seeds=4)
    renderer = Renderer(
        PLAIN, pad("thesis"), Surroundings(Deck.of(SUPPLY_SHIP), waves), FLAT, Sensor(psf_sigma_px=0.0, exposure_s=0.0)
    )
    for t in (0.0, 30.0):
        at = vessel.pad_at(t)
        body = Rotation.from_rpy(0.0, 0.0, 1.0)
        s = Exposure(
            t,
            body,
            at.p_ned - np.array([0, 0, 3.0]) - body @ PLAIN.T_body_cam.t,
            at.rotation(),
            at.p_ned,
            at.v_ned,
            np.zeros(3),
            at.v_ned,
        )
        image = renderer.render(s, np.random.default_rng(0)).astype(int)
        green = (image[..., 1] > 60) & (image[..., 2] < 40) & (image[..., 0] < 40)
        yy, xx = np.nonzero(green)
        assert np.hypot(xx.mean() - 319.5, yy.mean() - 179.5) < 2.0


def test_bad_scenery_is_refused() -> None:
    with pytest.raises(BadInput, match="deck"):
        Deck(length_m=0.1)
    with pytest.raises(BadInput, match="decal raft: size_m"):
        Decal("raft", (0.0, 0.0), 0.0)
    with pytest.raises(ValueError, match="batch of 2"):
        Surroundings(waves=Waves.draw(SHELTERED_SLIGHT, [1, 2]))
    with pytest.raises(BadInput, match="sensor"):
        Sensor(exposure_s=-1.0)
