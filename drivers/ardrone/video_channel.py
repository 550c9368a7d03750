"""The video channel turns TCP bytes into frames: they are decoded in one worker thread, in order, and only the newest is kept."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor

from drivers.ardrone.counters import Counters
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.pave import PaveFrame, PaveParser
from drivers.ardrone.setup import Setup
from drivers.ardrone.video import VideoDecoder, new_codec
from drivers.clock_map import ClockMap, ClockMapOptions
from drivers.mailbox import Latest
from estimator.contracts.errors import Recoverable
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp, seconds_between

_READ = 1 << 16
_MS = 1_000_000


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
