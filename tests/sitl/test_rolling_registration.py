"""Registration of frames whose rows are exposed one after the other, with and without the camera's readout time."""

import dataclasses
import math

import numpy as np
import pytest
from msgspec.structs import replace

from companion.guidance.pilot import make_pilot
from companion.settings.load import load
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import BodyMotion
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.camera import Camera
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.registration import register
from estimator.vision.rolling import CameraMotion, at_one_instant
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.surroundings import Surroundings
from tests import make
from tests.sitl.images import BENT, PLAIN, pad, pad_pose, shot
from tests.support.plain_light import FLAT, IDEAL

READOUT_S = 0.03
SENSOR = replace(IDEAL, psf_sigma_px=0.7, read_noise_e=10.0, full_well_e=8000.0)


def motion_of(view: Exposure, camera: Camera) -> CameraMotion:
    """Return the true motion of the camera against a pad at rest."""
    R_ned_cam = view.R_ned_body @ camera.T_body_cam.R
    arm = view.R_ned_body @ np.cross(view.w_body, camera.T_body_cam.t)
    return CameraMotion(camera.T_body_cam.R.inv @ view.w_body, R_ned_cam.inv @ (-view.v_body_ned - arm))


def errors(view: Exposure, camera: Camera, readout_s: float) -> tuple[F64, F64]:
    """Error of the registered pose, [m (3), rad (3)] in `cam`, as it is and corrected."""
    painted = pad("thesis")
    renderer = Renderer(camera, painted, Surroundings(), FLAT, replace(SENSOR, readout_s=readout_s))
    px = renderer.render(view, np.random.default_rng(3))
    true = pad_pose(view, camera)
    about = PadPose(Rotation.from_rotvec(np.array([0.01, -0.01, 0.02])) @ true.R_cam_pad, 1.02 * true.t_cam_pad)
    mended = at_one_instant(px, dataclasses.replace(camera, readout_s=readout_s), about, motion_of(view, camera))
    roll, pitch, _ = view.R_ned_body.rpy_rad
    tilt = Orientation(roll, pitch, math.radians(0.5) ** 2 * np.eye(2), math.radians(3.0), True)
    out = []
    for image in (px, mended):
        found = register(image, camera, painted, true, tilt)
        assert found is not None
        turned: Rotation = found.pose.R_cam_pad @ true.R_cam_pad.inv
        out.append(np.r_[found.pose.t_cam_pad - true.t_cam_pad, turned.rotvec_rad])
    return out[0], out[1]


@pytest.mark.parametrize("camera", [PLAIN, BENT], ids=["straight", "distorted"])
@pytest.mark.parametrize("height_m", [0.7, 1.5, 3.0])
def test_the_readout_is_taken_out_of_the_pose(camera: Camera, height_m: float) -> None:
    rng = np.random.default_rng(round(100 * height_m))
    before, after = [], []
    for _ in range(4):
        view = replace(
            shot(height_m, tuple(rng.uniform(-0.15, 0.15, 2)), tuple(rng.uniform(-0.08, 0.08, 3))),
            v_body_ned=rng.uniform(-0.5, 0.5, 3) * height_m / 2.0,
            w_body=rng.uniform(-0.6, 0.6, 3),
        )
        as_it_is, mended = errors(view, camera, READOUT_S)
        before.append(as_it_is / np.r_[np.full(3, height_m), np.ones(3)])
        after.append(mended / np.r_[np.full(3, height_m), np.ones(3)])
    assert np.linalg.norm(after) < 0.06 * np.linalg.norm(before)
    assert float(np.abs(before).max()) > 0.005


def test_a_frame_in_which_nothing_moves_is_left_as_it_is() -> None:
    px = np.zeros((360, 640, 3), np.uint8)
    still = CameraMotion(np.zeros(3), np.zeros(3))
    assert at_one_instant(px, dataclasses.replace(PLAIN, readout_s=0.03), pad_pose(shot(1.0), PLAIN), still) is px


