"""Markers: the same sighting as from the painted pad, from frames made here with known poses."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import Frame
from estimator.vision.camera import Camera
from estimator.vision.marker import Marker, MarkerBoard, find_markers
from tests.support.pad_images import STAMP, PadPlacement, sim_camera

SEA = Path(__file__).parents[3] / "../shared/data/sea"
NESTED = MarkerBoard.from_mapping(
    {
        "name": "nested",
        "marker": [
            {"family": "apriltag_36h11", "id": 7, "size_m": 0.5, "yaw_deg": 90.0},
            {"family": "4x4_50", "id": 3, "size_m": 0.08, "centre_m": [-0.05, 0.36]},
        ],
    }
)


def drawn(board: MarkerBoard, per_m: float) -> tuple[NDArray[np.uint8], float]:
    """A square of deck seen from above, rows to aft, columns to starboard, and half its side in m."""
    half = 0.6
    n = round(2 * half * per_m)
    deck = np.full((n, n), 235, np.uint8)
    for m in board.markers:
        family = cv2.aruco.getPredefinedDictionary(
            getattr(cv2.aruco, {"apriltag_36h11": "DICT_APRILTAG_36h11"}.get(m.family, "DICT_4X4_50"))
        )
        side = round(m.size_m * per_m)
        tile = cv2.aruco.generateImageMarker(family, m.id, side)
        # The tile's top left, top right and bottom left corners, where the marker says that they lie.
        at = m.corners()[[0, 1, 3], :2]
        to = np.stack([(half + at[:, 1]) * per_m - 0.5, (half - at[:, 0]) * per_m - 0.5], axis=1).astype(np.float32)
        corners = np.array([(-0.5, -0.5), (side - 0.5, -0.5), (-0.5, side - 0.5)], np.float32)
        A = cv2.getAffineTransform(corners, to)
        cv2.warpAffine(tile, A, (n, n), dst=deck, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_TRANSPARENT)
    return deck, half


def photograph(board: MarkerBoard, scene: PadPlacement, camera: Camera, seed: int = 0, fine: int = 4) -> Frame:
    """The board through the camera, `fine` squared samples a pixel, with noise."""
    deck, half = drawn(board, 1000.0)
    n = len(deck)
    T = scene.T_cam_pad(camera)
    H_pad = np.stack([T.R.matrix[:, 0], T.R.matrix[:, 1], T.t], axis=1)
    from_deck = np.array([[0.0, -1e-3, half - 0.5e-3], [1e-3, 0.0, 0.5e-3 - half], [0.0, 0.0, 1.0]])
    K = camera.K.copy()
    K[:2] *= fine
    K[:2, 2] += (fine - 1) / 2
    size = (camera.width * fine, camera.height * fine)
    big = cv2.warpPerspective(deck, K @ H_pad @ from_deck, size, flags=cv2.INTER_AREA, borderValue=90)
    assert n == len(deck)
    gray = cv2.resize(big, (camera.width, camera.height), interpolation=cv2.INTER_AREA).astype(float)
    gray += np.random.default_rng(seed).normal(0, 2.0, gray.shape)
    return Frame(STAMP, 5, np.repeat(np.clip(gray, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2))


def error(d_and_yaw: tuple[F64, float | None], scene: PadPlacement) -> F64:
    d, yaw = d_and_yaw
    assert yaw is not None
    return np.append(d - np.array(scene.d_body_pad_level), wrap_pi(yaw - scene.yaw_rad))


@pytest.mark.parametrize("seed", range(10))
def test_the_pose_is_the_true_one_within_its_covariance(seed: int) -> None:
    rng = np.random.default_rng([seed, 11])
    camera = sim_camera((0.15, 0.02, 0.03))
    height = float(rng.uniform(1.2, 3.0))
    scene = PadPlacement(
        (0.15 + float(rng.uniform(-0.12, 0.12)) * height, float(rng.uniform(-0.12, 0.12)) * height, height),
        float(rng.uniform(-math.pi, math.pi)), *(float(a) for a in rng.uniform(-0.2, 0.2, 2)),
    )  # fmt: skip
    found = find_markers(photograph(NESTED, scene, camera, seed), scene.attitude(), camera, NESTED, sigma_deck_rad=0.01)
    assert found is not None
    assert (found.method, found.seq, found.yaw_ambiguous) == ("marker", 5, False)
    e = error((found.d_body_pad_level, found.yaw_rad), scene)
    assert e @ np.linalg.solve(found.cov, e) < 23.5, "chi-square of 4, 1 in 10,000"
    assert np.linalg.norm(e[:3]) < 0.02 * height
    assert found.pose6 is not None
    assert np.allclose(found.pose6.cov[:3, :3], found.cov[:3, :3])


def test_near_the_deck_the_small_marker_alone_carries_on() -> None:
    camera = sim_camera((0.0, 0.0, 0.0))
    scene = PadPlacement((0.05, -0.36, 0.22), 0.0)
    found = find_markers(photograph(NESTED, scene, camera), scene.attitude(), camera, NESTED)
    assert found is not None
    assert len(found.features) == 1
    assert np.linalg.norm(error((found.d_body_pad_level, found.yaw_rad), scene)) < 0.01


def test_an_unknown_attitude_costs_what_it_makes_of_the_pose() -> None:
    camera = sim_camera()
    scene = PadPlacement((0.1, 0.1, 2.0), 0.4, 0.04, -0.05)
    frame = photograph(NESTED, scene, camera)
    told, untold = (find_markers(frame, a, camera, NESTED) for a in (scene.attitude(), None))
    assert told is not None
    assert untold is not None
    assert np.sqrt(untold.cov[0, 0]) > 5 * np.sqrt(told.cov[0, 0])
    off = untold.d_body_pad_level - np.array(scene.d_body_pad_level)
    assert off @ np.linalg.solve(untold.cov[:3, :3], off) < 21.1
    # A degree of roll and pitch moves a pad 2 m below by 3.5 cm: what the covariance says must be what happens.
    moved = np.linalg.norm(off[:2]) / math.hypot(0.04, 0.05)
    assert moved == pytest.approx(np.sqrt(untold.cov[0, 0]) / math.radians(5.0), rel=0.25)


@pytest.mark.skipif(not SEA.exists(), reason="no frames of the sea here")
def test_nothing_is_found_at_sea_nor_with_other_numbers() -> None:
    camera = sim_camera()
    for path in sorted(SEA.glob("*.jpg")):
        px = cv2.resize(np.asarray(cv2.imread(str(path)), np.uint8), (640, 360), interpolation=cv2.INTER_AREA)
        assert find_markers(Frame(STAMP, 0, np.asarray(px, np.uint8)), None, camera, NESTED) is None
    other = MarkerBoard("other", (Marker("apriltag_36h11", 8, 0.5, (0.0, 0.0), 0.0),))
    scene = PadPlacement((0.15, 0.0, 2.0))
    assert find_markers(photograph(NESTED, scene, camera), scene.attitude(), camera, other) is None
    with pytest.raises(ValueError, match="640x360"):
        find_markers(Frame(STAMP, 0, np.zeros((100, 100, 3), np.uint8)), None, camera, NESTED)


GOOD = {"family": "apriltag_36h11", "id": 7, "size_m": 0.5}


@pytest.mark.parametrize(
    ("data", "text"),
    [
        ({}, r"needs at least one \[\[marker\]\]"),
        ({"marker": [GOOD], "pads": 1}, "unknown key 'pads'"),
        ({"marker": [GOOD, GOOD]}, "same family and id twice"),
        ({"marker": [{**GOOD, "size": 1}]}, "marker 1: unknown key 'size'"),
        ({"marker": [{"id": 1, "size_m": 0.1}]}, "key 'family' is missing"),
        ({"marker": [{**GOOD, "family": "qr"}]}, "family must be one of"),
        ({"marker": [{**GOOD, "id": 100000}]}, r"id must be a whole number 0\.\.586"),
        ({"marker": [{**GOOD, "id": True}]}, "id must be"),
        ({"marker": [{**GOOD, "size_m": -1.0}]}, "size_m must be positive"),
        ({"marker": [{**GOOD, "size_m": math.nan}]}, "size_m must be a finite number"),
        ({"marker": [{**GOOD, "centre_m": [1]}]}, "centre_m must be a list of two"),
        ({"marker": [{**GOOD, "yaw_deg": "90"}]}, "yaw_deg must be a finite number"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(data: dict[str, Any], text: str) -> None:
    with pytest.raises(BadInput, match=text) as caught:
        MarkerBoard.from_mapping(data, "board.toml")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("board.toml")


def test_corners_turn_with_the_marker() -> None:
    straight, turned = (Marker("4x4_50", 0, 0.2, (0.3, -0.1), yaw).corners() for yaw in (0.0, 0.5))
    R = Rotation.from_rpy(0.0, 0.0, 0.5)
    centre = np.array([0.3, -0.1, 0.0])
    assert np.allclose(R @ (straight - centre) + centre, turned)
    assert np.allclose(straight[0], (0.4, -0.2, 0.0)), "top left lies ahead and to port"
