"""The rendered pad against OpenCV's projection and against many points a pixel: edges, blur of motion and lens, rolling shutter.

Positions are measured in linear light, as a sensor adds it up: the 50 % crossing of an edge in sRGB values lies elsewhere.

Of frames one after the other: automatics that lag, a driven exposure, a link that loses packets, a renderer of its own.
"""

import math
import multiprocessing
import os
import signal
from functools import cache
from itertools import pairwise
from typing import get_args

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from drivers.camera.exposure import ExposureDrive, ExposureSetting
from drivers.camera.exposure_law import ExposureGovernor
from drivers.camera.metering import TARGET, Metered, meter_inside
from drivers.camera.options import ExposureOptions
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera.camera import Camera
from estimator.vision.pad.geometry import covers
from estimator.vision.pad.pad import Pad
from estimator.vision.pad.shapes import part_of
from estimator.vision.srgb import linear_light
from sitl.camera import light
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.film import Adjusted, Automatics, Film, SimulatedExposure, Taken, VideoLink, adjust, taken_with
from sitl.camera.light import Light, Sensor
from sitl.camera.projection import F32, lens_of
from sitl.camera.render.pad import PadPainter, Stroke, smear
from sitl.camera.render_worker import render_worker
from sitl.camera.settings import LampSettings, VideoSettings
from sitl.camera.surroundings import Decal, DecalKind, Deck, Surroundings
from sitl.core.abi import DL_PAD_PAINTS
from sitl.core.library import SIM
from sitl.emulators.autopilots.body import Body
from sitl.scenario.scenario import load
from sitl.sea.sea import SEA_STATES, Waves
from sitl.vessel.seakeeping import FERRY, SUPPLY_SHIP
from sitl.vessel.vessel import Mooring, Vessel
from sitl.world import stage
from tests.sitl.images import BENT, BLACK, PLAIN, WHITE, pad, pad_pose, project, shot
from tests.support.plain_light import FLAT, IDEAL
from tests.support.shipped import shipped_pad

FULL = replace(FLAT, exposure_ev=math.log2(1.25))
"""White paint just reaches full scale."""
SOFT_PX = 1.2
"""Blur put on shares before edges are sought: pixels sample too coarsely to be interpolated as they are."""
WHITE_ALL = pad("thesis", disc=WHITE, ring=WHITE, h=WHITE)
POSES = [
    pytest.param(PLAIN, shot(1.0), id="straight_1m"),
    pytest.param(PLAIN, shot(1.2, (0.2, -0.1), (0.15, -0.2, 2.0)), id="tilted_1.2m"),
    pytest.param(BENT, shot(1.5, (0.25, 0.1), (-0.1, 0.12, -1.0)), id="distorted_1.5m"),
    pytest.param(BENT, shot(0.8, (-0.55, 0.25), (0.1, 0.1, 0.4)), id="distorted_partial_0.8m"),
]


def share(
    camera: Camera, s: Exposure, part: str, sensor: Sensor = IDEAL, sky: Light = FULL, lamps: LampSettings | None = None,
    finished: bool = False,
) -> F64:  # fmt: skip
    """(H, W) share of a pixel that one paint of the pad covers, from frames alone: 8-bit ones if finished, or their light."""

    def seen(p: Pad | None) -> F64:
        renderer = Renderer(camera, p, Surroundings(), sky, sensor, lamps)
        if finished:
            return linear_light(renderer.render(s, np.random.default_rng(0))[..., 1])
        return renderer.radiance(s)[..., 1].astype(float)

    without = seen(None if part == "disc" else pad("thesis", disc=BLACK))
    lit = seen(WHITE_ALL if part == "disc" else pad("thesis", **{part: WHITE}))
    return (lit - without) / (1.0 - (without if part == "disc" else 0.0))


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


