"""An AR.Drone in a ground station: what it shows, what it can be told, and MAVSDK as the station.

Link faults are reported by a running service within seconds: by the doctor's rules, in the log and in health.
"""

import asyncio
import logging
import math
import random
import socket
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.base.health import Health
from companion.base.orders import OperatorOrder
from companion.parts.mavlink import make
from companion.parts.mavlink.bridge.options import BridgeOptions
from companion.parts.mavlink.bridge.part import BridgePart, VehicleBridge
from companion.parts.mavlink.commands import ACCEPTED, DENIED, UNSUPPORTED
from companion.parts.mavlink.make import PART, LinkWatch
from companion.parts.mavlink.metadata import metadata_files
from companion.parts.mavlink.parameters import NAMES, Tunables
from companion.settings.load import load
from companion.settings.model import Settings
from drivers.clock import SystemClock
from drivers.endpoint import parse_endpoint
from drivers.mavlink.access import AccessLevel
from drivers.mavlink.autopilot import open_autopilot
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import LinkOptions, Links, ReceivedMessage
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.signing import Signing, SigningKey, SigningTimes
from drivers.reconnect import running_beside
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, BodyVelocity, Imu, Range, VehicleStatus
from estimator.contracts.time import MonoNs
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.companion.mavlink.stage import HOST, fetched_metadata, wire_frame
from tests.make import stamp_at
from tests.support.waiting import PATIENCE_S, free_port, until

S = 1_000_000_000


class Station:
    """Ground station that receives from a drone and sends to it."""

    def __init__(self) -> None:
        self.messages: list[Message] = []
        self.orders: list[OperatorOrder] = []
        self.broken = False
        self.now = MonoNs(100 * S)
        self.bridge = VehicleBridge(self._on_message, self._take, lambda: "over the pad")

    def _on_message(self, message: Message, to: int | None = None, *, component: int | None = None) -> bool:
        assert component == 1
        self.messages.append(message)
        return True

    def _take(self, order: OperatorOrder) -> str | None:
        if self.broken:
            return "the vehicle is silent"
        self.orders.append(order)
        return None

    def drone(self, *, flying: bool, mode: str, seconds: float = 1.0, yaw_deg: float = 90.0) -> None:
        """Fly forward at half a metre a second at 1.2 m."""
        for n in range(round(seconds * 50)):
            self.now = MonoNs(self.now + S // 50)
            if n % 10 == 0:
                self.bridge.on_sample(VehicleStatus(stamp_at(self.now), flying, mode, 0.66, False, True))
            body = Rotation.from_rpy(0.0, 0.0, math.radians(yaw_deg))
            self.bridge.on_sample(Attitude(stamp_at(self.now), body, np.eye(3) * 1e-4))
            self.bridge.on_sample(Imu(stamp_at(self.now), np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, -9.8])))
            self.bridge.on_sample(BodyVelocity(stamp_at(self.now), np.array([0.5, 0.0, 0.0]), np.eye(3) * 0.01))
            self.bridge.on_sample(Range(stamp_at(self.now), 1.2, 0.02))
            self.bridge.tick(self.now)

    def tell(self, command: int, *params: float) -> int:
        padded = [*params, 0, 0, 0, 0, 0, 0, 0][:7]
        message = mav.MAVLink_command_long_message(7, 1, command, 0, *padded)
        before = len(self.messages)
        self.bridge.on_message(ReceivedMessage(message, 0, self.now, 255, 190, access_level=AccessLevel.OPERATOR), 7, self.now)
        ack = self.messages[before]
        assert (ack.command, ack.target_system, ack.target_component) == (command, 255, 190)
        return int(ack.result)

    def newest(self, kind: str) -> Any:
        return [m for m in self.messages if m.get_type() == kind][-1]


