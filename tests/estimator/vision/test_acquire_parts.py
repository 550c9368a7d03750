"""What acquisition is made of: specks and patches, circles, headings, strokes, and laying the drawing on the frame."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.geometry import F64, Rotation
from estimator.core.interface.eyes import TEMPLATE_ONE
from estimator.vision.camera import Camera
from estimator.vision.detect.acquire import circle_normals
from estimator.vision.detect.alignment import SIGMA_TILT_RAD, align
from estimator.vision.detect.circles import Plane, circles
from estimator.vision.detect.heading import heading
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.detect.scan import blobs, coarse, disc_regions, limits
from estimator.vision.detect.strokes import h_markings
from estimator.vision.detect.template import DISC, ORANGE, STEP_M, H, paints_at, polar_drawing, template
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from sitl.light import Light
from tests.support.deck_images import shown
from tests.support.pad_images import sim_camera


def test_a_part_of_a_small_image_is_that_part_of_the_small_image() -> None:
    px = np.random.default_rng(0).integers(0, 256, (361, 643, 3), np.uint8)
    for level, box in (
        (0, (3, 5, 40, 50)),
        (1, (7, 9, 60, 70)),
        (2, (0, 0, 30, 20)),
        (3, (50, 30, 80, 45)),
        (2, (0, 0, 160, 90)),
    ):
        left, top, right, below = box
        assert np.array_equal(Pyramid(px).cut(level, *box), Pyramid(px)[level][top:below, left:right])
        assert Pyramid(px).size(level) == Pyramid(px)[level].shape[1::-1]


@given(
    roll=st.floats(-0.6, 0.6), pitch=st.floats(-0.6, 0.6), x=st.floats(-0.4, 0.4), y=st.floats(-0.3, 0.3),
    depth=st.floats(0.5, 20.0),
)  # fmt: skip
@settings(max_examples=60)
def test_the_normals_of_an_ellipse_contain_that_of_its_circle(
    roll: float, pitch: float, x: float, y: float, depth: float
) -> None:
    R = Rotation.from_rpy(roll, pitch, 0.0).matrix
    centre = np.array([x, y, 1.0]) * depth
    if float(R[:, 2] @ centre) < 0.3 * depth:
        return
    # The cone through the circle, as a conic at unit depth.
    e1, e2, n, r = R[:, 0], R[:, 1], R[:, 2], 0.39
    M = np.stack([e1, e2, centre], axis=1)
    Minv = np.linalg.inv(M)
    Q = Minv.T @ np.diag([1.0, 1.0, -(r**2)]) @ Minv
    A, b, c = Q[:2, :2], Q[:2, 2], Q[2, 2]
    mid = -np.linalg.solve(A, b)
    scale = float(mid @ A @ mid - c)
    values, vectors = np.linalg.eigh(A / scale)
    got = circle_normals(mid, values**-0.5, math.atan2(vectors[1, 0], vectors[0, 0]))
    assert got
    assert min(math.acos(min(1.0, abs(float(g @ n)))) for g in got) < 1e-3
    assert all(g[2] > 0 for g in got)


@given(
    cx=st.floats(-0.3, 0.3), cy=st.floats(-0.3, 0.3), radius=st.floats(0.02, 0.6), start=st.floats(0.0, 6.28),
    arc=st.floats(3.2, 6.28), seed=st.integers(0, 99),
)  # fmt: skip
@settings(max_examples=60)
def test_a_circle_is_found_in_an_outline_with_a_chord_across_it(
    cx: float, cy: float, radius: float, start: float, arc: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    a = start + np.linspace(0.0, arc, 120)
    on = np.stack([cx + radius * np.cos(a), cy + radius * np.sin(a)], axis=1)
    chord = on[-1] + np.linspace(0.0, 1.0, 40)[:, None] * (on[0] - on[-1])
    outline = np.concatenate([on, chord]) + rng.normal(0, 0.003 * radius, (160, 2))
    found = circles(outline, 0.004, 0.025)
    assert found
    assert np.hypot(*(found[0].centre - (cx, cy))) < 0.06 * radius
    assert found[0].radius == pytest.approx(radius, rel=0.06)
    assert found[0].arc_rad > 0.6 * arc


def test_points_on_a_line_or_none_at_all_make_no_circle() -> None:
    line = np.stack([np.linspace(0, 1, 50), np.linspace(0, 2, 50)], axis=1)
    nowhere: list[F64] = [line, np.empty((0, 2)), np.full((30, 2), np.nan), np.zeros((30, 2))]
    for points in nowhere:
        assert circles(points, 0.01, 0.03) == []


def test_shares_of_the_drawing_add_up_and_match_its_areas(pad: Pad) -> None:
    drawn = template(pad)
    assert np.abs(drawn.coverage.sum(axis=3) - TEMPLATE_ONE).max() <= 2, "rounded"
    area = drawn.coverage[0].sum(axis=(0, 1)) / TEMPLATE_ONE * STEP_M**2
    h_marking = 2 * pad.markings.h_length_m * pad.markings.leg_width_m + pad.markings.bar_length_m * pad.markings.bar_width_m
    assert area[H] == pytest.approx(h_marking, rel=0.02)
    ring = math.pi * (pad.markings.ring_outer_m**2 - pad.markings.ring_inner_m**2)
    assert ring < area[ORANGE] < ring + pad.markings.arrow_depth_m * pad.markings.arrow_half_base_m
    assert area[DISC] == pytest.approx(math.pi * pad.disc_radius_m**2 - area[H] - area[ORANGE], rel=0.01)
    assert np.abs(drawn.local.sum(axis=3)).max() <= 2, "less its neighbourhood"
    places = polar_drawing(pad).xy_m
    assert sum(m.sum() for m in paints_at(places, pad)) == np.count_nonzero(np.hypot(*places.T) <= pad.disc_radius_m)


@pytest.mark.parametrize("yaw_deg", [-170, -95, -31, 0, 12, 77, 149])
def test_heading_at_all_angles(camera: Camera, pad: Pad, yaw_deg: int) -> None:
    seen = shown(camera, pad, 1.5, yaw_rad=math.radians(yaw_deg))
    unturned = PadPose(seen.truth.R_cam_pad @ Rotation.from_rpy(0, 0, 1.0), seen.truth.t_cam_pad)
    got = heading(seen.px, 1, camera, pad, unturned)
    assert got is not None
    assert math.degrees(abs(math.remainder(got.turn_rad + 1.0, math.tau))) < 2.0
    assert got.arrow > 0.005
    assert got.score > 0.7
    elsewhere = PadPose(seen.truth.R_cam_pad, seen.truth.t_cam_pad + np.array([0.5, 0.0, 0.0]))
    other = heading(seen.px, 1, camera, pad, elsewhere)
    assert other is not None
    assert other.score < 0.5 * got.score
    assert heading(seen.px, 1, camera, pad, PadPose(seen.truth.R_cam_pad, np.array([50.0, 0.0, 1.0]))) is None


@pytest.mark.parametrize("height_m", [0.2, 0.3, 0.5, 0.75])
@pytest.mark.parametrize("kelvin", [3000.0, 9000.0])
def test_the_letter_alone_gives_a_pose_up_to_half_a_turn(camera: Camera, pad: Pad, height_m: float, kelvin: float) -> None:
    seen = shown(camera, pad, height_m, aside=(0.1, -0.05), yaw_rad=0.9, tilt_rad=(0.1, 0.05), light=Light(kelvin))
    found = h_markings(Pyramid(seen.px)[2], 4, camera, pad, Plane.of(camera, seen.R_level_body))
    assert found
    d = found[0].pose.t_cam_pad - seen.truth.t_cam_pad
    assert np.linalg.norm(d) < 0.08 * height_m + 0.01
    yaw = abs((seen.truth.R_cam_pad.inv @ found[0].pose.R_cam_pad).rpy_rad[2])
    assert min(yaw, math.pi - yaw) < 0.12


@pytest.mark.parametrize("seed", range(6))
def test_laying_the_drawing_brings_a_rough_pose_home(camera: Camera, pad: Pad, seed: int) -> None:
    rng = np.random.default_rng([seed, 4])
    height = (0.35, 0.6, 1.0, 2.0, 5.0, 12.0)[seed]
    seen = shown(camera, pad, height, light=Light(glare=0.5 * (seed % 2)))
    off = rng.normal(0, 0.015, 3)
    off[2] = 0.05 * height * rng.choice([-1, 1])
    turn = Rotation.from_rotvec([0.04, -0.03, 0.1])
    rough = PadPose(seen.truth.R_cam_pad @ turn, seen.truth.t_cam_pad + off)
    aligned = align(Pyramid(seen.px), camera, pad, rough, SIGMA_TILT_RAD, 8, local=True)
    assert aligned is not None
    left = aligned.pose.t_cam_pad - seen.truth.t_cam_pad
    assert np.linalg.norm(left[:2]) < 0.015 + 0.0005 * height
    assert abs(left[2]) < 0.02 * height
    assert seen.truth.R_cam_pad.angle_to(aligned.pose.R_cam_pad) < 0.05
    white, disc = aligned.paints[H], aligned.paints[DISC]
    assert np.all(white > disc + 0.2)


def test_the_drawing_is_not_laid_where_there_is_none_of_it(camera: Camera, pad: Pad) -> None:
    seen = shown(camera, pad, 1.0)
    away = PadPose(seen.truth.R_cam_pad, np.array([9.0, 0.0, 1.0]))
    assert align(Pyramid(seen.px), camera, pad, away, SIGMA_TILT_RAD) is None


def test_patches_and_specks_lie_on_the_pad_whatever_the_cast(camera: Camera, pad: Pad) -> None:
    for light in (Light(), Light(3000.0), Light(9000.0, white_balance=(1.2, 0.8, 1.2))):
        seen = shown(camera, pad, 2.0, aside=(0.2, 0.1), light=light)
        uv = camera.project(seen.truth.t_cam_pad[None])[0]
        image = coarse(Pyramid(seen.px)[1], 2, pad)
        first = disc_regions(image, limits(image)[0])[0]
        low, high = first.outline_px.min(axis=0), first.outline_px.max(axis=0)
        radius = camera.fx * pad.disc_radius_m / 2.0
        assert np.abs((low + high) / 2 - uv).max() < 0.05 * radius
        assert (high - low).max() / 2 == pytest.approx(radius, rel=0.08)
        far = shown(camera, pad, 25.0, light=light)
        uv = camera.project(far.truth.t_cam_pad[None])[0]
        assert min(np.hypot(*(s.centre_px - uv)) for s in blobs(coarse(far.px, 1, pad))) < 1.5


def test_a_lens_with_distortion_changes_nothing_for_the_plane() -> None:
    bent = sim_camera((0.0, 0.0, 0.0), (-0.1, 0.02, 0.001, -0.002, 0.0))
    R = Rotation.from_rpy(0.1, -0.2, 0.0)
    plane = Plane.of(bent, R)
    pose = plane.pose(np.array([0.1, -0.2]), 0.2, 0.39)
    rim = np.array([[0.39 * math.cos(a), 0.39 * math.sin(a), 0.0] for a in np.arange(0, 6.2, 0.5)])
    places = plane.places(bent, bent.project(pose.points(rim)))
    assert np.allclose(np.hypot(*(places - (0.1, -0.2)).T), 0.2, atol=1e-9)
