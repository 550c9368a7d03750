"""Orientation of a gimballed camera at an exposure: frames, interpolation, uncertainty, and the sighting that follows."""

import math
from itertools import pairwise

import numpy as np
import pytest

from estimator.attitude_history import DOWN, GimbalHistory
from estimator.contracts.estimates import PathName
from estimator.contracts.geometry import Rotation, Transform
from estimator.contracts.samples import GimbalAttitude, GimbalFrame
from estimator.options import EstimatorOptions
from estimator.pipeline import RelativeEstimator
from estimator.vision.camera import Camera
from tests.make import attitude, gimbal, stamp

RPY = (0.12, -0.07, 1.9)
R_NED_BODY = Rotation.from_rpy(*RPY)
ON_GIMBAL = Rotation.from_rpy(math.pi / 2, 0.0, math.pi / 2)


def pointing(seconds: float, rotation: Rotation, frame: GimbalFrame = "level", sigma_s: float = 0.0) -> GimbalAttitude:
    return gimbal(stamp(seconds, sigma_s=sigma_s), rotation, frame)


def swinging(t: float) -> Rotation:
    return Rotation.from_rpy(0.0, -0.5 * math.pi + 0.2 * math.sin(5.0 * t), 0.0)


@pytest.mark.parametrize("frame", ["ned", "level", "body"])
def test_the_same_pose_in_each_frame_is_the_same_camera_on_the_body(frame: GimbalFrame) -> None:
    R_body_gimbal = Rotation.from_rpy(0.05, -1.4, 0.2)
    R_level_body = R_NED_BODY.without_heading()
    reported = {"ned": R_NED_BODY @ R_body_gimbal, "level": R_level_body @ R_body_gimbal, "body": R_body_gimbal}[frame]
    held = (
        GimbalHistory().add(pointing(1.0, reported, frame), pointing(1.1, reported, frame)).at(stamp(1.05), attitude(1.05, *RPY))
    )
    assert held is not None
    assert held.R_body_gimbal.angle_to(R_body_gimbal) < 1e-9


def test_a_gimbal_that_points_down_holds_a_straight_camera_with_the_nose_at_the_top_of_the_image() -> None:
    camera = Camera(640, 480, 500.0, 500.0, 319.5, 239.5, np.zeros(5), Transform(ON_GIMBAL, np.array([0.1, 0.0, 0.05])))
    held = camera.held(DOWN)
    assert held.T_body_cam.R.angle_to(Rotation.from_rpy(0.0, 0.0, math.pi / 2)) < 1e-9
    assert held.T_body_cam.t.tolist() == [0.1, 0.0, 0.05]
    assert held.optics == camera.optics, "what is computed for a lens is found again"


def test_a_swinging_gimbal_is_interpolated_within_its_claimed_error() -> None:
    history = GimbalHistory().add(*[pointing(t, swinging(t)) for t in np.arange(0.0, 1.0, 0.05)])
    level = attitude(0.5, var=1e-6)
    for t in np.arange(0.3, 0.9, 0.013):
        held = history.at(stamp(t), level)
        assert held is not None
        off = float(held.R_body_gimbal.angle_to(swinging(t)))
        assert off < 0.004
        assert off < 3.0 * math.sqrt(float(held.cov_body[1, 1]))


def test_what_it_turns_within_the_uncertainty_of_the_times_is_in_the_covariance() -> None:
    level = attitude(0.5, var=1e-6)
    sure = GimbalHistory().add(*[pointing(t, swinging(t)) for t in (0.58, 0.60, 0.62, 0.64)]).at(stamp(0.63), level)
    unsure = (
        GimbalHistory().add(*[pointing(t, swinging(t), sigma_s=0.02) for t in (0.58, 0.60, 0.62, 0.64)]).at(stamp(0.63), level)
    )
    assert sure is not None
    assert unsure is not None
    rate = 0.2 * 5.0 * abs(math.cos(5.0 * 0.63))
    assert math.sqrt(unsure.cov_body[1, 1] - sure.cov_body[1, 1]) == pytest.approx(rate * 0.02, rel=0.02)


@pytest.mark.parametrize("exposed_s", [0.4, 1.1, 2.2, 3.0])
def test_reports_that_do_not_cover_the_exposure_give_nothing(exposed_s: float) -> None:
    history = GimbalHistory().add(*[pointing(t, DOWN) for t in (0.5, 0.6, 1.4, 1.5, 2.1)])
    assert history.at(stamp(exposed_s), attitude(exposed_s, *RPY)) is None
    assert GimbalHistory().at(stamp(exposed_s), attitude(exposed_s, *RPY)) is None


def test_a_change_of_frame_begins_again() -> None:
    history = GimbalHistory().add(pointing(1.0, DOWN, "level"), pointing(1.1, DOWN, "ned"))
    assert history.at(stamp(1.05), attitude(1.05, *RPY)) is None
    assert history.frame == "ned"


def test_the_next_report_is_awaited_only_while_reports_come() -> None:
    times = (1.0, 1.1)
    history = GimbalHistory().add(*[pointing(t, DOWN) for t in times])
    assert all(b > a for a, b in pairwise(times))
    assert history.reports(stamp(1.2))
    assert not history.reports(stamp(1.5))
    assert not GimbalHistory().reports(stamp(1.0))


@pytest.mark.parametrize("shadows", [(), ("dead_reckoning",)])
def test_the_estimator_keeps_the_reports_with_one_path_and_with_several(shadows: tuple[PathName, ...]) -> None:
    memory = RelativeEstimator(EstimatorOptions(), shadows)
    memory.put([attitude(1.0, *RPY), pointing(1.0, DOWN), attitude(1.1, *RPY), pointing(1.1, DOWN)])
    held = memory.held_at(stamp(1.05), attitude(1.05, *RPY))
    assert held is not None
    assert held.R_body_gimbal.angle_to(R_NED_BODY.without_heading().inv @ DOWN) < 1e-9
