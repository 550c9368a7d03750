"""The rendered pad against OpenCV's projection and against brute force.

Positions are measured in linear light, as a sensor adds it up: the 50 % crossing of an edge in sRGB values lies elsewhere.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import linear_from_srgb
from sitl.camera.surroundings import Surroundings
from tests.sitl.images import BENT, BLACK, PLAIN, WHITE, pad, project, shot
from tests.support.plain_light import FLAT, IDEAL

FULL = replace(FLAT, exposure_ev=math.log2(1.25))
"""White paint just reaches full scale."""
SOFT_PX = 1.2
"""Blur put on shares before edges are sought: pixels sample too coarsely to be interpolated as they are."""


POSES = [
    pytest.param(PLAIN, shot(1.0), id="straight_1m"),
    pytest.param(PLAIN, shot(1.2, (0.2, -0.1), (0.15, -0.2, 2.0)), id="tilted_1.2m"),
    pytest.param(BENT, shot(1.5, (0.25, 0.1), (-0.1, 0.12, -1.0)), id="distorted_1.5m"),
    pytest.param(BENT, shot(0.8, (-0.55, 0.25), (0.1, 0.1, 0.4)), id="distorted_partial_0.8m"),
]

NEAR = [
    pytest.param(PLAIN, shot(0.6, (0.0, 0.05)), id="straight_0.6m"),
    pytest.param(PLAIN, shot(0.8, (0.1, -0.1), (0.15, -0.2, 2.0)), id="tilted_0.8m"),
    pytest.param(BENT, shot(0.7, (-0.5, 0.25), (0.1, 0.1, 0.4)), id="distorted_partial_0.7m"),
]


def light_of(camera: Camera, s: Exposure, p: Pad | None, finished: bool = True) -> F64:
    """(H, W) linear light of the green channel, white paint = 1: of the 8-bit frame, or before it was cut to eight bits."""
    renderer = Renderer(camera, p, Surroundings(), FULL, IDEAL)
    if not finished:
        return renderer.radiance(s)[..., 1].astype(float)
    image = renderer.render(s, np.random.default_rng(0))
    return linear_from_srgb(image[..., 1])


def brute_force(camera: Camera, s: Exposure, p: Pad, n: int) -> dict[str, F64]:
    """(H, W) share of disc, orange and white by n x n points a pixel, each asked which paint it falls on."""
    h, w = camera.height, camera.width
    off = (np.arange(n) + 0.5) / n - 0.5
    R = (s.R_ned_body.matrix @ camera.T_body_cam.R.matrix).T
    t = R @ (s.p_pad_ned - s.p_body_ned - s.R_ned_body.matrix @ camera.T_body_cam.t)
    M = np.linalg.inv(np.stack([*(R @ s.R_ned_pad.matrix)[:, :2].T, t], axis=1))
    out = {key: np.zeros((h, w)) for key in ("disc", "ring", "h")}
    centre = project(camera, s, np.zeros((1, 3)))[0]
    radius = np.abs(project(camera, s, p.circle(p.disc_radius_m)) - centre).max() + 3
    x0, x1 = int(max(0, centre[0] - radius)), int(min(w, centre[0] + radius + 1))
    y0, y1 = int(max(0, centre[1] - radius)), int(min(h, centre[1] + radius + 1))
    yy, xx = np.mgrid[y0:y1, x0:x1]
    for dy in off:
        for dx in off:
            rays = camera.rays(np.stack([xx.ravel() + dx, yy.ravel() + dy], axis=1))
            q = np.c_[rays, np.ones(len(rays))] @ M.T
            u, v = (q[:, :2] / q[:, 2:]).T
            r, au, av = np.hypot(u, v), np.abs(u), np.abs(v)
            base = p.markings.arrow_tip_m - p.markings.arrow_depth_m
            side = p.markings.arrow_half_base_m * (p.markings.arrow_tip_m - u) - p.markings.arrow_depth_m * av
            half, inner = p.markings.h_width_m / 2, p.markings.h_width_m / 2 - p.markings.leg_width_m
            white = ((av <= half) & (av >= inner) & (au <= p.markings.h_length_m / 2)) | (
                (av < inner) & (au <= p.markings.bar_width_m / 2)
            )
            orange = ((r <= p.markings.ring_outer_m) & (r >= p.markings.ring_inner_m)) | ((u >= base) & (side >= 0))
            for key, hit in (("disc", r <= p.disc_radius_m), ("ring", orange), ("h", white)):
                out[key][y0:y1, x0:x1] += hit.reshape(yy.shape) / n**2
    return out


def share(camera: Camera, s: Exposure, part: str, finished: bool = True) -> F64:
    """(H, W) share of a pixel that one paint of the pad covers, from frames alone: 8-bit ones, or the light before that."""
    without = light_of(camera, s, None if part == "disc" else pad("thesis", disc=BLACK), finished)
    lit = light_of(
        camera, s, pad("thesis", **({part: WHITE} if part != "disc" else {"disc": WHITE, "ring": WHITE, "h": WHITE})), finished
    )
    return (lit - without) / (1.0 - (without if part == "disc" else 0.0))


@pytest.mark.parametrize(("camera", "s"), POSES[:3])
def test_the_disc_s_centroid_and_area_are_those_of_its_projected_outline(camera: Camera, s: Exposure) -> None:
    uv = project(camera, s, pad("thesis").circle(0.390, 2000))
    x, y = uv.T
    x2, y2 = np.roll(uv, -1, axis=0).T
    cross = x * y2 - x2 * y
    area = cross.sum() / 2
    centre = np.array([((x + x2) * cross).sum(), ((y + y2) * cross).sum()]) / (6 * area)
    a = share(camera, s, "disc")
    yy, xx = np.mgrid[0 : camera.height, 0 : camera.width]
    measured = np.array([(a * xx).sum(), (a * yy).sum()]) / a.sum()
    assert np.abs(measured - centre).max() < 0.02
    assert a.sum() == pytest.approx(abs(area), rel=1e-3)


def crossings(shares: F64, at_px: F64, along_px: F64) -> F64:
    """(N,) px by which the 50 % crossing lies off `at_px` along the unit vectors `along_px`; the share rises with them."""
    s = np.linspace(-2.0, 2.0, 81)
    places = at_px[:, None] + s[:, None] * along_px[:, None]
    profile = map_coordinates(gaussian_filter(shares, SOFT_PX), [places[..., 1], places[..., 0]], order=3, mode="nearest")
    rises = (profile[:, :-1] < 0.5) & (profile[:, 1:] >= 0.5)
    assert rises.any(axis=1).all()
    i = rises.argmax(axis=1)
    row = np.arange(len(i))
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


def straight_sides(p: Pad, part: str) -> list[tuple[F64, F64, F64]]:
    """(from, to, inward unit normal), each (3,), of the long sides of the H or of the arrowhead's two slanted ones."""
    corners = p.markings.h_corners() if part == "h" else p.markings.arrowhead()
    out = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if np.linalg.norm(b - a) > (0.09 if part == "h" else 0.0) and not (part == "ring" and a[0] == b[0]):
            n = np.cross([0.0, 0.0, 1.0], b - a)
            out.append((a, b, n / np.linalg.norm(n)))
    return out


