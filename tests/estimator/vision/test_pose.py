"""The camera as a value, and the pose from marks: exact under any tilt and lens; its covariance is what Monte Carlo finds."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from estimator.contracts.geometry import F64, Rotation, Transform, wrap_pi
from estimator.contracts.samples import Attitude
from estimator.vision.camera import Camera, ray_map
from estimator.vision.pad import Pad
from estimator.vision.pose import SIGMA_LEVEL_ASSUMED_RAD, Marks, Orientation, OrientedCamera, point_modes, solve
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track
from sitl.camera.projection import lens_of
from tests.support.pad_images import STAMP, PadPlacement, project, sim_camera
from tests.support.pad_views import Stage
from tests.support.shipped import shipped_camera, shipped_pad

angle = st.floats(-math.pi + 1e-6, math.pi, allow_nan=False)
tilt = st.floats(-0.35, 0.35)
side = st.floats(-0.3, 0.3)


def marks_of(points: F64, scene: PadPlacement, camera: Camera, sigma_px: float = 0.1) -> Marks:
    return Marks(project(points, scene, camera), points[:, :2], point_modes(np.full(len(points), sigma_px)))


@settings(max_examples=60)
@given(x=side, y=side, z=st.floats(0.3, 20.0), yaw=angle, roll=tilt, pitch=tilt, lens=st.booleans(), ahead=st.floats(-0.2, 0.2))
def test_exact_marks_give_the_exact_pose(x, y, z, yaw, roll, pitch, lens, ahead):
    """Tilt is put in, the camera's place on the body is turned with it, and the lens is undone."""
    distortion = (0.05, -0.02, 0.002, -0.001, 0.0) if lens else (0.0,) * 5
    camera = sim_camera((ahead, 0.03, 0.05), distortion)
    scene = PadPlacement((x * z, y * z, z), yaw, roll, pitch)
    points = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]])
    T = scene.T_cam_pad(camera)
    p_cam = points @ T.R.matrix.T + T.t
    # Farther out this lens folds its frame over, and nothing can undo that.
    assume(bool(np.all(p_cam[:, 2] > 0.1)) and float(np.abs(p_cam[:, :2] / p_cam[:, 2:]).max()) < 0.95)
    fix = solve(marks_of(points, scene, camera), OrientedCamera(camera, Orientation.of(scene.attitude())))
    assert fix is not None
    assert np.allclose(fix.d_body_pad_level, scene.d_body_pad_level, atol=1e-6 * max(1.0, z))
    assert abs(wrap_pi(fix.yaw_rad - yaw)) < 1e-6


def test_the_covariance_is_what_a_monte_carlo_finds(pad: Pad) -> None:
    """Pixels, roll and pitch, and the deck's tilt all drawn at random, for marks away from the middle of the frame."""
    camera = sim_camera()
    sigma_px, sigma_tilt, sigma_deck = 0.3, math.radians(0.6), math.radians(0.8)
    scene = PadPlacement((0.6, -0.5, 1.5), 0.6, 0.08, -0.05)
    points = np.concatenate([np.zeros((1, 3)), pad.markings.arrowhead()[:1]])
    attitude = Attitude(STAMP, scene.attitude().R_ned_body, np.diag([1.0, 1.0, 4.0]) * sigma_tilt**2)
    orientation = Orientation.of(attitude, sigma_deck)
    predicted = solve(marks_of(points, scene, camera, sigma_px), OrientedCamera(camera, orientation))
    assert predicted is not None
    rng = np.random.default_rng(4)
    errors = []
    for _ in range(600):
        deck = PadPlacement(scene.d_body_pad_level, scene.yaw_rad, scene.roll_rad, scene.pitch_rad, *rng.normal(0, sigma_deck, 2))
        uv = project(points, deck, camera) + rng.normal(0, sigma_px, (2, 2))
        slip = rng.normal(0, sigma_tilt, 3) * (1, 1, 2)
        R = attitude.R_ned_body @ Rotation.from_rotvec(slip)
        view = OrientedCamera(camera, Orientation.of(Attitude(STAMP, R, attitude.cov_body)))
        fix = solve(Marks(uv, points[:, :2], point_modes(np.full(2, sigma_px))), view)
        assert fix is not None
        errors.append(np.append(fix.d_body_pad_level - scene.d_body_pad_level, wrap_pi(fix.yaw_rad - scene.yaw_rad)))
    e = np.array(errors)
    nees = np.einsum("ni,ij,nj->n", e, np.linalg.inv(predicted.cov), e)
    assert 3.6 < nees.mean() < 4.4
    ratio = e.std(axis=0) / np.sqrt(np.diag(predicted.cov))
    assert np.all((ratio > 0.88) & (ratio < 1.12))


