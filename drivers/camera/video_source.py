"""Open a camera that is not part of the vehicle: a V4L2 device, a GStreamer pipeline, a network camera or a video file.

options = CameraOptions(source="v4l2", device="/dev/v4l/by-id/usb-...")
async with open_camera(options, (640, 480), clock) as camera:
    async for frame in camera.frames: ...

A file is played at its own speed. A live stream's clock stamps its frames, where its container has one (RTP, MPEG-TS, FLV); it is
mapped to ours by the least delay measured. What a demuxer makes up for a stream without times (MJPEG over HTTP, raw H.264) is not
used: such a frame is stamped by the arrival of its first byte. A frame that lay in the kernel's buffer before it was read arrived
at some instant since the reader last waited: its stamp is the middle of that time, and its standard deviation covers it.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.packet import Packet as AnyPacket
from av.video.stream import VideoStream
from numpy.typing import NDArray

from drivers.camera.counters import CameraCounters
from drivers.camera.exposure import ExposureDrive
from drivers.camera.images import ImageRefused
from drivers.camera.options import CameraOptions, Size, check_size
from drivers.camera.source import CameraLost, VideoSource
from drivers.camera.videos import MOST_PACKET_BYTES, has_times, open_video, predicts_frames
from drivers.clock_map import ClockMap, ClockMapOptions
from drivers.reconnect import BackOff, reconnect
from drivers.running_beside import running_beside
from estimator.contracts.errors import BadInput, Recoverable, in_words
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp, after, seconds_between

Packet: TypeAlias = "AnyPacket[VideoStream]"

_LIVE = {"fflags": "nobuffer", "flags": "low_delay", "rtsp_transport": "tcp", "analyzeduration": "1000000"}
_BY_LENGTH = frozenset({"mpjpeg"})
"""Formats without times whose frames carry their length; the end of others is known only when the next one begins."""
_BACKLOG_MOST, _WAITED_S = 300, 0.001
"""FFmpeg reads seconds of a stream to find its format. The arrival of those frames is unknown: without times in the container
they are not given out, until one has been waited for so long, or this many have passed."""
_ARRIVAL_SIGMA_S = 0.008
"""The standard deviation of a frame's way through kernel and demuxer where nothing but its arrival is known."""
_BUFFERED_MOST_S = 0.5
"""A frame without times that may have lain in the buffer for longer is not given out."""


@dataclass(frozen=True, slots=True, eq=False)
class _Image:
    px: NDArray[np.uint8]
    pts_s: float | None
    received_at: MonoNs
    buffered_s: float
    """The longest time for which it may have lain in the buffer before `received_at`."""


class StreamChannel:
    """One run from opening to the end; run it again after that."""

    def __init__(self, options: CameraOptions, size: Size | None, clock: Clock, camera: VideoSource) -> None:
        self._o = options
        self._size = size if size is None else check_size(size)
        self._clock = clock
        self._camera = camera
        self._seq = 0

    async def run(self) -> None:
        """Read frames until the stream breaks or the file ends.

        Raises:
            CameraLost: the source is absent, silent, failed, or a file that ended and is not repeated.
            BadInput: the file does not exist, or holds no video.
        """
        loop = asyncio.get_running_loop()
        pool = ThreadPoolExecutor(1, "stream")
        reader = _Reader(self._o, self._size, self._clock, self._camera.counters)
        try:
            await loop.run_in_executor(pool, reader.open)
            self._camera.down = None
            while True:
                await self._play(reader, pool)
                if not self._o.repeat or self._o.is_address:
                    reason = "failed" if self._o.is_address else "ended"
                    raise CameraLost(reason, f"{self._o.device}: the stream is over")
                await loop.run_in_executor(pool, reader.rewind)
        finally:
            # A read that hangs may last for the whole of `silence_s`, so nothing waits for it.
            pool.submit(reader.close)
            pool.shutdown(wait=False)

    async def _play(self, reader: _Reader, pool: ThreadPoolExecutor) -> None:
        loop = asyncio.get_running_loop()
        o, counters = self._o, self._camera.counters
        began: tuple[MonoNs, float] | None = None
        known = ClockMapOptions(
            resolution_s=1e-5, floor_s=o.latency_s, floor_sigma_s=o.latency_sigma_s, name=f"camera {o.device}"
        )
        clocks = ClockMap(known)
        while (image := await loop.run_in_executor(pool, reader.next)) is not None:
            self._camera.count_damage(o.device, image.received_at)
            if o.is_address:
                stamp = self._live_stamp(image, clocks)
            else:
                pts_s = self._seq / reader.rate_hz if image.pts_s is None else image.pts_s
                began = began or (self._clock.now(), pts_s)
                measured_at = after(began[0], pts_s - began[1])
                ahead_s = seconds_between(self._clock.now(), measured_at)
                if ahead_s > 0:
                    await self._clock.sleep(ahead_s)
                stamp = Stamp(after(measured_at, -o.latency_s), max(measured_at, self._clock.now()), o.latency_sigma_s, "arrival")
            counters.frames += 1
            frame = Frame(stamp, self._seq, image.px, o.exposure_s, coded=reader.coded)
            self._seq += 1
            counters.frames_replaced += self._camera.frames.offer(frame) is not None

    def _live_stamp(self, image: _Image, clocks: ClockMap) -> Stamp:
        if image.pts_s is None or not 0 <= image.pts_s < 1e9:
            measured_at = after(image.received_at, -self._o.latency_s - image.buffered_s / 2)
            sigma_s = math.hypot(self._o.latency_sigma_s, _ARRIVAL_SIGMA_S, image.buffered_s / math.sqrt(12))
            return Stamp(measured_at, image.received_at, sigma_s, "arrival")
        return clocks.stamp(round(image.pts_s * 1e9), image.received_at)


