"""Flight after flight behind the same sockets, each over a sea of its own.

When a flight has ended the drone stands for a while, then falls silent as one that is switched off, and another comes on the air
in flight at the start of the next. Its client sees what it would see of a fleet handed to it one by one: streams that end and
begin again, and a clock that goes on.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from estimator.contracts.ports import Clock
from estimator.contracts.time import seconds_between
from sitl.ardrone.server import ArDroneServer
from sitl.ardrone.state import AIRBORNE
from sitl.scenario import Fault, FaultKind, Scenario
from sitl.world import Phase, World

_LOOK_S = 0.1
_PASSING: tuple[FaultKind, ...] = ("lens_covered", "video_silent", "navdata_silent", "flow_blind", "ultrasound_silent", "gust")
"""Faults that a flight can survive."""


@dataclass(frozen=True, slots=True)
class Pause:
    """Between two flights, seconds."""

    stands_s: float = 3.0
    """The drone stands and says so."""
    silent_s: float = 2.0
    """Long enough for a client to give up what it believed of the drone's state: on the ground it orders the motors off."""


def faulty(scenario: Scenario, seed: int) -> Scenario:
    """The scenario with one or two passing faults of its own, the same for a seed."""
    rng = np.random.default_rng([seed, 0xFA])
    faults = [
        Fault(
            kind=_PASSING[int(rng.integers(len(_PASSING)))],
            start_s=float(rng.uniform(1.0, 15.0)),
            duration_s=float(rng.uniform(0.3, 4.0)),
            speed_m_s=float(rng.uniform(1.0, 4.0)),
            from_deg=float(rng.uniform(-180.0, 180.0)),
        )
        for _ in range(int(rng.integers(1, 3)))
    ]
    return msgspec.structs.replace(scenario, faults=(*scenario.faults, *faults))


async def fly_again(
    server: ArDroneServer,
    scenario: Scenario,
    seed: int,
    clock: Clock,
    say: Callable[..., None],
    *,
    faults: bool = False,
    pause: Pause | None = None,
) -> None:
    """Until cancelled: wait for the flight to end, tell how it did, begin the next with the next seed.

    Args:
        scenario: of the further flights.
        say: told `event="flight"`, how it ended and where it touched.
        faults: give each further flight passing faults.
    """
    pause = pause or Pause()
    while True:
        ended = await _end(server, clock)
        say(event="flight", seed=seed, ended=ended, **_contact(server.world))
        seed += 1
        following = faulty(scenario, seed) if faults else scenario
        rested = clock.now()
        world = await asyncio.to_thread(_prepared, following, seed)
        await clock.sleep(max(0.0, pause.stands_s - seconds_between(rested, clock.now())))
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
        if world.phase is Phase.EMERGENCY:
            return "emergency"
        if flew and world.phase is Phase.LANDED:
            return "landed"
    world.emergency()
    return "time is up"


def _contact(world: World) -> dict[str, Any]:
    touched = world.truth().touchdown
    if touched is None:
        return {"surface": None, "on_pad": False, "lateral_m": None}
    return {"surface": touched.surface, "on_pad": touched.on_pad, "lateral_m": round(touched.lateral_m, 4)}


def _prepared(scenario: Scenario, seed: int) -> World:
    """A world whose textures are made."""
    world = World(scenario, seed)
    world.render()
    return world
