"""Flights in a row behind the same sockets, with the real driver: each ends, and the next is another sea."""

import asyncio
from typing import Any

import msgspec

from drivers.ardrone.link import open_ardrone
from drivers.ardrone.options import ArDroneOptions
from drivers.clock import SystemClock
from estimator.contracts.commands import Land
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import MonoNs, seconds_between
from sitl.emulators.ardrone.serve import PauseBetweenFlights, fly_repeatedly
from sitl.emulators.ardrone.server import ArDroneServer, Ports
from sitl.perception.levels import perceive, represents
from sitl.perception.port import Perception
from sitl.scenario.scenario import Start
from sitl.scenario.scenario import load as load_scenario
from sitl.scenario.with_fault import faulty, real_time
from sitl.world.world import World
from tests.support.clocks import PatientClock

CLOCK = SystemClock()
NEAR = msgspec.structs.replace(load_scenario("calm"), start=Start(height_m=0.8, pad_right_m=0.1, pad_forward_m=0.1))


async def test_each_flight_ends_and_another_begins_in_the_air_under_the_same_client() -> None:
    reported: list[dict[str, Any]] = []
    # A driver that sets the drone up again misses what happens meanwhile: on a busy machine an answer may take its time.
    options = ArDroneOptions(host="127.0.0.1", config_timeout_s=30.0)
    too_short = msgspec.structs.replace(NEAR, duration_limit_s=2.5)
    patient = PatientClock()
    async with ArDroneServer(World(too_short, 1, patient.now()), ports=Ports(0, 0, 0, 0), clock=patient) as server:
        ports = {f"{name}_port": getattr(server.ports, name) for name in ("navdata", "video", "at", "control")}
        first, done, changes = server.world, asyncio.Event(), [False]

        def tell(**what: Any) -> None:
            reported.append(what)
            if len(reported) == 3:
                done.set()

        async with (
            asyncio.timeout(60),
            open_ardrone(msgspec.structs.replace(options, **ports), CLOCK) as drone,
            asyncio.TaskGroup() as group,
        ):
            flying_since: MonoNs | None = None

            async def fly() -> None:
                """Half a second in the air, then land; the first is let run out of time."""
                nonlocal flying_since
                async for sample in drone.samples:
                    if not isinstance(sample, VehicleStatus) or sample.flying is None:
                        continue
                    if sample.flying != changes[-1]:
                        changes.append(sample.flying)
                        flying_since = CLOCK.now() if sample.flying else None
                    if reported and flying_since is not None and seconds_between(flying_since, CLOCK.now()) > 0.5:
                        drone.command(Land())

            pilot = group.create_task(fly())
            flights = group.create_task(fly_repeatedly(server, NEAR, 1, patient, tell, pause=PauseBetweenFlights(0.3, 1.5)))
            await done.wait()
            while len(changes) < 7:  # noqa: ASYNC110 - the third landing is still on its way to the driver
                await asyncio.sleep(0.01)
            pilot.cancel()
            flights.cancel()
    assert [flight["seed"] for flight in reported] == [1, 2, 3]
    assert [flight["ended"] for flight in reported] == ["time is up", "landed", "landed"]
    assert all(flight["surface"] in ("pad", "deck") and flight["on_pad"] for flight in reported[1:])
    assert changes == [False, True, False, True, False, True, False], "on the ground between two flights, and never in between"
    assert server.world is not first


def test_faults_are_the_seeds_own_and_fit_the_flight() -> None:
    high = msgspec.structs.replace(NEAR, start=Start(height_m=4.0))
    drawn = [faulty(high, seed) for seed in range(80)]
    assert drawn == [faulty(high, seed) for seed in range(80)]
    assert len({scenario.title for scenario in drawn}) >= 20
    assert all(scenario.faults and scenario.because for scenario in drawn)
    assert all(real_time(scenario) for scenario in drawn)
    every = [faulty(high, seed, possible=lambda _: True) for seed in range(300)]
    assert not all(real_time(scenario) for scenario in every)
    assert not {"ship_speed", "ship_turn", "vessel_reports"} & {fault.kind for one in every for fault in one.faults}, "at anchor"
    low = [fault for seed in range(40) for fault in faulty(NEAR, seed).faults]
    assert all(fault.below_height_m is None or fault.below_height_m <= NEAR.start.height_m for fault in low)


def test_a_seed_selects_only_faults_that_the_level_of_perception_represents() -> None:
    """WHY: a soak of modelled perception ended at the first seed whose fault only rendered frames show."""
    seen = {level: kinds_of(perceive(level)) for level in ("pixels", "model", "truth")}
    assert "other_pad" in seen["pixels"]
    assert "other_pad" not in seen["model"] | seen["truth"]
    assert len(seen["truth"]) >= 10
    assert seen["truth"] < seen["model"] < seen["pixels"]


def kinds_of(level: Perception) -> set[str]:
    return {
        fault.kind
        for seed in range(500)
        for fault in faulty(load_scenario("demo"), seed, possible=lambda s: represents(level, s.faults)).faults
    }
