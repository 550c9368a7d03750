"""Simulate flight after flight behind the same sockets, each with its own seed.

After a flight has ended, the drone stays on the ground for a while and then falls silent, like one that is switched off. Then
another drone appears, in flight at the start of the next approach. Its client sees a fleet of drones one after another: streams
that end and begin again, on a clock that runs on.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from estimator.contracts.ports import Clock
from estimator.contracts.time import seconds_between
from sitl.ardrone.state import AIRBORNE
from sitl.emulators.ardrone.server import ArDroneServer
from sitl.flight.safety import dangers
from sitl.scenario.scenario import Scenario
from sitl.scenario.with_fault import faulty
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.world import World

_POLL_S = 0.1


@dataclass(frozen=True, slots=True)
class PauseBetweenFlights:
    """The pause between two flights."""

    landed_s: float = 3.0
    """Time for which the drone reports that it has landed, s."""
    silent_s: float = 2.0
    """Time without any packet, s: long enough for a client to give up its estimate of the drone's state, since on the ground it
    commands the motors off."""


async def fly_repeatedly(
    server: ArDroneServer,
    scenario: Scenario,
    seed: int,
    clock: Clock,
    say: Callable[..., None],
    *,
    faults: bool = False,
    pause: PauseBetweenFlights | None = None,
) -> None:
    """Wait for the flight to end, report its result, and begin the next with the next seed, until cancelled.

    Args:
        server: the server of the simulated drone.
        scenario: the scenario of the further flights.
        seed: the seed of the first flight.
        clock: the clock of the server.
        pause: the pause between two flights.
        say: called after each flight with `event="flight"`, its ending and its contact.
        faults: give each further flight the faults of a shipped fault scenario.
    """
    pause = pause or PauseBetweenFlights()
    while True:
        sent, stood_s = server.counters["video_sent"], server.stood_still_s
        ended = await _end(server, clock)
        load = {"frames_sent": server.counters["video_sent"] - sent, "stood_still_s": round(server.stood_still_s - stood_s, 3)}
        say(event="flight", seed=seed, ended=ended, **_result(server.world), **load)
        seed += 1
        following = faulty(scenario, seed) if faults else scenario
        rested = clock.now()
        world = await asyncio.to_thread(_prepared, following, seed)
        await clock.sleep(max(0.0, pause.landed_s - seconds_between(rested, clock.now())))
        server.silent = True
        await clock.sleep(pause.silent_s)
        server.enter(world)
        server.silent = False


async def _end(server: ArDroneServer, clock: Clock) -> str:
    """Wait for the end of the flight, and switch the drone off in the air if the flight exceeds the scenario's time."""
    world, flew = server.world, False
    while seconds_between(world.started, clock.now()) < world.scenario.duration_limit_s:
        await clock.sleep(_POLL_S)
        flew = flew or world.phase in AIRBORNE
        if world.phase is VehiclePhase.EMERGENCY:
            return "emergency"
        if flew and world.phase is VehiclePhase.LANDED:
            return "landed"
    world.emergency()
    return "time is up"


def _result(world: World) -> dict[str, Any]:
    """Return what the simulator knows of the flight's result."""
    truth, scenario = world.truth(), world.scenario
    touched = truth.touchdown
    return {
        "title": scenario.title,
        "expect": scenario.expect,
        "duration_s": round(seconds_between(world.started, truth.at), 3),
        "surface": None if touched is None else touched.surface,
        "on_pad": touched is not None and touched.on_pad,
        "lateral_m": None if touched is None else round(touched.lateral_m, 4),
        "unsafe": list(dangers(None, truth.contacts, None, phases_known=False)),
        "left_alone": world.active("link_lost"),
    }


def _prepared(scenario: Scenario, seed: int) -> World:
    """Return a world whose textures are already computed."""
    world = World(scenario, seed)
    world.render()
    return world
