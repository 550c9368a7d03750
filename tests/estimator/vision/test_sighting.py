"""A registered pose in level: its covariance, its heading, and the way back to the camera."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.tools.calibrate.flight_views import camera_pose
from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64, Rotation, Transform, rpy_matrix, wrap_pi
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera import Camera
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.registration import sighting_of
from tests.estimator.ekf import oracle

MOUNT = Transform(Rotation.from_rpy(0.02, -0.03, 1.6), np.array([0.15, 0.02, 0.01]))


CAMERA = Camera(640, 360, 370.0, 370.0, 319.5, 179.5, np.zeros(5), MOUNT)


FRAME = Frame(Stamp.from_seconds(1.0), 1, np.zeros((360, 640, 3), np.uint8))


def pose_seen(seed: int, cov_tilt: F64) -> tuple[PadPose, F64, Orientation]:
    """Return a pose of the pad in `cam` with its covariance, and what the attitude said."""
    rng = np.random.default_rng(seed)
    roll, pitch = rng.normal(0.0, 0.15, 2)
    orientation = Orientation(roll, pitch, cov_tilt, math.radians(3.0), True)
    rolled, pitched = rng.normal(0.0, 0.2, 2)
    pose = PadPose(Rotation.from_rpy(rolled, pitched, rng.uniform(-3.0, 3.0)), np.array([0.3, 0.2, 3.0]))
    half = rng.normal(0.0, 1e-3, (6, 6))
    return pose, half @ half.T, orientation


@pytest.mark.parametrize("seed", range(4))
def test_a_sighting_gives_its_pose_back(seed: int) -> None:
    pose, cov, orientation = pose_seen(seed, np.diag([0.01, 0.012]) ** 2)
    back = camera_pose(sighting_of(FRAME, pose, cov, CAMERA, orientation, False, 0.9), CAMERA, orientation)
    assert back is not None
    np.testing.assert_allclose(back.R_cam_pad, pose.R_cam_pad.matrix, atol=1e-11)
    np.testing.assert_allclose(back.t_cam_pad, pose.t_cam_pad, atol=1e-11)
    np.testing.assert_allclose(back.cov, cov, atol=1e-9 * float(np.abs(cov).max()))


BLANK = Frame(Stamp(MonoNs(0), MonoNs(0), 0.0, "sim"), 0, np.zeros((2, 2, 3), np.uint8))


TURNED_MOUNT = Transform(Rotation(rpy_matrix(0.1, -0.2, 1.4)), np.array([0.12, -0.05, 0.08]))


ROLL, PITCH, YAW, PLACE = 0.2, -0.35, 0.7, np.array([0.8, -0.5, 2.5])


COV_TILT = np.array([[4e-4, 1.5e-4], [1.5e-4, 3e-4]])


SIGMA_DECK = 0.025


STEP = 1e-5


def cov_pose() -> F64:
    A = np.random.default_rng(3).normal(size=(6, 6))
    return np.asarray(1e-4 * (A @ A.T + np.eye(6)))


def posed(deck: F64, off: F64) -> PadPose:
    """Return the pose in `cam` of a pad on a deck turned by (roll, pitch), with errors of place and rotation, (6,)."""
    R_level_cam = rpy_matrix(ROLL, PITCH, 0.0) @ TURNED_MOUNT.R.matrix
    lever = rpy_matrix(ROLL, PITCH, 0.0) @ TURNED_MOUNT.t
    R = R_level_cam.T @ oracle.exp(np.array([*deck, 0.0])) @ rpy_matrix(0.0, 0.0, -YAW)
    return PadPose(Rotation(oracle.exp(off[3:]) @ R), R_level_cam.T @ (PLACE - lever) + off[:3])


def levelled(camera: Camera, deck: F64, off: F64, tilt: F64, sigma_deck: float = SIGMA_DECK) -> Sighting:
    orientation = Orientation(ROLL + tilt[0], PITCH + tilt[1], COV_TILT, sigma_deck, True)
    return sighting_of(BLANK, posed(deck, off), cov_pose(), replace(camera, T_body_cam=TURNED_MOUNT), orientation, False, 1.0)


def level_errors(camera: Camera, deck: F64, off: F64, tilt: F64) -> F64:
    """Return the errors of a sighting, (7,): place, small rotation, heading."""
    pose_seen = levelled(camera, deck, off, tilt)
    assert pose_seen.pose6 is not None
    assert pose_seen.yaw_rad is not None
    R = oracle.exp(np.array([*deck, 0.0])) @ rpy_matrix(0.0, 0.0, -YAW)
    turn = oracle.log(pose_seen.pose6.R_level_pad.matrix @ R.T)
    return np.array([*(pose_seen.d_body_pad_level - PLACE), *turn, wrap_pi(pose_seen.yaw_rad + math.atan2(R[1, 0], R[0, 0]))])


def test_the_covariance_is_what_every_error_does_to_place_rotation_and_heading(camera: Camera) -> None:
    columns = []
    for k in range(10):
        by = [level_errors(camera, off[:2], off[2:8], off[8:]) for off in (STEP * np.eye(10)[k], -STEP * np.eye(10)[k])]
        columns.append((by[0] - by[1]) / (2.0 * STEP))
    J, given = np.array(columns).T, np.zeros((10, 10))
    given[:2, :2], given[2:8, 2:8], given[8:, 8:] = SIGMA_DECK**2 * np.eye(2), cov_pose(), COV_TILT
    expected = J @ given @ J.T
    pose_seen = levelled(camera, np.zeros(2), np.zeros(6), np.zeros(2))
    assert pose_seen.pose6 is not None
    np.testing.assert_allclose(pose_seen.pose6.cov, expected[:6, :6], rtol=1e-5, atol=1e-10)
    of = [0, 1, 2, 6]
    np.testing.assert_allclose(pose_seen.cov, expected[np.ix_(of, of)], rtol=1e-5, atol=1e-10)


def test_a_frame_s_tilt_is_the_attitude_s_error_as_far_as_the_deck_s_is_known(camera: Camera) -> None:
    tilt = np.array([0.03, -0.02])
    by_deck = [levelled(camera, np.zeros(2), np.zeros(6), tilt, sigma) for sigma in (1e-6, SIGMA_DECK, 10.0)]
    off = [float(np.linalg.norm(pose_seen.d_body_pad_level - PLACE)) for pose_seen in by_deck]
    assert off[0] < 3e-3
    assert off[0] < 0.2 * off[1] < 0.2 * off[2]


@pytest.mark.parametrize("cov", [np.zeros((2, 2)), COV_TILT])
def test_a_deck_known_to_be_level_and_an_attitude_known_for_certain_break_nothing(camera: Camera, cov: F64) -> None:
    orientation = Orientation(ROLL, PITCH, cov, 0.0, True)
    pose = posed(np.zeros(2), np.zeros(6))
    pose_seen = sighting_of(BLANK, pose, cov_pose(), replace(camera, T_body_cam=TURNED_MOUNT), orientation, False, 1.0)
    np.testing.assert_allclose(pose_seen.d_body_pad_level, PLACE, atol=1e-12)
    assert np.linalg.eigvalsh(pose_seen.cov).min() > 0.0


def test_a_rotation_that_rounding_has_stretched_is_brought_back(camera: Camera) -> None:
    pose = posed(np.zeros(2), np.zeros(6))
    stretched = PadPose(Rotation(pose.R_cam_pad.matrix * (1.0 + 2e-7)), pose.t_cam_pad)
    orientation = Orientation(ROLL, PITCH, COV_TILT, SIGMA_DECK, True)
    pose_seen = sighting_of(BLANK, stretched, cov_pose(), replace(camera, T_body_cam=TURNED_MOUNT), orientation, False, 1.0)
    assert pose_seen.pose6 is not None
    R = pose_seen.pose6.R_level_pad.matrix
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)


def test_the_heading_of_a_tilted_pad_is_that_of_its_arrow_along_the_horizon(camera: Camera) -> None:
    deck = np.array([0.3, -0.4])
    pose_seen = levelled(camera, deck, np.zeros(6), np.zeros(2), 10.0)
    assert pose_seen.pose6 is not None
    R, rows = pose_seen.pose6.R_level_pad.matrix, np.eye(4, 6)
    for k in range(3):
        more, less = (oracle.exp(sign * STEP * np.eye(3)[k]) @ R for sign in (1, -1))
        rows[3, 3 + k] = (math.atan2(less[1, 0], less[0, 0]) - math.atan2(more[1, 0], more[0, 0])) / (2.0 * STEP)
    np.testing.assert_allclose(pose_seen.cov, rows @ pose_seen.pose6.cov @ rows.T, rtol=1e-6, atol=1e-12)
    assert pose_seen.yaw_rad == pytest.approx(-math.atan2(R[1, 0], R[0, 0]), abs=1e-12)
