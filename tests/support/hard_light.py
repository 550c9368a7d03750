"""Frames that a search by colour fails on: haze, grey cameras, dusk, and pads in black and white."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import MappingProxyType

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.vision.camera.camera import Camera
from estimator.vision.pad.pad import Pad
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


def reversed_grey(px: U8, rng: np.random.Generator) -> U8:
    """Return the image of a monochrome camera in reversed light, as a thermal one may show it."""
    return np.asarray(255 - grey(px, rng), np.uint8)


def shifted(length_px: int) -> Callable[[U8, np.random.Generator], U8]:
    """Blur along a random direction."""

    def change(px: U8, rng: np.random.Generator) -> U8:
        kernel, middle, turn = np.zeros((length_px + 2, length_px + 2), np.float32), (length_px + 1) / 2, rng.uniform(0.0, np.pi)
        away = 0.5 * length_px * np.array([np.cos(turn), np.sin(turn)])
        ends = [tuple(np.rint(16.0 * (middle + side * away)).astype(int).tolist()) for side in (-1.0, 1.0)]
        cv2.line(kernel, ends[0], ends[1], 1.0, 1, cv2.LINE_AA, 4)
        return np.asarray(cv2.filter2D(px, -1, kernel / kernel.sum()), np.uint8)

    return change


def defocused(sigma_px: float) -> Callable[[U8, np.random.Generator], U8]:
    return lambda px, _: np.asarray(cv2.GaussianBlur(px, (0, 0), sigma_px), np.uint8)


def compressed(quality: int) -> Callable[[U8, np.random.Generator], U8]:
    """Return what a JPEG of a quality keeps."""

    def change(px: U8, _: np.random.Generator) -> U8:
        coded = cv2.imencode(".jpg", px, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)

    return change


def rain(px: U8, rng: np.random.Generator) -> U8:
    """Drops on the lens: round places that show a blurred image of what is around them."""
    soft, mask = cv2.GaussianBlur(px, (0, 0), 7.0), np.zeros(px.shape[:2], np.float32)
    for _ in range(25):
        at = int(rng.uniform(0, px.shape[1])), int(rng.uniform(0, px.shape[0]))
        cv2.circle(mask, at, int(rng.uniform(4, 18)), 1.0, -1)
    share = cv2.GaussianBlur(mask, (0, 0), 1.5)[..., None]
    return np.asarray(np.rint(px * (1.0 - share) + soft * share), np.uint8)


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
    "haze 80": Hard(THESIS, "plain", haze(0.2)),
    "glare": Hard(THESIS, "glare", _same),
    "wet": Hard(THESIS, "wet", _same),
    "cut": Hard(THESIS, "cut", _same),
    "rain": Hard(THESIS, "plain", rain),
    "motion 11 px": Hard(THESIS, "plain", shifted(11)),
    "motion 20 px": Hard(THESIS, "plain", shifted(20)),
    "defocus 3 px": Hard(THESIS, "plain", defocused(3.0)),
    "jpeg 8": Hard(THESIS, "plain", compressed(8)),
    "reversed": Hard(replace(THESIS, reversible=True), "plain", reversed_grey),
    "black on white": Hard(_painted(235, 20), "plain", _same),
    "white on black": Hard(_painted(20, 235), "plain", _same),
})  # fmt: skip


def hard_scene(rng: np.random.Generator, camera: Camera, hard: Hard, height_m: float) -> PadScene:
    """Return a random frame in a hard condition."""
    scene = pad_scene(rng, camera, hard.pad, height_m, hard.scene)
    return replace(scene, px=hard.change(scene.px, rng))
