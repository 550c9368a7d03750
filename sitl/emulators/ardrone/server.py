"""A simulated AR.Drone behind its four ports, in real time.

The ports count and pass on, the server decides. Nothing a peer sends raises.
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack, suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

from msgspec import Struct

from drivers.clock import SystemClock
from estimator.contracts.errors import Recoverable
from estimator.contracts.geometry import Rotation
from estimator.contracts.time import Clock, MonoNs, after, seconds_between
from sitl.ardrone.drone import TICK_S, Drone, DroneClock, SentFrame
from sitl.ardrone.state import FIRST, SECOND, Generation
from sitl.emulators.ardrone.truth_log import TruthLog
from sitl.emulators.ardrone.wire_pictures import PavePictures, Shot, UvlcPictures, WirePicture
from sitl.faults.faulty_streams import LAG_S, Fate, InTransit
from sitl.world.truth import RenderedFrame
from sitl.world.world import World

Address = tuple[str, int]

LEASE_S = 10.0
"""Time for which a UDP client is served after its last datagram; every client repeats its request when its stream stops."""
_UNICAST = (b"\x01", b"\x01\x00\x00\x00")
"""The datagrams that request a stream."""


class DatagramPort(asyncio.DatagramProtocol):
    """A UDP port: its clients are sent each datagram until they fall silent.

    Args:
        name: the first word of its counters.
        clients_max: the number of clients; a new one takes the place of the one that was silent longest.
        backlog_max: the number of bytes waiting to be sent beyond which a datagram is dropped.
        take: takes what peers send to a port that sends nothing.
    """

    def __init__(
        self,
        name: str,
        now: Callable[[], MonoNs],
        counters: Counter[str],
        clients_max: int = 1,
        backlog_max: int = 0,
        take: Callable[[bytes, Address], None] | None = None,
    ) -> None:
        self._name = name
        self._now = now
        self._counters = counters
        self._clients_max = clients_max
        self._backlog_max = backlog_max
        self._take = take
        self._clients: dict[Address, MonoNs] = {}
        self._transport: Any = None
        # The loops' datagram transports share no class that has all methods used here.

    @property
    def busy(self) -> bool:
        """True if somebody is served."""
        now = self._now()
        for address in [a for a, received_at in self._clients.items() if seconds_between(received_at, now) > LEASE_S]:
            del self._clients[address]
            self._count("client_expired")
        return bool(self._clients)

    async def listen(self, host: str, port: int, stack: AsyncExitStack) -> int:
        """Listen until the stack closes and return the port in use.

        Raises:
            OSError: the port is taken.
        """
        transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(lambda: self, local_addr=(host, port))
        stack.callback(transport.close)
        return int(transport.get_extra_info("sockname")[1])

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Address) -> None:
        if self._take is not None:
            self._take(data, addr)
            return
        if data not in _UNICAST:
            self._count("request_refused")
            return
        self._count("request")
        if self._clients.pop(addr, None) is None:
            self._count("client")
        self._clients[addr] = self._now()
        while len(self._clients) > self._clients_max:
            del self._clients[next(iter(self._clients))]
            self._count("client_replaced")

    def error_received(self, exc: Exception) -> None:
        self._count("socket_error")

    def received_from(self, host: str) -> None:
        """Commands came from this host: its clients live."""
        for address in self._clients:
            if address[0] == host:
                self._clients[address] = self._now()

    def send(self, datagram: bytes) -> None:
        """Send a datagram to every client, or drop it because those before have not left yet."""
        transport = self._transport
        if not self.busy or transport is None or transport.is_closing():
            return
        if transport.get_write_buffer_size() > self._backlog_max:
            self._count("dropped")
            return
        for address in self._clients:
            transport.sendto(datagram, address)
            self._count("sent")

    def _count(self, what: str) -> None:
        self._counters[f"{self._name}_{what}"] += 1


class StreamPort:
    """A TCP port, whose stream goes one way: what a client sends changes nothing.

    Args:
        name: the first word of its counters.
        clients_max: the number of clients. With one, a new client takes the place of the old, lest its own dead connection lock
            somebody out; with several, one too many is refused.
        backlog_max: the number of bytes waiting to be sent to a client beyond which it is sent nothing.
        buffer: bytes that the kernel may hold for a client; None for the system's own limit.
    """

    def __init__(
        self, name: str, counters: Counter[str], clients_max: int = 1, backlog_max: int = 0, buffer: int | None = None
    ) -> None:
        self._name = name
        self._counters = counters
        self._clients_max = clients_max
        self._backlog_max = backlog_max
        self._buffer = buffer
        self._clients: set[asyncio.StreamWriter] = set()
        """A writer that nobody keeps closes its connection."""

    @property
    def busy(self) -> bool:
        """True if somebody is served."""
        return bool(self._clients)

    async def listen(self, host: str, port: int, stack: AsyncExitStack) -> int:
        """Listen until the stack closes and return the port in use.

        Raises:
            OSError: the port is taken.
        """
        server = await asyncio.start_server(self._meet, host, port)
        stack.callback(self.drop)
        stack.callback(server.close)
        return int(server.sockets[0].getsockname()[1])

    def received_from(self, host: str) -> None:
        """Commands came from this host, which keeps no connection open."""

    def send(self, data: bytes) -> None:
        """Hand the data over to every client whose backlog allows it."""
        for writer in self._clients:
            if writer.is_closing():
                continue
            if writer.transport.get_write_buffer_size() > self._backlog_max:
                self._count("dropped")
            else:
                writer.write(data)
                self._count("sent")

    def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> Coroutine[None, None, None] | None:
        if self._buffer is not None:
            raw: socket.socket = writer.get_extra_info("socket")
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, self._buffer)
        if len(self._clients) >= self._clients_max > 1:
            self._count("client_refused")
            writer.transport.abort()
            return None
        if len(self._clients) >= self._clients_max:
            self._count("client_replaced")
            self.drop()
        self._count("client")
        self._clients.add(writer)
        return self._serve(reader, writer)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            with suppress(OSError):
                while await reader.read(4096):
                    pass
        finally:
            self._clients.discard(writer)
            writer.transport.abort()

    def drop(self) -> None:
        """Cut all connections."""
        for writer in self._clients:
            writer.transport.abort()
        self._clients.clear()

    def _count(self, what: str) -> None:
        self._counters[f"{self._name}_{what}"] += 1


DEMO_TICKS = 13
"""Ticks between two datagrams in demo mode and in the bootstrap: 15.4 Hz."""
TRUTH_TICKS = 2
"""Ticks between two true states that are written: 100 Hz, twice the rate of guidance."""
CATCH_UP_MAX_S = 0.25
"""Longest standstill of a host that is caught up.

