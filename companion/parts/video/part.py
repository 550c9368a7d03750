"""The video stream as a part of the service: an observer of the frames and a supervised body beside the flight."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from contextlib import suppress

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.observer import NullObserver, ProcessedFrame
from companion.base.worker import Worker
from companion.guidance.pilot import Pilot
from companion.parts.video.rtp_stream import RtpStream
from companion.settings.video import VideoStreamOptions
from companion.tools.report.expected_place import camera_lean
from companion.tools.report.overlay import Overlay, annotate, annotated_size
from drivers.mailbox import Latest
from estimator.contracts.errors import Recoverable
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import Rotation
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs, seconds_between
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad

_FLOWS_S = 2.0
"""The stream counts as flowing for this long after a picture."""
_CLOSING_S = 0.3


class VideoStreamPart(NullObserver):
    """Sends the newest frame whenever one is due; a slow machine or network costs pictures and never delays the flight."""

    def __init__(self, options: VideoStreamOptions, pilot: Pilot, clock: Clock) -> None:
        self._o = options
        self._pilot = pilot
        self._clock = clock
        self._frames: Latest[ProcessedFrame] = Latest()
        self._due: MonoNs | None = None
        self._sent = 0
        self._sent_at: MonoNs | None = None

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the pictures, px."""
        camera = self._pilot.camera
        return annotated_size(camera.width, camera.height)

    @property
    def flows(self) -> bool:
        """Whether a picture was sent lately."""
        return self._sent_at is not None and seconds_between(self._sent_at, self._clock.now()) < _FLOWS_S

    def counted(self) -> Mapping[str, float]:
        """Return the counters for health."""
        return {"pictures": self._sent, "pictures_skipped": self._frames.replaced}

    def on_frame(self, processed: ProcessedFrame) -> None:
        now, period_ns = self._clock.now(), round(1e9 / self._o.rate_hz)
        # Frames jitter: one that comes a little early is taken, so that 15 Hz of 30 is every second frame and not every third.
        due = now if self._due is None else self._due
        if now >= due - period_ns // 4:
            self._due = MonoNs((due if now < due + period_ns else now) + period_ns)
            self._frames.offer(processed)

    async def run(self) -> None:
        """Send until cancelled.

        Raises:
            Recoverable: the address cannot be resolved, or the network refuses a picture.
        """
        worker, lean = Worker("video stream"), Rotation.identity()
        stream = await worker.run(RtpStream, self._o, self.size)
        try:
            async for processed in self._frames:
                exposed = processed.frame.stamp.measured_at
                belief = self._pilot.believed(exposed) if self._o.drawn else None
                lean = camera_lean(processed, belief) or lean
                if await worker.run(self._send, stream, processed, belief, lean):
                    self._sent, self._sent_at = self._sent + 1, self._clock.now()
        finally:
            # A call that hangs in the network ends with the process; nothing waits for it.
            with suppress(TimeoutError, Recoverable):
                async with asyncio.timeout(_CLOSING_S):
                    await worker.run(stream.close)
            worker.close()

    def _send(self, stream: RtpStream, processed: ProcessedFrame, belief: RelativeState | None, lean: Rotation) -> bool:
        image = processed.frame.px
        if self._o.drawn:
            image = drawn(processed, belief, lean, processed.camera or self._pilot.camera, self._pilot.pad)
        elif image.shape[1::-1] != self.size:
            image = np.asarray(cv2.resize(image, self.size), np.uint8)
        return stream.send(image, processed.frame.stamp.measured_at)


def drawn(processed: ProcessedFrame, belief: RelativeState | None, lean: Rotation, camera: Camera, pad: Pad) -> NDArray[np.uint8]:
    """Return the frame with the pad where the filter expects it and the features that were found.

    Args:
        belief: the estimate at the exposure.
        lean: see `camera_lean`.
    """
    seen = processed.detection
    sightings = () if seen is None else tuple(s for s in seen.methods.values() if s is not None)
    if seen is not None:
        sightings = (*sightings, *(s for s in (seen.selected, seen.elsewhere) if s is not None))
    level = Rotation.identity() if processed.attitude is None else processed.attitude.R_ned_body.without_heading()
    overlay = Overlay(sightings, belief, level @ lean.inv)
    return annotate(processed.frame.px, overlay, camera, pad)
