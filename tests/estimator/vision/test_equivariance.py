"""The same scene seen in another way has the same answer: upside down, in a mirror, in another part of the frame."""

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation, Transform
from estimator.vision.camera import Camera
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.registration import Registration, RegistrationOptions, look
from tests.support.pad_images import sim_camera
from tests.support.pad_scenes import CONDITIONS, load_pad, pad_scene

TRACK = RegistrationOptions(coarse=False)
BENT = sim_camera((0.1, -0.05, 0.02), (-0.2, 0.06, 0.002, -0.001, -0.01))
ACROSS = np.diag([1.0, -1.0, 1.0])
"""Turns starboard to port: of body, level and pad."""
UPSIDE_DOWN, LEFT_RIGHT, TOP_DOWN = (np.diag([x, y, 1.0]) for x, y in ((-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0)))
"""Turn the camera's axes."""


class Aimed(NamedTuple):
    """A frame, the camera that took it, what is known of its attitude, and where the pad is about."""

    px: NDArray[np.uint8]
    camera: Camera
    orientation: Orientation
    start: PadPose

    def seen(self, pad: Pad) -> Registration | None:
        return look(FrameView(Pyramid(np.ascontiguousarray(self.px)), self.camera, pad), self.start, self.orientation, TRACK)


def level_numbers(level: NDArray[Any]) -> F64:
    """Return the numbers of the core's `dl_level_sighting`."""
    return np.atleast_1d(level).view(np.float64)


def mirrored(view: Aimed, in_cam: F64, in_body: F64) -> Aimed:
    """Return the view with axes of the camera, of the body and of the pad turned round: of the frame, those of the camera."""
    c = view.camera
    x, y, _ = np.diag(in_cam)
    k1, k2, p1, p2, k3 = c.distortion.tolist()
    mount = Transform(Rotation(in_body @ c.T_body_cam.R.matrix @ in_cam), in_body @ c.T_body_cam.t)
    camera = replace(
        c, cx=c.cx if x > 0 else c.width - 1 - c.cx, cy=c.cy if y > 0 else c.height - 1 - c.cy,
        distortion=np.array([k1, k2, y * p1, x * p2, k3]), T_body_cam=mount,
    )  # fmt: skip
    o, side = view.orientation, in_body[1, 1]
    cov = np.diag([side, 1.0]) @ o.cov_tilt @ np.diag([side, 1.0])
    orientation = Orientation(side * o.roll_rad, o.pitch_rad, cov, o.sigma_deck_rad, o.measured)
    start = PadPose(Rotation(in_cam @ view.start.R_cam_pad.matrix @ in_body), in_cam @ view.start.t_cam_pad)
    return Aimed(view.px[:: int(y), :: int(x)], camera, orientation, start)


def elsewhere(view: Aimed) -> Aimed:
    """Return the view in a larger frame, which goes on as its border is."""
    c = view.camera
    px = np.pad(view.px, ((32, 16), (48, 16), (0, 0)), mode="edge")
    return view._replace(px=px, camera=replace(c, width=c.width + 64, height=c.height + 48, cx=c.cx + 48, cy=c.cy + 32))


@lru_cache(maxsize=32)
def seen_at(k: int, pad_name: str) -> tuple[Pad, Aimed, Registration]:
    """Return one of some frames from 0.3 to 9 m in all conditions, half through a bent lens, and what is seen."""
    pad, camera = load_pad(pad_name), BENT if k % 2 else sim_camera()
    scene = pad_scene(np.random.default_rng(k), camera, pad, 0.3 * 1.45**k, CONDITIONS[k % len(CONDITIONS)])
    assert scene.truth is not None
    roll, pitch, _ = (scene.R_level_body or Rotation.identity()).rpy_rad
    orientation = Orientation(roll, pitch, np.array([[3e-4, 1e-4], [1e-4, 2e-4]]), 0.02, True)
    view = Aimed(scene.px, camera, orientation, scene.truth)
    found = view.seen(pad)
    assert found is not None
    return pad, view, found


def sigmas(found: Registration, other: Registration | None, in_cam: F64, in_pad: F64) -> float:
    """Return how far the pose of the other view lies from that of the first, its axes turned back, in standard deviations."""
    assert other is not None
    R = Rotation(in_cam @ other.pose.R_cam_pad.matrix @ in_pad) @ found.pose.R_cam_pad.inv
    e = np.append(in_cam @ other.pose.t_cam_pad - found.pose.t_cam_pad, R.rotvec_rad)
    return math.sqrt(e @ np.linalg.solve(found.cov, e))


@pytest.mark.parametrize("pad_name", ["thesis", "printed", "icao"])
@pytest.mark.parametrize("k", [0, 1, 2, 3, 4, 5, 6, 7, 9])
def test_a_frame_upside_down_has_the_same_pose_covariance_and_sighting(k: int, pad_name: str) -> None:
    pad, view, found = seen_at(k, pad_name)
    other = mirrored(view, UPSIDE_DOWN, np.eye(3)).seen(pad)
    assert sigmas(found, other, UPSIDE_DOWN, np.eye(3)) < 0.01
    assert other is not None
    turn = np.kron(np.eye(2), UPSIDE_DOWN)
    scale = np.sqrt(np.outer(np.diag(found.cov), np.diag(found.cov)))
    assert np.abs((turn @ other.cov @ turn - found.cov) / scale).max() < 0.01
    # Body and deck are the same, so that nothing turns in level; the words are place, rotation and their covariances.
    assert level_numbers(other.in_level) == pytest.approx(level_numbers(found.in_level), rel=0.02, abs=1e-5)
    assert (other.dense, other.yaw_ambiguous) == (found.dense, found.yaw_ambiguous)
    for kind, edges in found.edges.items():
        assert other.edges[kind].inliers == pytest.approx(edges.inliers, abs=2e-3)
    if view.start.disc_px(view.camera, pad) < 0.3 * view.camera.height:
        assert other.evidence == pytest.approx(found.evidence, abs=1e-3)
        assert other.log_odds == pytest.approx(found.log_odds, abs=2e-3)


@pytest.mark.parametrize("pad_name", ["thesis", "printed", "icao"])
@pytest.mark.parametrize(("in_cam", "k"), [(LEFT_RIGHT, 9), (TOP_DOWN, 9), (LEFT_RIGHT, 10), (TOP_DOWN, 10)])
def test_a_distant_pad_in_a_mirror_has_the_mirrored_pose(k: int, pad_name: str, in_cam: F64) -> None:
    # Left and right of the arrow, the drawing is its own mirror image. The places near by where edges are sampled are not.
    pad, view, found = seen_at(k, pad_name)
    other = mirrored(view, in_cam, ACROSS).seen(pad)
    assert sigmas(found, other, in_cam, ACROSS) < 0.05
    assert other is not None
    assert other.evidence == pytest.approx(found.evidence, abs=2e-3)
    across = np.array([1.0, -1.0, 1.0])
    assert level_numbers(other.in_level)[:3] * across == pytest.approx(level_numbers(found.in_level)[:3], abs=1e-4)


@pytest.mark.parametrize("pad_name", ["thesis", "printed", "icao"])
@pytest.mark.parametrize("k", [7, 9])
def test_a_pad_elsewhere_in_a_larger_frame_is_the_same_pad(k: int, pad_name: str) -> None:
    pad, view, found = seen_at(k, pad_name)
    other = elsewhere(view).seen(pad)
    assert sigmas(found, other, np.eye(3), np.eye(3)) < 1e-9
    assert other is not None
    assert other.evidence == pytest.approx(found.evidence, abs=1e-9)