After a longer one missed datagrams are not sent late; the physics runs up to now.
"""


_BACKLOG_MAX = 1 << 18
"""Bytes that wait for a client that does not read, some hundred datagrams of navdata; further ones are lost."""
_VIDEO_SEND_BUFFER = 1 << 16
"""Bytes the kernel may hold for the video client: about half a second, so that a slow client loses frames, not freshness."""


class Ports(Struct, frozen=True):
    """Ports on which the drone listens; 0 lets the system choose."""

    navdata: int = 5554
    video: int = 5555
    at: int = 5556
    control: int = 5559


class Habits(Struct, frozen=True):
    """The properties that differ from drone to drone."""

    generation: Generation = SECOND
    pave_header_size: int = 68
    """64, 68 or 76 bytes, by firmware."""
    frames_hz: float = 30.0
    """Rate of a 1.0's frames, Hz; clients choose that of a 2.0."""
    uptime_s: float = 90.0
    """Time for which the drone has been running when the server starts, s. Until 65.5 s the time stamps of its video contain
    bytes that ffmpeg, which takes the stream for plain H.264, mistakes for start codes."""
    clock_drift_ppm: float = 15.0
    """A crystal of its own."""
    video_delay_s: float = 0.04
    """Delay from mid-exposure to the frame's first byte: read-out, encoder, radio. A slower host adds its own delay."""
    crf: float = 23.0
    """Quality of the H.264 encoder, x264's scale."""


