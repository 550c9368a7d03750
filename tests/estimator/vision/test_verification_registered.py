"""The judge of registrations: sure of the pad, not of a helipad on green, and less with every part that is painted over."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.vision import native
from estimator.vision.camera import Camera
from estimator.vision.detect.acquire import acquire
from estimator.vision.detect.alignment import SIGMA_TILT_RAD, align
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.fit_verification import SEARCHED, calibrated, confidence
from estimator.vision.register.look import Looked, look
from estimator.vision.register.registration import RegistrationOptions, register
from estimator.vision.register.sighting import sighting_of, sighting_of_look
from sitl.camera.surroundings import Decal
from tests.support.deck_images import covered, disc_of, shown
from tests.support.hard_light import HARD
from tests.support.pad_images import STAMP
from tests.support.pad_scenes import CONDITIONS, load_pad, pad_scene

CLOSE = RegistrationOptions(coarse=False)
FRAME = Frame(STAMP, 0, np.zeros((2, 2, 3), np.uint8))


def looked(px: NDArray[np.uint8], camera: Camera, pad: Pad, start: PadPose, R_level_body: Rotation | None) -> Looked | None:
    attitude = None if R_level_body is None else Attitude(STAMP, R_level_body, 1e-6 * np.eye(3))
    return look(FrameView(Pyramid(px), camera, pad), start, Orientation.of(attitude), CLOSE)


def sure(px: NDArray[np.uint8], camera: Camera, pad: Pad, start: PadPose, R_level_body: Rotation) -> float:
    found = looked(px, camera, pad, start, R_level_body)
    return 0.0 if found is None else confidence(found.log_odds)


def test_a_look_is_a_registration_an_alignment_and_their_evidence(camera: Camera) -> None:
    """One call of the core gives what the parts give one by one."""
    rng, compared = np.random.default_rng(8), 0
    for k in range(40):
        pad = load_pad(("thesis", "printed", "icao", "h")[k % 4])
        height_m = math.exp(rng.uniform(math.log(0.25), math.log(20.0)))
        scene = pad_scene(rng, camera, pad, height_m, CONDITIONS[k % len(CONDITIONS)])
        assert scene.truth is not None
        pyramid = Pyramid(scene.px)
        found = looked(scene.px, camera, pad, scene.truth, scene.R_level_body)
        one = register(scene.px, camera, pad, scene.truth, None if found is None else found.orientation, CLOSE, pyramid=pyramid)
        if found is None or one is None:
            continue
        compared += 1
        registration, other = found.registration(), align(FrameView(pyramid, camera, pad), one.pose, SIGMA_TILT_RAD, 0)
        assert other is not None
        assert np.array_equal(registration.cov, one.cov)
        assert np.array_equal(found.pose.t_cam_pad, one.pose.t_cam_pad)
        assert found.record["aligned"]["features"] == pytest.approx(other.features, abs=1e-9)
        assert found.log_odds == pytest.approx(float(found.evidence @ SEARCHED), abs=1e-9)
        level = sighting_of(FRAME, one.pose, one.cov, camera, found.orientation, one.yaw_ambiguous, 0.5)
        assert np.array_equal(sighting_of_look(FRAME, found, 0.5).cov, level.cov)
    assert compared > 30


def test_a_rough_start_is_approached_first(camera: Camera, pad: Pad) -> None:
    for height_m in (0.5, 2.0, 8.0):
        seen = shown(camera, pad, height_m)
        off = PadPose(seen.truth.R_cam_pad, seen.truth.t_cam_pad + 0.04 * pad.disc_radius_m)
        pyramid, orientation = Pyramid(seen.px), Orientation.of(Attitude(STAMP, seen.R_level_body, 1e-6 * np.eye(3)))
        found = look(FrameView(pyramid, camera, pad), off, orientation, RegistrationOptions(coarse=True))
        one = register(seen.px, camera, pad, off, orientation, RegistrationOptions(coarse=True), pyramid=pyramid)
        assert found is not None
        assert one is not None
        assert found.pose.t_cam_pad == pytest.approx(one.pose.t_cam_pad, abs=1e-9)
        assert found.pose.t_cam_pad == pytest.approx(seen.truth.t_cam_pad, abs=2e-3 * height_m)


def test_evidence_that_is_no_number_is_no_pad(camera: Camera, pad: Pad, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = shown(camera, pad, 1.0)
    assert looked(seen.px, camera, pad, seen.truth, seen.R_level_body) is not None
    weights = native.SEARCHED.copy()
    weights[-1] = math.nan
    monkeypatch.setattr(native, "SEARCHED", weights)
    # The drawing that is tracked is made from the weights once: another name makes it again.
    pad = replace(pad, name="again")
    assert looked(seen.px, camera, pad, seen.truth, seen.R_level_body) is None


def test_a_frame_of_another_size_is_refused(camera: Camera, pad: Pad) -> None:
    seen = shown(camera, pad, 1.0)
    with pytest.raises(ValueError, match="want a frame of shape"):
        looked(np.ascontiguousarray(seen.px[:-2]), camera, pad, seen.truth, seen.R_level_body)


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


def test_what_is_sure_is_called_surer_and_nothing_else_is_sure() -> None:
    said = [calibrated(own) for own in np.linspace(0.0, 1.0, 1001)]
    assert said == sorted(said)
    assert said[:501] == pytest.approx(np.linspace(0.0, 0.5, 501))
    assert said[560] > 0.8
    assert 0.93 < said[620] < said[-1] <= 1.0
