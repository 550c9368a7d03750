"""The native core's alignment and verification against their oracle in numpy."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from hypothesis import strategies as st
from numpy.typing import NDArray

from estimator.contracts.geometry import Rotation
from estimator.vision.camera import Camera
from estimator.vision.detect import alignment
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.native import address, pixels
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.register.options import RegistrationOptions
from tests.support.pad_scenes import CONDITIONS, pad_scene

SIGMA = alignment.SIGMA_TILT_RAD
TRACK = RegistrationOptions(coarse=False)
INDEX, SEED = st.integers(0, 11), st.integers(0, 10_000)


@lru_cache(maxsize=16)
def scene(camera: Camera, pad: Pad, index: int) -> tuple[Pyramid, PadPose]:
    """Return one of some frames from 0.3 to 19 m in all conditions, and the true pose."""
    seen = pad_scene(np.random.default_rng(index), camera, pad, 0.3 * 1.45**index, CONDITIONS[index % len(CONDITIONS)])
    assert seen.truth is not None
    return Pyramid(seen.px), seen.truth


def beside(pose: PadPose, seed: int) -> PadPose:
    """Return a pose that is off by a tenth of the disc and by 2 % of the height at one sigma, and turned."""
    rng = np.random.default_rng(seed)
    off = rng.normal(0.0, 1.0, 3) * np.array([0.03, 0.03, 0.02 * pose.t_cam_pad[2]])
    return PadPose(pose.R_cam_pad @ Rotation.from_rotvec(rng.normal(0.0, 0.02, 3)), pose.t_cam_pad + off)


def test_an_image_that_c_would_misread_is_refused() -> None:
    px = np.zeros((4, 6, 3), np.uint8)
    assert pixels(px[1:, 2:]) == (px.ctypes.data + 18 + 6, 18)
    wrong: list[NDArray[np.generic]] = [px[:, ::2], px[:, :, :2], px.astype(np.int8), px[:, :, 0]]
    for image in wrong:
        with pytest.raises(TypeError, match="BGR"):
            pixels(image)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="float64"):
        address(np.zeros(3, np.float32))
