"""Ask a small trained network whether a candidate is the pad, as a second opinion beside the verification.

The network is an ONNX file (docs/vision.md says what made it) and is run by OpenCV. It can only lower a confidence.

Its input is the frame in the pad's plane beside the drawing that the pad's file gives. Both are sampled on the same grid around
the pad's centre, so that one network serves any pad: it compares two images and knows no pad by itself. The light is taken out
of both: each channel minus its mean, over one standard deviation of all channels.
"""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.detect.alignment import UNCUT
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.detect.template import BLURS_M, REACH
from estimator.vision.pad.information import paint_at
from estimator.vision.pad.pad import Pad

U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]

SIDE = 48
"""Samples of the grid along each axis of the pad."""
CHANNELS = 12
"""Channels of the network's input: frame, drawing and their product in blue, green and red, what is in view, what is not
known, and the size of a pixel.
"""
_CLIP = 4.0  # Largest deviation from the mean, in standard deviations, that goes into the network
_LEAST_SPREAD = 0.01  # Least standard deviation, of full scale 1, that the light is divided by: a step of a byte is no marking
_LEAST_SEEN = 0.03  # Least share of the pad in view that can be compared
_FINE_M = 0.006  # Distance between the samples that the drawing is blurred at
_BARE = 0.2  # Linear light that a deck without paint is taken for
_TONE = 2.2  # Exponent of the tone curve of frames, by which the drawing's light is converted


class Patch(Struct, frozen=True, eq=False):
    """A candidate's surroundings in the pad's plane: row by x from ahead to behind, column by y to starboard."""

    frame: U8
    """Blue, green and red, (SIDE, SIDE, 3)."""
    seen: NDArray[np.bool_]
    """Mask of the points in the frame that nothing covers, (SIDE, SIDE)."""
    drawn: U8
    """The drawing's blue, green, red and the share of a sample whose paint the pad's file gives, (SIDE, SIDE, 4)."""
    pixel: float
    """Logarithm to base 2 of a sample's side in pixels."""


def patch_of(pyramid: Pyramid, camera: Camera, pad: Pad, pose: PadPose, cut: F64 | None = None) -> Patch | None:
    """Return the patch of a candidate; None if hardly any of the pad is in view.

    Args:
        cut: the line beyond which something covers the pad, (3,); see `alignment.UNCUT`.
    """
    cam = pose.points(_grid(pad))
    if float(cam[:, 2].min()) < 1e-2:
        return None
    uv = camera.project(cam)
    a, b, c = (UNCUT if cut is None else cut).tolist()
    h, w = pyramid[0].shape[:2]
    inside = (uv[:, 0] > -0.5) & (uv[:, 0] < w - 0.5) & (uv[:, 1] > -0.5) & (uv[:, 1] < h - 0.5)
    seen = inside & (a * cam[:, 0] + b * cam[:, 1] + c * cam[:, 2] >= 0.0)
    sample_px = camera.fx * _cell_m(pad) / float(pose.t_cam_pad[2])
    drawn = _drawn(pad, _blur(0.5 * _cell_m(pad), 0.6 * float(pose.t_cam_pad[2]) / camera.fx))
    known = drawn[:, :, 3].ravel() > 127
    if float(np.count_nonzero(seen & known)) < _LEAST_SEEN * float(np.count_nonzero(known)):
        return None
    level = max(0, math.floor(math.log2(max(sample_px, 1e-3))))
    image = pyramid[level]
    at = ((uv + 0.5) / (1 << level) - 0.5).astype(np.float32).reshape(SIDE, SIDE, 2)
    frame = cv2.remap(image, at, np.empty(0), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return Patch(np.asarray(frame, np.uint8), seen.reshape(SIDE, SIDE), drawn, math.log2(max(sample_px, 1e-3)))


def inputs(patch: Patch) -> F32:
    """Return the network's input, (CHANNELS, SIDE, SIDE)."""
    weight = patch.seen * (patch.drawn[:, :, 3] * np.float32(1.0 / 255.0))
    frame, drawn = (_without_light(px, weight) for px in (patch.frame, patch.drawn[:, :, :3]))
    out = np.empty((CHANNELS, SIDE, SIDE), np.float32)
    out[0:3] = np.where(patch.seen, frame, 0.0)
    out[3:6] = np.where(weight > 0.0, drawn, 0.0)
    out[6:9] = out[0:3] * out[3:6]
    out[9] = patch.seen
    out[10] = 1.0 - patch.drawn[:, :, 3] * np.float32(1.0 / 255.0)
    out[11] = 0.25 * max(-4.0, min(4.0, patch.pixel))
    return out


def _without_light(px: U8, weight: F32) -> F32:
    """Return the channels of an image, (3, SIDE, SIDE), without their means over one spread of all."""
    values = px.transpose(2, 0, 1).astype(np.float32) * np.float32(1.0 / 255.0)
    total = float(weight.sum()) + 1e-6
    values -= (values * weight).sum(axis=(1, 2), keepdims=True) / np.float32(total)
    spread = math.sqrt(float((values * values * weight).sum()) / (3.0 * total))
    return np.asarray(np.clip(values / np.float32(max(spread, _LEAST_SPREAD)), -_CLIP, _CLIP))


def _cell_m(pad: Pad) -> float:
    return 2.0 * REACH * pad.disc_radius_m / SIDE


@lru_cache(maxsize=8)
def _grid(pad: Pad) -> F64:
    """Return the samples' places on the pad, (SIDE * SIDE, 3) m."""
    along = (np.arange(SIDE) - 0.5 * (SIDE - 1)) * _cell_m(pad)
    x, y = np.meshgrid(-along, along, indexing="ij")
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)


