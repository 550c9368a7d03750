"""A world small enough for protocol tests: a point mass that tilts as it is told, over a still pad. Same doors as `World`."""

import asyncio
import math
import select
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from drivers.ardrone import at, navdata, pave
from drivers.ardrone.navdata import Navdata, NavdataState
from drivers.ardrone.options import ArDroneOptions
from estimator.contracts.geometry import Rotation
from estimator.contracts.time import MonoNs, seconds_between
from sitl.emulators.ardrone.server import Ports
from sitl.faults.fault import Fault, FaultTimer
from sitl.faults.faulty_streams import VehicleStreams
from sitl.scenario.scenario import Scenario
from sitl.sensors.sensors import Readings
from sitl.vehicle.airframe import StickLimits
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.truth import RenderedFrame, Truth
from sitl.world.world import Stick

ASK = b"\x01\x00\x00\x00"


class Peer:
    """Commands on one socket, navdata on another."""

    def __init__(self, host: str, ports: Ports) -> None:
        self.host, self.ports = host, ports
        self.sequence = 0
        self.commands = udp()
        self.navdata = udp()

    def say(self, *commands: at.AtCommand) -> None:
        datagram = b""
        for command in commands:
            self.sequence += 1
            datagram += at.encode(self.sequence, command)
        self.commands.sendto(datagram, (self.host, self.ports.at))

    def ask(self, request: bytes = ASK) -> None:
        self.navdata.sendto(request, (self.host, self.ports.navdata))

    async def on_message(self) -> Navdata:
        loop = asyncio.get_running_loop()
        async with asyncio.timeout(60):
            received_at = navdata.decode(await loop.sock_recv(self.navdata, 4096))
        assert isinstance(received_at, Navdata), received_at
        return received_at

    def waiting(self) -> bool:
        """Return whether a datagram lies in the socket unread."""
        return bool(select.select([self.navdata], [], [], 0)[0])

    async def until(self, done: Callable[[Navdata], bool], timeout_s: float = 60.0) -> Navdata:
        """Return the first datagram that satisfies `done`."""
        async with asyncio.timeout(timeout_s):
            while True:
                received_at = await self.on_message()
                if done(received_at):
                    return received_at

    async def configure(self, key: str, value: str) -> None:
        """Configure the drone with the whole handshake, after a request for navdata."""
        self.say(at.Ctrl(at.CTRL_ACK))
        await self.until(lambda n: not n.state & NavdataState.COMMAND_ACK)
        self.say(at.Config(key, value))
        await self.until(lambda n: bool(n.state & NavdataState.COMMAND_ACK))
        self.say(at.Ctrl(at.CTRL_ACK))
        await self.until(lambda n: not n.state & NavdataState.COMMAND_ACK)

    @asynccontextmanager
    async def talking(self, *commands: at.AtCommand, period_s: float = 0.03) -> AsyncIterator[None]:
        """Say the same again and again, as a client keeps its drone in the air."""

        async def talk() -> None:
            while True:
                self.say(*commands)
                await asyncio.sleep(period_s)

        async with asyncio.TaskGroup() as group:
            task = group.create_task(talk())
            try:
                yield
            finally:
                task.cancel()

    def close(self) -> None:
        self.commands.close()
        self.navdata.close()


class Watcher:
    """A video client on a plain socket."""

    def __init__(self, host: str, ports: Ports, receive_buffer: int | None = None) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if receive_buffer is not None:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self.socket.connect((host, ports.video))
        self.socket.setblocking(False)
        self.parser = pave.PaveParser()
        self._ready: list[pave.PaveFrame] = []

    async def frame(self) -> pave.PaveFrame:
        loop = asyncio.get_running_loop()
        async with asyncio.timeout(60):
            while not self._ready:
                data = await loop.sock_recv(self.socket, 1 << 16)
                if not data:
                    raise EOFError("the drone closed the video connection")
                self._ready = self.parser.feed(data)
        return self._ready.pop(0)

    def close(self) -> None:
        self.socket.close()


def options_for(ports: Ports, **over: Any) -> ArDroneOptions:
    """Return the driver's options that lead to a simulated drone on loopback."""
    found = {f"{name}_port": getattr(ports, name) for name in ("navdata", "video", "at", "control")}
    return ArDroneOptions("127.0.0.1", **(found | over))


def udp() -> socket.socket:
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    s.setblocking(False)
    s.bind(("127.0.0.1", 0))
    return s


G = 9.80665
HOVER_HEIGHT_M = 0.8
CLIMB_M_S, SINK_M_S = 2.0, 2.0
STEERABLE = (VehiclePhase.HOVERING, VehiclePhase.FLYING)


class Failing:
    """The faults that a test has set to be active now."""

    def __init__(self) -> None:
        self.set: list[Fault] = []

    @property
    def now(self) -> list[tuple[Fault, float]]:
        return [(fault, 0.0) for fault in self.set]


