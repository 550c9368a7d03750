"""The camera as a value, the pose from marks, exact under any tilt and lens, and the sighting that it becomes."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.tools.calibrate.flight_views import camera_pose
from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64, Rotation, Transform, rpy_matrix, wrap_pi
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera.camera import Camera, ray_map
from estimator.vision.camera.pose import SIGMA_LEVEL_ASSUMED_RAD, Marks, Orientation, OrientedCamera, PadPose, point_modes, solve
from estimator.vision.pad.pad import Pad
from estimator.vision.register.sighting import sighting_of
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track
from sitl.camera.projection import lens_of
from tests.estimator.ekf import oracle
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
    rng = np.random.default_rng(4)
    errors = []
    for _ in range(600):
        deck = PadPlacement(scene.d_body_pad_level, scene.yaw_rad, scene.roll_rad, scene.pitch_rad, *rng.normal(0, sigma_deck, 2))
        uv = project(points, deck, camera) + rng.normal(0, sigma_px, (2, 2))
        slip = rng.normal(0, sigma_tilt, 3) * (1, 1, 2)
        R = attitude.R_ned_body @ Rotation.from_rotvec(slip)
        view = OrientedCamera(camera, Orientation.of(Attitude(STAMP, R, attitude.cov_body)))
        fix = solve(Marks(uv, points[:, :2], point_modes(np.full(2, sigma_px))), view)
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
    off = known.d_body_pad_level - view.d_body_pad_level
    assert off @ np.linalg.solve(known.cov[:3, :3], off) < 14.2
    assert np.linalg.norm(off) < 2e-3
    assert np.sqrt(unknown.cov[2, 2] - known.cov[2, 2]) == pytest.approx(0.01 * view.pose.t_cam_pad[2], rel=0.05)


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
    R = pose_seen.pose6.R_level_pad.matrix
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)


def test_the_heading_of_a_tilted_pad_is_that_of_its_arrow_along_the_horizon(camera: Camera) -> None:
    deck = np.array([0.3, -0.4])
    pose_seen = levelled(camera, deck, np.zeros(6), np.zeros(2), 10.0)
    R, rows = pose_seen.pose6.R_level_pad.matrix, np.eye(4, 6)
    for k in range(3):
        more, less = (oracle.exp(sign * STEP * np.eye(3)[k]) @ R for sign in (1, -1))
        rows[3, 3 + k] = (math.atan2(less[1, 0], less[0, 0]) - math.atan2(more[1, 0], more[0, 0])) / (2.0 * STEP)
    np.testing.assert_allclose(pose_seen.cov, rows @ pose_seen.pose6.cov @ rows.T, rtol=1e-6, atol=1e-12)
    assert pose_seen.yaw_rad == pytest.approx(-math.atan2(R[1, 0], R[0, 0]), abs=1e-12)