def _blur(sample_m: float, pixel_m: float) -> int:
    """Return which of the template's blurs is nearest to that of samples and pixels."""
    sigma = math.log(math.hypot(sample_m, pixel_m))
    return int(np.argmin([abs(math.log(blur) - sigma) for blur in BLURS_M]))


@lru_cache(maxsize=80)
def _drawn(pad: Pad, blur: int) -> U8:
    """Return the drawing as `Patch.drawn`.

    A pad without a ground of its own is compared on the bare deck around its markings, too.
    """
    reach_m = 1.1 * REACH * pad.disc_radius_m
    fine = np.arange(-reach_m, reach_m, _FINE_M)
    x, y = np.meshgrid(fine, fine, indexing="ij")
    xy = np.stack([x.ravel(), y.ravel()], axis=1)
    light, on_black = (paint_at(pad, xy, np.full(3, level)) for level in (_BARE, -1.0))
    known = on_black[:, :1] >= 0.0 if pad.markings.has_ground else np.hypot(*xy.T)[:, None] < pad.disc_radius_m
    maps = np.concatenate([light[:, ::-1], known], axis=1).astype(np.float32).reshape(*x.shape, 4)
    maps = np.asarray(cv2.GaussianBlur(maps, (0, 0), BLURS_M[blur] / _FINE_M), np.float32)
    at = ((_grid(pad)[:, :2] + reach_m) / _FINE_M).astype(np.float32).reshape(SIDE, SIDE, 2)
    # Maps have x in rows and y in columns; remap takes the column first.
    out = np.asarray(cv2.remap(maps, at[:, :, 1], at[:, :, 0], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)
    out[:, :, :3] = np.clip(out[:, :, :3], 0.0, 1.0) ** (1.0 / _TONE)
    drawn = np.asarray(np.rint(255.0 * out), np.uint8)
    drawn.setflags(write=False)
    return drawn


_CURE = "name one with the inputs of the shipped one, or none for the shipped one"


class SecondOpinion:
    """A trained network.

    Args:
        onnx: the file's bytes.
        where: the file, for errors.

    Raises:
        BadInput: the bytes are no network, or one that takes or returns something else; the text names `where` and a cure.
    """

    def __init__(self, onnx: bytes, where: str) -> None:
        self._onnx, self._where = onnx, where
        try:
            self._net = cv2.dnn.readNetFromONNX(np.frombuffer(onnx, np.uint8))
            answer = self._asked(np.zeros((CHANNELS, SIDE, SIDE), np.float32))
        except (cv2.error, ValueError) as why:
            taken = f"an ONNX network that takes a patch of {CHANNELS} x {SIDE} x {SIDE} numbers"
            raise BadInput(f"{where}: damaged, or not {taken}: {_CURE}") from why
        if answer.size != 1 or not np.isfinite(answer).all():
            raise BadInput(f"{where}: the network must return one finite number, got {answer.size} numbers: {_CURE}")

    def __reduce__(self) -> tuple[type[SecondOpinion], tuple[bytes, str]]:
        """Go to another process as bytes, since a network of OpenCV cannot."""
        return SecondOpinion, (self._onnx, self._where)

    def log_odds(self, pyramid: Pyramid, camera: Camera, pad: Pad, pose: PadPose, cut: F64 | None = None) -> float | None:
        """Answer as `estimator.vision.track.config.SecondOpinion` says; the network is run on this thread."""
        patch = patch_of(pyramid, camera, pad, pose, cut)
        return None if patch is None else float(self._asked(inputs(patch)).item())

    def _asked(self, x: np.ndarray) -> np.ndarray:
        self._net.setInput(x[None])
        return np.asarray(self._net.forward())