@pytest.mark.parametrize("noise_rad", [0.0, 2e-3])
def test_the_camera_s_motion_is_that_of_the_attitude_and_the_belief_or_of_the_gyro(
    noise_rad: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A body that turns about all axes and flies over a pad, its camera at the nose.

    The difference of two reported attitudes over 30 ms is noise: 0.1 rad/s for 2 mrad each.
    """
    w_body, v_body_ned, rng = np.array([0.5, -0.3, 0.2]), np.array([0.4, -0.2, 0.1]), np.random.default_rng(4)
    pilot = make_pilot(load("sim"))
    for k in range(120):
        turned = Rotation.from_rotvec(w_body * 0.01 * k) @ Rotation.from_rotvec(noise_rad * rng.standard_normal(3))
        pilot.on_sample(Attitude(make.stamp(1.0 + 0.01 * k), turned, (1e-6 + noise_rad**2) * np.eye(3)))
    stamp, R = make.stamp(2.0), Rotation.from_rotvec(w_body)
    at, v_level = stamp.measured_at, Rotation.from_rpy(0.0, 0.0, -R.rpy_rad[2]) @ -v_body_ned
    belief = RelativeState(at, "ekf", np.array([0.1, 0.2, 1.5]), v_level, 0.0, 1e-4 * np.eye(7), at, True)
    rolling = dataclasses.replace(PLAIN, readout_s=READOUT_S)
    true = motion_of(replace(shot(1.0), R_ned_body=R, v_body_ned=v_body_ned, w_body=w_body), PLAIN)
    by_attitude = pilot.estimator.camera_motion(stamp, rolling, belief)
    assert by_attitude is not None
    assert pilot.estimator.camera_motion(make.stamp(9.0), rolling, belief) is None
    if not noise_rad:
        assert by_attitude.w_cam == pytest.approx(true.w_cam, abs=1e-3)
        assert by_attitude.v_pad_cam == pytest.approx(true.v_pad_cam, abs=5e-3)
        return
    moves = BodyMotion(at, 0.0, np.zeros(3), np.eye(3), w_body, R, np.eye(3))
    # The gyro's rate is that of the exposure's instant, not of now.
    monkeypatch.setattr(pilot.estimator, "motion", lambda then: (moves, None) if then == at else None)
    by_gyro = pilot.estimator.camera_motion(stamp, rolling, belief)
    assert by_gyro is not None
    assert by_gyro.w_cam == pytest.approx(true.w_cam, abs=1e-9)
    assert np.linalg.norm(by_attitude.w_cam - true.w_cam) > 0.03


def test_a_camera_file_with_a_readout_time_changes_what_a_flight_sees() -> None:
    """The same rolling frames, tracked by a camera that knows its shutter and by one that does not."""
    still, painted, stamp = shot(1.5, (0.1, 0.05), (0.04, -0.03, 0.4)), pad("thesis"), make.stamp(2.0)
    view = replace(still, v_body_ned=np.array([0.3, -0.2, 0.1]), w_body=np.array([0.5, -0.6, 0.3]))
    renderer = Renderer(PLAIN, painted, Surroundings(), FLAT, replace(SENSOR, readout_s=READOUT_S))
    frame = Frame(stamp, 1, renderer.render(view, np.random.default_rng(1)))
    attitude = Attitude(stamp, view.R_ned_body, math.radians(0.2) ** 2 * np.eye(3))
    level = Rotation.from_rpy(0.0, 0.0, -view.R_ned_body.rpy_rad[2])
    d, heading = level @ (view.p_pad_ned - view.p_body_ned), (level @ view.R_ned_pad).rpy_rad[2]
    at, v = stamp.measured_at, level @ -view.v_body_ned
    belief, off = RelativeState(at, "ekf", d, v, -heading, 1e-4 * np.eye(7), at, True), {}
    for known_s in (0.0, READOUT_S):
        motion = motion_of(view, PLAIN) if known_s else None
        tracker = TrackerConfig(dataclasses.replace(PLAIN, readout_s=known_s), painted, motion=motion)
        seen, _ = track(tracker, TrackerMemory(), frame, attitude, belief)
        assert seen.selected is not None
        off[known_s] = float(np.linalg.norm(seen.selected.d_body_pad_level - d))
    assert off[READOUT_S] < 0.003 < 0.008 < off[0.0]
