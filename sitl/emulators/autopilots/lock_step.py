"""The daemon's clock, its camera and its links in lock step: the physics advances them.

However slow the machine is, every part sees the same time as the autopilot. Frames are rendered and processed while the simulated
world stands still. A relay passes the datagrams between an autopilot program and the daemon, with the faults of the scenario: a
datagram that is lost, late, doubled or overtaken meets the daemon's own link.
"""

import asyncio
import heapq
import itertools
from collections import Counter
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Executor
from contextlib import asynccontextmanager
from typing import Any, Generic, TypeVar

from msgspec import Struct

from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message
from estimator.contracts.errors import SetupImpossible
from estimator.contracts.samples import Frame
from estimator.contracts.time import Clock, MonoNs, Stamp, after
from sitl.emulators.autopilots.body import Body
from sitl.faults.faulty_streams import FaultyStream, InTransit, VehicleStreams
from sitl.world.truth import RenderedFrame

START = MonoNs(1_000_000_000_000)
"""First instant of a flight; it is not zero, so that it differs from the autopilot's time since boot."""
_ROUNDS = 4
"""Passes of the event loop after a step, enough for a message to go from socket to link to reader to part."""


class LockStepClock:
    """A `Clock` that stands still until it is advanced.

    Args:
        start: its first instant.
    """

    def __init__(self, start: MonoNs = START) -> None:
        self.started = self._now = start
        self._sleepers: list[tuple[int, int, asyncio.Future[None]]] = []
        self._order = itertools.count()

    def now(self) -> MonoNs:
        return self._now

    async def sleep(self, seconds: float) -> None:
        sleeper = asyncio.get_running_loop().create_future()
        heapq.heappush(self._sleepers, (after(self._now, max(seconds, 1e-6)), next(self._order), sleeper))
        await sleeper

    def advance(self, seconds: float) -> None:
        """Advance the time and wake the tasks whose time has come."""
        self._now = after(self._now, seconds)
        while self._sleepers and self._sleepers[0][0] <= self._now:
            sleeper = heapq.heappop(self._sleepers)[2]
            if not sleeper.done():
                sleeper.set_result(None)

    @staticmethod
    async def settle() -> None:
        """Let the woken tasks run."""
        for _ in range(_ROUNDS):
            await asyncio.sleep(0)


STAMP_SIGMA_S = 0.002
"""Standard deviation of a frame's stamp, s."""
_NAP_S = 0.0005
"""Pause between two looks whether vision's thread is done, well below the time of one frame."""
_TURNS = 40
"""Turns of the event loop after which a service that has a frame and does not look at it waits for the time to go on."""


class CameraTiming(Struct, frozen=True):
    """Delays of frames in the flight's own time."""

    period_s: float = 1.0 / 30.0
    delay_s: float = 0.05
    """Delay from mid-exposure to the frame's arrival, s: half the exposure, read-out and driver of a camera on a short cable."""
    vision_s: float = 0.03
    """Time that vision takes in the flight, s; the world waits for a slower machine."""


class LockStepCamera:
    """Takes frames of a body's deck while it is `on`.

    Args:
        offer: receives each frame when it has arrived.
        concluded: returns how many of the frames were processed.
        looking: returns whether vision is at work; the world stands still meanwhile, however long it takes.
        pool: executor that renders frames.
        stream: what becomes of the frames on their way.
        expose: fixes the scene of a body and returns the function that makes its frame.
    """

    def __init__(
        self,
        clock: LockStepClock,
        offer: Callable[[Frame], object],
        concluded: Callable[[], int],
        looking: Callable[[], bool],
        pool: Executor,
        stream: FaultyStream,
        timing: CameraTiming | None = None,
        expose: Callable[[Body], Callable[[], RenderedFrame]] = Body.expose,
    ) -> None:
        self.on = False
        self.frames = self.exposures = 0
        self.waited_out = 0
        """Number of times that the world went on although a frame was not processed, because the service waits for the time."""
        self._clock, self._offer, self._pool = clock, offer, pool
        self._concluded, self._looking = concluded, looking
        self._timing, self._expose = timing or CameraTiming(), expose
        self.shown: Callable[[int, RenderedFrame], None] = lambda number, view: None
        """Receives the number of each frame that has arrived, and what it truly shows."""
        self._due: MonoNs | None = None
        self._on_the_way: InTransit[asyncio.Future[RenderedFrame]] = InTransit(stream)
        self._looking_until: MonoNs | None = None

    @property
    def period_s(self) -> float:
        """Time between two frames, s."""
        return self._timing.period_s

    def stepped(self, body: Body) -> None:
        """Note a step of the physics; call it after each one."""
        now = self._clock.now()
        if not self.on or (self._due is not None and now < self._due):
            return
        self._due = after(self._due or now, self._timing.period_s)
        self.exposures += 1

        def exposed() -> asyncio.Future[RenderedFrame]:
            return asyncio.get_running_loop().run_in_executor(self._pool, self._expose(body))

        self._on_the_way.send(exposed, now, self._timing.delay_s)

    async def settle(self) -> None:
        """Wait until every due frame has arrived and every frame due to be processed was processed."""
        now = self._clock.now()
        while (arrived := self._on_the_way.arrived(now)) is not None:
            image = await arrived[1]
            self.frames += 1
            self.shown(self.frames, image)
            claimed_at = after(image.exposed_at, image.stamp_error_s)
            stamp = Stamp(claimed_at, max(claimed_at, now), STAMP_SIGMA_S, "sim")
            self._offer(Frame(stamp, self.frames, image.px, image.exposure_s, image.gain))
            self._looking_until = after(now, self._timing.vision_s)
        if self._looking_until is None or now < self._looking_until:
            return
        turns = 0
        while self._concluded() < self.frames:
            if self._looking():
                turns = 0
                await asyncio.sleep(_NAP_S)
                continue
            turns += 1
            if turns > _TURNS:
                self.waited_out += 1
                return
            await asyncio.sleep(0)
        self._looking_until = None