@pytest.mark.parametrize(("camera", "s"), POSES)
@pytest.mark.parametrize("part", ["disc", "h", "ring"])
def test_edges_cross_half_way_where_opencv_projects_them(camera: Camera, s: Exposure, part: str) -> None:
    p = pad("thesis")
    shares = share(camera, s, part)
    if part == "disc":
        points = p.circle(p.disc_radius_m, 90)
        uv, inward = edge(camera, s, points, -points / p.disc_radius_m)
    else:
        f = np.linspace(0.35, 0.65, 5)[:, None]
        sides = straight_sides(p, part)
        points = np.concatenate([a * (1 - f) + b * f for a, b, _ in sides])
        uv, inward = edge(camera, s, points, np.concatenate([np.repeat(n[None], 5, axis=0) for _, _, n in sides]))
    assert len(uv) >= (20 if part != "ring" else 5)
    off = crossings(shares, uv, inward)
    if part == "disc":
        # Blur moves an arc's half-way point towards its centre by half its variance over the radius.
        depth = np.linalg.norm(project(camera, s, points * 0.9) - project(camera, s, points), axis=1).mean() * 10
        off = off - (SOFT_PX**2 + 1 / 12) / (2 * depth)
    assert np.abs(off).max() < 0.02
    assert abs(off.mean()) < 0.005


