"""The video stream as a part of the service: frames by RTP from an observer and a supervised body beside the flight."""

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from fractions import Fraction

import av
import cv2
import numpy as np
from av.error import FFmpegError
from numpy.typing import NDArray

from companion.base.observer import NullObserver, ProcessedFrame
from companion.base.worker import Worker
from companion.cycle.ports import Assembly
from companion.guidance.pilot import Pilot
from companion.recording.frame_encoder import CLOCK_HZ, TimedFrames, prepare
from companion.settings.links import VideoStreamOptions
from companion.tools.report.overlay import Overlay, annotate, annotated_size, camera_lean
from drivers.mailbox import Latest
from estimator.contracts.errors import Recoverable, refused
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import Rotation
from estimator.contracts.time import Clock, MonoNs, seconds_between
from estimator.vision.camera.camera import Camera
from estimator.vision.pad.pad import Pad

# Send pictures as H.264 by RTP over UDP (RFC 6184), as ground stations expect it.
#
# Parameter sets go with every key frame, one a second, so that a station that begins to listen sees a picture within a second.

_PACKET_BYTES = 1200
"""Size below the MTU of tunnels and radios, so that no packet is fragmented."""
_FLOWS_S = 2.0
"""The stream counts as flowing for this long after a picture."""
_CLOSING_S = 0.3  # time that the encoder gets to end


class RtpStream:
    """One stream of pictures of one size; for one thread.

    Args:
        size: (width, height) px, even numbers.

    Raises:
        Recoverable: the address cannot be resolved or reached.
    """

    def __init__(self, options: VideoStreamOptions, size: tuple[int, int]) -> None:
        self.size = size
        self._to = options.to
        self._frames = TimedFrames(size)
        rate = Fraction(options.rate_hz).limit_denominator(1001)
        key_frames = max(1, round(options.rate_hz))
        kbit = options.bitrate_kbit_s
        self._container = av.open(f"rtp://{options.to}?pkt_size={_PACKET_BYTES}", "w", format="rtp")
        stream = self._container.add_stream("libx264", rate=rate)
        prepare(stream.codec_context, size)
        stream.codec_context.time_base = Fraction(1, CLOCK_HZ)
        stream.codec_context.thread_count = 1
        stream.codec_context.options = {
            "preset": "ultrafast",
            "tune": "zerolatency",
            "profile": "baseline",
            "x264-params": f"repeat-headers=1:scenecut=0:keyint={key_frames}:min-keyint={key_frames}:sliced-threads=0"
            f":bitrate={kbit}:vbv-maxrate={kbit}:vbv-bufsize={kbit}",
        }
        self._stream = stream
        with refused(f"video_stream.to: {options.to}", OSError, FFmpegError, by=Recoverable):
            self._container.start_encoding()

    def send(self, image: NDArray[np.uint8], at: MonoNs) -> bool:
        """Send an (H, W, 3) BGR picture of the instant `at`; return False for one that is not later than the last.

        Raises:
            ValueError: a picture of another size.
            Recoverable: the network refuses it.
        """
        frame = self._frames.frame(image, at)
        if frame is None:
            return False
        try:
            self._container.mux(self._stream.encode(frame))
        except (OSError, FFmpegError) as why:
            raise Recoverable(f"video_stream.to: {self._to}: {why}") from why
        return True

    def close(self) -> None:
        """Close the socket; what the network does not take any more is lost."""
        with suppress(OSError, FFmpegError):
            self._container.close()


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
        """True if a picture was sent lately."""
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
                belief = self._pilot.estimator.at(exposed) if self._o.drawn else None
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


def join(service: Assembly) -> None:
    """Add the stream, which the vehicle's links then describe to stations."""
    service.video = video = VideoStreamPart(service.settings.video_stream, service.pilot, service.clock)
    service.observers.append(video)
    service.add("video_stream", video)
