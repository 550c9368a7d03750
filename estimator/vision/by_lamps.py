"""See a lit pad by its lamps: where the filter expects it, else anywhere in the frame."""

from __future__ import annotations

import numpy as np

from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.believed import expected, sigma_of
from estimator.vision.pose import Orientation
from estimator.vision.tracker_config import TrackerConfig
from estimator.vision.tracker_memory import TrackerMemory

_EXPECTED_SIGMAS = 3.0
"""Standard deviations of the believed position within which the pad is expected."""
REACH_PX = 40.0
"""Largest reach about the believed position in which lamps are assigned to spots; beyond it the frame is searched for them."""
_EVERY_PX = 16
"""Every so many columns and rows tell whether a frame is dark."""
_DARK = 25
"""Value of the brightest channel below which half of a dark frame's pixels lie: 0.9 % of the light that saturates the camera, in
which a paint's contrast is a few values. Of night frames from 1 m or more nearly all are, and no frame by day."""


def is_dark(frame: Frame) -> bool:
    """Return whether most of a frame is so dark that lamps show rather than paint."""
    return bool(np.median(frame.px[::_EVERY_PX, ::_EVERY_PX].max(axis=2)) < _DARK)


def by_lamps(
    tracker: TrackerConfig, memory: TrackerMemory, frame: Frame, attitude: Attitude | None, belief: RelativeState | None
) -> Sighting | None:
    """Return the sighting of a pad by its lamps; None if they are not seen."""
    from estimator.vision.lamps.detect import detect_lamps  # of few pads, and the start of the others need not wait for it

    orientation, start, reach_px = Orientation.of(attitude, tracker.options.deck_tilt_sigma_rad), None, 0.0
    if belief is not None and attitude is not None:
        start = expected(belief, attitude, tracker.camera, memory.alike_yaw_rad)
        if start is not None and start.t_cam_pad[2] > 0.05:
            reach_px = _EXPECTED_SIGMAS * sigma_of(belief) * tracker.camera.fx / float(start.t_cam_pad[2])
    near = start is not None and 0.0 < reach_px < REACH_PX
    return detect_lamps(frame, tracker.camera, tracker.pad, orientation, start if near else None, reach_px)
