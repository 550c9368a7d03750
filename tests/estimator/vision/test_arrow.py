"""The arrow method: place and heading from the centre of the H and the tip of the arrowhead."""

import math

import cv2
import numpy as np
import pytest

from estimator.contracts.samples import Frame
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from estimator.vision.thesis.detection import detect
from estimator.vision.thesis.segmentation import SIMULATOR
from tests.support.pad_images import STAMP, PadPlacement, errors, image, project


@pytest.mark.parametrize("yaw_deg", [0.0, 35.0, 90.0, 179.9, -90.0, -145.0])
def test_the_heading_is_right_all_round(yaw_deg: float, camera: Camera, pad: Pad) -> None:
    scene = PadPlacement((0.17, -0.02, 1.2), math.radians(yaw_deg))
    s = detect(image(scene, camera, pad, blur_px=0.6, noise=1.5), scene.attitude(), camera, pad, SIMULATOR).methods["arrow"]
    assert s is not None
    assert not s.yaw_ambiguous
    d, yaw = errors(s, scene)
    assert abs(math.degrees(yaw)) < 0.15
    assert np.linalg.norm(d[:2]) < 0.001
    assert abs(d[2]) < 0.006


def test_centre_and_tip_keep_their_fractions_of_a_pixel(camera: Camera, pad: Pad) -> None:
    """Cut to whole pixels, as the thesis' code did, they would lie half a pixel off in the mean, towards the top left."""
    rng = np.random.default_rng(2)
    centre, tip = [], []
    for i in range(8):
        scene = PadPlacement((0.15 + rng.uniform(-0.01, 0.01), rng.uniform(-0.01, 0.01), 1.5), rng.uniform(-3, 3))
        s = detect(image(scene, camera, pad, blur_px=0.6, noise=1.5, seed=i), scene.attitude(), camera, pad, SIMULATOR).methods[
            "arrow"
        ]
        assert s is not None
        seen = {f.label: f.uv_px[0] for f in s.features if f.kind == "point"}
        true = project(np.array([[0.0, 0.0, 0.0], [pad.markings.arrow_tip_m, 0.0, 0.0]]), scene, camera)
        centre.append(seen["centre"] - true[0])
        tip.append(seen["tip"] - true[1])
    assert np.all(np.abs(np.mean(centre, axis=0)) < 0.03)
    assert np.all(np.abs(np.mean(tip, axis=0)) < 0.1)
    assert np.abs(tip).max() < 0.4


def test_the_centroid_is_one_of_paint_not_of_pixels(camera: Camera, pad: Pad) -> None:
    """Tilted by 25 degrees at 0.8 m, the nearer half of the H covers more pixels and pulls their centroid over a pixel away."""
    scene = PadPlacement((0.08, -0.37, 0.8), 0.3, math.radians(25.0), math.radians(-5.0))
    frame = image(scene, camera, pad, samples=5)
    s = detect(frame, scene.attitude(), camera, pad, SIMULATOR).methods["arrow"]
    assert s is not None
    true = project(np.zeros((1, 3)), scene, camera)[0]
    seen = next(f.uv_px[0] for f in s.features if f.label == "centre")
    h = np.asarray(frame.px.min(axis=2) > 120, np.uint8)
    h[:, : int(true[0]) - 120] = 0
    h[:, int(true[0]) + 120 :] = 0
    m = cv2.moments(h, binaryImage=True)
    assert np.linalg.norm(np.array([m["m10"], m["m01"]]) / m["m00"] - true) > 1.0
    assert np.linalg.norm(seen - true) < 0.1


def test_range_far_beyond_the_thesis(camera: Camera, pad: Pad) -> None:
    """The thesis had an arrow in 4 % of frames at 5 m, 0.64 m off in height and 100 degrees in heading."""
    for seed, yaw in enumerate((-2.0, 0.5, 2.2)):
        scene = PadPlacement((0.15, 0.1, 5.0), yaw)
        s = detect(
            image(scene, camera, pad, blur_px=0.6, noise=1.5, seed=seed), scene.attitude(), camera, pad, SIMULATOR
        ).methods["arrow"]
        assert s is not None
        d, off = errors(s, scene)
        assert abs(d[2]) < 0.08
        assert abs(math.degrees(off)) < 1.5


def test_no_orange_no_arrow(camera: Camera, pad: Pad) -> None:
    """An empty mask is no estimate, not an arrow at (0, 0)."""
    scene = PadPlacement((0.15, 0.0, 1.5))
    px = image(scene, camera, pad).px.copy()
    hsv = cv2.cvtColor(px, cv2.COLOR_BGR2HSV)
    px[(hsv[:, :, 0] < 45) & (hsv[:, :, 1] > 60)] = (0, 102, 0)
    seen = detect(Frame(STAMP, 0, px), scene.attitude(), camera, pad, SIMULATOR)
    assert seen.methods["arrow"] is None
    assert seen.methods["ellipse"] is not None


def test_an_h_that_leaves_the_image_has_no_centroid(camera: Camera, pad: Pad) -> None:
    scene = PadPlacement((0.15, 0.62, 0.9), -math.pi / 2)
    seen = detect(image(scene, camera, pad), scene.attitude(), camera, pad, SIMULATOR)
    assert seen.methods["arrow"] is None