def by_points(camera: Camera, s: Exposure, p: Pad, n: int, sigma_px: float) -> tuple[tuple[slice, slice], dict[str, F64]]:
    """Part of the frame, and what disc, orange and white have of its pixels: n x n points a pixel, blurred, then averaged."""
    outline = project(camera, s, p.circle(p.disc_radius_m))
    (x0, y0), (x1, y1) = (np.floor(outline.min(axis=0)) - 9).astype(int), (np.ceil(outline.max(axis=0)) + 10).astype(int)
    x0, y0, x1, y1 = max(0, x0), max(0, y0), min(camera.width, x1), min(camera.height, y1)
    x, y = ((np.arange((end - first) * n) + 0.5) / n - 0.5 + first for first, end in ((x0, x1), (y0, y1)))
    hits = paints(camera, s, p, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    out = {}
    for part, hit in hits.items():
        soft = gaussian_filter(hit.reshape(len(y), len(x)).astype(float), sigma_px * n, truncate=5.0)
        out[part] = soft.reshape(y1 - y0, n, x1 - x0, n).mean(axis=(1, 3))
    return (slice(y0, y1), slice(x0, x1)), out


def crossings(shares: F64, at_px: F64, along_px: F64) -> F64:
    """(N,) px by which the 50 % crossing lies off `at_px` along the unit vectors `along_px`; the share rises with them."""
    s = np.linspace(-2.0, 2.0, 81)
    places = at_px[:, None] + s[:, None] * along_px[:, None]
    profile = map_coordinates(gaussian_filter(shares, SOFT_PX), [places[..., 1], places[..., 0]], order=3, mode="nearest")
    rises = (profile[:, :-1] < 0.5) & (profile[:, 1:] >= 0.5)
    assert rises.any(axis=1).all()
    i, row = rises.argmax(axis=1), np.arange(len(rises))
    before, after = profile[row, i], profile[row, i + 1]
    return np.asarray(s[i] + (0.5 - before) / (after - before) * (s[1] - s[0]))


def edge(camera: Camera, s: Exposure, points: F64, inward: F64, margin_px: float = 6.0) -> tuple[F64, F64]:
    """Points of an edge (N, 3) in `pad` and its inward normals, as pixels and unit vectors in the frame, if well inside it."""
    uv = project(camera, s, points)
    # An edge's normal does not project onto its frame's normal: turn the frame's tangent instead.
    tangent = np.cross(inward, [0.0, 0.0, 1.0])
    along = project(camera, s, points + 1e-4 * tangent) - project(camera, s, points - 1e-4 * tangent)
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    toward = project(camera, s, points + 1e-3 * inward) - uv
    normal *= np.sign((normal * toward).sum(axis=1, keepdims=True))
    keep = np.all((uv > margin_px) & (uv < np.array([camera.width, camera.height]) - 1 - margin_px), axis=1)
    return uv[keep], normal[keep]


@pytest.mark.parametrize(("camera", "s"), POSES)
@pytest.mark.parametrize("part", ["disc", "h", "ring"])
def test_edges_cross_half_way_where_opencv_projects_them(camera: Camera, s: Exposure, part: str) -> None:
    p = pad("thesis")
    shares = share(camera, s, part, finished=True)
    if part == "disc":
        points = p.circle(p.disc_radius_m, 90)
        uv, inward = edge(camera, s, points, -points / p.disc_radius_m)
    else:
        corners = p.markings.h_corners() if part == "h" else p.markings.arrowhead()
        f, sides, normals = np.linspace(0.35, 0.65, 5)[:, None], [], []
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            n = np.cross([0.0, 0.0, 1.0], b - a)
            # The long sides of the H, and the arrowhead's two slanted ones.
            if np.linalg.norm(b - a) > (0.09 if part == "h" else 0.0) and not (part == "ring" and a[0] == b[0]):
                sides.append(a * (1 - f) + b * f)
                normals.append(np.repeat(n[None] / np.linalg.norm(n), 5, axis=0))
        uv, inward = edge(camera, s, np.concatenate(sides), np.concatenate(normals))
    assert len(uv) >= (20 if part != "ring" else 5)
    off = crossings(shares, uv, inward)
    if part == "disc":
        # Blur moves an arc's half-way point towards its centre by half its variance over the radius.
        depth = np.linalg.norm(project(camera, s, points * 0.9) - project(camera, s, points), axis=1).mean() * 10
        off = off - (SOFT_PX**2 + 1 / 12) / (2 * depth)
    assert np.abs(off).max() < 0.02
    assert abs(off.mean()) < 0.005


@pytest.mark.parametrize("height_m", [2.0, 10.0, 20.0, 30.0])
def test_shares_are_those_of_many_points_also_where_shapes_are_thinner_than_a_pixel(height_m: float) -> None:
    # At 30 m the ring is 0.2 px wide and the arrowhead half a pixel.
    s = shot(height_m, (0.1, 0.05), (0.1, 0.05, 0.3))
    part_of_frame, reference = by_points(PLAIN, s, pad("thesis"), 8 if height_m < 5 else 32, 0.0)
    for part, area_off in (("disc", 1e-3), ("ring", 3e-3), ("h", 1e-3)):
        measured, expected = share(PLAIN, s, part)[part_of_frame], reference[part]
        assert measured.sum() == pytest.approx(expected.sum(), rel=area_off)
        off = np.abs(measured - expected)
        assert np.percentile(off[expected > 0], 99) < (0.05 if height_m < 5 else 0.02)
        assert off.max() < (0.15 if height_m < 5 else 0.03)


@pytest.mark.parametrize(
    ("camera", "s", "sigma_px", "n"),
    [
        pytest.param(PLAIN, shot(3.5, (0.1, 0.05), (0.02, 0.01, 0.01)), 0.6, 16, id="along_the_axes_3.5m"),
        pytest.param(PLAIN, shot(5.0, (0.1, 0.05), (0.3, -0.25, 1.1)), 0.9, 16, id="tilted_5m"),
        pytest.param(BENT, shot(10.0, (0.3, 0.2), (-0.1, 0.15, -1.0)), 0.6, 24, id="distorted_10m"),
        pytest.param(PLAIN, shot(30.0, (0.1, 0.05), (0.1, -0.2, 0.3)), 0.6, 48, id="30m"),
    ],
)
def test_light_is_blurred_before_pixels_sample_it(camera, s, sigma_px, n, monkeypatch):
    sensor = replace(IDEAL, psf_sigma_px=sigma_px)
    part_of_frame, expected = by_points(camera, s, pad("thesis"), n, sigma_px)
    exact = {part: share(camera, s, part, sensor)[part_of_frame] for part in expected}
    monkeypatch.setattr(light, "_LENS_PX_MOST", 0)
    sampled = {part: share(camera, s, part, sensor)[part_of_frame] for part in exact}
    for part in exact:
        off, before = exact[part] - expected[part], sampled[part] - expected[part]
        assert np.sqrt((off**2).mean()) < 0.25 * np.sqrt((before**2).mean())
        assert np.abs(off).max() < 0.02


@pytest.mark.parametrize(
    ("v_body_ned", "w_body", "v_pad_ned", "w_pad"),
    [
        ((2.0, -1.0, 0.5), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.4, -0.3, 1.5), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.5, 0.5, 0.0), (0.0, 0.0, 0.0), (-0.8, 0.6, 0.9), (0.3, 0.3, -0.2)),
    ],
    ids=["flight", "turn", "heaving deck"],
)
def test_motion_blur_is_the_mean_of_the_sharp_images_during_the_exposure(v_body_ned, w_body, v_pad_ned, w_pad):
    exposure_s, still = 0.02, shot(1.5, (0.1, -0.05), (0.05, 0.02, 0.4))
    v, w, vp, wp = (np.array(x) for x in (v_body_ned, w_body, v_pad_ned, w_pad))
    moving = replace(still, v_body_ned=v, w_body=w, v_pad_ned=vp, w_pad=wp)
    painted, blank = pad("thesis", h=WHITE, ring=WHITE), pad("thesis", disc=BLACK)

    def shares(s: Exposure, exposure: float) -> F64:
        sensor = replace(IDEAL, exposure_s=exposure)
        a, b = (Renderer(PLAIN, p, Surroundings(), FULL, sensor).radiance(s)[..., 1] for p in (painted, blank))
        return (a - b).astype(float)

    mean = np.zeros((360, 640))
    for t in (np.arange(40) + 0.5) / 40 * exposure_s - exposure_s / 2:
        there = Exposure(
            4.0, still.R_ned_body @ Rotation.from_rotvec(w * t), still.p_body_ned + v * t,
            still.R_ned_pad @ Rotation.from_rotvec(wp * t), still.p_pad_ned + vp * t,
        )  # fmt: skip
        mean += shares(there, 0.0) / 40
    blurred, sharp = shares(moving, exposure_s), shares(still, 0.0)
    assert np.abs(sharp - mean).max() > 0.4, "the motion shows"
    assert np.sqrt(np.mean((blurred - mean) ** 2)) < 0.06 * np.sqrt(np.mean((sharp - mean) ** 2))
    assert np.abs(blurred - mean).max() < 0.15
    assert blurred.sum() == pytest.approx(mean.sum(), rel=2e-3)


