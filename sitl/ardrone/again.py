"""Flight after flight behind the same sockets, each over a sea of its own.

When a flight has ended the drone stands for a while, then falls silent as one that is switched off, and another comes on the air
in flight at the start of the next. Its client sees what it would see of a fleet handed to it one by one: streams that end and
begin again, and a clock that goes on.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import msgspec
import numpy as np

from companion.config.settings import shipped
from estimator.contracts.ports import Clock
from estimator.contracts.time import seconds_between
from sitl.ardrone.server import ArDroneServer
from sitl.ardrone.state import AIRBORNE
from sitl.faults import ServiceKilled
from sitl.safety import dangers
from sitl.scenario import FAULTS, Scenario, load
from sitl.world import VehiclePhase, World

_LOOK_S = 0.1


@dataclass(frozen=True, slots=True)
class PauseBetweenFlights:
    """Between two flights, seconds."""

    landed_s: float = 3.0
    """The drone stands and says so."""
    silent_s: float = 2.0
    """Long enough for a client to give up what it believed of the drone's state: on the ground it orders the motors off."""


def faulty(scenario: Scenario, seed: int, *, virtual: bool = False) -> Scenario:
    """The scenario with the faults of a shipped one on top, drawn by the seed, and with what is to be expected of it.

    Args:
        virtual: faults may be drawn that only a flight in virtual time can have.
    """
    start = scenario.start
    highest_m = math.inf if start.where == "pad" else start.height_m
    choices = [
        (name, other) for name, other in _choices(virtual) if all((f.below_height_m or 0.0) <= highest_m for f in other.faults)
    ]
    name, fault = choices[int(np.random.default_rng([seed, 0xFA]).integers(len(choices)))]
    title = f"{scenario.title}; {FAULTS}/{name}"[:120]
    faults = (*scenario.faults, *fault.faults)
    return msgspec.structs.replace(scenario, title=title, faults=faults, expect=fault.expect, because=fault.because)


def real_time(scenario: Scenario) -> bool:
    """Whether a drone behind sockets can have all of the scenario's faults."""
    return all(fault.in_phase is None and not isinstance(fault, ServiceKilled) for fault in scenario.faults)


@cache
def _choices(virtual: bool) -> list[tuple[str, Scenario]]:
    every = [(name, load(f"{FAULTS}/{name}")) for name in shipped(f"scenarios/{FAULTS}")]
    return [(name, scenario) for name, scenario in every if virtual or real_time(scenario)]


async def fly_again(
    server: ArDroneServer,
    scenario: Scenario,
    seed: int,
    clock: Clock,
    say: Callable[..., None],
    *,
    faults: bool = False,
    pause: PauseBetweenFlights | None = None,
) -> None:
    """Until cancelled: wait for the flight to end, tell how it did, begin the next with the next seed.

    Args:
        scenario: of the further flights.
        say: told `event="flight"`, how it ended and where it touched.
        faults: give each further flight the faults of a shipped scenario.
    """
    pause = pause or PauseBetweenFlights()
    while True:
        sent, stood_s = server.counters["video_sent"], server.stood_still_s
        ended = await _end(server, clock)
        load = {"frames_sent": server.counters["video_sent"] - sent, "stood_still_s": round(server.stood_still_s - stood_s, 3)}
        say(event="flight", seed=seed, ended=ended, **_judged(server.world), **load)
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
    """Wait for it; a flight longer than its scenario allows is switched off in the air."""
    world, flew = server.world, False
    while seconds_between(world.started, clock.now()) < world.scenario.duration_limit_s:
        await clock.sleep(_LOOK_S)
        flew = flew or world.phase in AIRBORNE
        if world.phase is VehiclePhase.EMERGENCY:
            return "emergency"
        if flew and world.phase is VehiclePhase.LANDED:
            return "landed"
    world.emergency()
    return "time is up"


def _judged(world: World) -> dict[str, Any]:
    """What is known of the flight on this side of the sockets."""
    truth, scenario = world.truth(), world.scenario
    touched = truth.touchdown
    return {
        "title": scenario.title,
        "expect": scenario.expect,
        "duration_s": round(seconds_between(world.started, truth.at), 3),
        "surface": None if touched is None else touched.surface,
        "on_pad": touched is not None and touched.on_pad,
        "lateral_m": None if touched is None else round(touched.lateral_m, 4),
        "unsafe": list(dangers(None, truth.contacts, None)),
        "left_alone": world.active("link_lost"),
    }


def _prepared(scenario: Scenario, seed: int) -> World:
    """A world whose textures are made."""
    world = World(scenario, seed)
    world.render()
    return world
