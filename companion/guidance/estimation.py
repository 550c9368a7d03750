"""Estimator and pad tracker in flight: their memories, the samples that wait, and the results that wait for a reader."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from msgspec import structs

from estimator import pipeline
from estimator.contracts.estimates import PathName, RelativeState, Verdict
from estimator.contracts.fusion import FusionResult
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.samples import Attitude, Frame, Sample
from estimator.contracts.time import MonoNs, Stamp
from estimator.ekf import Forecast
from estimator.gimbal_history import DOWN, HeldCamera
from estimator.options import EstimatorOptions
from estimator.vision.camera import Camera
from estimator.vision.detection import Detection
from estimator.vision.tracker_config import TrackerConfig

if TYPE_CHECKING:  # what looks at frames loads OpenCV, and the first guidance cycle does not wait for it
    from estimator.vision.tracker import TrackerMemory


class Estimation:
    """Keeps the estimator's memory, and lets it process samples when an answer is needed.

    Args:
        shadows: estimator paths that run for comparison only and never steer.
    """

    def __init__(self, options: EstimatorOptions, shadows: Sequence[PathName]) -> None:
        self._memory = pipeline.start(options, shadows)
        self._waiting: list[Sample] = []
        """Samples that the estimator has not processed yet."""
        self._fused: list[tuple[Sequence[Sample], Sequence[tuple[FusionResult, ...]]]] = []
        """Rows of samples that it has processed, with the results of each, for `processed`."""
        self._fused_n = 0
        """Number of these samples."""

    @property
    def memory(self) -> pipeline.Memory:
        """The memory as the samples that wait find it."""
        return self._memory

    @property
    def path(self) -> PathName:
        """The path to steer by."""
        return self._memory.options.path

    @property
    def paths(self) -> set[PathName]:
        """The paths that run."""
        return {one.name for one in self._memory.paths}

    def keep(self, samples: Sequence[Sample]) -> None:
        """Keep samples for the estimator."""
        self._waiting += samples

    @property
    def kept(self) -> int:
        """Number of samples whose results nobody has read."""
        return len(self._waiting) + self._fused_n

    def steer_by(self, path: PathName) -> None:
        """Steer by another path.

        Raises:
            ValueError: the path cannot run.
        """
        self._settle()
        self._memory = pipeline.steer_by(self._memory, path)

    def retune(self, *, min_confidence: float, max_delay_s: float) -> None:
        """Use other settings from now on."""
        self._settle()
        options = structs.replace(self._memory.options, min_confidence=min_confidence, max_delay_s=max_delay_s)
        self._memory = structs.replace(self._memory, options=options)

    def held_at(self, stamp: Stamp, attitude: Attitude) -> HeldCamera | None:
        """Return how the gimbal held the camera at the exposure of a frame; None if no report of it covers that.

        Args:
            attitude: the vehicle's at the exposure.
        """
        self._settle()
        return pipeline.held_at(self._memory, stamp, attitude)

    def awaits_gimbal(self, stamp: Stamp) -> bool:
        """Return whether the gimbal's report that covers the exposure of a frame may still come."""
        return self._memory.gimbal.reports(stamp)

    def fuse(self, seen: Detection) -> tuple[FusionResult, ...]:
        """Fuse what was seen in a frame; return the results, path by path, the steering one's first. Empty if no pad was seen."""
        sighting = seen.selected or seen.elsewhere
        if sighting is None:
            return ()
        self._settle()
        if seen.selected is not None and seen.elsewhere is not None:
            self._memory, results = pipeline.step_seen(self._memory, seen.selected, seen.elsewhere)
        else:
            self._memory, results = pipeline.step(self._memory, sighting)
        return results

    def believed(self, now: MonoNs) -> RelativeState | None:
        """Return the steering path's estimate as the estimator has it; None while there is none."""
        self._settle()
        return pipeline.belief(self._memory, now)

    def all_believed(self, now: MonoNs) -> tuple[RelativeState, ...]:
        """Return every path's estimate; the steering path's comes first if it has one."""
        self._settle()
        return pipeline.beliefs(self._memory, now)

    def motion(self, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
        """Return the motion of body and deck at an instant by the steering path; None for unknown parts."""
        self._settle()
        return pipeline.motion(self._memory, now)

    def forecast(self, now: MonoNs, horizons_s: Sequence[float]) -> Forecast | None:
        """Return the deck at these times, s, after an instant by the steering path; None if it does not forecast."""
        self._settle()
        return pipeline.forecast(self._memory, now, horizons_s)

    def attitude_at(self, stamp: Stamp) -> Attitude | None:
        """Return the attitude at the exposure of a frame; None when no sample covers it."""
        self._settle()
        return pipeline.attitude_at(self._memory, stamp)

    def assumed_at(self, stamp: Stamp) -> Attitude | None:
        """Return what to assume for a frame that no attitude covers; None if it is not to be looked at."""
        self._settle()
        return pipeline.assumed_at(self._memory, stamp)

    def follow(self, seen: Detection, assumed: Attitude) -> None:
        """Take note of what a frame without an attitude shows of the tracked pad."""
        sighting = seen.selected or seen.elsewhere
        if sighting is not None:
            self._settle()
            self._memory = pipeline.follow(self._memory, sighting, assumed, seen.alone_in)

    def admit(self, frame: Frame) -> Verdict | None:
        """Register a frame before the search; return None if it may be searched, otherwise its verdict."""
        self._settle()
        self._memory, verdict = pipeline.on_frame(self._memory, frame)
        return verdict

    def fused(self) -> list[tuple[Sample, tuple[FusionResult, ...]]]:
        """Process what waits; return all samples that were processed since the last call, each with its results, path by path."""
        self._settle()
        return self.processed()

    def processed(self) -> list[tuple[Sample, tuple[FusionResult, ...]]]:
        """Return all samples that the estimator has processed since the last call, as `fused`; what waits goes on waiting."""
        rows, self._fused, self._fused_n = self._fused, [], 0
        return [one for samples, results in rows for one in zip(samples, results, strict=True)]

    def _settle(self) -> None:
        """Let the estimator process the samples that wait."""
        if not self._waiting:
            return
        samples, self._waiting = self._waiting, []
        self._memory, results = pipeline.step_samples(self._memory, samples)
        self._fused.append((samples, results))
        self._fused_n += len(samples)


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

    def follow(self, known: pipeline.Memory, frame: Frame, assumed: Attitude, *, watches: bool = True) -> Detection:
        """Search a frame that no attitude covers for the pad, beginning where it was; otherwise as `detect`."""
        from estimator.vision.alone import alone_in
        from estimator.vision.tracker import TrackerMemory, track

        place, tracker = pipeline.place_to_look(known, assumed), replace(self._tracker, watches=watches)
        seen, self._memory = track(tracker, self._memory or TrackerMemory(), frame, assumed, place)
        sighting = seen.selected or seen.elsewhere
        if sighting is None or not pipeline.asks_alone(known, sighting, assumed):
            return seen
        return structs.replace(seen, alone_in=alone_in(self._tracker, self._memory, frame, assumed, sighting))

    def detect(
        self, known: pipeline.Memory, frame: Frame, attitude: Attitude, held: HeldCamera | None = None, *, watches: bool = True
    ) -> Detection:
        """Search a frame for the pad, beginning where it is expected.

        This may run on another thread, one call at a time: it reads only immutable estimator state and writes only its own.

        Args:
            known: the estimator's memory, which says where the pad is expected.
            held: how the gimbal held the camera at the exposure; None of a camera that is fixed on the body.
            watches: whether to look for things on the pad and about it too; else what was seen of them is forgotten.
        """
        from estimator.vision.tracker import TrackerMemory, track

        estimated = pipeline.belief(known, frame.stamp.measured_at)
        tracker = replace(self._tracker, watches=watches)
        if held is not None:
            tracker = replace(tracker, camera=tracker.camera.held(held.R_body_gimbal))
            attitude = structs.replace(attitude, cov_body=attitude.cov_body + held.cov_body)
        if tracker.camera.readout_s and estimated is not None:
            from estimator.camera_motion import camera_motion

            motion = camera_motion(known, frame.stamp, tracker.camera, estimated, held)
            tracker = replace(tracker, motion=motion)
        seen, self._memory = track(tracker, self._memory or TrackerMemory(), frame, attitude, estimated)
        return seen
