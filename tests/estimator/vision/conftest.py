"""The pads and cameras that the package ships."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from estimator.vision.camera import Camera
from estimator.vision.pad import Pad

CONFIGS = Path(__file__).parents[3] / "configs"


def shipped_pad(name: str) -> Pad:
    return Pad.from_mapping(tomllib.loads((CONFIGS / "pads" / f"{name}.toml").read_text()))


def shipped_camera(name: str) -> Camera:
    return Camera.from_mapping(tomllib.loads((CONFIGS / "cameras" / f"{name}.toml").read_text()))


@pytest.fixture(scope="session")
def pad() -> Pad:
    """The pad of the thesis."""
    return shipped_pad("thesis")


@pytest.fixture(scope="session")
def camera() -> Camera:
    """The camera of the thesis' simulator."""
    return shipped_camera("sim")
