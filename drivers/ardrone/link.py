"""A link to one AR.Drone: navdata, video, commands and configuration, each on its own socket, each restarted alone.

Of video only the newest frame is kept, and one worker thread decodes in order. A 2.0 sends H.264 by TCP. A 1.0 sends one UVLC
picture a datagram to the last peer that sent a datagram; a picture carries the drone's count of pictures and no time, so its
frame is stamped by its arrival.
"""

import asyncio
import math
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager

from msgspec.structs import replace

from drivers.ardrone.command_channel import CommandChannel
from drivers.ardrone.counters import Counters
from drivers.ardrone.custody import CommandStreamer
from drivers.ardrone.navdata import Navdata
from drivers.ardrone.navdata_channel import NavdataChannel
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.pave import PaveParser, VideoDecoder, unit_decoder
from drivers.ardrone.setup import ControlChannel, Setup
from drivers.clock_map import ClockMap, ClockMapOptions
from drivers.datagrams import open_waiting
from drivers.mailbox import Latest, Line
from drivers.reconnect import BackOff, reconnect, running_beside
from estimator.contracts.commands import Command
from estimator.contracts.errors import Recoverable, in_words
from estimator.contracts.pictures import CodedPicture, PictureDecoder, PictureRefusal
from estimator.contracts.samples import SAMPLE_QUEUE_ITEMS, Frame, Sample, VehicleStatus
from estimator.contracts.time import Clock, MonoNs, Stamp, after, seconds_between

_READ = 1 << 16  # bytes of the video stream that are read at once
_MS = 1_000_000  # nanoseconds of a millisecond, the unit of the stream's timestamps
OPENING = b"\x01\x00\x00\x00"
"""The datagram that requests the video; it is sent again when there is none."""
P264 = (
    "the drone sends pictures that build on earlier ones, which only its codec P264 does: "
    'set video:video_codec to 32 (UVLC), as vehicle.model = "1.0" does, and end whatever else configures the drone'
)
_NUMBERS = 1 << 32  # frame numbers are counted modulo this number
_LATE = 64
"""A picture that is up to this many counts older than the newest one arrived late; one that is older comes from a drone that has
restarted."""


class _Video:
    """Puts the frames of one video into `frames`, once the bottom camera is known to be selected."""

    def __init__(self, options: ArDroneOptions, clock: Clock, counters: Counters, setup: Setup, frames: Latest[Frame]) -> None:
        self._o = options
        self._clock = clock
        self._counters = counters
        self._setup = setup
        self._frames = frames

    def _selected(self, received_at: MonoNs) -> bool:
        """Return whether the bottom camera was selected when this arrived; count what came before."""
        done_at = self._setup.done_at
        selected = done_at is not None and seconds_between(done_at, received_at) >= self._o.video_settle_s
        self._counters.frames_before_setup += not selected
        return selected

    def _give(self, frame: Frame) -> None:
        self._counters.frames += 1
        self._counters.frames_replaced += self._frames.offer(frame) is not None


class VideoChannel(_Video):
    """The H.264 video of a 2.0."""

    def __init__(self, options: ArDroneOptions, clock: Clock, counters: Counters, setup: Setup, frames: Latest[Frame]) -> None:
        super().__init__(options, clock, counters, setup, frames)
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
            pool.submit(unit_decoder)
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
        if not batch:
            return
        arrived = [began if carried else now, *(now for _ in batch[1:])]
        stamps = [self._map.stamp(unit.header.timestamp_ms * _MS, at) for unit, at in zip(batch, arrived, strict=True)]
        image = await asyncio.get_running_loop().run_in_executor(pool, self._decoder.newest, batch)
        if image is None:
            return
        stamp = stamps[image.index]
        if self._selected(stamp.received_at):
            number = batch[image.index].header.frame_number
            self._give(Frame(stamp, number, image.px, self._o.exposure_s, coded=True))


