"""Stages of the renderer against what they replace: the swell's light against numpy, a long smear against its length."""

import math

import numpy as np
import pytest

from sitl.camera.light import Light
from sitl.camera.projection import lens_of
from sitl.camera.render.pad import smear
from sitl.camera.render.sea import SeaPainter
from sitl.camera.surroundings import Surroundings
from sitl.sea.sea import SHELTERED_SLIGHT, Waves
from tests.sitl.images import PLAIN


def test_the_light_of_the_swell_is_that_of_its_slope_the_mirrored_sky_and_the_sun() -> None:
    lens, waves = lens_of(PLAIN), Waves.draw(SHELTERED_SLIGHT, 3, towards_rad=0.8)
    painter = SeaPainter(lens, Surroundings(None, waves), Light(), "linear")
    R = np.array([[0.98, -0.17, 0.05], [0.17, 0.985, -0.03], [-0.045, 0.04, 0.998]])
    inverse = lens.plane_from_ray(np.stack([R[0], R[1], R.T @ np.array([0.0, 0.0, 12.0])], axis=1))
    assert inverse is not None
    light = painter._slow(R, inverse, 7.5)
    rays = lens.coarse[::4, ::4].astype(float)
    d = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1)
    met = d @ inverse.T
    slope = waves.longest(24).slope(met[..., :2] / met[..., 2:], 7.5)[0] @ np.array([0.75, 0.66])
    d = d @ R.T / np.linalg.norm(d, axis=-1, keepdims=True)
    light_angles = Light()
    e, a = light_angles.sun_elevation_rad, light_angles.sun_azimuth_rad
    bisector = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), -math.sin(e)]) - d
    glitter = np.exp(-(bisector[..., :2] ** 2).sum(axis=-1) / bisector[..., 2] ** 2 / (2 * 0.16**2))
    level = 52.0 + 95.0 * (1.0 - d[..., 2]) ** 2 + 150.0 * slope + 22.0 * glitter
    there = light[::2, ::2][: rays.shape[0], : rays.shape[1]]
    assert np.allclose(there[..., 0], level[: there.shape[0], : there.shape[1]], atol=2e-2)
    assert np.allclose(there[..., 1], 26.0 + 70.0 * glitter[: there.shape[0], : there.shape[1]], atol=2e-2)
    assert np.ptp(level) > 5.0


@pytest.mark.parametrize("way", [(3.0, 1.0), (-9.0, 4.0), (2.0, -21.0), (30.0, 1.0)])
def test_a_smear_is_as_long_as_the_way_and_moves_nothing(way: tuple[float, float]) -> None:
    lens = lens_of(PLAIN)
    scene = np.zeros((PLAIN.height, PLAIN.width, 4), np.uint16)
    scene[PLAIN.height // 2, PLAIN.width // 2] = 60000
    R, depth = np.eye(3), 5.0
    ends = [(R, np.array([s * way[0] / PLAIN.fx * depth, s * way[1] / PLAIN.fy * depth, depth])) for s in (-0.5, 0.5)]
    seen = smear(scene, lens, (R, np.array([0.0, 0.0, depth])), ends)[..., 0].astype(float)
    mass = np.where(seen > 200, seen, 0.0)
    y, x = np.mgrid[: PLAIN.height, : PLAIN.width]
    at = np.array([(mass * x).sum(), (mass * y).sum()]) / mass.sum() - (PLAIN.width // 2, PLAIN.height // 2)
    assert np.abs(at).max() < 0.6
    along = np.array(way) / math.hypot(*way)
    off = (x - PLAIN.width // 2 - at[0]) * along[0] + (y - PLAIN.height // 2 - at[1]) * along[1]
    deviation = math.sqrt((mass * off**2).sum() / mass.sum())
    assert deviation == pytest.approx(math.hypot(math.hypot(*way) / math.sqrt(12.0), 0.4), rel=0.15)
    assert mass.sum() == pytest.approx(60000, rel=0.1)