@pytest.mark.parametrize(("camera", "s"), NEAR)
def test_the_h_s_corners_by_line_fits_are_opencv_s(camera: Camera, s: Exposure) -> None:
    p = pad("thesis")
    shares = share(camera, s, "h")
    corners = p.markings.h_corners()
    checked = 0
    for i in range(12):
        lines = []
        for a, b in ((corners[i], corners[(i + 1) % 12]), (corners[i - 1], corners[i])):
            f = np.linspace(0.35, 0.65, 12)[:, None]
            n = np.cross([0.0, 0.0, 1.0], b - a)
            points = a * (1 - f) + b * f
            uv, inward = edge(camera, s, points, np.repeat(n[None] / np.linalg.norm(n), 12, axis=0))
            if len(uv) < 12:
                break
            # A lens bends lines: what is fitted is the found line's offset and turn against the projected one.
            slope, offset = np.polyfit(f[:, 0], crossings(shares, uv, inward), 1)
            lines.append((offset + slope * (0.0 if np.array_equal(a, corners[i]) else 1.0), inward[0]))
        if len(lines) < 2:
            continue
        corner_off = np.linalg.solve(np.stack([n for _, n in lines]), [d for d, _ in lines])
        assert np.abs(corner_off).max() < 0.02
        checked += 1
    assert checked >= 4


@pytest.mark.parametrize("height_m", [2.0, 10.0, 20.0, 30.0])
def test_shares_are_those_of_brute_force_also_where_shapes_are_thinner_than_a_pixel(height_m: float) -> None:
    # At 30 m the ring is 0.2 px wide and the arrowhead half a pixel.
    s = shot(height_m, (0.1, 0.05), (0.1, 0.05, 0.3))
    p = pad("thesis")
    reference = brute_force(PLAIN, s, p, 8 if height_m < 5 else 32)
    for part, area_off in (("disc", 1e-3), ("ring", 3e-3), ("h", 1e-3)):
        measured = share(PLAIN, s, part, finished=False)
        expected = reference[part]
        assert measured.sum() == pytest.approx(expected.sum(), rel=area_off)
        off = np.abs(measured - expected)
        assert np.percentile(off[expected > 0], 99) < (0.05 if height_m < 5 else 0.02)
        assert off.max() < (0.15 if height_m < 5 else 0.03)


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
    exposure_s = 0.02
    still = shot(1.5, (0.1, -0.05), (0.05, 0.02, 0.4))
    v, w, vp, wp = (np.array(x) for x in (v_body_ned, w_body, v_pad_ned, w_pad))
    moving = replace(still, v_body_ned=v, w_body=w, v_pad_ned=vp, w_pad=wp)
    painted, blank = pad("thesis", h=WHITE, ring=WHITE), pad("thesis", disc=BLACK)

    def shares(s: Exposure, exposure: float) -> F64:
        sensor = replace(IDEAL, exposure_s=exposure)
        a, b = (Renderer(PLAIN, p, Surroundings(), FULL, sensor).radiance(s)[..., 1] for p in (painted, blank))
        return (a - b).astype(float)

    mean = np.zeros((360, 640))
    times = (np.arange(40) + 0.5) / 40 * exposure_s - exposure_s / 2
    for t in times:
        there = Exposure(
            4.0, still.R_ned_body @ Rotation.from_rotvec(w * t), still.p_body_ned + v * t,
            still.R_ned_pad @ Rotation.from_rotvec(wp * t), still.p_pad_ned + vp * t,
        )  # fmt: skip
        mean += shares(there, 0.0) / len(times)
    blurred = shares(moving, exposure_s)
    sharp = shares(still, 0.0)
    assert np.abs(sharp - mean).max() > 0.4, "the motion shows"
    assert np.sqrt(np.mean((blurred - mean) ** 2)) < 0.06 * np.sqrt(np.mean((sharp - mean) ** 2))
    assert np.abs(blurred - mean).max() < 0.15
    assert blurred.sum() == pytest.approx(mean.sum(), rel=2e-3)
