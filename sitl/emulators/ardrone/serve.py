"""Run the simulated drone as a separate process: `python -m sitl.emulators.ardrone.serve demo --seed 1 --navdata-port 0 ...`.

The process prints one JSON line with the ports in use when it listens, and one with its counters when it ends. It ends on SIGTERM
or SIGINT, or, if standard input is a pipe, when the other end closes, so that it never outlives the program that started it.

It may simulate flight after flight behind the same sockets, each with its own seed. After a flight has ended, the drone stays on
the ground for a while and then falls silent, like one that is switched off. Then another drone appears, in flight at the start of
the next approach. Its client sees a fleet of drones one after another: streams that end and begin again, on a clock that runs on.
"""

import argparse
import asyncio
import json
import os
import signal
import stat
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from msgspec.structs import asdict

from drivers.clock import SystemClock
from estimator.contracts.errors import BadInput, DecklanderError
from estimator.contracts.time import Clock, seconds_between
from sitl.ardrone.state import AIRBORNE, GENERATIONS
from sitl.emulators.ardrone.server import ArDroneServer, Habits, Ports
from sitl.flight.referee import unsafe_contacts
from sitl.scenario.scenario import Scenario, camera_model, load, vehicle_model, with_ardrone1
from sitl.scenario.with_fault import VIRTUAL_ONLY, faulty, real_time
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.world import World

_POLL_S = 0.1
"""Interval at which the end of the flight is looked for."""


async def fly_repeatedly(
    server: ArDroneServer,
    scenario: Scenario,
    seed: int,
    clock: Clock,
    say: Callable[..., None],
    *,
    faults: bool = False,
    landed_s: float = 3.0,
    silent_s: float = 2.0,
) -> None:
    """Wait for the flight to end, report its result, and begin the next with the next seed, until cancelled.

    Args:
        server: the server of the simulated drone.
        scenario: the scenario of the further flights.
        seed: the seed of the first flight.
        clock: the clock of the server.
        say: called after each flight with `event="flight"`, its ending and its contact.
        faults: give each further flight the faults of a shipped fault scenario.
        landed_s: time for which the drone reports that it has landed, s.
        silent_s: time without any packet, s: long enough for a client to give up its estimate of the drone's state, since on the
            ground it commands the motors off.
    """
    while True:
        before, stood_s = server.counters.copy(), server.stood_still_s
        ended = await _end(server, clock)
        frames = {f"frames_{what}": server.counters[f"video_{what}"] - before[f"video_{what}"] for what in ("sent", "due")}
        load = {**frames, "stood_still_s": round(server.stood_still_s - stood_s, 3)}
        say(event="flight", seed=seed, ended=ended, **_result(server.world), **load)
        seed += 1
        following = faulty(scenario, seed) if faults else scenario
        rested = clock.now()
        world = await asyncio.to_thread(_prepared, following, seed)
        await clock.sleep(max(0.0, landed_s - seconds_between(rested, clock.now())))
        server.silent = True
        await clock.sleep(silent_s)
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
    world.vehicle.cut_motors()
    return "time is up"


def _result(world: World) -> dict[str, Any]:
    """Return what the simulator knows of the flight's result."""
    truth, scenario, vehicle = world.truth(), world.scenario, vehicle_model(world.scenario)
    touched = truth.touchdown
    return {
        "title": scenario.title,
        "expect": scenario.expect,
        "duration_s": round(seconds_between(world.started, truth.at), 3),
        "surface": None if touched is None else touched.surface,
        "on_pad": touched is not None and touched.on_pad,
        "lateral_m": None if touched is None else round(touched.lateral_m, 4),
        "unsafe": list(unsafe_contacts(truth.contacts, vehicle.contact, vehicle.airframe())),
        "left_alone": world.faults.left_alone,
    }


def _prepared(scenario: Scenario, seed: int) -> World:
    """Return a world whose textures are already computed."""
    world = World(scenario, seed)
    world.render()
    return world


_SWITCH_INTERVAL_S = 0.0005
"""Longest time for which the rendering thread may hold the interpreter, s; Python's default of 5 ms is a whole period of navdata.
"""


