"""The search of frames for the pad: what a search begins with, and the tracker's own memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from msgspec import Struct, structs

from estimator.attitude_history import DOWN, HeldCamera
from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.samples import Attitude, Frame
from estimator.pipeline import RelativeEstimator
from estimator.vision.camera import Camera
from estimator.vision.detection import Detection
from estimator.vision.tracker_config import TrackerConfig

if TYPE_CHECKING:  # what looks at frames loads OpenCV, and the first guidance cycle does not wait for it
    from estimator.vision.tracker import TrackerMemory

_DOWNWARD = 0.5
"""Cosine of the largest angle between the axis of a camera on a gimbal and the vertical: beyond it no pad is looked for."""


class Look(Struct, frozen=True):
    """A frame and what the search of it begins with. The estimate was taken before, so that another thread may search."""

    frame: Frame
    attitude: Attitude
    tracker: TrackerConfig
    """The tracker as it is for this frame: with the camera as it was held, and its motion."""
    expected: RelativeState | None
    """The estimate at the exposure; None for a search of the whole frame."""
    reads_deck: bool = True
    """Read the deck in the frame, too; else `PadSearch.read_deck` is for that, after the sighting was reported."""
    asks_alone: Callable[[Sighting], bool] | None = None
    """Tells whether to search for a second pad, for a frame without an attitude of its own."""


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

    def anywhere(self, frame: Frame, attitude: Attitude) -> Look:
        """Return what a search that expects the pad nowhere begins with."""
        return Look(frame, attitude, self._tracker, None)

    def begin(
        self, known: RelativeEstimator, frame: Frame, attitude: Attitude, held: HeldCamera | None = None, *, watches: bool = True
    ) -> Look:
        """Return what the search of a frame begins with.

        Args:
            known: the estimator, which says where the pad is expected.
            held: how the gimbal held the camera at the exposure; None of a camera that is fixed on the body.
            watches: whether to look for things on the pad and about it too; else what was seen of them is forgotten.
        """
        estimated = known.at(frame.stamp.measured_at)
        tracker = replace(self._tracker, watches=watches)
        if held is not None:
            tracker = replace(tracker, camera=tracker.camera.held(held.R_body_gimbal))
            attitude = structs.replace(attitude, cov_body=attitude.cov_body + held.cov_body)
        if tracker.camera.readout_s and estimated is not None:
            tracker = replace(tracker, motion=known.camera_motion(frame.stamp, tracker.camera, estimated, held))
        return Look(frame, attitude, tracker, estimated)

    def begin_following(self, known: RelativeEstimator, frame: Frame, assumed: Attitude, *, watches: bool = True) -> Look:
        """Return what the search of a frame that no attitude covers begins with: the place where the pad was."""
        tracker = replace(self._tracker, watches=watches)
        return Look(frame, assumed, tracker, known.place_to_look(assumed), asks_alone=known.asks_alone(assumed))

    def detect(self, look: Look) -> Detection:
        """Search a frame for the pad. This may run on another thread, one call at a time: it writes only its own memory."""
        from estimator.vision.tracker import TrackerMemory, alone_in, sight

        before = self._memory or TrackerMemory()
        seen, self._memory = sight(look.tracker, before, look.frame, look.attitude, look.expected)
        if look.reads_deck:
            seen = self.read_deck(seen)
        sighting = seen.selected or seen.elsewhere
        if look.asks_alone is None or sighting is None or not look.asks_alone(sighting):
            return seen
        return structs.replace(seen, alone_in=alone_in(self._tracker, self._memory, look.frame, look.attitude, sighting))

    @property
    def has_unread(self) -> bool:
        """True if `read_deck` has something to read in the newest frame."""
        return self._memory is not None and self._memory.unread is not None

    def read_deck(self, seen: Detection) -> Detection:
        """Return the newest detection with what its frame shows on the pad and about it; threads as for `detect`."""
        from estimator.vision.by_paint import read_deck

        if self._memory is not None:
            seen, self._memory = read_deck(seen, self._memory)
        return seen
