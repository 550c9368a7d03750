"""The video channels of both generations: only the newest frame is kept, and one worker thread decodes in order.

A 2.0 sends H.264 by TCP. A 1.0 sends one UVLC picture a datagram to whoever asked with a datagram last; a picture carries the
drone's count of pictures and no time, so its frame is stamped by its arrival.
"""

import asyncio
import math
from concurrent.futures import ThreadPoolExecutor

from drivers.ardrone.counters import Counters
from drivers.ardrone.datagrams import open_datagrams
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.pave import PaveFrame, PaveParser
from drivers.ardrone.setup import Setup
from drivers.ardrone.video import VideoDecoder, new_codec
from drivers.clock_map import ClockMap, ClockMapOptions
from drivers.mailbox import Latest
from estimator.contracts.errors import Recoverable
from estimator.contracts.pictures import CodedPicture, PictureDecoder, PictureRefusal
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp, after, seconds_between

_READ = 1 << 16
_MS = 1_000_000
OPENING = b"\x01\x00\x00\x00"
"""The datagram that requests the video; it is sent again when there is none."""
P264 = (
    "the drone sends pictures that build on earlier ones, which only its codec P264 does: "
    'set video:video_codec to 32 (UVLC), as vehicle.model = "1.0" does, and end whatever else configures the drone'
)
_NUMBERS = 1 << 32
_LATE = 64
"""A picture that is up to so many counts older than the newest one arrived late; one that is older comes from a drone that has
restarted."""


class VideoChannel:
    """Puts the frames of one video stream into `frames`, once the bottom camera is known to be selected."""

    def __init__(self, options: ArDroneOptions, clock: Clock, counters: Counters, setup: Setup, frames: Latest[Frame]) -> None:
        self._o = options
        self._clock = clock
        self._counters = counters
        self._setup = setup
        self._frames = frames
        self._parser = PaveParser()
        self._decoder = VideoDecoder()
        self._map = ClockMap(
            ClockMapOptions(
                wrap_ns=(1 << 32) * _MS,
                resolution_s=1e-3,
                floor_s=options.video_delay_s,
                floor_sigma_s=options.video_delay_sigma_s,
                name="the drone's video",
            )
        )
        self._began = MonoNs(0)
        """The instant at which the first byte of the unfinished frame was received."""

    def restarted(self) -> None:
        """Forget the drone's clock, because the drone has restarted."""
        self._map.reset()

    async def run(self) -> None:
        """Receive until the stream ends or is silent for `video_silence_s`.

        Raises:
            Recoverable: the stream ended or is silent.
            OSError: there is no connection.
        """
        async with asyncio.timeout(self._o.connect_timeout_s):
            reader, writer = await asyncio.open_connection(self._o.host, self._o.video_port, limit=4 * _READ)
        self._parser.reset()
        with ThreadPoolExecutor(1, "ardrone-video") as pool:
            # It loads the libraries while the first frame is on its way.
            pool.submit(new_codec)
            try:
                while True:
                    try:
                        async with asyncio.timeout(self._o.video_silence_s):
                            data = await reader.read(_READ)
                    except TimeoutError as why:
                        raise Recoverable(f"no video for {self._o.video_silence_s} s") from why
                    if not data:
                        raise Recoverable("the drone closed the video")
                    await self._take(data, pool)
            finally:
                writer.close()

    async def _take(self, data: bytes, pool: ThreadPoolExecutor) -> None:
        now = self._clock.now()
        self._counters.video_bytes += len(data)
        began, carried = self._began, self._parser.pending > 0
        batch = self._parser.feed(data)
        if not (carried and not batch):
            self._began = now
        self._counters.video_skipped_bytes = self._parser.skipped_bytes
        self._counters.video_torn = self._parser.torn
        self._counters.video_lost = self._parser.number_gaps
        if not batch:
            return
        self._counters.video_units += len(batch)
        stamps = [self._stamp(unit, began if carried and i == 0 else now) for i, unit in enumerate(batch)]
        image = await asyncio.get_running_loop().run_in_executor(pool, self._decoder.newest, batch)
        self._count()
        if image is None:
            return
        stamp = stamps[image.index]
        if not self._selected(stamp.received_at):
            self._counters.frames_before_setup += 1
            return
        frame = Frame(stamp, batch[image.index].header.frame_number, image.px, self._o.exposure_s, coded=True)
        self._counters.frames += 1
        self._counters.frames_replaced += self._frames.offer(frame) is not None

    def _stamp(self, unit: PaveFrame, received_at: MonoNs) -> Stamp:
        return self._map.stamp(unit.header.timestamp_ms * _MS, received_at)

    def _selected(self, received_at: MonoNs) -> bool:
        done_at = self._setup.done_at
        return done_at is not None and seconds_between(done_at, received_at) >= self._o.video_settle_s

    def _count(self) -> None:
        decoder, counters = self._decoder, self._counters
        counters.frames_overtaken = decoder.overtaken
        counters.frames_waiting = decoder.waiting
        counters.frames_damaged = decoder.damaged
        counters.frames_unsupported = decoder.unsupported


