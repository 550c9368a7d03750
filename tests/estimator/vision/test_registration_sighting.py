"""A registration brought to `level`: conventions, attitude's share in the covariance, ambiguity, confidence."""

import math

import cv2
import numpy as np
import pytest
from scipy.special import chdtri

from estimator.contracts.estimates import UNKNOWN_YAW_VAR
from estimator.contracts.geometry import wrap_pi
from estimator.vision.camera import Camera
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.pad import Pad
from estimator.vision.pose import Orientation
from estimator.vision.register.fit_verification import confidence
from estimator.vision.register.look import look
from estimator.vision.register.registration import RegistrationOptions
from estimator.vision.register.sighting import sighting_of_look
from tests.support.pad_views import RenderedView, Stage

TRACK = RegistrationOptions(coarse=False)


def believed(view: RenderedView, rng: np.random.Generator, sigma_rad: float, sigma_deck_rad: float) -> Orientation:
    """Return the attitude as an instrument of that quality says it."""
    roll, pitch = view.roll_rad + rng.normal(0.0, sigma_rad), view.pitch_rad + rng.normal(0.0, sigma_rad)
    return Orientation(roll, pitch, np.eye(2) * sigma_rad**2, sigma_deck_rad, True)


def test_place_and_heading_in_level(camera: Camera, pad: Pad) -> None:
    stage = Stage(camera, pad)
    for height_m in (0.3, 1.0, 4.0, 10.0):
        view = stage.view(height_m, tilt_rad=math.radians(5.0))
        orientation = view.orientation()
        found = look(FrameView(Pyramid(view.px), camera, pad), stage.start(view, 0.4), orientation, TRACK)
        assert found is not None
        s = sighting_of_look(view.frame(), found, confidence(found.log_odds))
        assert s.method == "registration"
        assert s.d_body_pad_level == pytest.approx(view.d_body_pad_level, abs=1.5e-3 * height_m)
        assert s.yaw_rad is not None
        assert abs(wrap_pi(s.yaw_rad - view.yaw_rad)) < 0.01
        assert s.pose6 is not None
        assert s.pose6.d_body_pad_level == pytest.approx(s.d_body_pad_level)
        assert s.pose6.cov[:3, :3] == pytest.approx(s.cov[:3, :3])
        assert len(s.features) == 4
        assert s.confidence > (0.55 if height_m < 0.5 else 0.88)


@pytest.mark.parametrize(("height_m", "sigma_deg", "deck_deg"), [(1.0, 0.5, 0.0), (3.0, 0.3, 2.0), (10.0, 0.5, 1.0)])
def test_errors_of_attitude_and_deck_are_in_the_covariance(camera, pad, height_m, sigma_deg, deck_deg):
    stage = Stage(camera, pad)
    sigma, deck = math.radians(sigma_deg), math.radians(deck_deg)
    four, six = [], []
    for _ in range(25):
        view = stage.view(height_m, deck_rad=deck)
        orientation = believed(view, stage.rng, sigma, max(deck, 1e-5))
        found = look(FrameView(Pyramid(view.px), camera, pad), stage.start(view, 0.4), orientation, TRACK)
        assert found is not None
        s = sighting_of_look(view.frame(), found, confidence(found.log_odds))
        assert s.yaw_rad is not None
        assert s.pose6 is not None
        e = np.append(s.d_body_pad_level - view.d_body_pad_level, wrap_pi(s.yaw_rad - view.yaw_rad))
        four.append(e @ np.linalg.solve(s.cov, e))
        R_level_cam = view.orientation().R_level_body @ camera.T_body_cam.R
        turn = (s.pose6.R_level_pad @ (R_level_cam @ view.pose.R_cam_pad).inv).rotvec_rad
        e6 = np.append(e[:3], turn)
        six.append(e6 @ np.linalg.solve(s.pose6.cov, e6))
    low, high = chdtri(4 * len(four), (0.9995, 0.0005)) / len(four)
    assert 0.5 * low < float(np.mean(four)) < high
    assert float(np.mean(six)) < chdtri(6 * len(six), 0.0005) / len(six)


def test_a_level_deck_in_the_image_corrects_the_attitude(camera: Camera, pad: Pad) -> None:
    """The frame's tilt over a level deck is the attitude's error, and correcting it improves the place."""
    stage = Stage(camera, pad)
    plain, better = [], []
    for _ in range(10):
        view = stage.view(1.5)
        orientation = believed(view, stage.rng, math.radians(1.0), 1e-4)
        found = look(FrameView(Pyramid(view.px), camera, pad), stage.start(view, 0.3), orientation, TRACK)
        assert found is not None
        s = sighting_of_look(view.frame(), found, confidence(found.log_odds))
        better.append(np.linalg.norm((s.d_body_pad_level - view.d_body_pad_level)[:2]))
        mount = camera.T_body_cam
        by_attitude = orientation.R_level_body.matrix @ (mount.R.matrix @ found.pose.t_cam_pad + mount.t)
        plain.append(np.linalg.norm((by_attitude - view.d_body_pad_level)[:2]))
    assert float(np.median(better)) < 0.2 * float(np.median(plain))


def test_no_heading_without_h_and_arrow(camera: Camera, pad: Pad) -> None:
    stage = Stage(camera, pad)
    view = stage.view(1.0, lateral=0.0)
    px = view.px.copy()
    uv = camera.project(view.pose.points(pad.circle(0.33)))
    cv2.fillPoly(px, [np.round(uv * 16).astype(np.int32)], (0, 102, 0), cv2.LINE_AA, 4)
    found = look(FrameView(Pyramid(px), camera, pad), view.pose, view.orientation(), TRACK)
    assert found is not None
    s = sighting_of_look(view.frame(), found, confidence(found.log_odds))
    assert s.yaw_rad is None
    assert not s.yaw_ambiguous
    assert s.cov[3, 3] == UNKNOWN_YAW_VAR
    assert not np.any(s.cov[3, :3])
    assert s.confidence < 0.6
