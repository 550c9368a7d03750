"""Things that stand out of the deck about the pad or move are seen; what is painted there and what light does is not."""

import math

import numpy as np
import pytest

from estimator.contracts.geometry import Rotation
from estimator.contracts.time import MonoNs
from estimator.vision.beside_pad import MOVED_LASTS_S, STANDING_LASTS_S, AroundMemory, around
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detection import NearThing
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import Light
from sitl.camera.picture_effects import PictureEffects
from sitl.camera.surroundings import Decal, Deck, Surroundings
from sitl.faults.kinds import Bystander
from sitl.sea.sea import SEA_STATES, Waves
from tests.support.pad_scenes import load_camera, load_pad, truth_of

CAMERA, PAD = load_camera("sim"), load_pad("thesis")
WIDE = Deck(8.0, 5.0, (0.0, 0.0), 0.0, seed=3)


def came_down(surroundings: Surroundings, *bodies: Bystander, light: Light | None = None) -> AroundMemory:
    """Return what is known after an approach from 4.5 m to 1.5 m, with errors of registration."""
    light = light or Light()
    renderer, effects = Renderer(CAMERA, PAD, surroundings, light), PictureEffects(CAMERA, PAD, light, 1)
    rng, memory = np.random.default_rng(4), None
    for k in range(14):
        height_m = 4.5 - 3.0 * k / 13
        R = Rotation.from_rpy(0.03 * math.sin(k), 0.02 * math.cos(k), 0.4)
        pad = np.array([0.0, 0.0, -0.6])
        shot = Exposure(
            0.25 * k, R, pad + np.array([0.06 * math.cos(k), 0.05 * math.sin(k), -height_m]), Rotation.identity(), pad
        )
        px = effects.drawn(renderer.render(shot, rng), bodies, shot, rng)
        memory = around(memory, FrameView(Pyramid(px), CAMERA, PAD), truth_of(shot, CAMERA), MonoNs(10**9 + 250_000_000 * k))
    assert memory is not None
    return memory


def seen(*bodies: Bystander) -> NearThing | None:
    memory = came_down(Surroundings(WIDE), *bodies)
    return memory.near(memory.at)


def test_the_height_and_the_place_of_a_crate_are_seen_by_its_parallax() -> None:
    near = seen(Bystander(at_s=0.0, thing="box", forward_m=0.1, right_m=0.75, width_m=0.4, height_m=0.4))
    assert near is not None
    assert near.height_m == pytest.approx(0.4, abs=0.1)
    assert math.hypot(near.forward_m - 0.1, near.right_m - 0.75) < 0.25


def test_a_person_who_stands_or_walks_beside_the_pad_is_seen() -> None:
    stands = seen(Bystander(at_s=0.0, forward_m=-0.3, right_m=0.8))
    assert stands is not None
    assert stands.height_m > 0.4
    assert seen(Bystander(at_s=0.0, forward_m=-1.0, right_m=0.9, to_forward_m=1.0, to_right_m=0.9, speed_m_s=0.7)) is not None


@pytest.mark.parametrize(
    ("surroundings", "light"),
    [
        (Surroundings(WIDE, decals=(Decal("crate", (0.1, 0.75), 0.4, 0.3, "deck"),)), Light(drone_shadow=0.0)),
        (Surroundings(WIDE), Light(drone_shadow=0.7, sun_elevation_rad=1.2)),
        (Surroundings(Deck(seed=2), Waves.draw(SEA_STATES[4], 3)), Light(drone_shadow=0.0)),
    ],
    ids=["something flat", "the drone's own shadow", "a small deck over waves"],
)
def test_what_lies_flat_and_what_is_light_or_sea_is_nothing(surroundings: Surroundings, light: Light) -> None:
    memory = came_down(surroundings, light=light)
    assert memory.began > 5
    assert memory.near(memory.at) is None


def test_a_deck_without_corners_is_read_again_until_it_has_some() -> None:
    shot = Exposure(0.0, Rotation.identity(), np.array([0.0, 0.0, -3.6]), Rotation.identity(), np.array([0.0, 0.0, -0.6]))
    plain, deck = (
        np.full((360, 640, 3), 90, np.uint8),
        Renderer(CAMERA, PAD, Surroundings(WIDE)).render(shot, np.random.default_rng(1)),
    )
    memory, counts = None, []
    for k, px in enumerate((plain, plain, deck, plain, plain)):
        memory = around(memory, FrameView(Pyramid(px), CAMERA, PAD), truth_of(shot, CAMERA), MonoNs(10**9 + 250_000_000 * k))
        counts.append(len(memory.uv))
    assert counts[:2] == counts[3:] == [0, 0]
    assert counts[2] > 5
    assert memory is not None
    assert memory.near(memory.at) is None


@pytest.mark.parametrize(
    ("body", "lasts_s"),
    [
        (Bystander(at_s=0.0, forward_m=-0.3, right_m=0.8), STANDING_LASTS_S),
        (Bystander(at_s=0.0, forward_m=-1.0, right_m=0.9, to_forward_m=1.0, to_right_m=0.9, speed_m_s=0.7), MOVED_LASTS_S),
    ],
    ids=["it stands", "it moves"],
)
def test_what_was_seen_counts_for_a_time_and_then_no_longer(body: Bystander, lasts_s: float) -> None:
    memory = came_down(Surroundings(WIDE), body)
    assert memory.found_at is not None
    assert memory.near(MonoNs(memory.found_at + round(1e9 * (lasts_s - 0.1)))) is not None
    assert memory.near(MonoNs(memory.found_at + round(1e9 * (lasts_s + 0.1)))) is None
