"""Pads of a few pixels are found by the outline of their area, obliquely, in grey, in noise, and without an attitude."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera import Camera
from estimator.vision.detect.acquire import acquire
from estimator.vision.detect.circles import EdgeCircle, blob_circles
from estimator.vision.detect.guesses import Guess, Outline, guesses_from
from estimator.vision.detect.hypotheses import Kind
from estimator.vision.detect.plane import Plane
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.pad import Pad
from tests.support.deck_images import Shown, shown
from tests.support.hard_light import HARD, hard_scene
from tests.support.pad_images import sim_camera

U8 = NDArray[np.uint8]
OBLIQUE = ((0.4, 0.15), (-0.3, 0.35), (0.1, -0.42))


def oval(shape: tuple[int, int], at: tuple[float, float], axes: tuple[float, float], turn: float, ways: tuple[int, int]) -> U8:
    """Return a grey frame with an ellipse of its own shade, whose middle has a third shade."""
    y, x = np.mgrid[: 4 * shape[0], : 4 * shape[1]] / 4.0 - 0.375
    dx, dy = x - at[0], y - at[1]
    u, v = (dx * math.cos(turn) + dy * math.sin(turn)) / axes[0], (dy * math.cos(turn) - dx * math.sin(turn)) / axes[1]
    light = np.full(u.shape, 100.0)
    light[np.hypot(u, v) < 1.0], light[np.hypot(u, v) < 0.4] = ways
    seen = light.reshape(shape[0], 4, shape[1], 4).mean(axis=(1, 3))
    return np.asarray(np.rint(seen)[:, :, None].repeat(3, axis=2), np.uint8)


def outline_of(circle: EdgeCircle) -> tuple[F64, F64]:
    """Return the centre and M of a circle's outline, px."""
    uv = circle.record["outline_px"].reshape(-1, 2)
    return uv.mean(axis=0), 2.0 * np.cov(uv.T, bias=True)


@pytest.mark.parametrize("ways", [(30, 200), (160, 60), (112, 100)])
@pytest.mark.parametrize(("axes", "turn"), [((8.0, 5.0), 0.5), ((14.0, 9.0), -0.8), ((10.0, 10.0), 0.0)])
def test_an_oval_is_the_most_prominent_outline_whatever_is_in_its_middle(ways, axes, turn):
    camera = sim_camera((0.0, 0.0, 0.0))
    px = oval((180, 320), (150.3, 80.7), axes, turn, ways)
    px = np.asarray(px + np.random.default_rng(2).integers(-1, 2, px.shape), np.uint8)
    best = blob_circles(Pyramid(px), camera, Plane.of(camera, None))[0]
    centre, M = outline_of(best)
    assert np.hypot(*(centre - (150.3, 80.7))) < 0.5
    assert np.sqrt(np.linalg.eigvalsh(M)[::-1]) == pytest.approx(axes, abs=1.0)
    assert best.support > 0.8
    assert best.bright_inside == (ways[0] > 100)


def test_nothing_stands_out_of_a_plain_frame_nor_of_stripes_and_noise_that_go_on_beyond_every_window() -> None:
    camera = sim_camera((0.0, 0.0, 0.0))
    plane = Plane.of(camera, None)
    assert blob_circles(Pyramid(np.full((180, 320, 3), 77, np.uint8)), camera, plane) == []
    stripes = np.asarray(60 + 120 * (np.arange(320) % 40 < 20), np.uint8)[None, :, None].repeat(180, axis=0).repeat(3, axis=2)
    assert blob_circles(Pyramid(np.ascontiguousarray(stripes)), camera, plane) == []
    noise = np.random.default_rng(1).integers(0, 256, (180, 320, 3), np.uint8)
    assert all(c.support < 0.8 for c in blob_circles(Pyramid(noise), camera, plane))


@pytest.mark.parametrize("tiny", [(2, 2), (1, 7), (9, 3), (40, 41)])
def test_a_frame_of_a_few_pixels_has_no_outlines(tiny: tuple[int, int]) -> None:
    camera = sim_camera((0.0, 0.0, 0.0))
    px = np.random.default_rng(3).integers(0, 256, (*tiny, 3), np.uint8)
    assert len(blob_circles(Pyramid(px), camera, Plane.of(camera, None))) <= 1


