"""Find the pad in one image after another: `estimator.vision.tracker` with its memory kept in an object."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera import Camera
from estimator.vision.detection import Detection
from estimator.vision.options import ColourSetName, TrackerMethod, TrackerOptions
from estimator.vision.pad import Pad
from estimator.vision.pose import SIGMA_DECK_RAD
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track

_NO_STAMP = Stamp(MonoNs(0), MonoNs(0), 0.0, "arrival")


class PadTracker:
    """Find the pad in the images of one camera. The tracker learns the colours of the paint as it goes.

    Args:
        camera: intrinsics and mount of the camera.
        pad: the drawing of the pad, in metres.
        method: "registration" aligns the drawing, "thesis" takes the thesis' three methods, "fused" combines all four by
            covariance, at three times the cost.
        colours: the colour limits of the thesis' methods: "simulator", "indoor" or "outdoor".
        min_confidence: a find with less confidence (0..1) counts as none.
        sigma_deck_rad: one standard deviation of the deck's roll and pitch, rad.

    Raises:
        ValueError: there is no such method or colours, `min_confidence` is outside 0..1, or `sigma_deck_rad` is outside 0 to
            30 degrees.
    """

    def __init__(
        self,
        camera: Camera,
        pad: Pad,
        *,
        method: TrackerMethod = "registration",
        colours: ColourSetName = "indoor",
        min_confidence: float = 0.2,
        sigma_deck_rad: float = SIGMA_DECK_RAD,
    ) -> None:
        if not 0.0 <= min_confidence <= 1.0:
            raise ValueError(f"min_confidence must lie in 0..1, got {min_confidence!r}")
        self._config = TrackerConfig(camera, pad, TrackerOptions(method, colours, math.degrees(sigma_deck_rad)))
        self._memory = TrackerMemory()
        self._min_confidence = min_confidence
        self._seq = 0
        self._detection: Detection | None = None

    @property
    def detection(self) -> Detection | None:
        """The result of every method for the newest image, at any confidence; None before the first image."""
        return self._detection

    def track(
        self,
        image: NDArray[Any],
        *,
        stamp: Stamp | None = None,
        attitude: Attitude | None = None,
        expected: RelativeState | None = None,
    ) -> Sighting | None:
        """Find the pad in one image.

        Args:
            image: (H, W, 3) uint8, BGR as OpenCV reads it, or (H, W) or (H, W, 1) of a mono camera. The caller must not write to
                it during the call.
            stamp: the instant of the exposure; the sighting carries it. Needed only where sightings go into an estimator.
            attitude: the vehicle's attitude at the exposure. None takes the vehicle as level, and the covariance grows to match.
            expected: the expected place of the pad at the exposure, from `RelativeEstimator.at`. The search then begins there,
                which is faster; it is used only together with `attitude`. None searches the whole image.

        Returns:
            The pad's position from the body's origin in `level` (m forward, right, down), the heading, their covariance and the
            confidence; None when the pad is not found. Where the expected place hardly shows it, this may be a pad in a place
            that a fresh `expected` excludes: an estimator refuses that one as `Verdict.ELSEWHERE`.

        Raises:
            ValueError: the image is no (H, W, 3), (H, W, 1) or (H, W) uint8 array, or not of the camera's size.
        """
        camera = self._config.camera
        pixels = np.asarray(image)[...]  # a view: Frame makes its array read-only, and the caller's stays writable
        if pixels.shape[:2] != (camera.height, camera.width):
            raise ValueError(f"the camera's images are {camera.width}x{camera.height} px, got an array of shape {pixels.shape}")
        if pixels.ndim == 2 or (pixels.ndim == 3 and pixels.shape[2] == 1):
            pixels = np.repeat(pixels.reshape(*pixels.shape[:2], 1), 3, axis=2)
        frame = Frame(stamp or _NO_STAMP, self._seq, pixels)
        self._seq += 1
        self._detection, self._memory = track(self._config, self._memory, frame, attitude, expected)
        for found in (self._detection.selected, self._detection.elsewhere):
            if found is not None and found.confidence >= self._min_confidence:
                return found
        return None