@pytest.mark.parametrize("camera", [PLAIN, BENT], ids=["straight", "distorted"])
def test_a_row_of_a_rolling_shutter_is_that_of_a_global_one_at_the_row_s_time(camera: Camera) -> None:
    readout_s, still = 0.03, shot(1.0, (0.05, 0.03), (0.05, 0.02, 0.4))
    moving = replace(still, v_body_ned=np.array([1.0, -0.6, 0.3]), w_body=np.array([0.6, -0.5, 1.5]))
    rolling = Renderer(camera, pad("thesis"), Surroundings(), FLAT, replace(IDEAL, readout_s=readout_s))
    at_once = Renderer(camera, pad("thesis"), Surroundings(), FLAT, IDEAL)
    rolled, middle, off, whole = rolling.radiance(moving), at_once.radiance(moving), [], []
    for row in range(10, 350, 20):
        t = (row / 359 - 0.5) * readout_s
        R = moving.R_ned_body @ Rotation.from_rotvec(moving.w_body * t)
        then = at_once.radiance(replace(moving, R_ned_body=R, p_body_ned=moving.p_body_ned + moving.v_body_ned * t))[row]
        off.append(rolled[row] - then)
        whole.append(middle[row] - then)
    assert np.sqrt(np.mean(np.square(off))) < 0.08 * np.sqrt(np.mean(np.square(whole)))
    assert np.abs(off).max() < 0.15
    assert np.abs(rolling.radiance(still) - at_once.radiance(still)).max() < 2e-3


