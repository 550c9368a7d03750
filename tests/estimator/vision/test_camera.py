"""The camera as a value, and linear light."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from estimator.contracts.geometry import Rotation, Transform
from estimator.contracts.samples import Attitude
from estimator.vision.camera import Camera, ray_map
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track
from sitl.camera.projection import lens_of
from tests.support.pad_images import STAMP
from tests.support.pad_views import Stage
from tests.support.shipped import shipped_camera, shipped_pad


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
