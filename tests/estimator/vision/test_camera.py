"""The camera as a value: equal numbers make equal cameras, so that what is kept for one is found for its like."""

from dataclasses import replace

import numpy as np

from estimator.contracts.geometry import Rotation, Transform
from estimator.vision.camera import Camera, ray_map
from sitl.camera.projection import lens_of


def camera(k1: float = -0.2) -> Camera:
    mount = Transform(Rotation.from_rpy(0.0, 0.1, 0.2), np.array([0.01, 0.0, 0.05]))
    return Camera(64, 48, 60.0, 61.0, 31.5, 23.5, np.array([k1, 0.01, 0.0, 0.0, 0.0]), mount)


def test_cameras_with_the_same_numbers_are_one_key() -> None:
    assert camera() == camera()
    assert hash(camera()) == hash(camera())
    assert camera() != "camera"


def test_any_other_number_makes_another_camera() -> None:
    one = camera()
    turned = Transform(Rotation.from_rpy(0.0, 0.1, 0.21), one.T_body_cam.t)
    moved = Transform(one.T_body_cam.R, np.array([0.01, 0.0, 0.06]))
    others = [replace(one, **{name: getattr(one, name) + 1}) for name in ("width", "height", "fx", "fy", "cx", "cy")]
    others += [camera(-0.21), replace(one, T_body_cam=turned), replace(one, T_body_cam=moved)]
    assert all(one != other for other in others)


def test_a_camera_read_again_shares_what_was_made_for_the_first() -> None:
    """Each flight of a soak reads its camera file anew; a map for each would be kept for as many flights as the cache is long."""
    assert ray_map(camera()) is ray_map(camera())
    assert lens_of(camera()) is lens_of(camera())