def test_a_quadrotor_is_seen() -> None:
    station = Station()
    station.drone(flying=True, mode="hovering", seconds=2.0)
    beat = station.newest("HEARTBEAT")
    assert (beat.type, beat.autopilot, beat.system_status) == (2, 0, 4)
    assert beat.base_mode & 128
    assert station.newest("EXTENDED_SYS_STATE").landed_state == 2
    assert station.newest("SYS_STATUS").battery_remaining == 66
    q = station.newest("ATTITUDE_QUATERNION")
    assert Rotation.from_quat([q.q1, q.q2, q.q3, q.q4]).rpy_rad[2] == pytest.approx(math.pi / 2)
    assert (q.rollspeed, q.pitchspeed, q.yawspeed) == (0.1, 0.2, 0.3)
    place = station.newest("LOCAL_POSITION_NED")
    assert (place.x, place.y, place.z) == pytest.approx((0.0, 1.0, -1.2), abs=0.07)
    assert (place.vx, place.vy) == pytest.approx((0.0, 0.5))
    counts = {kind: sum(m.get_type() == kind for m in station.messages) for kind in ("HEARTBEAT", "ATTITUDE_QUATERNION")}
    assert counts["HEARTBEAT"] == 2
    assert 30 <= counts["ATTITUDE_QUATERNION"] <= 42


def test_arm_take_off_hold_and_land() -> None:
    station = Station()
    station.drone(flying=False, mode="landed", seconds=0.5)
    assert station.tell(22) == DENIED, "not armed"
    assert station.tell(400, 1) == ACCEPTED
    assert station.tell(22) == ACCEPTED
    station.drone(flying=True, mode="hovering", seconds=0.5)
    assert station.tell(22) == DENIED, "it flies"
    assert station.tell(400, 0) == DENIED, "motors are not stopped in flight"
    assert station.tell(17) == ACCEPTED
    assert station.tell(21) == ACCEPTED
    station.drone(flying=True, mode="hovering", seconds=0.1)
    assert station.newest("STATUSTEXT").text == "Decklander: lands over the pad"
    assert station.orders == [OperatorOrder.TAKE_OFF, OperatorOrder.HOLD, OperatorOrder.LAND]
    station.broken = True
    assert station.tell(21) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    assert station.tell(16) == UNSUPPORTED
    assert station.tell(512, 148) == ACCEPTED
    assert station.newest("AUTOPILOT_VERSION")
    assert station.tell(512, math.nan) == UNSUPPORTED
    assert station.tell(511, 31, 1_000_000) == ACCEPTED


@asynccontextmanager
async def bridged(operators: str = "", **options: Any) -> AsyncIterator[tuple[BridgePart, Links, list[OperatorOrder]]]:
    """Yield the bridge listening on a port of its own, with a drone that stands."""
    clock, orders = SystemClock(), list[OperatorOrder]()
    links = [LinkOptions(parse_endpoint(f"udpin://{HOST}:0"))]
    part = BridgePart(BridgeOptions(system_id=7, operators=operators), links, clock, order=orders.append, below=str, **options)
    async with asyncio.TaskGroup() as group:
        running = group.create_task(part.run())
        await until(lambda: part._links is not None and part._links.all[0].local is not None)
        now = clock.now()
        part.on_sample(VehicleStatus(stamp_at(now), True, "hovering", 0.5, False, True))
        assert part._links is not None
        yield part, part._links, orders
        running.cancel()


class Wire:
    """A ground station's socket."""

    def __init__(self, links: Links, source: tuple[int, int]) -> None:
        self._sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sock.setblocking(False)
        self._links, self._codec = links, Codec(*source)

    async def say(self, *messages: Message | bytes) -> list[Message]:
        """Send these and return what has come back a little later."""
        counters, address = self._links.all[0].counters, self._links.all[0].local
        for message in messages:
            data = message if isinstance(message, bytes) else self._codec.pack(message)
            expected = counters.bytes_in + len(data)
            self._sock.sendto(data, address)
            await until(lambda expected=expected: counters.bytes_in >= expected and not len(self._links.received))
        await asyncio.sleep(0.05)
        out: list[Message] = []
        reader = Codec(1, 1, datagrams=True)
        with suppress(BlockingIOError):
            while True:
                out += reader.feed(self._sock.recv(2048))
        return out

    def close(self) -> None:
        self._sock.close()