FINE = 24
"""Rays along a pixel's side that the coverage is counted with."""
PAINTS = SIM.names("dl_sim_paint")
_PART = {
    "rim": "DL_PAD_RIM",
    "disc": "DL_PAD_DISC",
    "ring": "DL_PAD_ORANGE",
    "letter": "DL_PAD_WHITE",
    "triangle": "DL_PAD_WHITE",
}
SLANTED = Pad.from_mapping({
    "name": "slanted", "paints": {"grey": [60, 60, 60], "white": [240, 240, 240]},
    "regions": [
        {"shape": "disc", "paint": "grey", "radius_m": 0.6},
        {"shape": "stroke", "paint": "white", "from_m": [-0.4, -0.2], "to_m": [0.2, 0.3], "width_m": 0.06},
        {"shape": "polygon", "paint": "white", "points_m": [[0.0, -0.1], [0.4, -0.3], [0.2, -0.1], [0.45, 0.1]]},
    ],
})  # fmt: skip


def painted(pad: Pad, at: np.ndarray) -> np.ndarray:
    """Return the index in `PAINTS` of the topmost paint at points (N, 2) m."""
    out = np.zeros(len(at), int)
    for region in pad.regions:
        upper = region in pad.markings.upper
        out[covers(region, at)] = PAINTS["DL_PAD_UPPER" if upper else _PART[part_of(region)]]
    return out


@pytest.mark.parametrize("pad", [shipped_pad("hospital"), shipped_pad("faa_triangle"), SLANTED], ids=lambda p: p.name)
@pytest.mark.parametrize("height_m", [0.8, 3.0, 12.0])
def test_each_paint_has_its_share_of_a_pixel(pad: Pad, height_m: float) -> None:
    exposure = shot(height_m, (0.05, -0.03), (0.05, -0.04, 0.4))
    pose = pad_pose(exposure, PLAIN)
    R, t = pose.R_cam_pad.matrix, pose.t_cam_pad
    image = PadPainter(lens_of(PLAIN), pad).place([Stroke.still((R, t))])
    some = np.random.default_rng(3).choice(len(image.edges), min(150, len(image.edges)), replace=False)
    v, u = np.divmod(image.edges[some], PLAIN.width)
    fine = (np.arange(FINE) + 0.5) / FINE - 0.5
    du, dv = (g.ravel() for g in np.meshgrid(fine, fine))
    rays = np.stack([
        (u[:, None] + du - PLAIN.cx) / PLAIN.fx, (v[:, None] + dv - PLAIN.cy) / PLAIN.fy, np.ones((len(some), FINE * FINE)),
    ], axis=2) @ R  # fmt: skip
    d = R.T @ t
    at = rays[..., :2] * (d[2] / rays[..., 2])[..., None] - d[:2]
    kinds = painted(pad, at.reshape(-1, 2)).reshape(len(some), -1)
    counted = np.stack([(kinds == k).mean(axis=1) for k in range(DL_PAD_PAINTS)], axis=1)
    off = np.abs(image.shares[some] - counted)
    assert off.max() < 0.09, "corners are cut into products of their sides"
    assert off.mean() < 0.004
    assert np.abs((image.shares[some] - counted).mean(axis=0)).max() < 0.004


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


def test_a_process_of_its_own_makes_the_same_pictures_and_an_interrupt_is_for_the_one_that_it_works_for() -> None:
    cv2.setNumThreads(1)  # as in a flight: a fork while OpenCV's threads work could leave a lock behind
    with render_worker(film(link=LOSSY)) as worker:
        if worker is None:
            pytest.skip("a single processor")
        theirs = [worker.order(s, np.random.default_rng(i)) for i, s in enumerate(shots(4))]
        made = [theirs[0]()]
        for child in multiprocessing.active_children():
            os.kill(child.pid or 0, signal.SIGINT)
        made += [image() for image in theirs[1:]]
        assert all(map(np.array_equal, made, frames(film(link=LOSSY), 4)))


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
