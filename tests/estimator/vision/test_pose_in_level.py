"""A pose brought to `level`: its covariance is what errors of pose, attitude and deck do to it, differentiated numerically."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64, Rotation, Transform, rpy_matrix, wrap_pi
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera import Camera
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.sighting import sighting_of
from tests.estimator.ekf.oracle import so3

FRAME = Frame(Stamp(MonoNs(0), MonoNs(0), 0.0, "sim"), 0, np.zeros((2, 2, 3), np.uint8))
MOUNT = Transform(Rotation(rpy_matrix(0.1, -0.2, 1.4)), np.array([0.12, -0.05, 0.08]))
ROLL, PITCH, YAW, PLACE = 0.2, -0.35, 0.7, np.array([0.8, -0.5, 2.5])
COV_TILT = np.array([[4e-4, 1.5e-4], [1.5e-4, 3e-4]])
SIGMA_DECK = 0.025
STEP = 1e-5


def cov_pose() -> F64:
    A = np.random.default_rng(3).normal(size=(6, 6))
    return np.asarray(1e-4 * (A @ A.T + np.eye(6)))


def posed(deck: F64, off: F64) -> PadPose:
    """Return the pose in `cam` of a pad on a deck turned by (roll, pitch), with errors of place and rotation, (6,)."""
    R_level_cam = rpy_matrix(ROLL, PITCH, 0.0) @ MOUNT.R.matrix
    lever = rpy_matrix(ROLL, PITCH, 0.0) @ MOUNT.t
    R = R_level_cam.T @ so3.exp(np.array([*deck, 0.0])) @ rpy_matrix(0.0, 0.0, -YAW)
    return PadPose(Rotation(so3.exp(off[3:]) @ R), R_level_cam.T @ (PLACE - lever) + off[:3])


def levelled(camera: Camera, deck: F64, off: F64, tilt: F64, sigma_deck: float = SIGMA_DECK) -> Sighting:
    orientation = Orientation(ROLL + tilt[0], PITCH + tilt[1], COV_TILT, sigma_deck, True)
    return sighting_of(FRAME, posed(deck, off), cov_pose(), replace(camera, T_body_cam=MOUNT), orientation, False, 1.0)


def errors(camera: Camera, deck: F64, off: F64, tilt: F64) -> F64:
    """Return the errors of a sighting, (7,): place, small rotation, heading."""
    seen = levelled(camera, deck, off, tilt)
    assert seen.pose6 is not None
    assert seen.yaw_rad is not None
    R = so3.exp(np.array([*deck, 0.0])) @ rpy_matrix(0.0, 0.0, -YAW)
    turn = so3.log(seen.pose6.R_level_pad.matrix @ R.T)
    return np.array([*(seen.d_body_pad_level - PLACE), *turn, wrap_pi(seen.yaw_rad + math.atan2(R[1, 0], R[0, 0]))])


def test_a_pose_without_errors_is_where_it_is(camera: Camera) -> None:
    np.testing.assert_allclose(errors(camera, np.zeros(2), np.zeros(6), np.zeros(2)), np.zeros(7), atol=1e-12)


def test_the_covariance_is_what_every_error_does_to_place_rotation_and_heading(camera: Camera) -> None:
    columns = []
    for k in range(10):
        by = [errors(camera, off[:2], off[2:8], off[8:]) for off in (STEP * np.eye(10)[k], -STEP * np.eye(10)[k])]
        columns.append((by[0] - by[1]) / (2.0 * STEP))
    J, given = np.array(columns).T, np.zeros((10, 10))
    given[:2, :2], given[2:8, 2:8], given[8:, 8:] = SIGMA_DECK**2 * np.eye(2), cov_pose(), COV_TILT
    expected = J @ given @ J.T
    seen = levelled(camera, np.zeros(2), np.zeros(6), np.zeros(2))
    assert seen.pose6 is not None
    np.testing.assert_allclose(seen.pose6.cov, expected[:6, :6], rtol=1e-5, atol=1e-10)
    of = [0, 1, 2, 6]
    np.testing.assert_allclose(seen.cov, expected[np.ix_(of, of)], rtol=1e-5, atol=1e-10)


def test_a_frame_s_tilt_is_the_attitude_s_error_as_far_as_the_deck_s_is_known(camera: Camera) -> None:
    tilt = np.array([0.03, -0.02])
    by_deck = [levelled(camera, np.zeros(2), np.zeros(6), tilt, sigma) for sigma in (1e-6, SIGMA_DECK, 10.0)]
    off = [float(np.linalg.norm(seen.d_body_pad_level - PLACE)) for seen in by_deck]
    assert off[0] < 3e-3
    assert off[0] < 0.2 * off[1] < 0.2 * off[2]


@pytest.mark.parametrize("cov", [np.zeros((2, 2)), COV_TILT])
def test_a_deck_known_to_be_level_and_an_attitude_known_for_certain_break_nothing(camera: Camera, cov: F64) -> None:
    orientation = Orientation(ROLL, PITCH, cov, 0.0, True)
    pose = posed(np.zeros(2), np.zeros(6))
    seen = sighting_of(FRAME, pose, cov_pose(), replace(camera, T_body_cam=MOUNT), orientation, False, 1.0)
    np.testing.assert_allclose(seen.d_body_pad_level, PLACE, atol=1e-12)
    assert np.linalg.eigvalsh(seen.cov).min() > 0.0


def test_an_arrow_that_points_straight_up_breaks_nothing(camera: Camera) -> None:
    R = rpy_matrix(ROLL, PITCH, 0.0) @ MOUNT.R.matrix
    pose = PadPose(Rotation(R.T @ np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])), np.array([0.0, 0.0, 2.0]))
    orientation = Orientation(ROLL, PITCH, COV_TILT, SIGMA_DECK, True)
    seen = sighting_of(FRAME, pose, cov_pose(), replace(camera, T_body_cam=MOUNT), orientation, True, 1.0)
    assert np.isfinite(seen.cov).all()


def test_a_rotation_that_rounding_has_stretched_is_brought_back(camera: Camera) -> None:
    pose = posed(np.zeros(2), np.zeros(6))
    stretched = PadPose(Rotation(pose.R_cam_pad.matrix * (1.0 + 2e-7)), pose.t_cam_pad)
    orientation = Orientation(ROLL, PITCH, COV_TILT, SIGMA_DECK, True)
    seen = sighting_of(FRAME, stretched, cov_pose(), replace(camera, T_body_cam=MOUNT), orientation, False, 1.0)
    assert seen.pose6 is not None
    R = seen.pose6.R_level_pad.matrix
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)


def test_the_heading_of_a_tilted_pad_is_that_of_its_arrow_along_the_horizon(camera: Camera) -> None:
    deck = np.array([0.3, -0.4])
    seen = levelled(camera, deck, np.zeros(6), np.zeros(2), 10.0)
    assert seen.pose6 is not None
    R, rows = seen.pose6.R_level_pad.matrix, np.eye(4, 6)
    for k in range(3):
        more, less = (so3.exp(sign * STEP * np.eye(3)[k]) @ R for sign in (1, -1))
        rows[3, 3 + k] = (math.atan2(less[1, 0], less[0, 0]) - math.atan2(more[1, 0], more[0, 0])) / (2.0 * STEP)
    np.testing.assert_allclose(seen.cov, rows @ seen.pose6.cov @ rows.T, rtol=1e-6, atol=1e-12)
    assert seen.yaw_rad == pytest.approx(-math.atan2(R[1, 0], R[0, 0]), abs=1e-12)
