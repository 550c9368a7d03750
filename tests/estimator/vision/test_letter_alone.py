"""An H or X alone on the bare deck: found, and not seen in other things."""

import math

import numpy as np
import pytest

from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import Rotation, wrap_pi
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.options import TrackerOptions
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track
from sitl.camera.camera import Renderer
from tests.sitl.images import PLAIN, shot
from tests.support.pad_images import STAMP
from tests.support.pad_scenes import empty_scene, load_camera
from tests.support.shipped import shipped_pad


@pytest.mark.parametrize(("name", "height_m"), [("h", 0.4), ("h", 1.0), ("h", 3.0), ("x", 1.0), ("x", 2.0), ("x", 4.0)])
@pytest.mark.parametrize("yaw_rad", [0.3, -2.0])
def test_a_letter_is_found_up_to_its_symmetry(name: str, height_m: float, yaw_rad: float) -> None:
    pad, exposure = shipped_pad(name), shot(height_m, (0.02, 0.03), (0.08, -0.05, yaw_rad))
    px = Renderer(PLAIN, pad).render(exposure, np.random.default_rng(3))
    config = TrackerConfig(PLAIN, pad, TrackerOptions(method="registration"))
    attitude = Attitude(STAMP, exposure.R_ned_body, 1e-6 * np.eye(3))
    found = track(config, TrackerMemory(), Frame(STAMP, 0, px), attitude)[0].selected
    assert found is not None
    assert found.yaw_rad is not None
    assert found.confidence > 0.9
    assert found.yaw_ambiguous
    assert abs(found.d_body_pad_level[2] - (exposure.p_pad_ned - exposure.p_body_ned)[2]) < 0.003 * height_m
    symmetry = math.pi if name == "h" else math.pi / 2
    assert abs(math.remainder(found.yaw_rad - (yaw_rad - 0.7), symmetry)) < math.radians(2.0)
    if name == "x":
        assert abs(wrap_pi(found.yaw_rad)) <= math.radians(47.0), "of four the one nearest to the nose"


@pytest.mark.parametrize("name", ["h", "x"])
def test_a_letter_is_not_seen_on_decks_and_sea_without_one(name: str) -> None:
    """A bare H used to be seen on 37 of 40 of these, an X on 25."""
    config = TrackerConfig(load_camera("sim"), shipped_pad(name), TrackerOptions(method="registration"))
    sure = 0
    for i in range(12):
        rng = np.random.default_rng([9200, i])
        scene = empty_scene(rng, config.camera, float(np.exp(rng.uniform(math.log(0.4), math.log(20.0)))))
        R = scene.R_level_body
        attitude = None if R is None else Attitude(STAMP, R, 3e-4 * np.eye(3))
        seen = track(config, TrackerMemory(), Frame(STAMP, 0, scene.px), attitude)[0].selected
        sure += seen is not None and seen.confidence >= 0.5
    assert sure == 0


@pytest.mark.parametrize(("name", "sigma"), [("h", 0.004), ("h", 0.02), ("x", 0.02)])
def test_a_letter_that_is_followed_is_at_its_place_or_rejected(name: str, sigma: float) -> None:
    """Half of the fits beside a distant letter used to take the bare deck for one of another size, at a confidence of 1."""
    pad = shipped_pad(name)
    config = TrackerConfig(PLAIN, pad, TrackerOptions(method="registration"))
    renderer, rng, sure = Renderer(PLAIN, pad), np.random.default_rng(17), 0
    for height_m in (4.0, 7.0, 10.0):
        exposure = shot(height_m, (0.02, 0.03), (0.4, -0.3, 0.3))
        px = renderer.render(exposure, rng)
        attitude = Attitude(STAMP, exposure.R_ned_body, 1e-6 * np.eye(3))
        true = Rotation.from_rpy(0.0, 0.0, exposure.R_ned_body.rpy_rad[2]).inv @ (exposure.p_pad_ned - exposure.p_body_ned)
        heading = (exposure.R_ned_body.inv @ exposure.R_ned_pad).rpy_rad[2]
        for _ in range(5):
            sigma_m = sigma * height_m
            cov = np.diag([sigma_m**2] * 3 + [0.01] * 3 + [4e-4])
            near = true + rng.normal(0.0, sigma_m, 3)
            belief = RelativeState(STAMP.measured_at, "ekf", near, np.zeros(3), heading, cov, STAMP.measured_at, True)
            seen = track(config, TrackerMemory(), Frame(STAMP, 0, px), attitude, belief)[0].selected
            if seen is not None and seen.confidence >= 0.5:
                sure += 1
                assert np.linalg.norm(seen.d_body_pad_level - true) < 0.03 * height_m
    assert sure >= 3
