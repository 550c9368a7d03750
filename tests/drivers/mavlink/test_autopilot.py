"""The autopilot as vehicle, against one in miniature over real sockets."""

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest

from drivers.clock import SystemClock
from drivers.mavlink.autopilot import Autopilot, open_autopilot
from drivers.mavlink.dialect import mav
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.roster import Roster
from drivers.mavlink.vehicle import Stack
from estimator.contracts.commands import CutMotors, Land, LeaveEmergency, Velocity
from estimator.contracts.errors import Recoverable
from estimator.contracts.samples import Attitude, BodyVelocity, Imu, Sample, VehicleStatus
from estimator.contracts.time import seconds_between
from sitl.emulators.autopilots.stand_in.base import EPOCH_NS, MiniatureAutopilot
from tests.make import tuned
from tests.support.clocks import PatientClock
from tests.support.waiting import until

HOST = "127.0.0.1"


@asynccontextmanager
async def autopilot_of(
    fake: MiniatureAutopilot, parameters: tuple[str, ...] = (), *, waits: bool = False, **options: Any
) -> AsyncIterator[Autopilot]:
    quick = {"silence_s": 0.8, "command_period_s": 0.02, "restart_first_s": 0.02, "restart_most_s": 0.1}
    given = tuned(AutopilotOptions, links=f"udpin://{HOST}:0", **(quick | options))
    fake.clock = PatientClock()
    async with open_autopilot(given, fake.clock, parameters=parameters, waits=waits) as autopilot:
        await until(lambda: autopilot.links.all[0].local is not None)
        host, port = autopilot.links.all[0].local or ("", 0)
        async with fake.talking_to(f"udpout://{host}:{port}"):
            await until(lambda: autopilot.connected)
            yield autopilot


def drain(autopilot: Autopilot) -> list[Sample]:
    return [autopilot.samples._items.popleft() for _ in range(len(autopilot.samples))]


@pytest.mark.parametrize(("stack", "waits"), [(Stack.ARDUPILOT, False), (Stack.PX4, False), (Stack.ARDUPILOT, True)])
async def test_a_fresh_link_gets_requests_for_streams_and_gives_samples(stack: Stack, waits: bool) -> None:
    fake = MiniatureAutopilot(
        stack, mode="loiter" if stack is Stack.ARDUPILOT else "auto.loiter", v_ned=np.array([0.0, 1.0, 0.0])
    )
    fake.rpy = lambda t: (0.0, 0.0, math.radians(90.0))
    async with autopilot_of(fake, waits=waits) as autopilot:
        await until(lambda: autopilot.streams is not None and autopilot.streams.settled)
        await until(lambda: autopilot.sync is not None and autopilot.sync.locked)
        assert fake.intervals[mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION] == 0.01
        drain(autopilot)
        samples: list[Sample] = []

        def all_kinds() -> bool:
            samples.extend(drain(autopilot))
            return {Attitude, BodyVelocity, Imu, VehicleStatus} <= {type(s) for s in samples}

        await until(all_kinds)
        velocity = next(s for s in samples if isinstance(s, BodyVelocity))
        assert velocity.v_level == pytest.approx((1.0, 0.0, 0.0), abs=1e-6)
        assert autopilot.links.identity == (7, 191)
        assert autopilot.identity.stack is stack
        offset = autopilot.sync.offset_ns(fake.clock.now()) if autopilot.sync else None
        assert abs(offset[0] - EPOCH_NS) < 3e6
        assert all(s.stamp.measured_at <= s.stamp.received_at for s in samples)
        assert autopilot.condition.battery_fraction == 0.83


async def test_inertial_readings_are_older_than_their_stamps_by_the_autopilots_filter() -> None:
    fake = MiniatureAutopilot()
    fake.parameters["INS_GYRO_FILTER"] = 20.0
    async with autopilot_of(fake) as autopilot:
        await until(lambda: autopilot.parameters is not None and "INS_GYRO_FILTER" in autopilot.parameters.values)
        drain(autopilot)
        ages_s: list[float] = []

        def heard() -> bool:
            ages_s.extend(
                seconds_between(s.stamp.measured_at, s.stamp.received_at) for s in drain(autopilot) if isinstance(s, Imu)
            )
            return len(ages_s) > 4

        await until(heard)
        assert min(ages_s) > 0.011


async def test_an_autopilot_that_waits_to_be_spoken_to_is_found() -> None:
    fake = MiniatureAutopilot()
    async with fake.talking_to(f"udpin://{HOST}:0"):
        await until(lambda: fake.links is not None and fake.links.all[0].local is not None)
        host, port = fake.links.all[0].local or ("", 0)
        async with open_autopilot(AutopilotOptions(f"udpout://{host}:{port}"), SystemClock()) as autopilot:
            await until(lambda: autopilot.connected)


