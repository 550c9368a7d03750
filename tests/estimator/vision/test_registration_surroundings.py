"""Registration's covariance holds whatever surrounds the pad, also where camera and deck are tilted."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from estimator.vision.register.registration import RegistrationOptions, register
from tests.support.pad_surroundings import SURROUNDINGS, surrounded_view
from tests.support.pad_views import error

TRACK = RegistrationOptions(coarse=False)


def errors(camera: Camera, pad: Pad, name: str, height_m: float, tilt_deg: float, frames: int) -> tuple[F64, F64]:
    """Return the errors along the pad's axes, (frames, 6) in m and rad, and the covariances, (frames, 6, 6)."""
    off, cov = [], []
    for k in range(frames):
        rng = np.random.default_rng([67, SURROUNDINGS.index(name), round(10 * height_m), round(tilt_deg), k])
        view = surrounded_view(rng, camera, pad, name, height_m, math.radians(tilt_deg))
        found = register(view.px, camera, pad, view.start, view.prior, TRACK)
        assert found is not None
        T = np.kron(np.eye(2), view.truth.R_cam_pad.matrix.T)
        off.append(T @ error(found.pose, view.truth))
        cov.append(T @ found.cov @ T.T)
    return np.array(off), np.array(cov)


@pytest.mark.parametrize(("height_m", "most_deg"), [(5.0, 0.15), (10.0, 0.3)])
def test_a_blur_that_a_tilt_slants_does_not_turn_the_pad(camera: Camera, pad: Pad, height_m: float, most_deg: float) -> None:
    """Seen obliquely a round blur is an ellipse on the deck, which an H that it merges would follow."""
    off, _ = errors(camera, pad, "even", height_m, 25.0, 14)
    assert math.degrees(math.sqrt(float((off[:, 5] ** 2).mean()))) < most_deg


@pytest.mark.parametrize(("name", "height_m"), [("patchy", 30.0), ("wet", 20.0), ("wet", 10.0)])
def test_the_tilt_is_no_more_certain_than_the_frame(camera: Camera, pad: Pad, name: str, height_m: float) -> None:
    off, cov = errors(camera, pad, name, height_m, 12.0, 16)
    squares = off[:, 3:5] ** 2 / np.array([np.diag(c)[3:5] for c in cov])
    assert 0.2 < float(squares.mean()) < 2.2


@pytest.mark.parametrize("name", ["even", "patchy", "wet", "edge of the deck", "asphalt", "sea"])
def test_a_distant_pads_covariance_holds_in_all_directions(camera: Camera, pad: Pad, name: str) -> None:
    off, cov = errors(camera, pad, name, 20.0, 12.0, 12)
    nees = np.array([e @ np.linalg.solve(c, e) for e, c in zip(off, cov, strict=True)]) / 6.0
    assert 0.15 < float(np.median(nees)) < 1.9
    assert float(np.sort(nees)[-2]) < 6.0


@pytest.mark.parametrize("name", ["asphalt", "wet", "patchy"])
def test_what_all_channels_see_is_one_witness_and_wider_than_a_pixel(camera: Camera, pad: Pad, name: str) -> None:
    """Stones, puddles and wear darken blue, green and red together, and pass through the lens, as a sensor's noise does not."""
    off, cov = errors(camera, pad, name, 10.0, 12.0, 24)
    nees = np.array([e @ np.linalg.solve(c, e) for e, c in zip(off, cov, strict=True)]) / 6.0
    assert 0.5 < float(nees.mean()) < 1.6


@pytest.mark.parametrize("name", ["even", "sea", "shadow"])
def test_the_noise_of_pixels_on_an_edge_is_their_own(camera: Camera, pad: Pad, name: str) -> None:
    """Clipped paints hardly vary; at 5 m most of a profile's pixels lie between two of them."""
    off, cov = errors(camera, pad, name, 5.0, 12.0, 40)
    nees = np.array([e @ np.linalg.solve(c, e) for e, c in zip(off, cov, strict=True)]) / 6.0
    assert 0.7 < float(nees.mean()) < 1.3


@pytest.mark.parametrize("name", ["asphalt", "edge of the deck", "sea"])
def test_what_lies_around_a_pad_does_not_have_it_rejected(camera: Camera, pad: Pad, name: str) -> None:
    """A doubted registration says half a metre at 10 m, and no heading."""
    sigmas, known = [], 0
    for k in range(10):
        rng = np.random.default_rng([83, SURROUNDINGS.index(name), 100, 12, k])
        view = surrounded_view(rng, camera, pad, name, 10.0, math.radians(12.0))
        found = register(view.px, camera, pad, view.start, view.prior, TRACK)
        assert found is not None
        sight = view.truth.t_cam_pad / view.truth.range_m
        sigmas.append(math.sqrt(float(sight @ found.cov[:3, :3] @ sight)))
        known += not found.yaw_ambiguous
    assert np.median(sigmas) < 0.05
    assert known >= 9


@pytest.mark.parametrize(("height_m", "least"), [(1.0, 0.0015), (12.0, 0.003)])
def test_a_pad_painted_to_a_tolerance_is_at_a_range_of_that_tolerance(camera, pad, height_m, least):
    """Two millimetres of a disc of 390 are half a percent of the range; its lettering and ring say the range, too."""
    view = surrounded_view(np.random.default_rng([67, round(height_m)]), camera, pad, "even", height_m, 0.0)
    rough = replace(pad, size_sigma_m=0.002)
    sigmas = []
    for drawn in (pad, rough):
        found = register(view.px, camera, drawn, view.start, view.prior, TRACK)
        assert found is not None
        sigmas.append(math.sqrt(found.cov[2, 2]) / height_m)
    assert sigmas[0] < least < sigmas[1] < 0.0075