def nearest_guess(seen: Shown, px: U8, camera: Camera, pad: Pad) -> float:
    """Return the smallest error of a guess without an attitude, as a fraction of the range."""
    pyramid, plane = Pyramid(px), Plane.of(camera, None)
    guesses = guesses_from(blob_circles(pyramid, camera, plane), Outline.AREA, pyramid, camera, pyramid.as_seen(pad), plane, 60)
    off = [
        float(np.linalg.norm(g.flat.t_cam_pad - seen.truth.t_cam_pad)) / seen.truth.range_m
        for g in guesses
        if g.flat.R_cam_pad.matrix[:, 2] @ seen.truth.R_cam_pad.matrix[:, 2] > math.cos(math.radians(12.0))
    ]
    return min(off, default=9.0)


@pytest.mark.parametrize("condition", ["black on white", "white on black", "dusk noise 20", "haze 15", "grey"])
@pytest.mark.parametrize("tilt", OBLIQUE)
def test_an_oblique_pad_without_an_attitude_is_guessed_with_its_tilt(camera, condition, tilt):
    hard = HARD[condition]
    seen = shown(camera, hard.pad, 10.0, tilt_rad=tilt)
    px = hard.change(seen.px, np.random.default_rng(4))
    assert nearest_guess(seen, px, camera, hard.pad) < 0.12


@pytest.mark.parametrize(("condition", "height_m", "tilt"), [
    ("white on black", 14.0, OBLIQUE[0]), ("white on black", 12.0, OBLIQUE[1]), ("dusk noise 20", 14.0, OBLIQUE[1]),
    ("grey", 12.0, OBLIQUE[2]),
])  # fmt: skip
def test_a_search_finds_an_oblique_pad_from_afar_without_an_attitude(camera, condition, height_m, tilt):
    hard = HARD[condition]
    seen = shown(camera, hard.pad, height_m, tilt_rad=tilt)
    px = hard.change(seen.px, np.random.default_rng(6))
    best = acquire(px, camera, hard.pad)[0]
    assert np.linalg.norm(best.pose.t_cam_pad - seen.truth.t_cam_pad) < 0.08 * seen.truth.range_m
    assert best.score > 0.1


@pytest.mark.parametrize(("k", "height_m"), [(22, 15.0), (33, 15.0), (36, 10.0)])
def test_ring_and_h_blurred_into_one_are_an_area_of_some_size_between_theirs(camera: Camera, k: int, height_m: float) -> None:
    # The disc is as bright as the deck. Taken for the disc or the ring's outer edge the areas are 20 to 70 % off in range.
    seen = hard_scene(np.random.default_rng([97, k, round(10 * height_m)]), camera, HARD["grey"], height_m)
    pyramid, plane, pad = Pyramid(seen.px), Plane.of(camera, seen.R_level_body), HARD["grey"].pad
    circles = blob_circles(pyramid, camera, plane)
    guesses = guesses_from(circles, Outline.AREA, pyramid, camera, pyramid.as_seen(pad), plane, 60)
    assert seen.truth is not None
    right = [g for g in guesses if np.linalg.norm(g.flat.t_cam_pad - seen.truth.t_cam_pad) < 0.1 * seen.truth.range_m]
    assert max((g.score for g in right), default=0.0) > 0.8 * max(g.score for g in guesses)
    best = acquire(seen.px, camera, pad, seen.R_level_body)[0]
    assert np.linalg.norm(best.pose.t_cam_pad - seen.truth.t_cam_pad) < 0.06 * seen.truth.range_m
    assert best.score > 0.3


def test_a_guess_of_an_area_needs_less_of_the_drawing_only_if_the_area_is_an_ellipse() -> None:
    R, t = Rotation.identity().matrix.ravel().tolist(), (0.0, 0.0, 5.0)
    faint_and_round, faint, clear = (
        Guess(R, t, 0.0, drawing, drawing, True, support) for drawing, support in ((0.02, 0.9), (0.02, 0.5), (0.05, 0.5))
    )
    edges, areas = Kind(1.0, list), Kind(1.0, list, least_round=0.015)
    assert [kind.is_drawn(of) for kind in (edges, areas) for of in (faint_and_round, faint, clear)] == [
        False, False, True, True, False, True,
    ]  # fmt: skip