class _Reader:
    """The blocking half, whose methods all run on one worker thread."""

    def __init__(self, options: CameraOptions, size: Size | None, clock: Clock, counters: CameraCounters) -> None:
        self._o = options
        self._size = size
        self._clock = clock
        self._counters = counters
        self._container: InputContainer | None = None
        self._packets: Iterator[Packet] = iter(())
        self._ready: list[_Image] = []
        self._waiting = True
        self._timed = True
        self._at_once = True
        self._newest: tuple[MonoNs, float] | None = None
        self._emptied_at = clock.now()
        self._backlog = 0
        self.rate_hz = 30.0
        self.coded = False

    def open(self) -> None:
        o = self._o
        if not o.is_address and not Path(o.device).is_file():
            raise BadInput(f"{o.device}: no such file")
        silence_s = o.silence_s
        try:
            self._container = open_video(
                o.device,
                self._size,
                options=_LIVE if o.is_address else {},
                codec_options={"err_detect": "explode"} if o.is_address else {},
                timeout=(silence_s, silence_s) if o.is_address else None,
            )
        except ImageRefused as why:
            if o.is_address:
                raise CameraLost("failed", f"{o.device}: {why}") from why
            raise BadInput(f"{o.device}: {why}") from why
        except FFmpegError as why:
            if o.is_address:
                raise CameraLost("absent", f"{o.device}: {why.strerror}") from why
            raise BadInput(f"{o.device}: not a video that can be read ({why.strerror})") from why
        if not self._container.streams.video:
            raise BadInput(f"{o.device}: there is no video in it")
        self.coded = predicts_frames(self._container)
        self._timed = has_times(self._container)
        self._backlog = _BACKLOG_MOST if o.is_address and not self._timed else 0
        self._at_once = self._timed or self._container.format.name in _BY_LENGTH
        stream = self._container.streams.video[0]
        stream.thread_type = "SLICE" if o.is_address else "AUTO"
        rate = stream.average_rate
        self.rate_hz = float(rate) if rate else 30.0
        if not math.isfinite(self.rate_hz) or self.rate_hz <= 0:
            self.rate_hz = 30.0
        self._begin()

    def rewind(self) -> None:
        assert self._container is not None
        self._container.seek(0)
        self._begin()

    def _begin(self) -> None:
        assert self._container is not None
        self._packets = self._container.demux(self._container.streams.video[0])
        self._ready, self._waiting = [], True

    def next(self) -> _Image | None:
        """Return the next frame, None at the end."""
        while not self._ready:
            asked = self._clock.now()
            try:
                packet = next(self._packets)
            except StopIteration:
                return None
            except FFmpegError as why:
                reason = "silent" if isinstance(why, av.error.ExitError | av.error.TimeoutError) else "failed"
                raise CameraLost(reason, f"{self._o.device}: {why.strerror}") from why
            now = self._clock.now()
            if seconds_between(asked, now) > _WAITED_S:
                self._backlog, self._emptied_at = 0, now
            newest = now, seconds_between(self._emptied_at, now)
            # A packet whose end is the begin of the next one is given out when that begins: its own begin gave the last one out.
            began, self._newest = (newest if self._at_once else self._newest or newest), newest
            self._decode(packet, *began)
        return self._ready.pop(0)

    def _decode(self, packet: Packet, received_at: MonoNs, buffered_s: float) -> None:
        flush = packet.size == 0
        self._counters.buffers += not flush
        if packet.size > MOST_PACKET_BYTES:
            self._counters.frames_damaged += 1
            self._waiting = True
            return
        if self._waiting and not flush:
            if not packet.is_keyframe:
                self._counters.frames_waiting += 1
                return
            self._waiting = False
        try:
            frame_images = packet.decode()
        except FFmpegError:
            self._counters.frames_damaged += 1
            self._waiting = True
            return
        for image in frame_images:
            if image.is_corrupt:
                self._counters.frames_damaged += 1
                self._waiting = True
                continue
            if self._backlog or (self._o.is_address and not self._timed and buffered_s > _BUFFERED_MOST_S):
                self._backlog = max(0, self._backlog - 1)
                self._counters.frames_overtaken += 1
                continue
            px = np.asarray(image.to_ndarray(format="bgr24"), dtype=np.uint8)
            self._ready.append(_Image(px, image.time if self._timed else None, received_at, buffered_s))

    def close(self) -> None:
        if self._container is not None:
            self._container.close()


