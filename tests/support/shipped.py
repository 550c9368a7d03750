"""The pads and cameras that the package ships, for tests and benches."""

import tomllib
from pathlib import Path

from estimator.vision.camera.camera import Camera
from estimator.vision.pad.pad import Pad

CONFIGS = Path(__file__).parents[2] / "configs"


def shipped_pad(name: str) -> Pad:
    return Pad.from_mapping(tomllib.loads((CONFIGS / "pads" / f"{name}.toml").read_text()))


def shipped_camera(name: str) -> Camera:
    return Camera.from_mapping(tomllib.loads((CONFIGS / "cameras" / f"{name}.toml").read_text()))