async def test_silence_is_reported_and_everything_is_requested_again() -> None:
    fake = MiniatureAutopilot(parameters={"PLND_LAG": 0.02})
    async with autopilot_of(fake, parameters=("PLND_LAG",)) as autopilot:
        await until(lambda: autopilot.streams is not None and autopilot.streams.settled)
        asked = fake.commands[511]
        drain(autopilot)
        fake.silent = True
        await until(lambda: not autopilot.connected)
        lost = [s for s in drain(autopilot) if isinstance(s, VehicleStatus)]
        assert lost[-1].link_ok is False
        with pytest.raises(Recoverable, match="no autopilot"):
            autopilot.command(Land())
        with pytest.raises(Recoverable, match="no autopilot"):
            autopilot.command(CutMotors())
        await until(lambda: not fake.armed)  # it was heard all the same
        fake.silent = False
        await until(lambda: fake.commands[511] >= 2 * asked)
        assert autopilot.connects == 2
        await until(lambda: autopilot.parameters is not None and autopilot.parameters.settled)
        assert autopilot.parameters.values == {"PLND_LAG": pytest.approx(0.02)}


async def test_without_its_heartbeats_nothing_is_commanded_whatever_else_it_sends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mode and motors may be others by then: a person may have taken it."""
    fake = MiniatureAutopilot(Stack.ARDUPILOT, mode="guided")
    async with autopilot_of(fake) as autopilot, asyncio.timeout(30):
        autopilot.command(Velocity(np.array([1.0, 0.0, 0.0]), 0.0))
        await until(lambda: bool(fake.setpoints))
        send = fake.send
        monkeypatch.setattr(fake, "send", lambda m: None if m.get_type() == "HEARTBEAT" else send(m))
        await until(lambda: not autopilot.connected)
        last = [s for s in drain(autopilot) if isinstance(s, VehicleStatus)][-1]
        assert (last.link_ok, last.mode) == (False, "unknown")
        with pytest.raises(Recoverable, match="no autopilot"):
            autopilot.command(Velocity(np.array([1.0, 0.0, 0.0]), 0.0))
        setpoints = len(fake.setpoints)
        await asyncio.sleep(0.2)
        assert len(fake.setpoints) == setpoints
        monkeypatch.setattr(fake, "send", send)
        await until(lambda: autopilot.connected)


async def test_others_are_not_mistaken_for_the_autopilot() -> None:
    ship = MiniatureAutopilot(system=17)
    ship.heartbeat = lambda: mav.MAVLink_heartbeat_message(11, 3, 0, 0, 4, 3)  # type: ignore[method-assign]
    fake = MiniatureAutopilot()
    async with autopilot_of(fake, vessel_id=17) as autopilot:
        host, port = autopilot.links.all[0].local or ("", 0)
        async with ship.talking_to(f"udpout://{host}:{port}"):
            await until(lambda: ship.links is not None and 17 in autopilot.links.access._held)
            assert autopilot.links.all[0].peers == 1, "it is listened to, and told nothing"
            drain(autopilot)
            for _ in range(5):
                ship.send(mav.MAVLink_global_position_int_message(4000, 0, 0, 0, 0, 150, 0, 0, 9000))
                ship.send(mav.MAVLink_statustext_message(3, b"not the autopilot"))
                await asyncio.sleep(0.02)
            await asyncio.sleep(0.1)
            reports = [s for s in drain(autopilot) if type(s).__name__ == "VesselReport"]
            assert len(reports) == 5
            assert autopilot.identity.system == 7
            assert len(autopilot.texts) == 0


async def test_flown_by_velocity_and_landed_through_mavlink_alone() -> None:
    fake = MiniatureAutopilot(Stack.PX4, mode="auto.loiter")
    fake.rpy = lambda t: (0.0, 0.0, math.radians(90.0))
    async with autopilot_of(fake, prestream_s=1.6) as autopilot:
        async with asyncio.timeout(60):
            while fake.mode != "offboard" or fake.v_ned[1] < 0.9:
                autopilot.command(Velocity(np.array([1.0, 0.0, 0.0]), 0.0))
                await asyncio.sleep(0.05)
            assert fake.v_ned == pytest.approx([0.0, 1.0, 0.0], abs=0.1)
            east = fake.p_ned[1]
            while fake.p_ned[1] - east < 0.3:
                autopilot.command(Velocity(np.array([1.0, 0.0, 0.0]), 0.0))
                await asyncio.sleep(0.05)
        autopilot.command(Land())
        await until(lambda: fake.v_ned[2] > 0.3)
        fake.landed_state, fake.armed = 1, False
        await until(lambda: autopilot.condition.flying is False)
        await asyncio.sleep(0.7)  # the stream outlives the motors by half a second
        setpoints = len(fake.setpoints)
        await asyncio.sleep(0.2)
        assert len(fake.setpoints) == setpoints, "silent on the ground"


async def test_while_it_is_unclear_who_is_the_autopilot_nothing_old_is_flown_and_only_a_cut_is_sent(monkeypatch) -> None:
    """ArduCopter flew its last velocity for 3 s, down too."""
    fake = MiniatureAutopilot(Stack.ARDUPILOT, mode="guided")
    async with autopilot_of(fake) as autopilot, asyncio.timeout(30):
        autopilot.command(Velocity(np.array([1.0, 0.0, 0.5]), 0.0))
        await until(lambda: fake.v_ned[0] > 0.5)
        monkeypatch.setattr(Roster, "unclear", "two autopilots")
        await until(lambda: bool(fake.v_ned[0] == 0.0))
        setpoints = len(fake.setpoints)
        for command in (Velocity(np.array([1.0, 0.0, 0.5]), 0.0), CutMotors()):
            await asyncio.sleep(0.2)
            assert len(fake.setpoints) == setpoints
            with pytest.raises(Recoverable, match="two autopilots"):
                autopilot.command(command)
        await until(lambda: not fake.armed)
        fake.landed_state = 1
        await until(lambda: any(s.emergency for s in drain(autopilot) if isinstance(s, VehicleStatus)))


async def test_leaving_holds_the_vehicle() -> None:
    fake = MiniatureAutopilot(Stack.ARDUPILOT, mode="guided")
    async with autopilot_of(fake) as autopilot:
        autopilot.command(Velocity(np.array([1.0, 0.0, 0.0]), 0.0))
        await until(lambda: fake.v_ned[0] > 0.5)
        autopilot._close()
        await until(lambda: bool(fake.v_ned[0] == 0.0))
        with pytest.raises(Recoverable, match="closed"):
            autopilot.command(Land())


async def reported_within_s(fake: MiniatureAutopilot, autopilot: Autopilot, taken: Callable[[str | None], bool]) -> float:
    """Return after how many seconds the vehicle's status says so."""
    began_s = fake.now_s
    await until(lambda: any(taken(s.taken) for s in drain(autopilot) if isinstance(s, VehicleStatus)))
    return fake.now_s - began_s


