"""The search for the pad in frames: the tracker, its memory, and the camera as the vehicle or its gimbal holds it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from msgspec import structs

from estimator import pipeline
from estimator.contracts.samples import Attitude, Frame
from estimator.gimbal_history import DOWN, HeldCamera
from estimator.vision.camera import Camera
from estimator.vision.detection import Detection
from estimator.vision.tracker_config import TrackerConfig

if TYPE_CHECKING:  # what looks at frames loads OpenCV, and the first guidance cycle does not wait for it
    from estimator.vision.tracker import TrackerMemory

_DOWNWARD = 0.5
"""Cosine of the largest angle between the axis of a camera on a gimbal and the vertical: beyond it no pad is looked for."""


class PadSearch:
    """Searches frames for the pad.

    Args:
        gimballed: whether a gimbal carries the camera, whose file then holds its rotation on the gimbal's last axis.
    """

    def __init__(self, tracker: TrackerConfig, gimballed: bool) -> None:
        self._tracker = tracker
        self._memory: TrackerMemory | None = None
        self.gimballed = gimballed
        self.pad = tracker.pad
        self.camera = tracker.camera.held(DOWN) if gimballed else tracker.camera
        """The camera on the body; one on a gimbal as it is while that points straight down."""

    def pointed_down(self, held: HeldCamera | None, attitude: Attitude) -> HeldCamera | None:
        """Return how the gimbal holds the camera; None if that is not known, or not downward.

        Args:
            attitude: the vehicle's at the same instant.
        """
        if held is None:
            return None
        axis_level = attitude.R_ned_body @ (held.R_body_gimbal @ self._tracker.camera.T_body_cam.R.matrix[:, 2])
        return held if float(axis_level[2]) > _DOWNWARD else None

    def camera_held(self, held: HeldCamera | None) -> Camera | None:
        """Return the camera on the body while the gimbal holds it so; None without a gimbal's attitude."""
        return None if held is None else self._tracker.camera.held(held.R_body_gimbal)

    def rehearse(self) -> None:
        """Look at a drawn frame, so that the first real one takes no longer than the others. This may run on another thread."""
        from estimator.vision.tracker import rehearse

        rehearse(replace(self._tracker, camera=self.camera))

    def detect(self, known: pipeline.Memory, frame: Frame, attitude: Attitude, held: HeldCamera | None = None) -> Detection:
        """Search a frame for the pad, beginning where it is expected.

        This may run on another thread, one call at a time: it reads only immutable estimator state and writes only its own.

        Args:
            known: the estimator's memory, which says where the pad is expected.
            held: how the gimbal held the camera at the exposure; None of a camera that is fixed on the body.
        """
        from estimator.vision.tracker import TrackerMemory, track

        believed = pipeline.belief(known, frame.stamp.measured_at)
        tracker = self._tracker
        if held is not None:
            tracker = replace(tracker, camera=tracker.camera.held(held.R_body_gimbal))
            attitude = structs.replace(attitude, cov_body=attitude.cov_body + held.cov_body)
        if tracker.camera.readout_s and believed is not None:
            from estimator.camera_motion import camera_motion

            motion = camera_motion(known, frame.stamp, tracker.camera, believed, held)
            tracker = replace(tracker, motion=motion)
        seen, self._memory = track(tracker, self._memory or TrackerMemory(), frame, attitude, believed)
        return seen