class UvlcChannel(_Video):
    """The UVLC video of a 1.0."""

    def __init__(
        self,
        options: ArDroneOptions,
        clock: Clock,
        counters: Counters,
        setup: Setup,
        frames: Latest[Frame],
        decoder: PictureDecoder,
    ) -> None:
        super().__init__(options, clock, counters, setup, frames)
        self._decoder = decoder
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
            arrived.offer((datagram, received_at))

        with ThreadPoolExecutor(1, "ardrone-video") as pool:
            async with open_waiting(self._o.host, self._o.video_port, self._clock, received, at_once=True) as socket:
                found = self._clock.now()
                socket.send(OPENING)
                while True:
                    try:
                        async with asyncio.timeout(self._o.video_silence_s / 4):
                            datagram, received_at = await arrived.get()
                    except TimeoutError as why:
                        if seconds_between(found, self._clock.now()) >= self._o.video_silence_s:
                            raise Recoverable(f"no video for {self._o.video_silence_s} s") from why
                        socket.send(OPENING)
                        continue
                    found = received_at
                    await self._take(datagram, received_at, pool)

    async def _take(self, datagram: bytes, received_at: MonoNs, pool: ThreadPoolExecutor) -> None:
        picture = self._decoder.header(datagram)
        if not self._selected(received_at):
            return  # a drone that is not configured yet sends what its last client wanted: the other camera, or P264
        if isinstance(picture, PictureRefusal):
            self._refuse(picture)
            return
        px = await asyncio.get_running_loop().run_in_executor(pool, self._decoder.decode, datagram, picture)
        if isinstance(px, PictureRefusal):
            self._refuse(px)
            return
        if not self._in_order(picture):
            return
        stamp = Stamp(after(received_at, -self._o.video_delay_s), received_at, self._sigma_s, "arrival")
        self._give(Frame(stamp, picture.number, px, self._o.exposure_s))

    def _refuse(self, why: PictureRefusal) -> None:
        self._counters.video_refused[why.value] += 1
        if why is PictureRefusal.INTER_PICTURE:
            raise Recoverable(P264)

    def _in_order(self, picture: CodedPicture) -> bool:
        if self._newest is not None:
            ahead = (picture.number - self._newest) % _NUMBERS
            if ahead == 0 or _NUMBERS - ahead <= _LATE:
                return False
        self._newest = picture.number
        return True