@pytest.mark.parametrize(("stack", "velocity", "land", "words"), [
    (Stack.ARDUPILOT, "guided", "land", "Battery Failsafe"), (Stack.PX4, "offboard", "auto.land", "critical battery"),
])  # fmt: skip
async def test_a_failsafe_has_the_vehicle_and_its_words_follow_until_an_order(stack, velocity, land, words):
    fake = MiniatureAutopilot(stack, mode="loiter" if stack is Stack.ARDUPILOT else "auto.loiter")
    async with autopilot_of(fake, prestream_s=0.1, landing="mode") as autopilot, asyncio.timeout(30):

        async def flown(command: Velocity | Land, until_mode: str) -> None:
            while autopilot.condition.mode != until_mode:
                autopilot.command(command)
                await asyncio.sleep(0.02)

        await flown(Velocity(np.array([1.0, 0.0, 0.0]), 0.0), velocity)
        await flown(Land(), land)
        drain(autopilot)
        asked = fake.commands[mav.MAV_CMD_DO_SET_MODE]
        fake.fail(land, words if stack is Stack.ARDUPILOT else "Failsafe activated", cause=4)
        text = f"{stack.value} took the vehicle: {words} (mode {land})"
        assert await reported_within_s(fake, autopilot, lambda taken: taken == text) < 0.5
        assert autopilot.condition.failsafe is not None
        for _ in range(20):  # a go-around
            autopilot.command(Velocity(np.array([0.0, 0.0, -1.0]), 0.0))
            await asyncio.sleep(0.02)
        fake.critical = False
        await until(lambda: autopilot.condition.failsafe is None)
        autopilot.command(Velocity(np.array([0.0, 0.0, -1.0]), 0.0))
        await asyncio.sleep(0.1)
        assert (fake.mode, fake.commands[mav.MAV_CMD_DO_SET_MODE]) == (land, asked), "it stays the failsafe's until an order"
        autopilot.engage()
        await flown(Velocity(np.array([0.0, 0.0, -1.0]), 0.0), velocity)


async def test_who_takes_the_vehicle_is_reported_at_once_and_so_is_that_it_was_given_back() -> None:
    fake = MiniatureAutopilot(Stack.PX4, mode="auto.loiter")
    async with autopilot_of(fake, prestream_s=0.1, mode_is_order=True) as autopilot, asyncio.timeout(30):
        while fake.mode != "offboard" or autopilot.condition.mode != "offboard":
            autopilot.command(Velocity(np.array([1.0, 0.0, 0.0]), 0.0))
            await asyncio.sleep(0.02)
        drain(autopilot)
        fake.text(2, "Maximum flight time reached")
        fake.mode = "auto.loiter"
        text = "PX4 took the vehicle: Maximum flight time reached (mode auto.loiter)"
        assert await reported_within_s(fake, autopilot, lambda taken: taken == text) < 0.5
        fake.mode = "offboard"
        assert await reported_within_s(fake, autopilot, lambda taken: taken is None) < 0.5
        autopilot.texts.clear()
        fake.mode = "posctl"
        assert await reported_within_s(fake, autopilot, lambda taken: taken == "the vehicle was taken over: mode posctl") < 0.5
        autopilot.engage()
        assert await reported_within_s(fake, autopilot, lambda taken: taken is None) < 0.1
        autopilot.command(CutMotors())  # it goes on flying
        autopilot.command(LeaveEmergency())
        left = "nobody commands it since the reset: mode posctl"
        assert await reported_within_s(fake, autopilot, lambda taken: taken == left) < 0.5
