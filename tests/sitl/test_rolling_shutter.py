"""Each row of a rolling shutter shows the scene at its own time."""

from dataclasses import replace

import numpy as np
import pytest

from estimator.contracts.geometry import Rotation
from estimator.vision.camera import Camera
from sitl.camera.camera import Renderer
from sitl.camera.surroundings import Surroundings
from tests.sitl.images import BENT, PLAIN, pad, shot
from tests.support.plain_light import FLAT, IDEAL

READOUT_S = 0.03


@pytest.mark.parametrize("camera", [PLAIN, BENT], ids=["straight", "distorted"])
def test_a_row_is_that_of_a_global_shutter_at_the_row_s_time(camera: Camera) -> None:
    moving = replace(
        shot(1.0, (0.05, 0.03), (0.05, 0.02, 0.4)), v_body_ned=np.array([1.0, -0.6, 0.3]), w_body=np.array([0.6, -0.5, 1.5])
    )
    rolling = Renderer(camera, pad("thesis"), Surroundings(), FLAT, replace(IDEAL, readout_s=READOUT_S)).radiance(moving)
    at_once = Renderer(camera, pad("thesis"), Surroundings(), FLAT, IDEAL)
    middle = at_once.radiance(moving)
    off, whole = [], []
    for row in range(10, 350, 20):
        t = (row / 359 - 0.5) * READOUT_S
        R = moving.R_ned_body @ Rotation.from_rotvec(moving.w_body * t)
        then = at_once.radiance(replace(moving, R_ned_body=R, p_body_ned=moving.p_body_ned + moving.v_body_ned * t))[row]
        off.append(rolling[row] - then)
        whole.append(middle[row] - then)
    assert np.sqrt(np.mean(np.square(off))) < 0.08 * np.sqrt(np.mean(np.square(whole)))
    assert np.abs(off).max() < 0.15


def test_a_still_scene_is_that_of_a_global_shutter() -> None:
    still = shot(1.0, (0.05, 0.03), (0.05, 0.02, 0.4))
    rolling, at_once = (
        Renderer(PLAIN, pad("thesis"), Surroundings(), FLAT, replace(IDEAL, readout_s=s)).radiance(still)
        for s in (READOUT_S, 0.0)
    )
    assert np.abs(rolling - at_once).max() < 2e-3
