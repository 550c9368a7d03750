"""The pad from afar without colour, in haze and in noise: what the frame says of itself, and what is found with that."""

import cv2
import numpy as np
import pytest

from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera import Camera
from estimator.vision.detect.alignment import SIGMA_TILT_RAD, align
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detect.verification import FEATURES
from estimator.vision.options import TrackerOptions
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track
from estimator.vision.tracker_config import FRAME_WORK
from sitl.camera.light import Light
from tests.support.deck_images import shown
from tests.support.hard_light import HARD, U8, grey, hard_scene
from tests.support.pad_scenes import PadScene, pad_scene

SEED = 21


def scene(camera: Camera, name: str, height_m: float, k: int) -> PadScene:
    return hard_scene(np.random.default_rng([SEED, k, round(10 * height_m)]), camera, HARD[name], height_m)


@pytest.mark.parametrize(
    ("name", "height_m", "k"),
    [
        ("grey", 10.0, 13),
        ("grey", 15.0, 2),
        ("haze 15", 15.0, 2),
        ("haze 15", 15.0, 12),
        ("dusk noise 20", 10.0, 2),
        ("dusk noise 20", 15.0, 0),
        ("black on white", 15.0, 8),
    ],
)
def test_found_from_afar_and_sure(camera: Camera, name: str, height_m: float, k: int) -> None:
    seen, stamp = scene(camera, name, height_m, k), Stamp(MonoNs(0), MonoNs(0), 0.0, "sim")
    attitude = None if seen.R_level_body is None else Attitude(stamp, seen.R_level_body, np.eye(3) * 3e-4)
    tracker = TrackerConfig(camera, HARD[name].pad, TrackerOptions("registration", "simulator"), FRAME_WORK)
    memory, best = TrackerMemory(), None
    for _ in range(3):
        found, memory = track(tracker, memory, Frame(stamp, 0, seen.px), attitude)
        if best is None or (found.selected is not None and found.selected.confidence > best.confidence):
            best = found.selected
    assert seen.truth is not None
    assert best is not None
    assert best.confidence > 0.5
    assert float(np.linalg.norm(best.d_body_pad_level)) == pytest.approx(seen.truth.range_m, rel=0.1)


def ring_place(camera: Camera, pad: Pad, px: U8, truth: PadPose) -> float:
    """Return how far the ring is from its place between disc and H, 0 or less."""
    pyramid = Pyramid(px)
    aligned = align(FrameView(pyramid, camera, pad).as_seen(), truth, SIGMA_TILT_RAD, 0)
    assert aligned is not None
    return float(aligned.features[FEATURES.index("orange_place")])


@pytest.mark.parametrize("height_m", [3.0, 6.0, 10.0])
def test_the_ring_of_a_pad_whose_h_is_burnt_out_may_be_any_darker_than_the_h(camera: Camera, pad: Pad, height_m: float) -> None:
    seen, rng = shown(camera, pad, height_m, light=Light(exposure_ev=2.0)), np.random.default_rng(0)
    burnt = grey(seen.px, rng)
    assert ring_place(camera, pad, burnt, seen.truth) > -0.05, "it seems almost as bright as the H"
    # The same shades below what a frame clips: there the H is known, and the ring is too bright.
    dimmed = np.asarray(np.rint(burnt * 0.97), np.uint8)
    assert ring_place(camera, pad, dimmed, seen.truth) < -0.3


@pytest.mark.parametrize("sigma", [6.0, 12.0, 20.0])
def test_the_noise_of_a_frame_is_measured_beside_what_it_shows(camera: Camera, pad: Pad, sigma: float) -> None:
    rng = np.random.default_rng(5)
    seen = pad_scene(rng, camera, pad, 3.0, "light").px
    mid = np.clip(seen, 64, 190)
    noisy = np.asarray(np.clip(np.rint(mid + rng.normal(0.0, sigma, mid.shape)), 0, 255), np.uint8)
    assert 255.0 * Pyramid(noisy).native.quality.noise == pytest.approx(np.sqrt(sigma**2 - 3.0**2), rel=0.15)


@pytest.mark.parametrize("k", range(4))
def test_an_ordinary_frame_is_clear_and_has_no_more_than_the_usual_noise(camera: Camera, pad: Pad, k: int) -> None:
    seen = pad_scene(np.random.default_rng(k), camera, pad, 2.0, "plain")
    quality = Pyramid(seen.px).native.quality
    assert (quality.noise, quality.contrast) == (0.0, 1.0)


@pytest.mark.parametrize("quality", [1, 60, 95])
def test_a_grey_camera_is_known_and_its_codec_does_not_hide_it(camera: Camera, pad: Pad, quality: int) -> None:
    rng = np.random.default_rng(7)
    colour = pad_scene(rng, camera, pad, 15.0, "plain").px
    coded = cv2.imdecode(cv2.imencode(".jpg", grey(colour, rng), [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)
    assert Pyramid(np.asarray(coded, np.uint8)).monochrome
    assert not Pyramid(colour).monochrome, "the pad itself is its only colour, twenty pixels wide"