LAND = mav.MAVLink_command_long_message(7, 1, 21, 0, 0, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize("operators", ["", "254"])
async def test_it_is_closed_to_whoever_is_not_named(operators: str) -> None:
    async with bridged(operators=operators) as (part, links, orders):
        wire = Wire(links, (255, 190))
        beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
        assert await wire.say(beat, LAND) == []
        assert orders == []
        assert (part.counted()["unknown_senders"], part.counted()["peers"]) == (2, 0)
        wire.close()


async def test_a_refused_parameter_is_answered_with_its_value_and_the_reason() -> None:
    async with bridged(operators="255", store=Tunables(load("sim"), lambda settings: None)) as (_part, links, _orders):
        named, other = Wire(links, (255, 190)), Wire(links, (254, 190))
        for wire, name, value, why in (
            (named, b"PID_H_KP", 99.0, "PID_H_KP"), (named, b"NO_SUCH", 1.0, "NO_SUCH"), (named, b"PID_H_KP", 0.5, ""),
            (other, b"PID_H_KP", 0.5, ""),
        ):  # fmt: skip
            heard = await wire.say(
                mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), mav.MAVLink_param_set_message(7, 1, name, value, 9)
            )
            texts = "".join(m.text for m in heard if m.get_type() == "STATUSTEXT")
            assert (why in texts) if why else texts == ""
            assert not why or texts.startswith("Decklander: ")
        for wire in (named, other):
            wire.close()


async def test_no_fields_of_any_message_end_it() -> None:
    chance = random.Random(5)
    async with bridged(operators="255") as (_part, links, orders):
        wire = Wire(links, (255, 190))
        frames = []
        for cls in mav.mavlink_map.values():
            size = cls.unpacker.size
            frames += [wire_frame(cls, payload, (255, 190)) for payload in (b"\xff" * size, chance.randbytes(size))]
        await wire.say(*frames)
        assert dict(links.contained.faults) == {}
        assert dict(links.unfit) == {}
        orders.clear()
        answers = await wire.say(LAND)
        assert [(m.command, m.result) for m in answers if m.get_type() == "COMMAND_ACK"] == [(21, ACCEPTED)]
        assert orders == [OperatorOrder.LAND]
        wire.close()


async def test_mavsdk_flies_it_and_reads_and_sets_its_parameters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mavsdk = pytest.importorskip("mavsdk.asyncio", reason="MAVSDK is not installed")
    from mavsdk import ComponentType, Configuration
    from mavsdk.asyncio.plugins.action import ActionAsync
    from mavsdk.asyncio.plugins.param import ParamAsync

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # what was fetched before is not fetched again
    port, clock, orders, applied = free_port(), SystemClock(), list[OperatorOrder](), list[Settings]()
    store = Tunables(load("sim"), applied.append)
    links = [LinkOptions(parse_endpoint(f"udpout://{HOST}:{port}"))]
    part = BridgePart(BridgeOptions(system_id=7, operators="245"), links, clock, order=orders.append, below=str, store=store)
    async with asyncio.TaskGroup() as group:
        flying = False

        async def live() -> None:
            while True:
                now = clock.now()
                part.on_sample(VehicleStatus(stamp_at(now), flying, "hovering" if flying else "landed", 0.5, False, True))
                await asyncio.sleep(0.02)

        tasks = [group.create_task(live()), group.create_task(part.run())]
        async with mavsdk.Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as station:
            await station.add_any_connection(f"udpin://{HOST}:{port}")
            system = await station.first_autopilot(timeout_s=PATIENCE_S)
            assert system is not None
            action = ActionAsync(system)
            await action.arm()
            await action.takeoff()
            flying = True
            await asyncio.sleep(0.1)
            await action.land()
            assert (await fetched_metadata(system, 1)).encode() == metadata_files(1)["parameters.json"]
            param = ParamAsync(system)
            await param.set_param_float("PID_H_KP", 1.5)
            assert {p.name for p in (await param.get_all_params()).float_params} == set(NAMES)
            assert [one.guidance.pid.horizontal.kp for one in applied] == [1.5]
        for task in tasks:
            task.cancel()
    assert orders == [OperatorOrder.TAKE_OFF, OperatorOrder.LAND]


