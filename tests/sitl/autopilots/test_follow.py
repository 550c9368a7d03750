"""A vehicle that somebody else simulates, over links that lose, delay and double: its pose, our deck under it, a landing."""

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.mission import FlightOutcome
from drivers.mavlink.autopilot import Autopilot, open_autopilot
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.samples import LocalPosition
from estimator.contracts.commands import Velocity
from estimator.contracts.errors import SetupImpossible
from estimator.contracts.geometry import F64, GeoPoint, Rotation, moved
from estimator.contracts.samples import Attitude, BodyVelocity, Imu, Sample
from estimator.contracts.time import Stamp
from sitl.emulators.autopilots.follow import AutopilotPose, DeckUnder, PoseSource, follow
from sitl.emulators.autopilots.lock_step import FaultyRelay
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from sitl.faults.fault import FaultTimer
from sitl.faults.faulty_streams import VehicleStreams
from sitl.faults.kinds import LinkLost, NavdataStream, StreamFault
from sitl.scenario.scenario import load
from sitl.scenario.settings import settings_for
from tests.make import ns
from tests.support.clocks import PatientClock
from tests.support.waiting import free_port, until

HOST = "127.0.0.1"

HOME = GeoPoint.of_degrees(63.44, 10.40, 0.0)


def stamped(seconds: float) -> Stamp:
    return Stamp(ns(seconds), ns(seconds), 0.0, "synced")


def position(seconds: float, p: F64, v: F64) -> LocalPosition:
    return LocalPosition(stamped(seconds), p, v)


def attitude(seconds: float) -> Attitude:
    return Attitude(stamped(seconds), Rotation.from_rpy(0.1, -0.05, 1.0), np.eye(3) * 1e-4)


def truth(kind: str, p: F64) -> Message:
    """Return a simulator's report of a place, in steps of 1e-7 degrees."""
    at = moved(HOME, p)
    lat, lon = math.degrees(at.latitude_rad), math.degrees(at.longitude_rad)
    q = [1.0, 0.0, 0.0, 0.0]
    if kind == "HIL_STATE_QUATERNION":
        millimetres = round(-1e3 * p[2])
        return mav.MAVLink_hil_state_quaternion_message(
            0, q, 0.1, 0.2, 0.3, round(lat * 1e7), round(lon * 1e7), millimetres, 0, 0, 0, 0, 0, 0, 0, 0
        )
    return mav.MAVLink_sim_state_message(
        *q, 0, 0, 0, 0, 0, 0, 0.1, 0.2, 0.3, lat, lon, -p[2], 0, 0, 0, 0, 0, round(lat * 1e7), round(lon * 1e7)
    )


@pytest.mark.parametrize("kind", ["SIM_STATE", "HIL_STATE_QUATERNION"])
def test_the_autopilots_place_is_shifted_onto_the_truth_smoothly(kind: str) -> None:
    source, v, off = PoseSource(), np.array([0.7, -0.4, 0.2]), np.array([1.3, -2.1, 0.6])
    found = []
    for n in range(500):
        t = 0.02 * n
        p = v * t
        there = (position(t, p + off, v),)
        source.on_message(truth(kind, p), ns(t), there)
        pose = source.newest(ns(t), there, attitude(t))
        assert pose.is_truth
        found.append(pose.p_ned - p)
    errors = np.array(found)[200:]
    assert np.abs(errors - errors.mean(0)).max() < 2e-3, "truth comes in steps of a centimetre, the pose does not"
    # It counts from the first truth received, itself in such steps
    assert errors.mean(0) == pytest.approx([0.0, 0.0, 0.0], abs=0.012)
    assert pose.w_body == pytest.approx((0.1, 0.2, 0.3))


def test_without_truth_it_is_the_autopilots_own_and_of_the_attitudes_instant() -> None:
    source = PoseSource()
    there = (position(5.00, np.array([1.0, 2.0, -3.0]), np.array([0.5, 0.0, -1.0])),)
    pose = source.newest(ns(5.03), there, attitude(5.02))
    assert not pose.is_truth
    assert pose.at == ns(5.02)
    assert pose.p_ned == pytest.approx((1.01, 2.0, -3.02))
    assert source.newest(ns(6.0), there, attitude(6.0)) is None, "too far apart"
    assert source.newest(ns(6.0), (), attitude(6.0)) is None
    assert source.newest(ns(6.0), there, None) is None


