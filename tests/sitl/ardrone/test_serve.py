"""The drone as a process: it says where it listens, and it always ends when it should."""

import asyncio
import json
import signal
import subprocess
import sys
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
import pytest

from drivers.ardrone.link import open_ardrone
from drivers.clock import SystemClock
from estimator.contracts.commands import Land
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import MonoNs, seconds_between
from sitl.emulators.ardrone import serve, truth_log
from sitl.emulators.ardrone.serve import fly_repeatedly
from sitl.emulators.ardrone.server import ArDroneServer, Ports
from sitl.perception.levels import perceive, represents
from sitl.perception.port import Perception
from sitl.scenario.scenario import Start
from sitl.scenario.scenario import load as load_scenario
from sitl.scenario.with_fault import faulty, real_time
from sitl.world.world import World
from tests.sitl.ardrone.peer import options_for
from tests.sitl.ardrone.point_mass import PointMass
from tests.support.clocks import PatientClock
from tests.support.processes import started
from tests.support.waiting import until

ANY = ("--navdata-port", "0", "--video-port", "0", "--at-port", "0", "--control-port", "0")


def start(*arguments: str, **options: Any) -> AbstractContextManager[subprocess.Popen[str]]:
    return started([sys.executable, "-m", "sitl.emulators.ardrone.serve", *arguments], stderr=subprocess.PIPE, **options)


@pytest.mark.parametrize("how", ["stdin closes", "SIGTERM"])
def test_it_ends_when_ordered_and_leaves_the_whole_truth(how: str, tmp_path: Path) -> None:
    truth = tmp_path / "truth.jsonl"
    with start("calm", "--truth", str(truth), *ANY, stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        ready = json.loads(process.stdout.readline())
        assert ready["event"] == "ready"
        assert len(set(ready["ports"].values())) == 4
        assert all(1024 < port < 65536 for port in ready["ports"].values())
        process.stdout.flush()
        if how == "SIGTERM":
            process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    ended = json.loads(out)
    assert ended["event"] == "ended"
    assert ended["phase"] == "hovering"
    assert ended["stood_still_s"] >= 0.0
    records = truth_log.read(truth)
    assert all(r["at_ns"] >= ready["started_ns"] for r in records)


@pytest.mark.parametrize(
    ("arguments", "code", "what"),
    [
        (("nowhere",), 2, "there is no file 'nowhere' and no shipped one"),
        (("calm", "--seed", "-1"), 2, "--seed must be 0 or more"),
        (("calm", "--truth", "/nowhere/at/all", *ANY), 2, "truth log /nowhere/at/all: No such file"),
    ],
)
def test_wrong_use_is_one_line(arguments: tuple[str, ...], code: int, what: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert serve.main(list(arguments)) == code
    output = capsys.readouterr()
    assert output.out == ""
    assert what in output.err
    assert output.err.count("\n") == 1


HOST = "127.0.0.1"


async def test_its_stamps_of_frames_agree_with_when_they_were_exposed() -> None:
    clock = SystemClock()
    world = PointMass(clock.now(), height_m=1.5)
    exposed: list[MonoNs] = []
    lags_ms: list[float] = []
    expose = world.expose

    def recorded() -> object:
        exposed.append(world.now)
        lags_ms.append((clock.now() - world.now) * 1e-6)
        return expose()

    world.expose = recorded  # type: ignore[assignment, method-assign]
    async with ArDroneServer(cast(World, world), HOST, Ports(0, 0, 0, 0), clock) as server:
        exposed.clear()  # the frame made before flight is no frame
        async with open_ardrone(options_for(server.ports), clock) as drone:
            await until(lambda: drone.ready)
            off_ms = []
            for _ in range(28):
                frame = await drone.frames.get()
                assert frame.px.shape == (360, 640, 3)
                off_ms.append((frame.stamp.measured_at - exposed[frame.seq - 1]) * 1e-6)
            # The drone of a busy machine lags behind its own clock, which no stamp can know. Late is one side: the quarter that
            # was least so is what the stamps are judged by.
            low, middle = np.percentile(off_ms[10:], [25, 50])
            assert abs(low) < 8.0 + 2.0 * np.median(lags_ms)
            assert middle - low < 5.0 + 2.0 * np.median(lags_ms)


CLOCK = SystemClock()
NEAR = msgspec.structs.replace(load_scenario("calm"), start=Start(height_m=0.8, pad_right_m=0.1, pad_forward_m=0.1))


async def test_each_flight_ends_and_another_begins_in_the_air_under_the_same_client() -> None:
    reported: list[dict[str, Any]] = []
    too_short = msgspec.structs.replace(NEAR, duration_limit_s=2.5)
    patient = PatientClock()
    async with ArDroneServer(World(too_short, 1, patient.now()), ports=Ports(0, 0, 0, 0), clock=patient) as server:
        first, done, changes = server.world, asyncio.Event(), [False]

        def tell(**what: Any) -> None:
            reported.append(what)
            if len(reported) == 3:
                done.set()

        # A driver that sets the drone up again misses what happens meanwhile: on a busy machine an answer may take its time.
        async with (
            asyncio.timeout(60),
            open_ardrone(options_for(server.ports, config_timeout_s=30.0), CLOCK) as drone,
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
            flights = group.create_task(fly_repeatedly(server, NEAR, 1, patient, tell, landed_s=0.3, silent_s=1.5))
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
