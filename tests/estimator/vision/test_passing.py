"""Passing objects are seen from high above and in the last half metre; light moving with the drone, and waves, are not."""

import math

import numpy as np
import pytest

from estimator.contracts.geometry import Rotation
from estimator.contracts.time import MonoNs
from estimator.vision.beside_pad import MOVED_LASTS_S
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.passing import PassMemory, passed
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import Light
from sitl.camera.picture_effects import PictureEffects
from sitl.camera.surroundings import Deck, Surroundings
from sitl.faults.kinds import Bystander, Glint
from sitl.sea.sea import SEA_STATES, Waves
from tests.support.pad_scenes import load_camera, load_pad, truth_of

CAMERA, PAD = load_camera("sim"), load_pad("thesis")
WIDE = Surroundings(Deck(8.0, 5.0, (0.0, 0.0), 0.0, seed=3))
BIRD = Bystander(
    at_s=0.0,
    thing="bird",
    forward_m=1.0,
    right_m=-1.5,
    to_forward_m=-1.0,
    to_right_m=1.5,
    width_m=0.5,
    height_m=1.5,
    speed_m_s=3.0,
)


def came_down(
    from_m: float,
    to_m: float,
    *faults: Bystander | Glint,
    scene: Surroundings = WIDE,
    light: Light | None = None,
    gain: float = 1.0,
) -> PassMemory:
    """Return what is known after 1.2 s on the way down, with swings, errors of registration, and an exposure that rises."""
    light = light or Light(drone_shadow=0.0)
    renderer, effects = Renderer(CAMERA, PAD, scene, light), PictureEffects(CAMERA, PAD, light, 1)
    rng, memory = np.random.default_rng(5), None
    for k in range(13):
        height_m = from_m + (to_m - from_m) * k / 12
        R = Rotation.from_rpy(0.04 * math.sin(0.3 * k), 0.03 * math.cos(0.3 * k), 0.4)
        pad = np.array([0.0, 0.0, -0.6])
        aside = np.array([0.06 * math.cos(0.2 * k), 0.05 * math.sin(0.2 * k), -1.0]) * height_m
        shot = Exposure(0.1 * k, R, pad + aside, Rotation.identity(), pad)
        px = effects.drawn(renderer.render(shot, rng), faults, shot, rng)
        px = np.clip(px * gain ** (k / 12), 0, 255).astype(np.uint8)
        true = truth_of(shot, CAMERA)
        off = type(true)(true.R_cam_pad @ Rotation.from_rotvec(rng.normal(0, 0.002, 3)), true.t_cam_pad + rng.normal(0, 0.002, 3))
        memory = passed(memory, FrameView(Pyramid(px), CAMERA, PAD), off, MonoNs(10**9 + 100_000_000 * k))
    assert memory is not None
    return memory


@pytest.mark.parametrize(
    ("from_m", "to_m", "body"),
    [
        (4.8, 3.8, BIRD),
        (2.6, 1.8, BIRD),
        (3.0, 2.2, Bystander(at_s=0.0, forward_m=0.2, right_m=-0.9, to_forward_m=0.0, to_right_m=0.9, speed_m_s=0.8)),
        (
            0.5,
            0.2,
            Bystander(at_s=0.0, forward_m=0.1, right_m=-0.8, to_forward_m=0.1, to_right_m=0.9, height_m=0.15, speed_m_s=0.8),
        ),
    ],
    ids=["a bird far below", "a bird close below", "a person", "a foot that comes in below during the commit"],
)
def test_what_crosses_the_pad_once_is_seen_where_it_is_and_for_a_time(from_m: float, to_m: float, body: Bystander) -> None:
    memory = came_down(from_m, to_m, body)
    near, at = memory.near(memory.at), memory.found_at
    assert near is not None
    assert at is not None
    assert near.from_centre_m < PAD.disc_radius_m + 1.2
    assert memory.near(MonoNs(at + round(1e9 * (MOVED_LASTS_S - 0.1)))) == near
    assert memory.near(MonoNs(at + round(1e9 * (MOVED_LASTS_S + 0.1)))) is None


@pytest.mark.parametrize("heights", [(4.8, 3.6), (2.4, 1.2), (0.7, 0.2)])
@pytest.mark.parametrize(
    ("scene", "light", "gain"),
    [
        (WIDE, Light(drone_shadow=0.7, sun_elevation_rad=1.2), 1.0),
        (WIDE, Light(drone_shadow=0.7, sun_elevation_rad=0.8), 1.0),
        (WIDE, None, 1.6),
        (Surroundings(Deck(seed=2), Waves.draw(SEA_STATES[4], 3)), None, 1.0),
    ],
    ids=["the drone's own shadow", "its shadow in low sun", "a changing exposure", "a small deck over waves"],
)
def test_light_and_waves_do_not_pass(scene: Surroundings, light: Light | None, gain: float, heights: tuple[float, float]) -> None:
    memory = came_down(*heights, scene=scene, light=light, gain=gain)
    assert memory.near(memory.at) is None
    assert (memory.known > 0).any()