KEY = SigningKey(bytes(range(32)))


@asynccontextmanager
async def watch_links(monkeypatch: pytest.MonkeyPatch, *, signed: bool = False) -> AsyncIterator[tuple[Health, tuple[str, int]]]:
    """Yield a watch ten times as fast as in flight, beside the links."""
    for name in ("_EACH_S", "_WINDOW_S", "_FIRST_S"):
        monkeypatch.setattr(make, name, 0.1 * getattr(make, name))
    clock = SystemClock()
    health, options = Health(clock), AutopilotOptions(f"udpin://{HOST}:0")
    signing = Signing(lambda: KEY, SigningTimes(None), 0) if signed else None
    links = (LinkOptions(parse_endpoint(options.links), signing),)
    async with open_autopilot(options, clock, links) as autopilot:
        await until(lambda: autopilot.links.all[0].local is not None)
        watch = LinkWatch(autopilot, 0, health, clock)
        async with running_beside([("watch", watch.work.run(clock))]):
            assert autopilot.links.all[0].local is not None
            yield health, autopilot.links.all[0].local
        watch.close()


def heartbeat_of(three_days_ago: bool) -> Callable[[], bytes]:
    """Return what makes heartbeats signed three days ago, or not signed at all."""
    times = SigningTimes(None, lambda: time.time() - 3 * 86_400.0)
    codec = Codec(1, 1, signing=Signing(lambda: KEY, times, 3) if three_days_ago else None)
    return lambda: codec.pack(mav.MAVLink_heartbeat_message(2, 3, 128, 5, 4, 3))


@pytest.mark.parametrize(
    ("data", "signed", "said"),
    [
        (heartbeat_of(True), True, "the time of their signature, which is 3.0 days behind ours"),
        (heartbeat_of(False), True, "refused for their signature"),
        (heartbeat_of(False), False, "answers nothing: no parameter, no stream, no TIMESYNC"),
        (lambda: bytes(range(90, 250)), False, "set the same speed on both sides"),
        (lambda: b"", False, "not one byte"),
    ],
    ids=["time", "key", "one way", "speed", "silent"],
)
async def test_a_fault_is_reported_once(data, signed, said, monkeypatch, caplog):
    async with watch_links(monkeypatch, signed=signed) as (health, address):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:

            async def send() -> None:
                while True:
                    if sent := data():
                        sock.sendto(sent, address)
                    await asyncio.sleep(0.02)

            async with running_beside([("sender", send())]):
                await until(lambda: PART in health.parts and said in health.parts[PART].last_error)
                await asyncio.sleep(0.5)
        assert not health.parts[PART].up
    assert sum(said in line for line in caplog.messages) == 1
    assert health.parts[PART].up


async def test_a_good_link_reports_nothing_and_a_fault_that_is_over_no_more(monkeypatch, caplog):
    caplog.set_level(logging.INFO)
    async with watch_links(monkeypatch) as (health, address):
        await until(lambda: PART in health.parts)
        async with MiniatureAutopilot().talking_to("udpout://{}:{}".format(*address)):
            await until(lambda: health.parts[PART].up)
            await asyncio.sleep(1.0)
            assert health.parts[PART].up
            assert health.parts[PART].restarts == 1
    assert any("nothing is wrong with the links any more" in line for line in caplog.messages)
