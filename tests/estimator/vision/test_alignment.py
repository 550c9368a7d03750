"""The native core's alignment and verification against their oracle in numpy."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera import Camera
from estimator.vision.detect import alignment, verification
from estimator.vision.detect.paint import FRESH
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.native import address, pixels
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.look import look
from estimator.vision.register.registration import RegistrationOptions
from tests.estimator.vision.oracle import alignment as oracle
from tests.estimator.vision.oracle import paint as paint_oracle
from tests.estimator.vision.oracle import verification as verification_oracle
from tests.support.hard_light import U8, dusk, haze
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


def features_of(ours: alignment.AlignedTemplate, theirs: oracle.Aligned, pad: Pad) -> tuple[float, float]:
    """Return the largest difference of a feature, and that of the confidence."""
    expected = verification_oracle.features(theirs, pad)
    off = verification.confidence(ours.features) - verification.confidence(expected)
    return float(np.abs(ours.features - expected).max()), abs(off)


def compare(pyramid: Pyramid, camera: Camera, pad: Pad, pose: PadPose) -> alignment.AlignedTemplate | None:
    """Align without a step and hold everything to the oracle."""
    ours = alignment.align(pyramid, camera, pad, pose, SIGMA, 0)
    theirs = oracle.align(pyramid, camera, pad, pose, SIGMA, 0)
    assert (ours is None) == (theirs is None)
    if ours is None or theirs is None:
        return None
    features, confidence = features_of(ours, theirs, pad)
    # Mostly below 5e-4; where few samples are in view, one that single precision rounds away moves a correlation more.
    assert features < 5e-3
    assert confidence < 2e-3
    assert ours.paints == pytest.approx(theirs.paints, abs=1e-3)
    assert (ours.sample_m, ours.in_view) == pytest.approx((theirs.sample_m, theirs.in_view), rel=1e-9)
    for place, expected in zip(ours.arrow, theirs.arrow, strict=True):
        assert (place.found, place.seen, place.clear) == pytest.approx((expected.found, expected.seen, expected.clear), abs=2e-3)
    return ours


@given(index=INDEX, seed=SEED)
@settings(max_examples=30)
def test_features_and_paints_are_the_oracles(camera: Camera, pad: Pad, index: int, seed: int) -> None:
    pyramid, truth = scene(camera, pad, index)
    compare(pyramid, camera, pad, beside(truth, seed))


@given(index=INDEX, seed=SEED, change=st.sampled_from((dusk(0.1, 20.0), dusk(0.3, 8.0), haze(0.15), haze(0.4))))
@settings(max_examples=20)
def test_features_in_noise_and_haze_are_the_oracles(
    camera: Camera, pad: Pad, index: int, seed: int, change: Callable[[U8, np.random.Generator], U8]
) -> None:
    pyramid, truth = scene(camera, pad, index)
    rng = np.random.default_rng(seed)
    compare(Pyramid(change(pyramid[0], rng)), camera, pad, beside(truth, seed))


@given(at=st.tuples(st.floats(-0.9, 0.9), st.floats(-0.6, 0.6), st.floats(0.3, 20.0)), seed=SEED)
@settings(max_examples=20)
def test_features_beside_the_pad_are_the_oracles(camera: Camera, pad: Pad, at: tuple[float, float, float], seed: int) -> None:
    x, y, z = at
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec([*rng.normal(0.0, 0.2, 2), rng.uniform(-3.0, 3.0)])
    compare(scene(camera, pad, seed % 12)[0], camera, pad, PadPose(turn, np.array([x * z, y * z, z])))


def test_a_lens_with_distortion_is_the_oracles(camera: Camera, pad: Pad) -> None:
    mount = camera.T_body_cam
    bent = Camera(640, 360, 420.0, 400.0, 331.0, 170.0, np.array([-0.28, 0.09, 0.001, -0.002, -0.01]), mount)
    pyramid, truth = scene(camera, pad, 4)
    for aside in (0.0, 0.4, -0.6):
        at = PadPose(truth.R_cam_pad, np.array([aside, 0.5 * aside, 1.5]))
        assert compare(pyramid, bent, pad, at) is not None


def test_what_is_learned_of_the_paints_is_the_oracles(camera: Camera, pad: Pad) -> None:
    ours, theirs = FRESH, FRESH
    for index in range(2, 5):
        pyramid, truth = scene(camera, pad, index)
        one = look(pyramid, camera, pad, truth, Orientation.of(None), TRACK, paint=ours)
        other = oracle.align(pyramid, camera, pad, truth, SIGMA, 0)
        assert one is not None
        assert other is not None
        ours, theirs = one.paint(), paint_oracle.shown(theirs, other)
    # One sample more or less that counts as a paint alone changes a mean in the third digit.
    assert ours.mean == pytest.approx(theirs.mean, abs=0.01)
    assert ours.var == pytest.approx(theirs.var, abs=0.01)
    assert ours.trust == theirs.trust


@pytest.mark.parametrize(("steps", "local", "side"), [(6, False, None), (4, True, None), (8, True, np.array([0.6, 0.8]))])
def test_poses_are_the_oracles(camera: Camera, pad: Pad, steps: int, local: bool, side: F64 | None) -> None:
    # Where a start is on the edge of what converges, the last bits decide; so a few frames may differ.
    samples, confidence, apart = [], [], 0
    for seed in range(24):
        pyramid, truth = scene(camera, pad, seed % 12)
        pose = beside(truth, seed)
        ours = alignment.align(pyramid, camera, pad, pose, SIGMA, steps, local=local, side=side)
        theirs = oracle.align(pyramid, camera, pad, pose, SIGMA, steps, local=local, side=side)
        apart += (ours is None) != (theirs is None)
        if ours is not None and theirs is not None:
            moved = float(np.linalg.norm(ours.pose.t_cam_pad - theirs.pose.t_cam_pad))
            turned = pad.disc_radius_m * ours.pose.R_cam_pad.angle_to(theirs.pose.R_cam_pad)
            samples.append((moved + turned) / ours.sample_m)
            confidence.append(features_of(ours, theirs, pad)[1])
    assert apart <= 1
    assert len(samples) > 8
    assert np.median(samples) < 3e-3
    assert np.percentile(samples, 85) < 0.05
    assert np.percentile(confidence, 90) < 0.01


def test_an_image_that_c_would_misread_is_refused() -> None:
    px = np.zeros((4, 6, 3), np.uint8)
    assert pixels(px[1:, 2:]) == (px.ctypes.data + 18 + 6, 18)
    wrong: list[NDArray[np.generic]] = [px[:, ::2], px[:, :, :2], px.astype(np.int8), px[:, :, 0]]
    for image in wrong:
        with pytest.raises(TypeError, match="BGR"):
            pixels(image)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="float64"):
        address(np.zeros(3, np.float32))
