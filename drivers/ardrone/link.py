"""A link to one AR.Drone: navdata, video, commands and configuration, each on its own socket, each restarted alone."""

from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager

from drivers.ardrone.command_channel import CommandChannel
from drivers.ardrone.command_streamer import CommandStreamer
from drivers.ardrone.counters import Counters
from drivers.ardrone.navdata import Navdata
from drivers.ardrone.navdata_channel import NavdataChannel
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.setup import ControlChannel, Setup
from drivers.ardrone.video_channels import UvlcChannel, VideoChannel
from drivers.mailbox import Latest, Line
from drivers.queue_sizes import SAMPLE_QUEUE_ITEMS
from drivers.reconnect import BackOff, reconnect
from drivers.running_beside import running_beside
from estimator.contracts.commands import Command
from estimator.contracts.errors import Recoverable, in_words
from estimator.contracts.pictures import PictureDecoder
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Frame, Sample
from estimator.contracts.time import MonoNs


class ArDrone:
    """An open link: it has `frames` and `samples` and takes a `command`. See `open_ardrone`."""

    def __init__(
        self,
        options: ArDroneOptions,
        clock: Clock,
        sample_queue_items: int = SAMPLE_QUEUE_ITEMS,
        decoder: PictureDecoder | None = None,
    ) -> None:
        self._clock = clock
        self._open = True
        self._released = False
        self.counters = Counters()
        self.frames: Latest[Frame] = Latest()
        """The newest frame of the bottom camera."""
        self.down: dict[str, str] = {}
        """The channels that wait to be started again, each with the reason."""
        self._streamer = CommandStreamer(options, self.counters)
        self._navdata = NavdataChannel(options, clock, self.counters, self._received_at, self._restarted)
        self.samples: Line[Sample] = Line(sample_queue_items, self._navdata.take_waiting)
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
        """Whether the drone has acknowledged its whole configuration, the bottom camera among it."""
        return self._setup.done.is_set()

    @property
    def configuration(self) -> Mapping[str, str]:
        """The configuration that the drone reported last; empty before the first report."""
        return self._control.configuration

    def _received_at(self, navdata: Navdata, samples: list[Sample], received_at: MonoNs) -> None:
        self._streamer.on_navdata(navdata, received_at)
        self._setup.on_state(navdata.state)
        for sample in samples:
            self._streamer.on_sample(sample)
            self.samples.offer(sample)

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
    sample_queue_items: int = SAMPLE_QUEUE_ITEMS,
    decoder: PictureDecoder | None = None,
) -> AsyncIterator[ArDrone]:
    """Open the link and keep it open; it does not wait for the drone (see `ArDrone.ready`).

    A channel that fails for an outside reason is started again alone, with back-off, and counted. An error of this program ends
    the whole link as an `ExceptionGroup`. Leaving the block for any reason commands the drone to hover, or to continue a
    commanded landing. After an error or a cancellation without `ArDrone.release` the sender stays for `hold_s` and holds a flying
    drone for a successor.

    Args:
        sample_queue_items: samples that may wait for a slow reader; the oldest are dropped.
        decoder: of a 1.0's UVLC pictures (`estimator.uvlc.UvlcDecoder`); a 2.0 needs none.

    Raises:
        ValueError: a 1.0 without a decoder.
    """
    drone = ArDrone(options, clock, sample_queue_items, decoder)
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