def test_without_an_attitude_level_is_assumed_and_priced(camera: Camera) -> None:
    scene = PadPlacement((0.15, 0.0, 4.0))
    points = np.array([[0, 0, 0], [0.3, 0, 0.0]])
    reported = solve(marks_of(points, scene, camera), OrientedCamera(camera, Orientation.of(scene.attitude())))
    assumed = solve(marks_of(points, scene, camera), OrientedCamera(camera, Orientation.of(None)))
    assert reported is not None
    assert assumed is not None
    assert np.allclose(reported.d_body_pad_level, assumed.d_body_pad_level, atol=1e-9)
    # 4 m below a lever of the unknown tilt.
    assert math.sqrt(assumed.cov[1, 1]) == pytest.approx(4.0 * SIGMA_LEVEL_ASSUMED_RAD, rel=0.02)
    assert math.sqrt(reported.cov[1, 1]) < 0.03


def test_rays_that_miss_the_deck_give_nothing() -> None:
    """A camera that looks at the horizon sees no deck below it, and there is no answer in zeros."""
    mount = Transform(Rotation.from_rpy(math.pi / 2, 0.0, math.pi / 2), np.zeros(3))
    camera = Camera(640, 360, 374.67, 374.67, 319.5, 179.5, np.zeros(5), mount)
    view = OrientedCamera(camera, Orientation.of(None))
    assert np.all(np.isnan(view.plane(np.array([[319.5, 100.0]]))))
    marks = Marks(np.array([[319.5, 100.0], [319.5, 50.0]]), np.array([[0, 0], [0.3, 0]]), point_modes(np.full(2, 0.1)))
    assert solve(marks, view) is None
    at_one_place = Marks(np.full((2, 2), 200.0), np.array([[0, 0], [0.3, 0]]), point_modes(np.full(2, 0.1)))
    assert solve(at_one_place, OrientedCamera(sim_camera(), Orientation.of(None))) is None


def camera(k1: float = -0.2) -> Camera:
    mount = Transform(Rotation.from_rpy(0.0, 0.1, 0.2), np.array([0.01, 0.0, 0.05]))
    return Camera(64, 48, 60.0, 61.0, 31.5, 23.5, np.array([k1, 0.01, 0.0, 0.0, 0.0]), mount)


def test_any_other_number_makes_another_camera() -> None:
    one = camera()
    turned = Transform(Rotation.from_rpy(0.0, 0.1, 0.21), one.T_body_cam.t)
    moved = Transform(one.T_body_cam.R, np.array([0.01, 0.0, 0.06]))
    others = [replace(one, **{name: getattr(one, name) + 1}) for name in ("width", "height", "fx", "fy", "cx", "cy")]
    others += [camera(-0.21), replace(one, T_body_cam=turned), replace(one, T_body_cam=moved)]
    assert all(one != other for other in others)
    assert one == camera()


def test_a_camera_read_again_shares_what_was_made_for_the_first() -> None:
    """Each flight of a soak reads its camera file again; a map for each would fill the cache."""
    assert ray_map(camera()) is ray_map(camera())
    assert lens_of(camera()) is lens_of(camera())


def test_a_fisheye_of_160_degrees_finds_the_pad_and_an_uncertain_focal_length_shows_in_its_depth() -> None:
    whole = shipped_camera("sim")
    lens = replace(whole, fx=260.0, fy=261.0, lens="fisheye", distortion=np.array([-0.02, 0.004, -0.001, 0.0002]))
    uv = np.stack(np.meshgrid(np.linspace(0, 639, 9), np.linspace(0, 359, 7)), axis=-1).reshape(-1, 2)
    rays = lens.rays(uv)
    assert np.degrees(2.0 * np.arctan(np.hypot(*rays[0]))) > 160.0
    assert np.allclose(rays, cv2.fisheye.undistortPoints(uv[:, None], lens.K, lens.distortion)[:, 0], atol=1e-9)
    assert np.allclose(lens.project(np.c_[rays, np.ones(len(rays))]), uv, atol=1e-9)
    view = Stage(lens, shipped_pad("thesis"), seed=3).view(2.0, lateral=0.8)
    reported = Attitude(STAMP, Rotation.from_rpy(view.roll_rad, view.pitch_rad, 0.0), 1e-8 * np.eye(3))
    known, unknown = (
        track(TrackerConfig(camera, shipped_pad("thesis")), TrackerMemory(), view.frame(), reported)[0].selected
        for camera in (lens, replace(lens, focal_sigma=0.01))
    )
    assert known is not None
    assert unknown is not None
    off = known.d_body_pad_level - view.d_body_pad_level
    assert off @ np.linalg.solve(known.cov[:3, :3], off) < 14.2
    assert np.linalg.norm(off) < 2e-3
    assert np.sqrt(unknown.cov[2, 2] - known.cov[2, 2]) == pytest.approx(0.01 * view.pose.t_cam_pad[2], rel=0.05)
