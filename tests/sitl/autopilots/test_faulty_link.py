"""Faults of the streams over the real MAVLink link: a stand-in autopilot, the relay, and the daemon's driver on UDP.

WHY: what is lost, late, doubled or overtaken must be counted, refused or told as old; never taken for new. WHAT: the same class
of faults as for the simulated AR.Drone acts on datagrams, and the driver's samples, stamps and counters are looked at.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

import numpy as np
import pytest

from drivers.mavlink.autopilot import Autopilot, open_autopilot
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.commands import Velocity
from estimator.contracts.samples import Attitude, BodyVelocity, Imu, Sample
from sitl.emulators.autopilots.lock_step import FaultyLink
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from sitl.faults.fault import FaultTimer
from sitl.faults.faulty_streams import VehicleStreams
from sitl.faults.kinds import LinkLost, NavdataStream, StreamFault
from tests.support.clocks import PatientClock
from tests.support.waiting import free_port, until

HOST = "127.0.0.1"


@dataclass
class Linked:
    """A stand-in and the driver with the relay between them."""

    fake: MiniatureAutopilot
    driver: Autopilot
    link: FaultyLink
    timer: FaultTimer
    samples: list[Sample]

    async def fly(self, seconds: float, begins: bool = False) -> list[Sample]:
        """Pass some time, with the faults from now on if `begins`; return the samples that came."""
        if begins:
            self.timer.update(1.0, 3.0, None)
        had = len(self.samples)
        await self.fake.clock.sleep(seconds)
        return self.samples[had:]


@asynccontextmanager
async def linked(*faults: StreamFault | LinkLost) -> AsyncIterator[Linked]:
    clock, relay_port, port = PatientClock(), free_port(), free_port()
    timer = FaultTimer(faults, 1)
    link = FaultyLink(VehicleStreams(timer, 1), clock)
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
