"""Parts of acquisition: circles of edges, headings, strokes, and alignment of the drawing with the frame."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.core.abi import DL_TEMPLATE_ONE
from estimator.vision.camera import Camera
from estimator.vision.detect.alignment import SIGMA_TILT_RAD, align
from estimator.vision.detect.circles import EdgeCircle, Radii, edge_circles
from estimator.vision.detect.colour import disc_colour, is_coloured
from estimator.vision.detect.guesses import Outline, guesses_from
from estimator.vision.detect.heading import heading
from estimator.vision.detect.hypotheses import h_markings
from estimator.vision.detect.plane import Plane
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detect.template import DISC, ORANGE, STEP_M, H, paints_at, polar_drawing, template
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.srgb import LINEAR_LIGHT
from sitl.camera.light import Light
from tests.support.deck_images import shown
from tests.support.pad_images import sim_camera
from tests.support.pad_scenes import load_camera, load_pad, pad_scene

U8 = NDArray[np.uint8]


@pytest.mark.parametrize("range_m", [0.5, 1.5, 4.0])
def test_the_core_reduces_the_parts_that_it_needs_as_the_pyramid_does(range_m: float) -> None:
    camera, pad = load_camera("sim"), load_pad("thesis")
    rng = np.random.default_rng(0)
    scene = pad_scene(rng, camera, pad, range_m, "plain", 0.1)
    assert scene.truth is not None
    unmade, made = Pyramid(scene.px), Pyramid(scene.px)
    made[5]
    found = [align(FrameView(pyramid, camera, pad), scene.truth, SIGMA_TILT_RAD) for pyramid in (unmade, made)]
    assert found[0] is not None
    assert found[1] is not None
    assert np.array_equal(found[0].features, found[1].features)
    assert np.array_equal(found[0].pose.t_cam_pad, found[1].pose.t_cam_pad)


def disc_on(shape: tuple[int, int], at: tuple[float, float], radius: float, inside: int, outside: int) -> U8:
    v, u = np.mgrid[: shape[0], : shape[1]]
    share = np.clip(radius - np.hypot(u - at[0], v - at[1]) + 0.5, 0.0, 1.0)
    return np.asarray(np.rint(outside + share * (inside - outside)), np.uint8)


@given(
    u=st.floats(40.0, 120.0), v=st.floats(35.0, 55.0), radius=st.floats(9.0, 22.0), shades=st.sampled_from([(90, 60), (60, 90)]),
    seed=st.integers(0, 99),
)  # fmt: skip
@settings(max_examples=40)
def test_a_disc_of_little_contrast_is_the_most_prominent_circle(u, v, radius, shades, seed):
    camera = sim_camera((0.0, 0.0, 0.0))
    grey = disc_on((90, 160), (u, v), radius, *shades) + np.random.default_rng(seed).normal(0.0, 2.0, (90, 160))
    best = edge_circles(np.asarray(np.rint(grey), np.uint8), 4, camera, Plane.of(camera, None), Radii(8.5, 1.2, 7), 3)[0]
    middle = camera.rays((np.array([[u, v]]) + 0.5) * 4 - 0.5)[0]
    assert np.hypot(*(best.centre - middle)) < 0.05 * radius * 4 / camera.fx
    assert best.radius == pytest.approx(radius * 4 / camera.fx, rel=0.05)
    assert best.bright_inside == (shades[0] > shades[1])
    assert best.support > 0.8


def test_a_plain_frame_has_no_circles_and_stripes_and_noise_none_with_much_of_an_outline() -> None:
    camera = sim_camera((0.0, 0.0, 0.0))
    plane, radii = Plane.of(camera, None), Radii(6.0, 1.2, 6)
    stripes = np.asarray(60 + 120 * (np.arange(160) % 40 < 20), np.uint8)[None].repeat(90, axis=0)
    assert edge_circles(np.full((90, 160), 77, np.uint8), 4, camera, plane, radii, 6) == []
    noise = np.random.default_rng(1).integers(0, 256, (90, 160), np.uint8)
    for px, most in ((np.ascontiguousarray(stripes), 0.4), (noise, 0.8)):
        assert all(c.support < most for c in edge_circles(px, 4, camera, plane, radii, 6))


@pytest.mark.parametrize("square_px", [6, 14])
def test_a_pattern_everywhere_counts_against_the_circles_that_it_makes(square_px: int) -> None:
    # Every centre has votes from edges all around; a disc of a fifth of their contrast is the first of the few that stand out.
    camera = sim_camera((0.0, 0.0, 0.0))
    v, u = np.mgrid[:180, :320]
    px = disc_on((180, 320), (230.0, 90.0), 20.0, 75, 60)
    px[:, :170] = (60 + 80 * ((u // square_px + v // square_px) % 2))[:, :170]
    found = edge_circles(px, 2, camera, Plane.of(camera, None), Radii(12.0, 1.2, 7), 20)
    assert np.hypot(*(found[0].centre - camera.rays(np.array([[460.5, 180.5]]))[0])) < 0.1 * found[0].radius
    assert len(found) < 8


def discs_on_grey(camera: Camera, at: tuple[float, float], discs: tuple[tuple[float, float], ...], half: bool = False) -> U8:
    """Return a grey frame with discs of (radius px, shade) on each other; with `half`, without their upper halves."""
    fine = np.full((2 * camera.height, 2 * camera.width), 110.0, np.float32)
    for radius, shade in discs:
        middle = (round((2 * at[0] + 0.5) * 16), round((2 * at[1] + 0.5) * 16))
        cv2.circle(fine, middle, round(2 * radius * 16), shade, -1, cv2.LINE_AA, 4)
    if half:
        fine[: round(2 * at[1] + 1)] = 110.0
    return np.asarray(np.rint(cv2.resize(fine, (camera.width, camera.height), interpolation=cv2.INTER_AREA)), np.uint8)


def test_a_bright_circle_does_not_hide_a_dark_one_about_it() -> None:
    camera = sim_camera((0.0, 0.0, 0.0))
    px = discs_on_grey(camera, (328.0, 184.0), ((9.0, 60.0), (5.0, 200.0)))
    found = edge_circles(px, 1, camera, Plane.of(camera, None), Radii(4.5, 1.22, 5), 6)
    sizes = {circle.bright_inside: circle.radius * camera.fx for circle in found}
    assert sizes == {True: pytest.approx(5.0, abs=0.5), False: pytest.approx(9.0, abs=0.5)}


def test_a_search_for_bright_circles_finds_the_same_ones_and_no_dark_one() -> None:
    camera = sim_camera((0.0, 0.0, 0.0))
    plane, radii = Plane.of(camera, None), Radii(4.5, 1.22, 5)
    px = discs_on_grey(camera, (328.0, 184.0), ((9.0, 60.0), (5.0, 200.0)))
    both = edge_circles(px, 1, camera, plane, radii, 6)
    bright = edge_circles(px, 1, camera, plane, radii, 6, only_bright=True)
    assert [c.centre.tolist() for c in bright] == [c.centre.tolist() for c in both if c.bright_inside]
    assert 0 < len(bright) < len(both)


def test_the_disc_s_colour_is_the_logarithm_of_its_channel_less_that_of_the_stronger_of_the_others(pad: Pad) -> None:
    px = np.random.default_rng(5).integers(0, 256, (360, 640, 3), np.uint8)
    light = np.rint(np.log1p(LINEAR_LIGHT[px] / 0.01) * (255.0 / math.log1p(100.0)))
    expected = (80 + light[:, :, 1] - np.maximum(light[:, :, 0], light[:, :, 2])).clip(0, 255)
    assert np.array_equal(disc_colour(px, pad), expected)


def test_half_a_disc_is_more_prominent_than_what_noise_makes_of_smaller_circles() -> None:
    # Ranked by the fraction of an outline that has edges, four of the ten were no circle at all.
    camera = sim_camera((0.0, 0.0, 0.0))
    half = discs_on_grey(camera, (320.0, 180.0), ((9.2, 70.0),), half=True)
    middle, first = camera.rays(np.array([[320.0, 180.0]]))[0], 0
    for seed in range(10):
        noise = np.random.default_rng(seed).normal(0.0, 16.0, (camera.height, camera.width))
        px = np.asarray(np.rint(np.clip(half + cv2.GaussianBlur(noise, (0, 0), 0.8), 0, 255)), np.uint8)
        first += any(
            np.hypot(*(c.centre - middle)) * camera.fx < 2.5 and abs(c.radius * camera.fx - 9.2) < 1.4 and not c.bright_inside
            for c in edge_circles(px, 1, camera, Plane.of(camera, None), Radii(4.5, 1.22, 5), 60)[:2]
        )
    assert first >= 8


@pytest.mark.parametrize("tilt", [(0.35, 0.1), (-0.2, 0.3), (0.0, -0.4), (-0.3, -0.25)])
def test_the_tilt_of_a_disc_is_guessed_without_an_attitude(camera: Camera, pad: Pad, tilt: tuple[float, float]) -> None:
    seen = shown(camera, pad, 2.0, tilt_rad=tilt)
    frame, plane = Pyramid(seen.px), Plane.of(camera, None)
    circles: list[EdgeCircle] = []
    for level in (1, 2):
        grey = np.asarray(cv2.cvtColor(frame[level], cv2.COLOR_BGR2GRAY), np.uint8)
        circles += edge_circles(grey, 1 << level, camera, plane, Radii(5.0 * level, 1.2, 12 // level), 4)
    guesses = [g for one in circles for g in guesses_from([one], Outline.EDGES, frame, camera, pad, plane)]
    tilted = [g.flat for g in guesses if g.tilt_known]
    normal = seen.truth.R_cam_pad.matrix[:, 2]
    near = [g for g in tilted if np.linalg.norm(g.t_cam_pad - seen.truth.t_cam_pad) < 0.1]
    assert min(math.acos(min(1.0, float(g.R_cam_pad.matrix[:, 2] @ normal))) for g in near) < 0.1


@pytest.mark.parametrize("most", [3, 5, 60])
def test_guesses_that_are_known_are_the_guesses_that_would_be_computed(camera: Camera, pad: Pad, most: int) -> None:
    seen = shown(camera, pad, 6.0, tilt_rad=(0.2, 0.1))
    frame, plane = Pyramid(seen.px), Plane.of(camera, None)
    circles: list[EdgeCircle] = []
    for level in (1, 2):
        grey = np.asarray(cv2.cvtColor(frame[level], cv2.COLOR_BGR2GRAY), np.uint8)
        circles += edge_circles(grey, 1 << level, camera, plane, Radii(5.0, 1.2, 7), 6)

    def tried(of: list[EdgeCircle], rated: dict[int, F64] | None = None) -> list[tuple[object, ...]]:
        found = guesses_from(of, Outline.EDGES, frame, camera, pad, plane, most, rated)
        return [(*g.R_cam_pad, *g.t_cam_pad, *g[2:7], None if g.side is None else tuple(g.side)) for g in found]

    rated: dict[int, F64] = {}
    first = tried(circles[::2], rated)
    assert len(first) > 1
    assert rated
    assert tried(circles[::2], rated) == first
    assert tried(circles, rated) == tried(circles)
    assert tried(circles[::-1], rated) == tried(circles[::-1])


def test_shares_of_the_drawing_add_up_and_match_its_areas(pad: Pad) -> None:
    drawn = template(pad)
    assert np.abs(drawn.coverage.sum(axis=3) - DL_TEMPLATE_ONE).max() <= 2, "rounded"
    area = drawn.coverage[0].sum(axis=(0, 1)) / DL_TEMPLATE_ONE * STEP_M**2
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
    aligned = align(FrameView(Pyramid(seen.px), camera, pad), rough, SIGMA_TILT_RAD, 8, local=True)
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
    assert align(FrameView(Pyramid(seen.px), camera, pad), away, SIGMA_TILT_RAD) is None


@pytest.mark.parametrize("light", [Light(), Light(3000.0), Light(9000.0, white_balance=(1.2, 0.8, 1.2))])
def test_the_disc_is_the_first_circle_in_luminance_and_in_colour(camera: Camera, pad: Pad, light: Light) -> None:
    seen = shown(camera, pad, 2.0, aside=(0.2, 0.1), light=light, tilt_rad=(0.2, -0.1))
    plane, px = Plane.of(camera, seen.R_level_body), Pyramid(seen.px)[2]
    colour = disc_colour(px, pad)
    assert is_coloured(colour)
    for image in (np.asarray(cv2.cvtColor(px, cv2.COLOR_BGR2GRAY), np.uint8), colour):
        circle = edge_circles(image, 4, camera, plane, Radii(8.5, 1.2, 7), 1)[0]
        poses = [
            plane.pose(circle.centre, circle.radius, r)
            for r in (pad.disc_radius_m, pad.markings.ring_outer_m, pad.markings.ring_inner_m)
        ]
        assert min(float(np.linalg.norm(p.t_cam_pad - seen.truth.t_cam_pad)) for p in poses) < 0.1
    grey = np.asarray(cv2.cvtColor(cv2.cvtColor(px, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR), np.uint8)
    assert not is_coloured(disc_colour(grey, pad))


def test_a_lens_with_distortion_changes_nothing_for_the_plane() -> None:
    bent = sim_camera((0.0, 0.0, 0.0), (-0.1, 0.02, 0.001, -0.002, 0.0))
    R = Rotation.from_rpy(0.1, -0.2, 0.0)
    plane = Plane.of(bent, R)
    pose = plane.pose(np.array([0.1, -0.2]), 0.2, 0.39)
    rim = np.array([[0.39 * math.cos(a), 0.39 * math.sin(a), 0.0] for a in np.arange(0, 6.2, 0.5)])
    places = plane.places(bent, bent.project(pose.points(rim)))
    assert np.allclose(np.hypot(*(places - (0.1, -0.2)).T), 0.2, atol=1e-9)
