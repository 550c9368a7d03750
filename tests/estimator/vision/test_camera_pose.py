"""The pose in the camera's axes comes back from a sighting as it went in, whatever the attitude said."""

import math

import numpy as np
import pytest

from estimator.contracts.estimates import UNKNOWN_YAW_VAR
from estimator.contracts.geometry import F64, Rotation, Transform
from estimator.contracts.samples import Frame
from estimator.contracts.time import Stamp
from estimator.vision.camera import Camera
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.sighting import camera_pose, sighting_of

MOUNT = Transform(Rotation.from_rpy(0.02, -0.03, 1.6), np.array([0.15, 0.02, 0.01]))
CAMERA = Camera(640, 360, 370.0, 370.0, 319.5, 179.5, np.zeros(5), MOUNT)


FRAME = Frame(Stamp.from_seconds(1.0), 1, np.zeros((360, 640, 3), np.uint8))


def seen(seed: int, cov_tilt: F64) -> tuple[PadPose, F64, Orientation]:
    """Return a pose of the pad in `cam` with its covariance, and what the attitude said."""
    rng = np.random.default_rng(seed)
    roll, pitch = rng.normal(0.0, 0.15, 2)
    orientation = Orientation(roll, pitch, cov_tilt, math.radians(3.0), True)
    rolled, pitched = rng.normal(0.0, 0.2, 2)
    pose = PadPose(Rotation.from_rpy(rolled, pitched, rng.uniform(-3.0, 3.0)), np.array([0.3, 0.2, 3.0]))
    half = rng.normal(0.0, 1e-3, (6, 6))
    return pose, half @ half.T, orientation


def test_a_heading_that_the_pose_does_not_hold_is_none() -> None:
    pose, cov, orientation = seen(0, 1e-4 * np.eye(2))
    found = sighting_of(FRAME, pose, cov + np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), CAMERA, orientation, True, 0.9)
    assert (found.yaw_rad, found.yaw_ambiguous) == (None, False)
    np.testing.assert_array_equal(found.cov[3], [0.0, 0.0, 0.0, UNKNOWN_YAW_VAR])


@pytest.mark.parametrize("seed", range(4))
def test_a_sighting_gives_its_pose_back(seed: int) -> None:
    pose, cov, orientation = seen(seed, np.diag([0.01, 0.012]) ** 2)
    back = camera_pose(sighting_of(FRAME, pose, cov, CAMERA, orientation, False, 0.9), CAMERA, orientation)
    assert back is not None
    np.testing.assert_allclose(back.R_cam_pad, pose.R_cam_pad.matrix, atol=1e-11)
    np.testing.assert_allclose(back.t_cam_pad, pose.t_cam_pad, atol=1e-11)
    np.testing.assert_allclose(back.cov, cov, atol=1e-9 * float(np.abs(cov).max()))
