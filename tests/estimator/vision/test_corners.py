"""Right angles, and the corners method that stands on them."""

import math

import cv2
import numpy as np
import pytest

from estimator.contracts.estimates import Sighting
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from estimator.vision.pose import Orientation, OrientedCamera
from estimator.vision.thesis.corners import Side, find_corners, side_of
from estimator.vision.thesis.detection import detect
from estimator.vision.thesis.right_angles import RightAngle, candidates, refine
from estimator.vision.thesis.segmentation import SIMULATOR, segment
from tests.support.pad_images import PadPlacement, errors, image, project


def corners_of(scene: PadPlacement, camera: Camera, pad: Pad, seed: int = 0) -> Sighting | None:
    frame = image(scene, camera, pad, blur_px=0.6, noise=1.5, seed=seed)
    return detect(frame, scene.attitude(), camera, pad, SIMULATOR).methods["corners"]


def wedge(u: float, v: float, heading: float, inner: bool) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    """Return a corner at (u, v): a quarter plane of paint, or all but a quarter, turned by `heading`."""
    n = 8
    x = (np.arange(60 * n) + 0.5) / n - 0.5
    dx, dy = x[None, :] - u, x[:, None] - v
    c, s = math.cos(heading), math.sin(heading)
    quarter = (dx * c + dy * s > 0) & (dy * c - dx * s > 0)
    share = (~quarter if inner else quarter).reshape(60, n, 60, n).mean(axis=(1, 3)).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(share, (0, 0), 0.7), np.float32)


@pytest.mark.parametrize("inner", [False, True])
def test_a_corner_is_found_to_a_few_hundredths_of_a_pixel_with_its_arms(inner: bool) -> None:
    rng = np.random.default_rng(0)
    off: list[float] = []
    for _ in range(12):
        u, v, heading = *rng.uniform(27, 33, 2), rng.uniform(-3, 3)
        share = wedge(u, v, heading, inner)
        found = refine(share, np.rint([[u, v]]) + rng.integers(-2, 3, 2), 9.0)
        assert len(found) == 1
        corner = found[0]
        assert corner.inner is inner
        off.append(float(np.linalg.norm(corner.uv_px - (u, v))))
        along = np.array([[math.cos(heading), math.sin(heading)], [-math.sin(heading), math.cos(heading)]])
        assert np.allclose(corner.arms, along, atol=0.03)
    assert max(off) < 0.12
    assert math.sqrt(np.mean(np.square(off))) < 0.05


def test_what_is_no_right_angle_is_none() -> None:
    """A straight edge, a round blob, a thin line and plain noise."""
    x = np.arange(60.0)
    edge = np.broadcast_to((x > 30).astype(np.float32), (60, 60)).copy()
    disc = (np.hypot(x[None, :] - 30, x[:, None] - 30) < 14).astype(np.float32)
    line = np.broadcast_to((np.abs(x - 30) < 1).astype(np.float32), (60, 60)).copy()
    noise = np.random.default_rng(0).uniform(0, 1, (60, 60)).astype(np.float32)
    everywhere = np.full((60, 60), 255, np.uint8)
    for share in (edge, disc, line, noise):
        start = np.concatenate([candidates(share, everywhere, 12.0), [[30.0, 30.0], [30.0, 16.0]]])
        assert refine(share, start, 9.0) == []


@pytest.mark.parametrize("yaw_deg", [0.0, 20.0, 45.0, 89.0, 90.0, 135.0, -60.0, -179.0])
@pytest.mark.parametrize("height_m", [0.4, 1.0, 2.0])
def test_pose_of_the_h_up_to_half_a_turn(height_m: float, yaw_deg: float, camera: Camera, pad: Pad) -> None:
    scene = PadPlacement((0.16, 0.01, height_m), math.radians(yaw_deg))
    s = corners_of(scene, camera, pad)
    assert s is not None
    assert s.yaw_ambiguous
    assert s.yaw_rad is not None
    assert -math.pi / 2 - 1e-9 < s.yaw_rad <= math.pi / 2 + 1e-9
    d, yaw = errors(s, scene)
    assert abs(math.degrees(yaw)) < 0.2
    assert np.linalg.norm(d[:2]) < 0.0007 * max(1.0, height_m)
    assert abs(d[2]) < 0.004 * height_m