def test_the_pad_lies_where_the_scenarios_start_says() -> None:
    scenario = load("calm")
    turned = Rotation.from_rpy(0.0, 0.0, math.radians(90.0))
    first = AutopilotPose(ns(1.0), np.array([50.0, -20.0, -100.0]), np.zeros(3), turned, np.zeros(3), True)
    flying = DeckUnder(scenario, 1, first, on_ground=False)
    assert flying.height_m(first) == pytest.approx(scenario.start.height_m)
    # ahead is east, to the right is south
    ahead, right = scenario.start.pad_forward_m, scenario.start.pad_right_m
    over = AutopilotPose(ns(1.0), first.p_ned + np.array([-right, ahead, 0.0]), np.zeros(3), turned, np.zeros(3), True)
    landing = flying.landing(over, 0.4)
    assert landing.on_pad
    assert landing.lateral_m == pytest.approx(0.0, abs=1e-6)
    assert landing.vertical_speed_m_s == 0.4
    beside = flying.landing(first, 0.4)
    assert not beside.on_pad
    assert beside.lateral_m == pytest.approx(math.hypot(ahead, right))
    standing = DeckUnder(scenario, 1, first, on_ground=True)
    assert standing.height_m(first) == pytest.approx(0.045)
    assert flying.frame_at(over)().px.shape == (360, 640, 3)


