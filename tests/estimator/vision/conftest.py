"""The pads and cameras that the package ships."""

import pytest

from estimator.vision.camera.camera import Camera
from estimator.vision.pad.pad import Pad
from tests.support.shipped import shipped_camera, shipped_pad


@pytest.fixture(scope="session")
def pad() -> Pad:
    """Return the pad of the thesis."""
    return shipped_pad("thesis")


@pytest.fixture(scope="session")
def camera() -> Camera:
    """Return the camera of the thesis' simulator."""
    return shipped_camera("sim")