class UvlcChannel:
    """Puts the frames of one video into `frames`, once the bottom camera is known to be selected."""

    def __init__(
        self,
        options: ArDroneOptions,
        clock: Clock,
        counters: Counters,
        setup: Setup,
        frames: Latest[Frame],
        decoder: PictureDecoder,
    ) -> None:
        self._o = options
        self._decoder = decoder
        self._clock = clock
        self._counters = counters
        self._setup = setup
        self._frames = frames
        self._newest: int | None = None
        self._sigma_s = min(0.999, math.hypot(options.video_delay_sigma_s, options.arrival_sigma_s))

    def restarted(self) -> None:
        """Forget the drone's count of pictures, because the drone has restarted."""
        self._newest = None

    async def run(self) -> None:
        """Receive until the video is silent for `video_silence_s`.

        Raises:
            Recoverable: the video is silent, or of a codec that is not decoded, or the socket is broken.
            OSError: the host is not known or not reachable.
        """
        arrived: Latest[tuple[bytes, MonoNs]] = Latest()

        def received(datagram: bytes, received_at: MonoNs) -> None:
            self._counters.video_bytes += len(datagram)
            self._counters.video_units += 1
            self._counters.frames_overtaken += arrived.offer((datagram, received_at)) is not None

        with ThreadPoolExecutor(1, "ardrone-video") as pool:
            async with open_datagrams(self._o.host, self._o.video_port, self._clock, received) as socket:
                heard = self._clock.now()
                socket.send(OPENING)
                while True:
                    try:
                        async with asyncio.timeout(self._o.video_silence_s / 4):
                            datagram, received_at = await arrived.get()
                    except TimeoutError as why:
                        if seconds_between(heard, self._clock.now()) >= self._o.video_silence_s:
                            raise Recoverable(f"no video for {self._o.video_silence_s} s") from why
                        socket.send(OPENING)
                        continue
                    heard = received_at
                    await self._take(datagram, received_at, pool)

    async def _take(self, datagram: bytes, received_at: MonoNs, pool: ThreadPoolExecutor) -> None:
        picture = self._decoder.header(datagram)
        if not self._selected(received_at):
            # A drone that is not configured yet sends what its last client wanted: the other camera, or P264.
            self._counters.frames_before_setup += 1
            return
        if isinstance(picture, PictureRefusal):
            self._refuse(picture)
            return
        px = await asyncio.get_running_loop().run_in_executor(pool, self._decoder.decode, datagram, picture)
        if isinstance(px, PictureRefusal):
            self._refuse(px)
            return
        if not self._in_order(picture):
            self._counters.frames_overtaken += 1
            return
        stamp = Stamp(after(received_at, -self._o.video_delay_s), received_at, self._sigma_s, "arrival")
        frame = Frame(stamp, picture.number, px, self._o.exposure_s)
        self._counters.frames += 1
        self._counters.frames_replaced += self._frames.offer(frame) is not None

    def _refuse(self, why: PictureRefusal) -> None:
        self._counters.video_refused[why.value] += 1
        if why is PictureRefusal.INTER_PICTURE:
            raise Recoverable(P264)

    def _in_order(self, picture: CodedPicture) -> bool:
        if self._newest is not None:
            ahead = (picture.number - self._newest) % _NUMBERS
            if ahead == 0 or _NUMBERS - ahead <= _LATE:
                return False
            if ahead <= _NUMBERS // 2:
                self._counters.video_lost += ahead - 1
        self._newest = picture.number
        return True

    def _selected(self, received_at: MonoNs) -> bool:
        done_at = self._setup.done_at
        return done_at is not None and seconds_between(done_at, received_at) >= self._o.video_settle_s