class PointMass:
    """Acceleration follows the tilt at once, drag slows it, a hover brakes."""

    def __init__(self, start: MonoNs, height_m: float = 0.0, size: tuple[int, int] = (640, 360)) -> None:
        self.vehicle, self.now, self.started = self, start, start
        self.scenario, self.seed = Scenario("a point mass"), 3
        self.phase = VehiclePhase.HOVERING if height_m else VehiclePhase.LANDED
        self.limits = StickLimits()
        self.failing = Failing()
        self.streams = VehicleStreams(cast(FaultTimer, self.failing), 1)
        self.stamp_error_s = 0.0
        self.p = np.array([0.0, 0.0, -height_m])
        self.v = np.zeros(3)
        self.rpy = [0.0, 0.0, 0.0]
        self._stick = Stick(0.0, 0.0, 0.0, 0.0, False)
        self._rng = np.random.default_rng(self.seed)
        self._texture = (self._rng.random((size[1], size[0], 3)) * 60 + 90).astype(np.uint8)
        self._images = 0

    def stick(self, stick: Stick) -> None:
        self._stick = stick

    def take_off(self) -> None:
        if self.phase is VehiclePhase.LANDED:
            self.phase = VehiclePhase.TAKING_OFF

    def land(self) -> None:
        if self.phase in (VehiclePhase.TAKING_OFF, *STEERABLE):
            self.phase = VehiclePhase.LANDING

    def cut_motors(self) -> None:
        self.phase = VehiclePhase.EMERGENCY

    def leave_emergency(self) -> None:
        if self.phase is VehiclePhase.EMERGENCY and self.p[2] == 0.0:
            self.phase = VehiclePhase.LANDED

    def advance(self, to: MonoNs) -> None:
        dt = seconds_between(self.now, to)
        self.now = to
        stick = self._stick
        if self.phase in STEERABLE:
            self.phase = VehiclePhase.FLYING if stick.progressive else VehiclePhase.HOVERING
        flying = self.phase is VehiclePhase.FLYING
        tilt = self.limits.euler_angle_max_rad
        roll, pitch = (stick.roll * tilt, stick.pitch * tilt) if flying else (0.0, 0.0)
        self.rpy = [roll, pitch, self.rpy[2] + (stick.yaw * self.limits.yaw_rate_max_rad_s * dt if flying else 0.0)]
        c, s = math.cos(self.rpy[2]), math.sin(self.rpy[2])
        ahead, right = -G * math.tan(pitch), G * math.tan(roll)
        drag = 0.4 if flying else 3.0
        self.v[:2] += dt * (np.array([c * ahead - s * right, s * ahead + c * right]) - drag * self.v[:2])
        self.v[2] = {
            VehiclePhase.TAKING_OFF: -CLIMB_M_S,
            VehiclePhase.FLYING: -stick.gaz * self.limits.vz_max_m_s,
            VehiclePhase.LANDING: SINK_M_S,
            VehiclePhase.EMERGENCY: self.v[2] + G * dt,
        }.get(self.phase, 0.0)
        self.p += dt * self.v
        if self.phase is VehiclePhase.TAKING_OFF and -self.p[2] >= HOVER_HEIGHT_M:
            self.phase = VehiclePhase.HOVERING
        if self.p[2] >= 0.0:
            self.p[2], self.v[:] = 0.0, 0.0
            if self.phase is VehiclePhase.LANDING:
                self.phase = VehiclePhase.LANDED

    def readings(self) -> Readings:
        c, s = math.cos(self.rpy[2]), math.sin(self.rpy[2])
        R = Rotation.from_rpy(*self.rpy)
        x, y, z = (R.inv @ np.array([0.0, 0.0, -G])).tolist()
        roll, pitch, yaw = map(float, self.rpy)
        return Readings(
            at=self.now,
            f_body=(x, y, z),
            w_body=(0.01, -0.02, 0.03),
            rpy_rad=(roll, pitch, yaw),
            v_level_m_s=(float(c * self.v[0] + s * self.v[1]), float(c * self.v[1] - s * self.v[0])),
            ultrasound_m=float(-self.p[2]) / (math.cos(self.rpy[0]) * math.cos(self.rpy[1])) if self.p[2] < -0.2 else None,
            pressure_pa=101_325.0 + 12.0 * float(self.p[2]),
            temperature_c=43.5,
            magnetometer=(210e-7, -15e-7, 430e-7),
            battery_fraction=0.5,
            motors_pwm=(170, 171, 172, 173) if self.phase is not VehiclePhase.LANDED else (0, 0, 0, 0),
        )

    def render(self) -> RenderedFrame:
        return self.expose()()

    def expose(self) -> Callable[[], RenderedFrame]:
        self._images += 1
        px: NDArray[np.uint8] = np.roll(self._texture, 3 * self._images, axis=1)
        image = RenderedFrame(px=px, exposed_at=self.now, exposure_s=0.002, stamp_error_s=self.stamp_error_s)
        return lambda: image

    def truth(self) -> Truth:
        return Truth(
            at=self.now,
            p_body_ned=self.p.copy(),
            v_body_ned=self.v.copy(),
            R_ned_body=Rotation.from_rpy(*self.rpy),
            p_pad_ned=np.zeros(3),
            v_pad_ned=np.zeros(3),
            R_ned_pad=Rotation.identity(),
            phase=self.phase,
            touchdown=None,
        )
