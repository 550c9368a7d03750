"""The verification: confidence falls with every part that is missing, light does not count, and what is sure is the pad."""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.vision import native
from estimator.vision.camera import Camera
from estimator.vision.detect.acquire import SIGMA_TILT_RAD, AlignedTemplate, align, search
from estimator.vision.detect.paint import FRESH, PaintMemory, fade
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detect.verification import SEARCHED, calibrate, confidence, log_odds
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.registration import (
    Registration,
    RegistrationOptions,
    look,
    register,
    sighting_of,
    sighting_of_look,
)
from sitl.camera.light import Light
from tests.support.deck_images import covered, disc_of, keeps_claim, shown
from tests.support.pad_images import STAMP
from tests.support.pad_scenes import CONDITIONS, load_pad, pad_scene


def align_at(px: np.ndarray, camera: Camera, pad: Pad, pose: PadPose) -> AlignedTemplate:
    aligned = align(FrameView(Pyramid(np.asarray(px, np.uint8)), camera, pad), pose, SIGMA_TILT_RAD, 0)
    assert aligned is not None
    return aligned


def test_confidence_falls_with_every_part_that_is_missing(camera: Camera, pad: Pad) -> None:
    seen = shown(camera, pad, 1.2)
    paint = (0, 95, 0)
    band = np.concatenate([disc_of(0.31), disc_of(0.31)[:1], disc_of(0.225)[:1], disc_of(0.225)[::-1]])
    images = [
        seen.px,
        covered(seen, camera, disc_of(0.2), paint),
        covered(seen, camera, band, paint),
        covered(seen, camera, disc_of(0.31), paint),
    ]
    values = [confidence(log_odds(align_at(px, camera, pad, seen.truth).features)) for px in images]
    assert values[0] > 0.9
    assert max(values[1:]) < 0.5
    shifted = PadPose(seen.truth.R_cam_pad, seen.truth.t_cam_pad + np.array([0.05, 0.0, 0.0]))
    assert confidence(log_odds(align_at(seen.px, camera, pad, shifted).features)) < 0.5


def test_features_are_finite_on_anything(camera: Camera, pad: Pad) -> None:
    rng = np.random.default_rng(1)
    shape = (camera.height, camera.width, 3)
    pose = shown(camera, pad, 1.0).truth
    for px in (np.zeros(shape), np.full(shape, 255), rng.integers(0, 256, shape)):
        values = align_at(px.astype(np.uint8), camera, pad, pose).features
        assert np.all(np.isfinite(values))
        assert confidence(log_odds(values)) < 0.2


CLOSE = RegistrationOptions(coarse=False)


FRAME = Frame(STAMP, 0, np.zeros((2, 2, 3), np.uint8))


def looked(px: NDArray[np.uint8], camera: Camera, pad: Pad, start: PadPose, R_level_body: Rotation | None) -> Registration | None:
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
        one = register(scene.px, camera, pad, scene.truth, None if found is None else found.prior, CLOSE)
        if found is None or one is None:
            continue
        compared += 1
        other = align(FrameView(pyramid, camera, pad), one.pose, SIGMA_TILT_RAD, 0)
        assert other is not None
        assert np.array_equal(found.cov, one.cov)
        assert np.array_equal(found.pose.t_cam_pad, one.pose.t_cam_pad)
        assert found.record["aligned"]["features"] == pytest.approx(other.features, abs=1e-9)
        assert found.log_odds == pytest.approx(float(found.evidence @ SEARCHED), abs=1e-9)
        level = sighting_of(FRAME, one.pose, one.cov, camera, found.prior, one.yaw_ambiguous, 0.5)
        assert np.array_equal(sighting_of_look(FRAME, found, 0.5).cov, level.cov)
    assert compared > 30


def test_evidence_that_is_no_number_is_no_pad(camera: Camera, pad: Pad, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = shown(camera, pad, 1.0)
    assert looked(seen.px, camera, pad, seen.truth, seen.R_level_body) is not None
    weights = native.SEARCHED.copy()
    weights[-1] = math.nan
    monkeypatch.setattr(native, "SEARCHED", weights)
    # The drawing that is tracked is made from the weights once: another name makes it again.
    pad = replace(pad, name="again")
    assert looked(seen.px, camera, pad, seen.truth, seen.R_level_body) is None


def test_what_is_sure_is_called_surer_and_nothing_else_is_sure() -> None:
    said = [calibrate(own) for own in np.linspace(0.0, 1.0, 1001)]
    assert said == sorted(said)
    assert said[:501] == pytest.approx(np.linspace(0.0, 0.5, 501))
    assert said[560] > 0.8
    assert 0.93 < said[620] < said[-1] <= 1.0


Teach = Callable[[PaintMemory], PaintMemory]


def view(camera: Camera, pad: Pad, light: Light, seed: int = 0) -> Teach:
    """Return what one frame makes of a memory."""
    seen = shown(camera, pad, 1.5, light=light, seed=seed)
    pyramid, orientation = Pyramid(seen.px), Orientation.of(Attitude(STAMP, seen.R_level_body, 1e-6 * np.eye(3)))

    def teach(memory: PaintMemory) -> PaintMemory:
        found = look(FrameView(pyramid, camera, pad), seen.truth, orientation, RegistrationOptions(coarse=False), paint=memory)
        assert found is not None
        return found.paint()

    return teach


def taught(frames: int, one: Teach, start: PaintMemory = FRESH) -> PaintMemory:
    for _ in range(frames):
        start = one(start)
    return start


def test_three_confident_frames_make_it_trusted_and_doubtful_ones_teach_nothing(camera: Camera, pad: Pad) -> None:
    one = view(camera, pad, Light())
    assert taught(2, one).dominance(pad) is None
    learned = taught(3, one).dominance(pad)
    assert learned is not None
    disc, around = learned
    assert disc > around + 1.0, "the disc is green and the deck is not"
    assert abs(around) < 0.25


def test_without_the_pad_it_fades_back_to_knowing_nothing(camera: Camera, pad: Pad) -> None:
    memory = taught(200, view(camera, pad, Light()))
    trusts = []
    for _ in range(60):
        memory = fade(memory)
        trusts.append(memory.trust)
    assert memory is FRESH
    assert all(a >= b for a, b in itertools.pairwise(trusts))
    used = sum(t >= 0.1 for t in trusts)
    assert 20 < used < 40, "a second or so at 30 frames a second"
    assert fade(FRESH) is FRESH


@pytest.mark.parametrize("height_m", [0.4, 1.5, 6.0])
def test_a_memory_of_the_wrong_colours_hinders_nothing(camera: Camera, pad: Pad, height_m: float) -> None:
    good = taught(50, view(camera, pad, Light()))
    swapped = PaintMemory(good.mean[[3, 1, 0, 2]], good.var, good.trust)
    upside_down = PaintMemory(good.mean[:, [2, 0, 1]] + 2.0, good.var, good.trust)
    seen = shown(camera, pad, height_m, aside=(0.1, -0.1))
    for memory in (FRESH, good, swapped, upside_down):
        best = search(FrameView(Pyramid(seen.px), camera, pad), seen.R_level_body, memory).candidates[0]
        assert best.score > 0.5
        assert keeps_claim(best.pose, seen.truth, camera, pad, best.yaw_ambiguous)
