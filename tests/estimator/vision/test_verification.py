"""The judge: parts speak for themselves, light does not count, and confidence falls with every part that is missing."""

import math

import numpy as np
import pytest

from estimator.vision.camera import Camera
from estimator.vision.detect.alignment import SIGMA_TILT_RAD, AlignedTemplate, align
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detect.verification import FEATURES, confidence
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from sitl.camera.light import Light
from tests.support.deck_images import covered, disc_of, shown
from tests.support.pad_claims import keeps_claim


def at(px: np.ndarray, camera: Camera, pad: Pad, pose: PadPose) -> AlignedTemplate:
    aligned = align(FrameView(Pyramid(np.asarray(px, np.uint8)), camera, pad), pose, SIGMA_TILT_RAD, 0)
    assert aligned is not None
    return aligned


def named(aligned: AlignedTemplate) -> dict[str, float]:
    return dict(zip(FEATURES, aligned.features.tolist(), strict=True))


@pytest.mark.parametrize("height_m", [0.6, 1.5, 4.0])
def test_each_part_painted_over_is_missed_by_name(camera: Camera, pad: Pad, height_m: float) -> None:
    seen = shown(camera, pad, height_m)
    uv = camera.project(seen.truth.points(np.array([[0.0, 0.18, 0.0]])))[0]
    green = tuple(int(c) for c in seen.px[round(uv[1]), round(uv[0])])
    paint = (green[0], green[1], green[2])
    whole = named(at(seen.px, camera, pad, seen.truth))
    no_h = named(at(covered(seen, camera, disc_of(0.2), paint), camera, pad, seen.truth))
    assert no_h["h_marking"] < 0.25 * whole["h_marking"]
    assert no_h["ring"] > 0.6 * whole["ring"]
    band = np.concatenate([disc_of(0.31), disc_of(0.31)[:1], disc_of(0.225)[:1], disc_of(0.225)[::-1]])
    no_ring = named(at(covered(seen, camera, band, paint), camera, pad, seen.truth))
    assert no_ring["ring"] < 0.35 * whole["ring"]
    assert no_ring["h_marking"] > 0.6 * whole["h_marking"]
    assert abs(no_ring["arrow"]) < 0.5


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
    values = [confidence(at(px, camera, pad, seen.truth).features) for px in images]
    assert values[0] > 0.9
    assert max(values[1:]) < 0.5
    shifted = PadPose(seen.truth.R_cam_pad, seen.truth.t_cam_pad + np.array([0.05, 0.0, 0.0]))
    assert confidence(at(seen.px, camera, pad, shifted).features) < 0.5


@pytest.mark.parametrize("light", [Light(3000.0), Light(9000.0), Light(white_balance=(1.2, 1.0, 0.8)), Light(exposure_ev=-2.0)])
def test_light_that_burns_nothing_out_does_not_count(camera: Camera, pad: Pad, light: Light) -> None:
    plain, other = (
        named(at(shown(camera, pad, 1.5, light=k).px, camera, pad, shown(camera, pad, 1.5).truth)) for k in (Light(), light)
    )
    # A quarter of the light against the same noise costs up to log 4 of a gain that is 3.3 here.
    kept = 0.55 if light.exposure_ev < 0.0 else 0.7
    for part in ("h_marking", "ring", "edge", "arrow"):
        assert other[part] > kept * plain[part]
    assert other["orange_place"] > plain["orange_place"] - 0.15


def test_the_arrow_resolves_half_a_turn(camera: Camera, pad: Pad) -> None:
    for height in (0.7, 2.0, 8.0):
        seen = shown(camera, pad, height)
        right, wrong = (at(seen.px, camera, pad, p).arrow_support for p in (seen.truth, seen.truth.turned(math.pi)))
        assert right > 0.5
        assert wrong < -0.4


def test_features_are_finite_on_anything(camera: Camera, pad: Pad) -> None:
    rng = np.random.default_rng(1)
    shape = (camera.height, camera.width, 3)
    pose = shown(camera, pad, 1.0).truth
    for px in (np.zeros(shape), np.full(shape, 255), rng.integers(0, 256, shape)):
        values = at(px.astype(np.uint8), camera, pad, pose).features
        assert np.all(np.isfinite(values))
        assert confidence(values) < 0.2


def test_a_claim_is_kept_or_broken_in_each_of_its_parts(camera: Camera, pad: Pad) -> None:
    truth = shown(camera, pad, 2.0).truth
    d = truth.t_cam_pad / truth.range_m
    assert keeps_claim(truth, truth, camera, pad, False)
    assert keeps_claim(PadPose(truth.R_cam_pad, truth.t_cam_pad + 0.1 * d), truth, camera, pad, False)
    assert not keeps_claim(PadPose(truth.R_cam_pad, truth.t_cam_pad + 0.3 * d), truth, camera, pad, False)
    assert not keeps_claim(PadPose(truth.R_cam_pad, truth.t_cam_pad + np.array([0.06, 0.0, 0.0])), truth, camera, pad, False)
    assert not keeps_claim(truth.turned(0.3), truth, camera, pad, False)
    assert not keeps_claim(truth.turned(math.pi), truth, camera, pad, False)
    assert keeps_claim(truth.turned(math.pi), truth, camera, pad, True)