class ArDroneServer:
    """`async with ArDroneServer(world, host, ports, clock) as server`: flies `world` in real time and answers for it.

    `server.ports` holds the ports in use, `server.drone` what is behind them, `server.counters` what passed. A bug inside takes
    the body of the `async with` down with an ExceptionGroup.

    Raises:
        Recoverable: a port is taken.
        BadInput: the truth log cannot be written.
    """

    def __init__(
        self,
        world: World,
        host: str = "127.0.0.1",
        ports: Ports | None = None,
        clock: Clock | None = None,
        *,
        truth_path: Path | None = None,
        habits: Habits | None = None,
    ) -> None:
        """`world` begins at an instant of `clock`; the truth log then is in this host's monotonic time."""
        self.world = world
        self.host = host
        self.ports = ports or Ports()
        self.counters: Counter[str] = Counter()
        self._clock = clock or SystemClock()
        self._truth_path = truth_path
        self._habits = habits or Habits()
        self._drone_clock = DroneClock(after(world.now, -self._habits.uptime_s), self._habits.clock_drift_ppm)
        self._stack = AsyncExitStack()
        self._truth: TruthLog | None = None
        now, counters = self._clock.now, self.counters
        self._navdata = DatagramPort("navdata", now, counters, clients_max=8, backlog_max=_BACKLOG_MAX)
        first = self._habits.generation is FIRST
        self._video = DatagramPort("video", now, counters) if first else StreamPort("video", counters, buffer=_VIDEO_SEND_BUFFER)
        self._pictures = UvlcPictures() if first else PavePictures(self._habits.pave_header_size, self._habits.crf)
        self._control = StreamPort("control", counters, clients_max=8, backlog_max=_BACKLOG_MAX)
        self._at = DatagramPort("at", now, counters, take=self._take)
        self._ticks = 0
        self.drone = self._new_drone({})
        self._carry(world)
        self.stood_still_s = 0.0
        """Total time in which this host kept the drone from sending; up to `CATCH_UP_MAX_S` at a time is caught up."""
        self.silent = False
        """Send no navdata, as a drone that is switched off."""

    async def __aenter__(self) -> ArDroneServer:
        async with AsyncExitStack() as stack:
            if self._truth_path is not None:
                self._truth = stack.enter_context(TruthLog(self._truth_path))
            await self._listen(stack)
            network = {
                "navdata_port": self.ports.navdata,
                "video_port": self.ports.video,
                "at_port": self.ports.at,
                "cmd_port": self.ports.control,
            }
            self.drone = self._new_drone(network)
            # The first frame takes longest, as textures are made for it: before the drone has to keep time.
            self.world.render()
            pool = stack.enter_context(ThreadPoolExecutor(1, "render"))
            group = await stack.enter_async_context(asyncio.TaskGroup())
            tasks = [group.create_task(self._fly(), name="fly"), group.create_task(self._film(pool), name="film")]
            stack.callback(lambda: [task.cancel() for task in tasks])
            self._stack = stack.pop_all()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, why: BaseException | None, where: TracebackType | None
    ) -> bool | None:
        return await self._stack.__aexit__(kind, why, where)

    def enter(self, world: World) -> None:
        """Go on in another world that nothing has happened in yet; its time begins now. Sockets and configuration stay."""
        world.wait(seconds_between(world.now, self._clock.now()))
        world.begin()
        self.world = world
        self.drone.enter(world)
        self._carry(world)

    def _carry(self, world: World) -> None:
        """Carry the packets of this world's drone."""
        self._sent: InTransit[bytes] = InTransit(world.streams.navdata)
        self._asked: InTransit[tuple[bytes, Address]] = InTransit(world.streams.commands)
        self._filmed: InTransit[bytes] = InTransit(world.streams.frames)

    def _new_drone(self, network: dict[str, int]) -> Drone:
        drone = Drone(self.world, self._drone_clock, network, self._habits.generation)
        drone.state.config.fix("video:camif_fps", f"{self._habits.frames_hz:.0f}")
        return drone

    async def _listen(self, stack: AsyncExitStack) -> None:
        asked = self.ports
        try:
            self.ports = Ports(
                navdata=await self._navdata.listen(self.host, asked.navdata, stack),
                video=await self._video.listen(self.host, asked.video, stack),
                at=await self._at.listen(self.host, asked.at, stack),
                control=await self._control.listen(self.host, asked.control, stack),
            )
        except OSError as why:
            raise Recoverable(f"the simulated drone cannot listen on {self.host}: {os.strerror(why.errno or 0)}") from why

    # Flying

    async def _fly(self) -> None:
        due = self._clock.now()
        while True:
            behind_s = seconds_between(due, self._clock.now())
            if behind_s > CATCH_UP_MAX_S:
                self.counters["stood_still"] += 1
                self.stood_still_s += behind_s
                due = self._clock.now()
            elif behind_s < 0.0:
                await self._clock.sleep(-behind_s)
                continue
            self._tick(due)
            due = after(due, TICK_S)
            # Even when many ticks are due, sockets get their turn between two of them.
            await self._clock.sleep(0.0)

    def _tick(self, at: MonoNs) -> None:
        drone = self.drone
        self._obey()
        drone.tick(at)
        self._ticks += 1
        if not drone.in_demo_mode or self._ticks % DEMO_TICKS == 0:
            now = self._clock.now()
            if self._navdata.busy and not self.silent:
                self._sent.send(self.drone.datagram, now)
            while (packet := self._sent.arrived(now)) is not None:
                self._navdata.send(packet[1])
        if drone.answers and self._control.busy:
            for answer in drone.answers.values():
                self._control.send(answer())
            drone.answers.clear()
        if self._truth is not None and self._ticks % TRUTH_TICKS == 0:
            self._truth.write(self.world.truth())

    def _take(self, data: bytes, sender: Address) -> None:
        self._asked.send(lambda: (data, sender), self._clock.now())
        self._obey()

    def _obey(self) -> None:
        now = self._clock.now()
        while (packet := self._asked.arrived(now)) is not None:
            data, sender = packet[1]
            self.drone.take(data, now)
            self._navdata.received_from(sender[0])
            self._video.received_from(sender[0])

    # Frames

    async def _film(self, pool: ThreadPoolExecutor) -> None:
        loop = asyncio.get_running_loop()
        due = self._clock.now()
        while True:
            await self._clock.sleep(max(0.0, seconds_between(self._clock.now(), due)))
            config = self.drone.state.config
            period_s = 1.0 / config.number(self._habits.generation.frame_rate)
            # A host too slow to render them all films fewer, evenly numbered: only lost frames leave a gap.
            before, due = due, max(after(due, period_s), after(self._clock.now(), -period_s))
            if not self._video.busy or not config.flag("general:video_enable"):
                continue
            fate = self.world.streams.frames.fate()
            if not fate.copies:
                continue
            self.counters["video_due"] += round(seconds_between(before, due) / period_s)
            rpy, altitude_m = self.drone.rpy_rad, self.drone.altitude_m
            keys = {name: config[name] for name in self._habits.generation.film_keys}
            R_ned_body, number = self.world.truth().R_ned_body, self.drone.shot.number + 1
            shoot = partial(self._shoot, self.world.expose(), R_ned_body, number, 1.0 / period_s, keys)
            image, sent, picture = await loop.run_in_executor(pool, shoot)
            self._send_image(image, sent, picture, rpy, altitude_m, fate)

    def _shoot(
        self, expose: Callable[[], RenderedFrame], R_ned_body: Rotation, number: int, fps: float, keys: Mapping[str, str]
    ) -> tuple[RenderedFrame, Shot, WirePicture]:
        """Expose and encode one frame, in the pool's thread. It uses only arguments and what `expose` fixed before."""
        image = expose()
        timestamp_ms = self._drone_clock.milliseconds(after(image.exposed_at, image.stamp_error_s))
        shot = Shot(image.px, R_ned_body, number, timestamp_ms, fps, keys)
        return image, shot, self._pictures.make(shot)

    def _send_image(
        self,
        image: RenderedFrame,
        shot: Shot,
        picture: WirePicture,
        rpy: tuple[float, float, float],
        altitude_m: float,
        fate: Fate,
    ) -> None:
        self.drone.shot = SentFrame(shot.number, shot.timestamp_ms, rpy, altitude_m, picture.payload_bytes, picture.bitrate_kbps)
        now = self._clock.now()
        wait_s = max(0.0, self._habits.video_delay_s - seconds_between(image.exposed_at, now))
        due = self._filmed.put(picture.data, fate, now, wait_s)
        if due is not None:
            for at in (due, after(due, LAG_S)):
                asyncio.get_running_loop().call_later(seconds_between(now, at), self._send_frames, at)

    def _send_frames(self, due: MonoNs) -> None:
        while (packet := self._filmed.arrived(due)) is not None:
            self._video.send(packet[1])
