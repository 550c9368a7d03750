"""The component on the links of an autopilot in miniature, with a pad that stands still under it."""

import asyncio
import math
import socket
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from hypothesis import strategies as st

import companion.settings.load as settings_of
from companion.base.health import Health
from companion.base.observer import Decision
from companion.parts.mavlink.bridge.part import VehicleBridge
from companion.parts.mavlink.component import PARAMETERS, Component, speaking
from companion.parts.mavlink.outputs import Outputs
from companion.parts.mavlink.parameters import Tunables
from companion.settings.links import OutputOptions
from companion.settings.model import Settings
from drivers.mavlink.autopilot import Autopilot, open_autopilot
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.estimates import IntegrityAlert, RelativeState
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Range
from estimator.contracts.time import MonoNs, seconds_between
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.support.clocks import PatientClock
from tests.support.fake_operator import FakeOperator
from tests.support.waiting import until

AUTOPILOT, US, STATION = (7, 1), (7, 191), (255, 190)
_RANGES = {f"{sign}int{bits}_t": (0, 2**bits - 1) if sign else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
           for bits in (8, 16, 32, 64) for sign in ("u", "")}  # fmt: skip
_FLOATS = [0.0, -0.0, 1.0, -1.0, 0.5, 1e-40, 1e6, -1e6, 1e38, -1e38, math.inf, -math.inf, math.nan]
_COMMANDS = [21, 22, 17, 176, 191, 193, 400, 510, 511, 512, 2510, 2511]
_MESSAGES = [0.0, 1.0, 2.0, 148.0, 251.0, 390.0, 396.0, 65535.0, 65536.0]
NAMED: dict[str, st.SearchStrategy[Any]] = {
    "target_system": st.sampled_from([0, 7, 255]),
    "target_component": st.sampled_from([0, 1, 191]),
    "command": st.sampled_from(_COMMANDS) | st.integers(0, 65535),
    "param1": st.sampled_from(_MESSAGES + _FLOATS),
    "param2": st.sampled_from(_FLOATS),
    "param_id": st.sampled_from([b"PLND_LAG", b"PID_H_KP", b"RNGFND1_TYPE", b"\xff" * 16]) | st.binary(min_size=16, max_size=16),
    "param_type": st.sampled_from([0, 1, 3, 5, 6, 9, 10, 255]),
    "orientation": st.sampled_from([0, 25, 255]),
}
"""Fields whose values our handlers look at: mostly values that they would take."""


def wire_frame(cls: Any, payload: bytes, source: tuple[int, int] = AUTOPILOT, sequence: int = 0) -> bytes:
    """Return a MAVLink 2 frame with this payload and the right checksum."""
    header = struct.pack("<BBBBBBB", len(payload), 0, 0, sequence, *source, cls.id & 0xFF) + struct.pack("<H", cls.id >> 8)
    crc = mav.x25crc(header + payload + bytes([cls.crc_extra]))
    return b"\xfd" + header + payload + struct.pack("<H", crc.crc)


