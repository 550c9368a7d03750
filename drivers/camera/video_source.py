"""Read the frames of a network camera or of a video file.

A file is played at its own speed. A live stream's clock stamps its frames, where its container has one (RTP, MPEG-TS, FLV); it is
mapped to ours by the least delay measured. What a demuxer makes up for a stream without times (MJPEG over HTTP, TCP or a pipe,
raw H.264) is not used: such a frame is stamped by the arrival of its first byte, and a JPEG is given out at its end mark. FFmpeg
gives out a frame of many streams when the first byte of the next one arrives, or that of the one after: its arrival is that of
its own. A frame that lay in the kernel's buffer before it was read arrived at some instant since the reader last waited: its
stamp is the middle of that time, and its standard deviation covers it.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeAlias

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.packet import Packet as AnyPacket
from av.video.stream import VideoStream
from msgspec import Struct
from numpy.typing import NDArray

from drivers.camera.images import ImageRefused, claimed_size, decode
from drivers.camera.live_bytes import Arrival, ArrivalClock, JpegSplitter, LiveBytes
from drivers.camera.options import CameraOptions, Size, check_size
from drivers.camera.source import CameraCounters, CameraLost, VideoSource
from drivers.camera.videos import (
    MOST_PACKET_BYTES,
    WholeFrames,
    has_times,
    most_pixels,
    open_video,
    packets_held,
    predicts_frames,
    video_of,
)  # fmt: skip
from drivers.clock_map import ClockMap, ClockMapOptions
from estimator.contracts.address import raw
from estimator.contracts.errors import BadInput, DecklanderError
from estimator.contracts.samples import Frame
from estimator.contracts.time import Clock, MonoNs, Stamp, after, seconds_between

Packet: TypeAlias = "AnyPacket[VideoStream]"

_LIVE = {"fflags": "nobuffer", "flags": "low_delay", "rtsp_transport": "tcp", "analyzeduration": "1000000"}
_DESCRIBED = {"protocol_whitelist": "file,udp,rtp"}
"""FFmpeg's protocols for streams that a file (.sdp) describes."""
_PLAIN = ("http://", "https://", "tcp://")
"""Addresses whose bytes may be JPEGs one after another."""
_BACKLOG_MOST = 300
"""FFmpeg reads seconds of a stream to find its format. The arrival of those frames is unknown: without times in the container
they are not given out, until one has been waited for so long, or this many have passed."""
_ARRIVAL_SIGMA_S = 0.008
"""The standard deviation of a frame's way through kernel and demuxer where nothing but its arrival is known."""
_BUFFERED_MOST_S = 0.5
"""A frame without times that may have lain in the buffer for longer is not given out."""


class _Image(Struct, frozen=True, eq=False):
    px: NDArray[np.uint8]
    pts_s: float | None
    arrival: Arrival


class StreamChannel:
    """One run from opening to the end; run it again after that."""

    def __init__(self, options: CameraOptions, size: Size | None, clock: Clock, camera: VideoSource) -> None:
        self._o = options
        self._size = size if size is None else check_size(size)
        self._clock = clock
        self._camera = camera
        self._seq = 0
        self._live = options.is_live

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
                if not self._o.repeat or self._live:
                    reason = "failed" if self._live else "ended"
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
            resolution_s=1e-5, floor_s=o.latency_s, floor_sigma_s=o.latency_sigma_s, unknown_s=_ARRIVAL_SIGMA_S, claimed=True,
            name=f"camera {o.device}",
        )  # fmt: skip
        clocks = ClockMap(known)
        while (image := await loop.run_in_executor(pool, reader.next)) is not None:
            self._camera.count_damage(o.device, image.arrival.received_at)
            if self._live:
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
        received_at, buffered_s = image.arrival.received_at, image.arrival.buffered_s
        if image.pts_s is None or not 0 <= image.pts_s < 1e9:
            measured_at = after(received_at, -self._o.latency_s - buffered_s / 2)
            sigma_s = math.hypot(self._o.latency_sigma_s, _ARRIVAL_SIGMA_S, buffered_s / math.sqrt(12))
            return Stamp(measured_at, received_at, sigma_s, "arrival")
        return clocks.stamp(round(image.pts_s * 1e9), received_at)