@asynccontextmanager
async def open_camera(options: CameraOptions, size: Size | None, clock: Clock) -> AsyncIterator[VideoSource]:
    """Open the camera and keep it open; it does not wait for the first frame.

    A camera that is unplugged, silent or absent is opened again with back-off, and counted; the reader of `frames` just waits.
    The `async with` block raises the errors that another attempt cannot fix.

    Args:
        size: the width and height of the camera's frames, px. A device needs it; frames of a stream that have more than four
            times as many pixels are not decoded, and with None any size is taken.

    Raises:
        ValueError: the frames are the vehicle's, or the size of a device's frames is missing or out of range.
        BadInput: the device cannot do what the options request (size, format, control).
        SetupImpossible: permission is missing, or the device is not a camera.
    """
    camera = VideoSource(ExposureDrive(options.exposure.settle_frames) if options.exposure.driven else None)
    # Each kind loads what it reads by only when it is used.
    if options.source == "vehicle":
        raise ValueError("the frames of this camera come with the vehicle")
    if options.source == "stream":
        from drivers.camera.video_source import StreamChannel

        body = StreamChannel(options, size, clock, camera).run
    elif size is None:
        raise ValueError("a device needs the size of its frames")
    elif options.source == "v4l2":
        from drivers.camera.v4l2 import V4l2Channel

        body = V4l2Channel(options, size, clock, camera).run
    else:
        from drivers.camera.gstreamer import GstreamerChannel

        body = GstreamerChannel(options, size, clock, camera).run
    name, longest_s = options.device, options.reconnect_most_s
    back_off = BackOff(options.reconnect_first_s, longest_s, healthy_after_s=longest_s)

    async def attempt() -> None:
        try:
            await body()
            raise CameraLost("ended", f"{name} ended by itself")
        except CameraLost as why:
            if why.reason != "ended":
                raise
            camera.down = in_words(why)
            camera.frames.fail(why)

    def on_failure(why: BaseException) -> None:
        camera.down = in_words(why)
        camera.counters.restarts[_reason(why)] += 1

    try:
        async with running_beside([("camera", reconnect(f"camera {name}", attempt, back_off, clock, on_failure))]):
            try:
                yield camera
            finally:
                camera.frames.fail(Recoverable("the camera is closed"))
    except BaseExceptionGroup as errors:
        if len(errors.exceptions) == 1:
            raise errors.exceptions[0] from None
        raise


def _reason(why: BaseException) -> str:
    while isinstance(why, BaseExceptionGroup):
        why = why.exceptions[0]
    return why.reason if isinstance(why, CameraLost) else "failed"
