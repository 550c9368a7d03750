"""Ask a small trained network whether a candidate is the pad, as a second opinion beside the verification.

The network comes as ONNX from `python -m benches.train_verifier` and is run by OpenCV. It can only lower a confidence.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.learned.patch import CHANNELS, SIDE, Patch, inputs, patch_of
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose

WORTH_ASKING = 0.1
"""Confidence of the verification below which the second opinion is not asked: no pad is seen there anyway."""
_CURE = "name one that benches.train_verifier wrote, or none for the shipped one"


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

    def of_patch(self, patch: Patch) -> float:
        """Return the log-odds that a patch shows the pad."""
        return float(self._asked(inputs(patch)).item())

    def log_odds(self, pyramid: Pyramid, camera: Camera, pad: Pad, pose: PadPose, cut: F64 | None = None) -> float | None:
        """Return the log-odds that the pad is at a pose; None if hardly any of it is in view.

        Args:
            cut: the line beyond which something covers the pad, (3,); see `alignment.UNCUT`.
        """
        patch = patch_of(pyramid, camera, pad, pose, cut)
        return None if patch is None else self.of_patch(patch)

    def _asked(self, x: np.ndarray) -> np.ndarray:
        self._net.setInput(x[None])
        return np.asarray(self._net.forward())


def probability(log_odds: float) -> float:
    """Return the network's confidence, 0..1."""
    return 1.0 / (1.0 + math.exp(-max(-30.0, min(30.0, log_odds))))


def lowered(confidence: float, learned: float) -> float:
    """Return the confidence of the verification after a second opinion, the network's confidence: the same, or less."""
    return min(confidence, learned)