_Address = tuple[str, int]


_Packet = TypeVar("_Packet")


class FaultyLink(Generic[_Packet]):
    """The packets under way in both directions: datagrams, or messages where nothing reads bytes.

    Args:
        streams: what becomes of the vehicle's samples and of the service's commands.
        sent: receives each packet that the service sends.
        arrived: receives each packet that reaches the service.
        changed: returns a packet of the vehicle as it leaves it.
        ordered: returns a packet of the service as it reaches the vehicle.
    """

    def __init__(
        self,
        streams: VehicleStreams,
        clock: Clock,
        sent: Callable[[_Packet], None],
        arrived: Callable[[_Packet], None],
        changed: Callable[[_Packet], _Packet],
        ordered: Callable[[_Packet], _Packet],
    ) -> None:
        self._clock, self._sent, self._arrived, self._changed, self._ordered = clock, sent, arrived, changed, ordered
        self._samples: InTransit[_Packet] = InTransit(streams.navdata)
        self._commands: InTransit[_Packet] = InTransit(streams.commands)
        self.to_daemon: Callable[[_Packet], None] | None = None
        """Takes what arrives at the service; None while nothing does. Likewise for the vehicle."""
        self.to_program: Callable[[_Packet], None] | None = None
        self.cut = False
        """True while no service is there: messages under way are lost."""
        self.muted = False
        """True while nothing of the daemon's passes, although it receives the program."""
        self.ahead_s: Callable[[_Packet], float] = lambda packet: 0.0
        """Returns how far the program was ahead of the flight when it sent a packet, s: it arrives that much later."""
        self.carried: Counter[str] = Counter()
        """Packets that came in and that went on: "samples in", "samples out", "commands in", "commands out"."""

    def deliver(self) -> None:
        """Hand on what has arrived by now; call it after each step of the physics."""
        now = self._clock.now()
        for name, stream, send in (
            ("samples out", self._samples, self.to_daemon),
            ("commands out", self._commands, self.to_program),
        ):
            while send is not None and (packet := stream.arrived(now)) is not None:
                if not self.cut:
                    self.carried[name] += 1
                    if stream is self._samples:
                        self._arrived(packet[1])
                    send(packet[1])

    def from_program(self, packet: _Packet) -> None:
        """Take a packet of the program."""
        self.carried["samples in"] += 1
        ahead_s, reported = self.ahead_s(packet), self._changed(packet)
        self._samples.send(lambda: reported, self._clock.now(), ahead_s)
        self.deliver()

    def from_daemon(self, packet: _Packet) -> None:
        """Take a packet of the daemon."""
        if self.cut or self.muted:
            return
        self.carried["commands in"] += 1
        self._sent(packet)
        ordered = self._ordered(packet)
        self._commands.send(lambda: ordered, self._clock.now())
        self.deliver()


class FaultyRelay(FaultyLink[bytes]):
    """A relay of datagrams between an autopilot program and the daemon.

    Args:
        streams: what becomes of the vehicle's samples and of the service's commands.
        sent: receives each message that the service sends.
        arrived: receives each message that reaches the service.
        changed: returns a datagram of the vehicle as it leaves it.
        ordered: returns a datagram of the service as it reaches the vehicle.
    """

    def __init__(
        self,
        streams: VehicleStreams,
        clock: Clock,
        sent: Callable[[Message], None] = lambda message: None,
        arrived: Callable[[Message], None] = lambda message: None,
        changed: Callable[[bytes], bytes] = lambda data: data,
        ordered: Callable[[bytes], bytes] = lambda data: data,
    ) -> None:
        def reader(on_message: Callable[[Message], None]) -> Callable[[bytes], None]:
            codec = Codec(0, 0, datagrams=True)

            def read(data: bytes) -> None:
                for message in codec.feed(data):
                    on_message(message)

            return read

        super().__init__(streams, clock, reader(sent), reader(arrived), changed, ordered)

    @asynccontextmanager
    async def relaying(self, host: str, program_port: int, daemon_port: int) -> AsyncIterator[None]:
        """Relay between `program_port`, to which the program sends, and the daemon at `daemon_port`, until the context ends.

        Raises:
            SetupImpossible: the program's port is in use.
        """
        loop = asyncio.get_running_loop()
        try:
            near, program = await loop.create_datagram_endpoint(lambda: _End(self.from_program), local_addr=(host, program_port))
        except OSError as why:
            raise SetupImpossible(
                f"the autopilot sends to {host}:{program_port}, which is taken: another flight or simulator runs there"
            ) from why
        try:
            far, _ = await loop.create_datagram_endpoint(
                lambda: _End(self.from_daemon), local_addr=(host, 0), remote_addr=(host, daemon_port)
            )
            try:
                self.to_daemon = far.sendto
                self.to_program = lambda data: None if program.peer is None else near.sendto(data, program.peer)
                yield
            finally:
                self.to_daemon = self.to_program = None
                far.close()
        finally:
            near.close()


class _End(asyncio.DatagramProtocol):
    """One socket of the relay; it remembers who spoke last."""

    def __init__(self, take: Callable[[bytes], None]) -> None:
        self._take = take
        self.peer: _Address | None = None

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self.peer = addr
        self._take(data)