def _values(kind: str, name: str) -> st.SearchStrategy[Any]:
    if kind == "char":
        return NAMED.get(name, st.binary(max_size=50))
    if kind in ("float", "double"):
        return NAMED.get(name, st.sampled_from(_FLOATS) | st.floats(width=32))
    low, high = _RANGES[kind]
    return NAMED.get(name, st.sampled_from([0, 1, high, low, high // 2]) | st.integers(low, high))


@st.composite
def messages(draw: st.DrawFn, cls: Any | None = None) -> bytes:
    """Any message of the dialect with any fields, from the autopilot or from others behind it."""
    chosen = draw(st.sampled_from(list(mav.mavlink_map.values()))) if cls is None else cls
    kinds = dict(zip(chosen.fieldnames, chosen.fieldtypes, strict=True))
    flat: list[Any] = []
    for name, length in zip(chosen.ordered_fieldnames, chosen.array_lengths, strict=True):
        kind = kinds[name]
        count = length if length and kind != "char" else 1
        flat += [draw(_values(kind, name)) for _ in range(min(count, 4))] + [0] * (count - 4)
    payload = chosen.unpacker.pack(*flat)
    return wire_frame(chosen, payload, draw(st.sampled_from([AUTOPILOT, AUTOPILOT, STATION, (0, 0), (17, 1)])))


class Border:
    """The service's MAVLink side: autopilot, component and bridge behind one listening socket.

    Attributes:
        wire: the autopilot's socket.
    """

    def __init__(
        self, autopilot: Autopilot, component: Component, bridge: VehicleBridge, tower: FakeOperator, clock: PatientClock
    ) -> None:
        self.autopilot, self.component, self.bridge, self.tower = autopilot, component, bridge, tower
        self.clock = clock
        self.links = autopilot.links
        self.wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.wire.setblocking(False)
        self.codec = Codec(*AUTOPILOT, datagrams=True)

    async def throw(self, *data: bytes, wire: socket.socket | None = None, link: int = 0) -> None:
        """Send datagrams to a link, and wait until all of them have been handled."""
        counters = self.links.all[link].counters
        address = self.links.all[link].local
        for one in data:
            expected = counters.bytes_in + len(one)
            (wire or self.wire).sendto(one, address)
            while counters.bytes_in < expected or len(self.links.received):  # noqa: ASYNC110 - no event tells of bytes
                await asyncio.sleep(0)
        await asyncio.sleep(0)

    async def send(
        self, *messages: Message, wire: socket.socket | None = None, source: tuple[int, int] = AUTOPILOT, link: int = 0
    ) -> None:
        """Throw messages as `source`."""
        codec = self.codec if source == AUTOPILOT else Codec(*source)
        await self.throw(*(codec.pack(m) for m in messages), wire=wire, link=link)

    def answers(self, wire: socket.socket | None = None) -> list[Message]:
        """Everything that came back to a socket."""
        out: list[Message] = []
        reader = Codec(1, 1, datagrams=True)
        while True:
            try:
                out += reader.feed((wire or self.wire).recv(2048))
            except BlockingIOError:
                return out

    async def alive(self) -> None:
        """Fail unless the service answers a command as it should, and no handler raised."""
        assert dict(self.links.contained.faults) == {}
        assert dict(self.links.unfit) == {}
        await self.send(mav.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
        self.answers()
        await self.send(mav.MAVLink_command_long_message(*US, 512, 0, 396, 0, 0, 0, 0, 0, 0))
        answered: list[str] = []

        def both() -> bool:
            answered.extend(m.get_type() for m in self.answers())
            return {"COMMAND_ACK", "COMPONENT_INFORMATION_BASIC"} <= set(answered)

        await until(both)

    async def told_of_the_pad(self) -> None:
        """Fail unless an autopilot that flies and tells its attitude is sent LANDING_TARGETs, whatever it said before."""
        flies = mav.MAVLink_extended_sys_state_message(0, mav.MAV_LANDED_STATE_IN_AIR)
        clock, got = self.clock, set[str]()
        began = clock.now()
        # What two autopilots with one id seem to have said counts for some seconds.
        while "LANDING_TARGET" not in got:
            assert seconds_between(began, clock.now()) < 20.0, f"no target: {self.component.outputs.withheld}"
            # The autopilot's clock runs as fast as ours, however seldom a busy machine lets it speak.
            boot_ms = 20_000 + round(1000 * seconds_between(began, clock.now()))
            level = mav.MAVLink_attitude_quaternion_message(boot_ms, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            await self.send(mav.MAVLink_heartbeat_message(2, 3, 128, 0, 4, 3), flies, level)
            await asyncio.sleep(0.02)
            got |= {m.get_type() for m in self.answers()}


@asynccontextmanager
async def bordered(*more_links: str, clock: PatientClock | None = None, **options: Any) -> AsyncIterator[Border]:
    """Yield the service's MAVLink side with its autopilot found on the first of its links."""
    clock, tower = clock or PatientClock(), FakeOperator()
    pad = np.array([0.3, -0.2, 4.0])

    def believe(now: MonoNs) -> RelativeState:
        return RelativeState(now, "dead_reckoning", pad, np.zeros(3), 0.2, np.eye(7) * 1e-4, now, True)

    component = Component(
        Outputs(OutputOptions(), 0.39, 0.5),
        tower,
        Tunables(settings_of.load("sim"), lambda settings: None),
        believe=believe,
        clock=clock,
        health=Health(clock),
    )
    given = AutopilotOptions(", ".join((f"udpin://{HOST}:0", *more_links)), vessel_id=17, **options)
    async with open_autopilot(given, clock, parameters=("PLND_LAG",)) as autopilot:
        await until(lambda: autopilot.links.all[0].local is not None)
        bridge = VehicleBridge(autopilot.links.send, lambda command: None, str)
        autopilot.add_listener(lambda received: bridge.on_message(received, AUTOPILOT[0], clock.now()))
        border = Border(autopilot, component, bridge, tower, clock)

        async def pump() -> None:
            async for sample in autopilot.samples:
                autopilot.links.contained.run("the test's pump", "", partial(component.on_sample, sample))

        async with speaking(component, autopilot, clock), asyncio.TaskGroup() as group:
            pumping = group.create_task(pump())
            await border.send(mav.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
            await until(lambda: autopilot.connected)
            yield border
            pumping.cancel()
        border.wire.close()


HOST = "127.0.0.1"
PAD_NED = np.array([1.5, -0.8, 0.0])


@dataclass
class Stage:
    """Everything of one test."""

    component: Component
    autopilot: Autopilot
    fake: MiniatureAutopilot
    tower: FakeOperator
    health: Health
    applied: list[Settings] = field(default_factory=list)
    seen: bool = True
    alerts: tuple[IntegrityAlert, ...] = ()
    lost: tuple[str, ...] = ()
    deciding: bool = True
    phase: str = "approach"
    ranges: int = 0
    """Measured distances that came from the autopilot."""

    def believe(self, now: MonoNs) -> RelativeState | None:
        """Return the truth, as long as it is `seen`."""
        attitude = self.autopilot.attitude
        if not self.seen or attitude is None:
            return None
        to_level = Rotation.from_rpy(0.0, 0.0, attitude.R_ned_body.rpy_rad[2]).inv
        d, v = to_level @ (PAD_NED - self.fake.p_ned), to_level @ -self.fake.v_ned
        return RelativeState(
            now, "dead_reckoning", d, v, 0.2, np.eye(7) * 1e-4, now, not self.alerts, alerts=self.alerts, lost=self.lost
        )


@asynccontextmanager
async def staged(
    fake: MiniatureAutopilot, *more_links: str, outputs: dict[str, Any] | None = None, operators: str = ""
) -> AsyncIterator[Stage]:
    """Autopilot found, component speaking, guidance deciding at 50 Hz."""
    clock = fake.clock = PatientClock()
    health = Health(clock)
    autopilot_options = AutopilotOptions(
        ", ".join((f"udpin://{HOST}:0", *more_links)),
        silence_s=0.8,
        command_period_s=0.02,
        operators=operators,
        restart_first_s=0.02,
        restart_most_s=0.1,
    )
    stage: Stage
    tower = FakeOperator()
    applied: list[Settings] = []
    component = Component(
        Outputs(OutputOptions(**(outputs or {})), 0.39, 0.5),
        tower,
        Tunables(settings_of.load("sim"), applied.append),
        believe=lambda now: stage.believe(now),
        clock=clock,
        health=health,
    )
    async with open_autopilot(autopilot_options, clock, parameters=PARAMETERS) as autopilot:
        stage = Stage(component, autopilot, fake, tower, health, applied)

        async def pump() -> None:
            async for sample in autopilot.samples:
                stage.ranges += isinstance(sample, Range)
                component.on_sample(sample)

        async def decide() -> None:
            while True:
                if stage.deciding:
                    now = clock.now()
                    component.on_decision(Decision(now, stage.phase, None, stage.believe(now)))
                await asyncio.sleep(0.02)

        await until(lambda: autopilot.links.all[0].local is not None)
        host, port = autopilot.links.all[0].local or ("", 0)
        async with fake.talking_to(f"udpout://{host}:{port}"), asyncio.TaskGroup() as group:
            tasks = [group.create_task(pump()), group.create_task(decide())]
            await until(lambda: autopilot.connected)
            async with speaking(component, autopilot, clock):
                yield stage
            for task in tasks:
                task.cancel()


async def fetched_metadata(system: Any, component: int) -> str:
    """Return the description of a component's parameters as MAVSDK has fetched and parsed it."""
    from mavsdk.asyncio.plugins.component_metadata import ComponentMetadataAsync

    metadata = ComponentMetadataAsync(system)
    available = metadata.subscribe_metadata_available()
    await metadata.request_component(component)
    async with asyncio.timeout(60):
        update = await anext(available)
    assert update.compid == component
    return str(update.json_metadata)


def count(fake: MiniatureAutopilot, kind: str) -> Callable[[], int]:
    return lambda: len(fake.of(kind))