class _Reader:
    """The blocking half, whose methods all run on one worker thread."""

    def __init__(self, options: CameraOptions, size: Size | None, clock: Clock, counters: CameraCounters) -> None:
        self._o = options
        self._size = size
        self._clock = clock
        self._counters = counters
        self._live = options.is_live
        self._container: InputContainer | None = None
        self._stream: VideoStream | None = None
        self._bytes: LiveBytes | None = None
        self._jpegs: JpegSplitter | None = None
        self._packets: Iterator[Packet] = iter(())
        self._ready: list[_Image] = []
        self._waiting = True
        self._timed = True
        self._held: deque[Arrival] = deque()
        """Arrivals of the newest packets. FFmpeg held them back, and the first byte of each gave out an earlier one."""
        self._held_most = 0
        self._arrivals = ArrivalClock(clock)
        self._backlog = 0
        self._frames = WholeFrames()
        self.rate_hz = 30.0
        self.coded = False

    def open(self) -> None:
        o = self._o
        if not self._live and not Path(o.device).is_file():
            raise BadInput(f"{o.device}: no such file")
        if (container := self._open_container()) is None:
            return
        if not container.streams.video:
            raise BadInput(f"{o.device}: there is no video in it")
        stream = self._stream = video_of(container, self._size)
        self.coded = predicts_frames(stream)
        self._timed = has_times(container)
        self._held_most = packets_held(stream) if self._live else 0
        self._backlog = _BACKLOG_MOST if self._live and not self._timed else 0
        stream.thread_type = "SLICE" if self._live else "AUTO"
        rate = stream.average_rate
        self.rate_hz = float(rate) if rate else 30.0
        if not math.isfinite(self.rate_hz) or self.rate_hz <= 0:
            self.rate_hz = 30.0
        self._begin()

    def _open_container(self) -> InputContainer | None:
        """Open the file or stream; None if it is bytes of JPEGs, which need no container."""
        o = self._o
        try:
            if self._live and self._open_bytes():
                return None
            self._container = open_video(
                raw(o.device) if self._bytes is None else self._bytes,
                self._size,
                options=_LIVE | ({} if "://" in o.device else _DESCRIBED) if self._live else {},
                codec_options={"err_detect": "explode"} if self._live else {},
                timeout=(o.silence_s, o.silence_s) if self._live else None,
            )
        except ImageRefused as why:
            raise self._refused(why) from why
        except (FFmpegError, OSError) as why:
            if self._live:
                raise CameraLost("absent", f"{o.device}: {why.strerror}") from why
            raise BadInput(f"{o.device}: not a video that can be read ({why.strerror})") from why
        return self._container

    def _refused(self, why: ImageRefused) -> DecklanderError:
        text = f"{self._o.device}: {why}"
        return CameraLost("failed", text) if self._live else BadInput(text)

    def _open_bytes(self) -> bool:
        """Open a stream that may be of JPEGs, and return whether it is; FFmpeg reads what else is in it."""
        device = self._o.device
        if not (device.lower().startswith(_PLAIN) or Path(device).is_fifo()):
            return False
        self._bytes = LiveBytes(raw(device), self._o.silence_s)
        if self._bytes.holds_jpegs():
            self._timed, self._jpegs = False, JpegSplitter()
            self._arrivals = ArrivalClock(self._clock)
            return True
        if device.lower().startswith("http"):  # a playlist names further addresses, and a file may be read from its end
            self._bytes.close()
            self._bytes = None
        return False

    def rewind(self) -> None:
        assert self._container is not None
        self._container.seek(0)
        self._begin()

    def _begin(self) -> None:
        assert self._container is not None
        assert self._stream is not None
        self._packets = self._container.demux(self._stream)
        self._ready, self._waiting = [], True

    def next(self) -> _Image | None:
        """Return the next frame, None at the end."""
        while not self._ready:
            asked = self._clock.now()
            try:
                more = self._next_packet(asked) if self._jpegs is None else self._next_bytes(self._jpegs, asked)
                if not more:
                    self._frames.end()
            except FFmpegError as why:
                reason = "silent" if isinstance(why, av.error.ExitError | av.error.TimeoutError) else "failed"
                raise CameraLost(reason, f"{self._o.device}: {why.strerror}") from why
            except ImageRefused as why:
                raise self._refused(why) from why
            if not more:
                return None
        return self._ready.pop(0)

    def _next_bytes(self, jpegs: JpegSplitter, asked: MonoNs) -> bool:
        assert self._bytes is not None
        piece = self._bytes.next()
        for jpeg, began in jpegs.jpegs(piece, self._arrivals.now(asked)):
            self._counters.buffers += 1
            width, height = claimed_size(jpeg) or (0, 0)
            try:
                if not 0 < width * height <= most_pixels(self._size):
                    raise ImageRefused(f"{width}x{height} px")
                px = decode(jpeg)
            except ImageRefused:
                self._counters.frames_damaged += 1
                continue
            self._give(px, None, began)
        return bool(piece)

    def _next_packet(self, asked: MonoNs) -> bool:
        packet = next(self._packets, None)
        if packet is None:
            return False
        newest = self._arrivals.now(asked)
        if newest.waited:
            self._backlog = 0
        self._held.append(newest)
        self._decode(packet, self._held.popleft() if len(self._held) > self._held_most else self._held[0])
        return True

    def _give(self, px: NDArray[np.uint8], pts_s: float | None, arrival: Arrival) -> None:
        if self._backlog or (self._live and not self._timed and arrival.buffered_s > _BUFFERED_MOST_S):
            self._backlog = max(0, self._backlog - 1)
            self._counters.frames_overtaken += 1
        else:
            self._ready.append(_Image(px, pts_s, arrival))

    def _decode(self, packet: Packet, began: Arrival) -> None:
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
            if (px := self._frames.px(image)) is None:
                self._counters.frames_damaged += 1
                self._waiting |= image.is_corrupt
                continue
            self._give(px, image.time if self._timed else None, began)

    def close(self) -> None:
        for opened in (self._container, self._bytes):
            if opened is not None:
                opened.close()
