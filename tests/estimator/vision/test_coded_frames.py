"""Effects of a codec on frames are included in the covariance of finds."""

import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.ardrone.video import AccessUnitDecoder
from estimator.contracts.samples import Frame
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from estimator.vision.register.registration import Registration, RegistrationOptions, register
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track
from estimator.vision.verified import CODED_PX
from sitl.emulators.ardrone.wire_pictures import Encoder
from tests.support.pad_images import STAMP
from tests.support.pad_views import RenderedView, Stage, error


def coded_views(camera: Camera, pad: Pad, height_m: float, frames: int) -> list[RenderedView]:
    """Frames of a vehicle that hovers, after an encoder as that of the simulated AR.Drone; the first of them is not predicted."""
    stage, encoder, decoder = Stage(camera, pad, seed=3), Encoder(camera.width, camera.height, 30.0, 4000.0), AccessUnitDecoder()
    views = []
    for k in range(frames):
        t = k / 30.0
        rpy = (0.01 * math.sin(2.1 * t), 0.012 * math.sin(1.7 * t + 1.0), 0.3 + 0.02 * math.sin(0.6 * t))
        aside = 0.1 * height_m * np.array([math.sin(0.5 * t), math.cos(0.4 * t)])
        view = stage.view_from(height_m * (1.0 + 0.01 * math.sin(0.7 * t)), aside, rpy)
        (image,) = decoder.decode(encoder.encode(view.px).data)
        px = np.asarray(image.to_ndarray(format="bgr24"), np.uint8)
        views.append(replace(view, px=px))
    return views


def nees(found: Registration, view: RenderedView) -> float:
    e = error(found.pose, view.pose)
    return float(e @ np.linalg.solve(found.cov, e))


@pytest.mark.parametrize("height_m", [1.5, 4.0, 12.0])
def test_the_covariance_has_what_the_codec_moved(camera: Camera, pad: Pad, height_m: float) -> None:
    as_if_plain, coded = list[float](), list[float]()
    for view in coded_views(camera, pad, height_m, 40)[1:]:
        for coded_px, into in ((0.0, as_if_plain), (CODED_PX, coded)):
            found = register(view.px, camera, pad, view.pose, None, RegistrationOptions(coarse=False, coded_px=coded_px))
            assert found is not None
            into.append(nees(found, view))
    assert 1.0 < np.mean(coded) < 9.0
    assert np.mean(coded) < 0.7 * np.mean(as_if_plain)


def test_only_predicted_frames_are_downgraded(camera: Camera, pad: Pad) -> None:
    view = coded_views(camera, pad, 4.0, 2)[1]
    seen = [
        track(TrackerConfig(camera, pad), TrackerMemory(), Frame(STAMP, 0, view.px, coded=coded), None)[0]
        for coded in (False, True)
    ]
    plain, suspect = (look.selected for look in seen)
    assert plain is not None
    assert suspect is not None
    assert np.all(plain.d_body_pad_level == suspect.d_body_pad_level)
    assert np.linalg.eigvalsh(suspect.cov[:3, :3] - plain.cov[:3, :3]).min() > 0.0