class Elsewhere(MiniatureAutopilot):
    """A copter that another simulator flies, with a level attitude; its LAND descends to the ground at 0."""

    def _streams(self, t: float) -> list[Message]:
        if self.mode == "land" and self.armed:
            self.v_ned = np.array([0.0, 0.0, 0.4])
            if self.p_ned[2] > -0.05:
                self.v_ned, self.landed_state, self.armed = np.zeros(3), 1, False
        out = [m for m in super()._streams(t) if m.get_type() != "RAW_IMU"]
        if t >= self._next.get(-1, 0.0):
            self._next[-1] = t + 0.01
            out.append(mav.MAVLink_raw_imu_message(self.boot_ns // 1000, 0, 0, -1000 + self._samples % 7, 0, 0, 0, 0, 0, 0))
        if t >= self._next.get(-2, 0.0) and mav.MAVLINK_MSG_ID_SIM_STATE in self.intervals:
            self._next[-2] = t + 0.02
            out.append(truth("SIM_STATE", self.p_ned))
        return out


@pytest.mark.timeout(600)
async def test_followed_seen_and_landed_in_real_time() -> None:
    scenario = load("calm")
    start = replace(scenario.start, height_m=1.6, pad_forward_m=0.2, pad_right_m=-0.15)
    scenario = replace(scenario, start=start, duration_limit_s=90.0)
    settings = settings_for(scenario, None, by_autopilot=True)
    thesis = replace(settings.guidance.thesis, approach_height_m=1.2, speed_m_s=0.6)
    settings = replace(
        settings,
        # Real time on a busy machine: a few frames a second must do.
        guidance=replace(settings.guidance, controller="pid", mission="thesis", thesis=thesis, stale_after_s=2.0),
        estimator=replace(settings.estimator, path="dead_reckoning"),
    )
    for _ in range(3):  # a landing that a starved machine gave up, as it should, is flown again
        fake, port = Elsewhere(mode="loiter", p_ned=np.array([3.0, 4.0, -1.6])), free_port()
        async with asyncio.timeout(200), fake.talking_to(f"udpout://{HOST}:{port}"):
            end = await follow(scenario, 1, settings, f"udpin://{HOST}:{port}")
        assert end.failure == ""
        if end.outcome is not FlightOutcome.GAVE_UP:
            break
    assert end.outcome is FlightOutcome.LANDED
    assert end.by_truth
    assert end.landing.lateral_m < 0.15
    assert end.landing.on_pad
    assert end.landing.vertical_speed_m_s == pytest.approx(0.4, abs=0.05)
    # It began at (3, 4); the pad lay 0.2 m ahead of it and 0.15 m to the left.
    assert fake.p_ned[:2] == pytest.approx((3.2, 3.85), abs=0.15)
    assert fake.of("LANDING_TARGET"), "and the autopilot was told of the pad"


@dataclass
class Linked:
    """A stand-in and the driver with the relay between them."""

    fake: MiniatureAutopilot
    driver: Autopilot
    link: FaultyRelay
    timer: FaultTimer
    samples: list[Sample]

    async def fly(self, seconds: float, begins: bool = False) -> list[Sample]:
        """Pass some time, with the faults from now on if `begins`; return the samples that came."""
        if begins:
            self.timer.update(1.0, 3.0, None)
        had = len(self.samples)
        await self.fake.clock.sleep(seconds)
        return self.samples[had:]


async def test_a_port_that_another_flight_has_is_named_in_one_line() -> None:
    clock, port = PatientClock(), free_port()
    link = FaultyRelay(VehicleStreams(FaultTimer((), 1), 1), clock)
    async with link.relaying(HOST, port, free_port()):
        with pytest.raises(SetupImpossible, match=f"sends to {HOST}:{port}, which is taken: another flight"):
            await link.relaying(HOST, port, free_port()).__aenter__()


@asynccontextmanager
async def linked(*faults: StreamFault | LinkLost) -> AsyncIterator[Linked]:
    clock, relay_port, port = PatientClock(), free_port(), free_port()
    timer = FaultTimer(faults, 1)
    link = FaultyRelay(VehicleStreams(timer, 1), clock)
    fake = MiniatureAutopilot(clock=clock)
    samples: list[Sample] = []
    async with (
        asyncio.timeout(60),
        open_autopilot(AutopilotOptions(f"udpin://{HOST}:{port}"), clock) as driver,
        link.relaying(HOST, relay_port, port),
        fake.talking_to(f"udpout://{HOST}:{relay_port}"),
    ):

        async def deliver() -> None:
            while True:
                await asyncio.sleep(0.004)
                link.deliver()

        async def read() -> None:
            async for sample in driver.samples:
                samples.append(sample)

        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(deliver()), group.create_task(read())]
            try:
                await until(lambda: driver.sync is not None and driver.sync.locked)
                await until(lambda: {Attitude, BodyVelocity, Imu} <= {type(s) for s in samples})
                yield Linked(fake, driver, link, timer, samples)
            finally:
                for task in tasks:
                    task.cancel()


def lost(driver: Autopilot) -> int:
    """Sequence numbers that never came, as the link counts them."""
    return driver.links.all[0].counters.codec.lost


async def test_without_a_fault_the_relay_changes_nothing() -> None:
    async with linked() as it:
        await it.fly(0.6)
        assert lost(it.driver) == 0
        it.driver.command(Velocity(np.array([0.4, 0.0, 0.0]), 0.0))
        carried = it.link.carried
        assert carried["samples in"] == carried["samples out"] > 20
        assert carried["commands in"] == carried["commands out"] > 5


async def test_lost_datagrams_are_counted() -> None:
    async with linked(NavdataStream(at_s=1.0, dropped_fraction=0.3)) as it:
        before = it.link.carried.copy()
        await it.fly(1.0, begins=True)
        came, went = (it.link.carried[name] - before[name] for name in ("samples in", "samples out"))
        assert 0.15 < 1.0 - went / came < 0.45
        assert lost(it.driver) == pytest.approx(came - went, abs=3)


@pytest.mark.parametrize("effect", ["duplicated_fraction", "reordered_fraction"])
async def test_doubled_and_overtaken_samples_reach_the_service_once_and_in_order(effect: str) -> None:
    async with linked(NavdataStream(at_s=1.0, **{effect: 0.4})) as it:
        samples = await it.fly(1.0, begins=True)
        for kind in (Imu, Attitude, BodyVelocity):
            stamps = [s.stamp.measured_at for s in samples if isinstance(s, kind)]
            assert len(stamps) > 10
            assert stamps == sorted(set(stamps)), kind
        assert it.driver.out_of_order > 0, "counted"


async def test_a_lost_link_is_noticed_and_comes_back() -> None:
    async with linked(LinkLost(at_s=1.0, for_s=2.0)) as it:
        await it.fly(0.1, begins=True)
        assert await it.fly(0.5) == []
        it.timer.update(3.1, 3.0, None)
        assert len(await it.fly(0.8)) > 20
