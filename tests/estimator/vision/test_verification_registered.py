"""The judge of registrations: sure of the pad, not of a helipad on green, and less with every part that is painted over."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude
from estimator.vision.camera import Camera
from estimator.vision.detect.acquire import acquire
from estimator.vision.detect.alignment import SIGMA_TILT_RAD, align
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.fit_verification import FITTED_FEATURES, HAND_SET_FEATURES, confidence, features
from estimator.vision.register.registration import RegistrationOptions, register
from sitl.surroundings import Decal
from tests.support.deck_images import covered, disc_of, shown
from tests.support.hard_light import HARD
from tests.support.pad_images import STAMP


def sure(px: NDArray[np.uint8], camera: Camera, pad: Pad, start: PadPose, R_level_body: Rotation) -> float:
    orientation = Orientation.of(Attitude(STAMP, R_level_body, 1e-6 * np.eye(3)))
    found = register(px, camera, pad, start, orientation, RegistrationOptions(coarse=False))
    if found is None:
        return 0.0
    aligned = align(Pyramid(px), camera, pad, found.pose, SIGMA_TILT_RAD, 0)
    if aligned is None:
        return 0.0
    values = features(aligned, found, pad)
    assert values.shape == (len(FITTED_FEATURES) + len(HAND_SET_FEATURES),)
    assert np.all(np.isfinite(values))
    return confidence(values)


@pytest.mark.parametrize("height_m", [0.4, 1.2, 4.0, 12.0])
def test_sure_of_the_pad(camera: Camera, pad: Pad, height_m: float) -> None:
    seen = shown(camera, pad, height_m)
    assert sure(seen.px, camera, pad, seen.truth, seen.R_level_body) > 0.9


@pytest.mark.parametrize("height_m", [0.4, 1.2, 4.0, 12.0])
def test_sure_of_a_pad_with_dark_marks(camera: Camera, height_m: float) -> None:
    pad = HARD["black on white"].pad
    seen = shown(camera, pad, height_m)
    assert sure(seen.px, camera, pad, seen.truth, seen.R_level_body) > 0.9


def test_less_sure_with_every_part_that_is_painted_over(camera: Camera, pad: Pad) -> None:
    seen = shown(camera, pad, 1.2)
    band = np.concatenate([disc_of(0.31), disc_of(0.31)[:1], disc_of(0.225)[:1], disc_of(0.225)[::-1]])
    for outline in (disc_of(0.2), band, disc_of(0.31)):
        px = covered(seen, camera, outline, (0, 95, 0))
        assert sure(px, camera, pad, seen.truth, seen.R_level_body) < 0.3


@pytest.mark.parametrize("height_m", [0.6, 1.5, 4.0])
def test_not_sure_of_a_helipad_on_green(camera: Camera, pad: Pad, height_m: float) -> None:
    seen = shown(camera, None, height_m, decals=(Decal("helipad", (0.05, -0.03), 0.9, 0.5, "deck", (0, 102, 0)),))
    for candidate in acquire(seen.px, camera, pad, seen.R_level_body, sure=2.0):
        assert sure(seen.px, camera, pad, candidate.pose, seen.R_level_body) < 0.3
