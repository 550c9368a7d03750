"""The blur of the lens on the pad's edges, against light that is blurred finely before pixels sample it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from sitl.camera import light
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import Light, PadBlur, Sensor
from sitl.camera.render.light import Lamps
from sitl.camera.surroundings import Surroundings
from sitl.core.abi import DL_GAIN_ONE
from tests.sitl.images import BENT, BLACK, PLAIN, WHITE, pad, project, shot
from tests.support.plain_light import FLAT, IDEAL

FULL = replace(FLAT, exposure_ev=math.log2(1.25))
"""White paint just reaches full scale."""


def paints(camera: Camera, s: Exposure, p: Pad, rays_uv: F64) -> dict[str, NDArray[np.bool_]]:
    """Return whether points of the frame (N, 2) px show disc, orange or white."""
    R = (s.R_ned_body.matrix @ camera.T_body_cam.R.matrix).T
    t = R @ (s.p_pad_ned - s.p_body_ned - s.R_ned_body.matrix @ camera.T_body_cam.t)
    M = np.linalg.inv(np.stack([*(R @ s.R_ned_pad.matrix)[:, :2].T, t], axis=1))
    q = np.c_[camera.rays(rays_uv), np.ones(len(rays_uv))] @ M.T
    u, v = (q[:, :2] / q[:, 2:]).T
    r, au, av, m = np.hypot(u, v), np.abs(u), np.abs(v), p.markings
    half, inner = m.h_width_m / 2, m.h_width_m / 2 - m.leg_width_m
    side = m.arrow_half_base_m * (m.arrow_tip_m - u) - m.arrow_depth_m * av
    return {
        "disc": r <= p.disc_radius_m,
        "ring": ((r <= m.ring_outer_m) & (r >= m.ring_inner_m)) | ((u >= m.arrow_tip_m - m.arrow_depth_m) & (side >= 0)),
        "h": ((av <= half) & (av >= inner) & (au <= m.h_length_m / 2)) | ((av < inner) & (au <= m.bar_width_m / 2)),
    }


def through_the_lens(camera: Camera, s: Exposure, p: Pad, sigma_px: float, n: int) -> tuple[tuple[slice, slice], dict[str, F64]]:
    """Part of the frame, and what disc, orange and white have of its pixels: n x n points a pixel, blurred, then averaged."""
    outline = project(camera, s, p.circle(p.disc_radius_m))
    (x0, y0), (x1, y1) = (np.floor(outline.min(axis=0)) - 9).astype(int), (np.ceil(outline.max(axis=0)) + 10).astype(int)
    x, y = ((np.arange((end - first) * n) + 0.5) / n - 0.5 + first for first, end in ((x0, x1), (y0, y1)))
    hits = paints(camera, s, p, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    out = {}
    for part, hit in hits.items():
        soft = gaussian_filter(hit.reshape(len(y), len(x)).astype(float), sigma_px * n, truncate=5.0)
        out[part] = soft.reshape(y1 - y0, n, x1 - x0, n).mean(axis=(1, 3))
    return (slice(y0, y1), slice(x0, x1)), out


def share(camera: Camera, s: Exposure, part: str, sensor: Sensor, sky: Light = FULL, lamps: Lamps | None = None) -> F64:
    """(H, W) share of a pixel that one paint of the pad covers, from the linear light of frames."""
    white = {"disc": WHITE, "ring": WHITE, "h": WHITE} if part == "disc" else {part: WHITE}
    lit, without = (
        Renderer(camera, p, Surroundings(), sky, sensor, lamps).radiance(s)[..., 1].astype(float)
        for p in (pad("thesis", **white), None if part == "disc" else pad("thesis", disc=BLACK))
    )
    return np.asarray((lit - without) / (1.0 - (without if part == "disc" else 0.0)))


VIEWS = [
    pytest.param(PLAIN, shot(3.5, (0.1, 0.05), (0.02, 0.01, 0.01)), 0.6, 16, id="along_the_axes_3.5m"),
    pytest.param(PLAIN, shot(5.0, (0.1, 0.05), (0.1, 0.05, 0.3)), 0.5, 16, id="5m"),
    pytest.param(PLAIN, shot(5.0, (0.1, 0.05), (0.3, -0.25, 1.1)), 0.9, 16, id="tilted_5m"),
    pytest.param(BENT, shot(10.0, (0.3, 0.2), (-0.1, 0.15, -1.0)), 0.6, 24, id="distorted_10m"),
    pytest.param(PLAIN, shot(30.0, (0.1, 0.05), (0.1, -0.2, 0.3)), 0.6, 48, id="30m"),
]


@pytest.mark.parametrize(("camera", "s", "sigma_px", "n"), VIEWS)
def test_light_is_blurred_before_pixels_sample_it(camera, s, sigma_px, n, monkeypatch):
    sensor, p = replace(IDEAL, psf_sigma_px=sigma_px), pad("thesis")
    part_of_frame, expected = through_the_lens(camera, s, p, sigma_px, n)
    exact = {part: share(camera, s, part, sensor)[part_of_frame] for part in expected}
    monkeypatch.setattr(light, "_LENS_PX_MOST", 0)
    sampled = {part: share(camera, s, part, sensor)[part_of_frame] for part in exact}
    for part in exact:
        off, before = exact[part] - expected[part], sampled[part] - expected[part]
        assert np.sqrt((off**2).mean()) < 0.25 * np.sqrt((before**2).mean())
        assert np.abs(off).max() < 0.02


def test_a_frame_is_the_same_from_its_scene_and_from_its_light() -> None:
    renderer = Renderer(PLAIN, pad("thesis"), Surroundings(), FULL, Sensor(0.0, 0.6))
    s = shot(5.0, (0.1, 0.05), (0.1, 0.05, 0.3))
    scene, development = renderer.render(s, np.random.default_rng(3)), renderer.development(FULL, renderer.sensor)
    lit, blur = renderer._light_on_sensor(s, development, renderer._view(s, development))
    assert blur is not None
    assert np.array_equal(scene, development.sensor_image(lit, np.random.default_rng(3), blur))
    assert not np.array_equal(scene, development.sensor_image(lit, np.random.default_rng(3)))


def test_edges_of_a_floodlit_pad_are_blurred_as_by_day() -> None:
    s, sensor = shot(5.0, (0.1, 0.05), (0.1, 0.05, 0.3)), replace(IDEAL, psf_sigma_px=0.6)
    dim, floods = replace(FULL, daylight_ev=-4.0), Lamps(floods=2, flood_level=0.4)
    white = Renderer(PLAIN, pad("thesis", disc=WHITE, ring=WHITE, h=WHITE), Surroundings(), dim, sensor, floods)
    by_day, lit = share(PLAIN, s, "h", sensor), share(PLAIN, s, "h", sensor, dim, floods)
    there = by_day > 0.01
    assert np.abs(lit / white.radiance(s)[..., 1] - by_day)[there].max() < 0.01


def test_light_that_is_added_follows_factors_on_it() -> None:
    window, added = np.array([2, 1, 3, 2], np.int32), np.full((2, 3, 3), 100, np.int16)
    gains = np.full((5, 6, 3), DL_GAIN_ONE, np.int16)
    gains[1, 3] = DL_GAIN_ONE // 2, DL_GAIN_ONE, 0
    under = PadBlur(window, added).under(gains).added
    assert under[0, :, 1].tolist() == [50, 100, 0]
    assert (np.delete(under[0], 1, axis=1) == 100).all()
    assert (under[1] == 100).all()
