"""A small pad is looked for some pixels about the place where it is expected."""

import math

import numpy as np

from estimator.vision.camera import Camera
from estimator.vision.detect.guesses import pose_about
from estimator.vision.detect.plane import Plane
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.verified import SURE, verified
from tests.support.pad_scenes import PadScene, pad_scene


def half_covered(camera: Camera, pad: Pad, k: int) -> tuple[PadScene, PadPose, Plane]:
    """Return a scene at 15 m, a pose 2.5 px off the true one, and the plane of the true attitude."""
    scene = pad_scene(np.random.default_rng([77, k, 150]), camera, pad, 15.0, "half covered")
    assert scene.truth is not None
    off = 2.5 * float(scene.truth.t_cam_pad[2]) / camera.fx * np.array([math.cos(k), math.sin(k), 0.0])
    return scene, PadPose(scene.truth.R_cam_pad, scene.truth.t_cam_pad + off), Plane(scene.truth.R_cam_pad.matrix, True)


def test_half_a_pad_is_found_some_pixels_beside_the_expected_place_where_registration_finds_nothing(camera, pad):
    near = from_there = from_here = 0
    for k in range(12):
        scene, start, plane = half_covered(camera, pad, k)
        assert scene.truth is not None
        pyramid = Pyramid(scene.px)
        found = pose_about(pyramid, camera, pad, plane, start)
        assert found is not None
        there, true = camera.project(np.array([found[0].t_cam_pad, scene.truth.t_cam_pad]))
        near += bool(np.hypot(*(there - true)) < 1.5)
        of = verified(FrameView(pyramid, camera, pad), found[0], Orientation.of(None))
        from_there += of is not None and of.confidence >= SURE
        of = verified(FrameView(pyramid, camera, pad), start, Orientation.of(None))
        from_here += of is not None and of.confidence >= SURE
    assert near >= 10
    assert from_there >= 10
    assert from_here <= 2