async def serve(
    scenario: Scenario,
    seed: int,
    host: str = "127.0.0.1",
    ports: Ports | None = None,
    truth_path: Path | None = None,
    habits: Habits | None = None,
    *,
    repeat: bool = False,
    faults: bool = False,
) -> None:
    """Fly `scenario` until ordered to end.

    Args:
        repeat: begin a new flight with the next seed after each one.
        faults: give each of the further flights a fault.

    Raises:
        Recoverable: a port is in use.
        BadInput: the truth log cannot be written.
    """
    end = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, end.set)
    clock = SystemClock()
    world = World(scenario, seed, start=clock.now())
    try:
        async with ArDroneServer(world, host, ports, clock, truth_path=truth_path, habits=habits) as server:
            _say(
                event="ready",
                host=host,
                ports=asdict(server.ports),
                started_ns=int(world.started),
                truth=None if truth_path is None else str(truth_path),
            )
            parent = await _watch_parent(end)
            async with asyncio.TaskGroup() as group:
                if repeat:
                    flights = group.create_task(fly_repeatedly(server, scenario, seed, clock, _say, faults=faults))
                await end.wait()
                if repeat:
                    flights.cancel()
            if parent is not None:
                parent.close()
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.remove_signal_handler(number)
    _say(
        event="ended",
        phase=server.world.phase.name.lower(),
        stood_still_s=round(server.stood_still_s, 3),
        counters=dict(server.counters + server.drone.counters + server.drone.state.counters),
    )


def main(argv: list[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    usual = Ports()
    parser = argparse.ArgumentParser(
        prog="python -m sitl.emulators.ardrone.serve", description="An AR.Drone over a simulated ship"
    )
    parser.add_argument("scenario", help="a shipped scenario's name or a TOML file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--host", default="127.0.0.1")
    for name in ("navdata", "video", "at", "control"):
        parser.add_argument(f"--{name}-port", type=int, default=getattr(usual, name), help="0 for any; %(default)s unless given")
    parser.add_argument("--truth", type=Path, metavar="FILE", help="write what really happens, one JSON object a line")
    parser.add_argument("--ardrone1", action="store_true", help="be an AR.Drone 1.0 with its camera, whatever the scenario says")
    parser.add_argument(
        "--frames-hz", type=float, default=30.0, metavar="HZ", help="rate of a 1.0's frames; %(default)s unless given"
    )
    parser.add_argument("--pave-header", type=int, choices=(64, 68, 76), default=Habits().pave_header_size)
    parser.add_argument("--repeat", action="store_true", help="after each flight begin another, with the next seed")
    parser.add_argument("--faults", action="store_true", help="with --repeat: give each further flight a fault")
    asked = parser.parse_args(argv)
    ports = Ports(asked.navdata_port, asked.video_port, asked.at_port, asked.control_port)
    try:
        if asked.seed < 0:
            raise BadInput(f"--seed must be 0 or more, got {asked.seed}")
        if not 1.0 <= asked.frames_hz <= 60.0:
            raise BadInput(f"--frames-hz must be from 1 to 60, got {asked.frames_hz}")
        scenario = with_ardrone1(load(asked.scenario)) if asked.ardrone1 else load(asked.scenario)
        generation = GENERATIONS[scenario.vehicle.generation]
        generation.check_camera(camera_model(scenario))
        habits = Habits(generation, asked.pave_header, round(asked.frames_hz))
        if not real_time(scenario):
            kinds = ", ".join(sorted(str(kind.__struct_config__.tag) for kind in VIRTUAL_ONLY))
            raise BadInput(f"{asked.scenario}: {kinds} and in_phase are for flights in virtual time (decklander simulate)")
        flights = {"repeat": asked.repeat, "faults": asked.faults}
        asyncio.run(serve(scenario, asked.seed, asked.host, ports, asked.truth, habits, **flights))
    except DecklanderError as why:
        print(f"decklander: {why}", file=sys.stderr)
        return 2 if isinstance(why, BadInput) else 1
    return 0


def _say(**what: Any) -> None:
    try:
        print(json.dumps(what, separators=(",", ":")), flush=True)
    except BrokenPipeError:
        # Nobody reads standard output any more; the text left in the buffer must not raise again at exit.
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115


async def _watch_parent(end: asyncio.Event) -> asyncio.ReadTransport | None:
    """Set `end` when the pipe on standard input closes. Return None if standard input is not a pipe."""
    try:
        mode = os.fstat(sys.stdin.fileno()).st_mode
    except (OSError, ValueError, AttributeError):
        return None
    if not (stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode)):
        return None
    transport, _ = await asyncio.get_running_loop().connect_read_pipe(lambda: _Parent(end), sys.stdin)
    return transport


class _Parent(asyncio.Protocol):
    def __init__(self, end: asyncio.Event) -> None:
        self._end = end

    def connection_lost(self, exc: Exception | None) -> None:
        self._end.set()


if __name__ == "__main__":
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    sys.exit(main())