class ArDrone:
    """An open link: it has `frames` and `samples` and takes a `command`. See `open_ardrone`."""

    def __init__(
        self,
        options: ArDroneOptions,
        clock: Clock,
        decoder: PictureDecoder | None = None,
        failed: Callable[[str, BaseException], None] = lambda name, why: None,
    ) -> None:
        self._clock = clock
        self._failed = failed
        self._open = True
        self._released = False
        self.counters = Counters()
        self.frames: Latest[Frame] = Latest()
        """The newest frame of the bottom camera."""
        self.down: dict[str, str] = {}
        """The channels that wait to be started again, each with the reason."""
        self._streamer = CommandStreamer(options)
        self._navdata = NavdataChannel(options, clock, self.counters, self._received_at, self._restarted)
        self.samples: Line[Sample] = Line(SAMPLE_QUEUE_ITEMS, self._navdata.take_waiting)
        self._commands = CommandChannel(options, clock, self.counters, self._streamer, self._navdata)
        self._setup = Setup(options, clock, self.counters, self._commands, self._navdata)
        self._control = ControlChannel(options, self.counters, self._commands, self._setup)
        self._video = self._video_channel(options, decoder)

    def _video_channel(self, options: ArDroneOptions, decoder: PictureDecoder | None) -> VideoChannel | UvlcChannel:
        if options.model == "2.0":
            return VideoChannel(options, self._clock, self.counters, self._setup, self.frames)
        if decoder is None:
            raise ValueError("the video of an AR.Drone 1.0 needs a decoder")
        return UvlcChannel(options, self._clock, self.counters, self._setup, self.frames, decoder)

    def command(self, command: Command) -> None:
        """Take the newest command; it is sent within one period and held as `CommandStreamer` says.

        Raises:
            Recoverable: the link was closed.
        """
        if not self._open:
            raise Recoverable("the link to the AR.Drone is closed")
        self._streamer.take(command, self._clock.now())

    def release(self) -> None:
        """Leave the drone in its own hover on closing, instead of holding it for a successor: the service ends on purpose."""
        self._released = True

    @property
    def navdata(self) -> Navdata | None:
        """The newest navdata datagram."""
        return self._navdata.newest

    @property
    def ready(self) -> bool:
        """True if the drone has acknowledged its whole configuration, the bottom camera among it."""
        return self._setup.done.is_set()

    @property
    def configuration(self) -> Mapping[str, str]:
        """The configuration that the drone reported last; empty before the first report."""
        return self._control.configuration

    def _received_at(self, navdata: Navdata, samples: list[Sample], received_at: MonoNs) -> None:
        self._streamer.on_navdata(navdata, received_at)
        self._setup.on_state(navdata.state)
        others_at = self._streamer.others_at
        samples = [replace(s, others_at=others_at) if type(s) is VehicleStatus else s for s in samples]
        for sample in samples:
            self._streamer.on_sample(sample)
        self.samples.offer_all(samples)

    def _restarted(self) -> None:
        self._video.restarted()
        self._setup.restart()

    @property
    def sender_pid(self) -> int | None:
        """The id of the process that sends the commands, None while there is none."""
        return self._commands.sender_pid

    async def _keep_open(self, name: str, body: Callable[[], Awaitable[None]], back_off: BackOff) -> None:
        async def attempt() -> None:
            self.down.pop(name, None)
            await body()
            raise Recoverable("ended by itself")

        def on_failure(why: BaseException) -> None:
            self.counters.restarts[name] += 1
            self.down[name] = in_words(why)
            self._failed(f"AR.Drone {name}", why)

        await reconnect(f"AR.Drone {name}", attempt, back_off, self._clock, on_failure)

    def _close(self, *, hold: bool) -> None:
        self._open = False
        self._commands.close(hold=hold and not self._released)
        closed = Recoverable("the link to the AR.Drone is closed")
        self.frames.fail(closed)
        self.samples.fail(closed)


@asynccontextmanager
async def open_ardrone(
    options: ArDroneOptions,
    clock: Clock,
    decoder: PictureDecoder | None = None,
    failed: Callable[[str, BaseException], None] = lambda name, why: None,
) -> AsyncIterator[ArDrone]:
    """Open the link and keep it open; it does not wait for the drone (see `ArDrone.ready`).

    A channel that fails for an outside reason is started again alone, with back-off, and counted. An error of this program ends
    the whole link as an `ExceptionGroup`. Leaving the block for any reason commands the drone to hover, or to continue a
    commanded landing. After an error or a cancellation without `ArDrone.release` the sender stays for `hold_s` and holds a flying
    drone for a successor.

    Args:
        decoder: of a 1.0's UVLC pictures (`estimator.uvlc.UvlcDecoder`); a 2.0 needs none.
        failed: called with each failure of a channel, and the channel's name.

    Raises:
        ValueError: a 1.0 without a decoder.
    """
    drone = ArDrone(options, clock, decoder, failed)
    back_off = BackOff(options.restart_first_s, options.restart_most_s, healthy_after_s=options.restart_most_s)
    # Without commands a flying drone lands by itself, so that socket is never left closed for long.
    fast_most_s = min(options.restart_most_s, 8 * options.command_period_s)
    fast_back_off = BackOff(options.command_period_s, fast_most_s, healthy_after_s=fast_most_s)
    channels = {
        "at": (drone._commands.run, fast_back_off),
        "navdata": (drone._navdata.run, back_off),
        "setup": (drone._setup.run, back_off),
        "control": (drone._control.run, back_off),
        "video": (drone._video.run, back_off),
    }
    tasks = [(f"ardrone-{name}", drone._keep_open(name, body, wait)) for name, (body, wait) in channels.items()]
    async with running_beside(tasks):
        hold = True
        try:
            yield drone
            hold = False
        finally:
            drone._close(hold=hold)
