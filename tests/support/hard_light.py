"""Frames that a search by colour fails on: haze, grey cameras, dusk, and pads in black and white."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import MappingProxyType

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from tests.support.pad_scenes import PadScene, load_pad, pad_scene

U8 = NDArray[np.uint8]


@dataclass(frozen=True)
class Hard:
    """A pad, what is in the scene, and what happens to the frame."""

    pad: Pad
    scene: str
    change: Callable[[U8, np.random.Generator], U8]


def _same(px: U8, _: np.random.Generator) -> U8:
    return px


def grey(px: U8, _: np.random.Generator) -> U8:
    """Return the image of a monochrome camera."""
    return np.asarray(cv2.cvtColor(cv2.cvtColor(px, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR), np.uint8)


def haze(contrast: float) -> Callable[[U8, np.random.Generator], U8]:
    """Airlight over everything, which leaves this contrast."""

    def change(px: U8, _: np.random.Generator) -> U8:
        return np.asarray(np.rint(px * contrast + np.array([205.0, 200.0, 195.0]) * (1.0 - contrast)), np.uint8)

    return change


def dusk(light: float, noise: float) -> Callable[[U8, np.random.Generator], U8]:
    """Return a fraction of the light, raised again by the camera's gain, with the noise that this brings, in steps of a byte."""

    def change(px: U8, rng: np.random.Generator) -> U8:
        linear = (px / 255.0) ** 2.2 * light
        seen = 255.0 * np.clip(linear * min(6.0, 0.5 / light), 0.0, 1.0) ** (1 / 2.2)
        return np.asarray(np.clip(seen + rng.normal(0.0, noise, px.shape), 0, 255), np.uint8)

    return change


def infrared(px: U8, _: np.random.Generator) -> U8:
    """Return the image of a camera without an infrared filter: washed out and reddish."""
    mean = px.mean(axis=2, keepdims=True)
    return np.asarray(np.clip(0.35 * px + 0.5 * mean + np.array([25.0, 15.0, 60.0]), 0, 255), np.uint8)


THESIS = load_pad("thesis")


def _painted(disc: int, marks: int) -> Pad:
    shades = {name: (disc if name == "green" else marks,) * 3 for name, _ in THESIS.paints}
    return replace(THESIS, paints=tuple(shades.items()))


HARD = MappingProxyType({
    "plain": Hard(THESIS, "plain", _same),
    "light": Hard(THESIS, "light", _same),
    "shadow": Hard(THESIS, "shadow", _same),
    "occluded": Hard(THESIS, "occluded", _same),
    "haze 40": Hard(THESIS, "plain", haze(0.4)),
    "haze 15": Hard(THESIS, "plain", haze(0.15)),
    "grey": Hard(THESIS, "light", grey),
    "grey occluded": Hard(THESIS, "occluded", grey),
    "infrared": Hard(THESIS, "plain", infrared),
    "dusk": Hard(THESIS, "plain", dusk(0.1, 10.0)),
    "dusk noise 20": Hard(THESIS, "plain", dusk(0.1, 20.0)),
    "black on white": Hard(_painted(235, 20), "plain", _same),
    "white on black": Hard(_painted(20, 235), "plain", _same),
})  # fmt: skip


def hard_scene(rng: np.random.Generator, camera: Camera, hard: Hard, height_m: float) -> PadScene:
    """Return a random frame in a hard condition."""
    scene = pad_scene(rng, camera, hard.pad, height_m, hard.scene)
    return replace(scene, px=hard.change(scene.px, rng))