@pytest.mark.parametrize(
    ("place", "side"), [((0.05, 0.0), "long"), ((0.25, 0.0), "long"), ((0.15, -0.16), "short"), ((0.15, 0.16), "short")]
)
def test_two_inner_corners_do_on_the_long_side_and_on_the_short_one(place, side, camera, pad):
    """The thesis' listing had the two sides exchanged, which makes three times the range, or a third."""
    scene = PadPlacement((*place, 0.22), 0.03)
    frame = image(scene, camera, pad, blur_px=0.6, noise=1.5)
    seg = segment(frame.px, SIMULATOR)
    assert seg is not None
    found = find_corners(seg, OrientedCamera(camera, Orientation.of(scene.attitude())), pad)
    assert found is not None
    assert found.side == side
    inner_seen = [tuple(xy) for xy in np.abs(found.marks.pad_xy_m).round(3).tolist()].count((0.02, 0.06))
    assert inner_seen == 2
    s = corners_of(scene, camera, pad)
    assert s is not None
    d, yaw = errors(s, scene)
    assert np.linalg.norm(d) < 0.002
    assert abs(math.degrees(yaw)) < 0.3


@pytest.mark.parametrize(
    ("pair", "side"), [((0, 1), "long"), ((2, 3), "long"), ((1, 2), "short"), ((3, 0), "short"), ((0, 2), None), ((1, 3), None)]
)
def test_arms_tell_the_side_of_the_cross_bar(pair: tuple[int, int], side: Side | None, pad: Pad) -> None:
    """Inner corners drawn by hand, bow up: arms along the leg outwards, arms along the bar inwards."""
    inner = pad.markings.h_corners()[[2, 3, 8, 9], :2]
    corners = []
    for forward, right in inner:
        arms = np.array([[0.0, -math.copysign(1.0, forward)], [-math.copysign(1.0, right), 0.0]])
        corners.append(RightAngle(np.array([300 + 400 * right, 200 - 400 * forward]), arms, True, 0.05))
    assert side_of(corners[pair[0]], corners[pair[1]]) == side


def test_corners_keep_their_fractions_of_a_pixel(camera: Camera, pad: Pad) -> None:
    rng = np.random.default_rng(3)
    off = []
    for i in range(6):
        scene = PadPlacement((0.15 + rng.uniform(-0.01, 0.01), rng.uniform(-0.01, 0.01), 0.9), rng.uniform(-3, 3))
        s = corners_of(scene, camera, pad, seed=i)
        assert s is not None
        true = project(pad.markings.h_corners(), scene, camera)
        for uv in next(f.uv_px for f in s.features if f.label == "corners"):
            off.append(uv - true[np.argmin(np.linalg.norm(true - uv, axis=1))])
    assert len(off) >= 60
    assert np.all(np.abs(np.mean(off, axis=0)) < 0.02)
    assert np.sqrt(np.mean(np.square(off))) < 0.12


def test_figures_drawn_beside_the_h_do_not_move_its_corners(camera: Camera, pad: Pad) -> None:
    """The thesis' code wrote numbers into the very frame it measured. Ours leaves the frame as it was."""
    scene = PadPlacement((0.15, 0.0, 1.0), 0.3)
    frame = image(scene, camera, pad)
    before = frame.px.copy()
    first = detect(frame, scene.attitude(), camera, pad, SIMULATOR)
    again = detect(frame, scene.attitude(), camera, pad, SIMULATOR)
    assert np.array_equal(frame.px, before)
    assert first.selected is not None
    assert again.selected is not None
    assert np.array_equal(first.selected.d_body_pad_level, again.selected.d_body_pad_level)
    assert np.array_equal(first.selected.cov, again.selected.cov)


def test_a_bare_white_square_is_no_h(camera: Camera, pad: Pad) -> None:
    scene = PadPlacement((0.15, 0.0, 0.9), 0.2)
    px = image(scene, camera, pad).px.copy()
    outline = project(pad.markings.h_corners()[[0, 5, 6, 11]], scene, camera)
    cv2.fillPoly(px, [np.rint(outline).astype(np.int32)], (231, 231, 231))
    frame = image(scene, camera, pad)
    seen = detect(type(frame)(frame.stamp, 0, px), scene.attitude(), camera, pad, SIMULATOR)
    assert seen.methods["corners"] is None
