"""Time that the physics makes, frames that wait for nobody and for whom the world waits, and programs that are always ended."""

import asyncio
import stat
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from msgspec.structs import replace

from estimator.contracts.errors import Recoverable
from estimator.contracts.samples import Frame
from estimator.contracts.time import seconds_between
from sitl.emulators.autopilots.body import Body
from sitl.emulators.autopilots.lock_step import CameraTiming, LockStepCamera, LockStepClock
from sitl.emulators.autopilots.program import reserved_port, running
from sitl.faults.fault import FaultTimer
from sitl.faults.faulty_streams import VehicleStreams
from sitl.scenario.scenario import load
from tests.support.processes import alive
from tests.support.waiting import until

STEP_S = 0.005


async def test_sleepers_wake_in_the_order_of_their_time_and_not_before_it() -> None:
    clock = LockStepClock()
    woke: list[tuple[str, float]] = []

    async def sleeper(name: str, seconds: float) -> None:
        await clock.sleep(seconds)
        woke.append((name, seconds_between(clock.started, clock.now())))

    async with asyncio.TaskGroup() as group:
        for name, seconds in (("late", 0.03), ("early", 0.01), ("at once", 0.0)):
            group.create_task(sleeper(name, seconds))
        await clock.settle()
        assert not woke, "time stands still"
        for _ in range(4):
            clock.advance(0.01)
            await clock.settle()
    assert woke == [("at once", pytest.approx(0.01)), ("early", pytest.approx(0.01)), ("late", pytest.approx(0.03))]


async def filmed(timing: CameraTiming, eyes_s: float | None, seconds: float) -> tuple[LockStepCamera, list[Frame], LockStepClock]:
    """Return a camera over the deck; eyes that take so long of wall time for each frame, or wait for the time to go on."""
    clock, frames, done = LockStepClock(), [], [0]
    scenario = load("calm")
    body = Body(replace(scenario, start=replace(scenario.start, height_m=1.0)), 1, STEP_S)
    loop = asyncio.get_running_loop()

    def offer(frame: Frame) -> None:
        frames.append(frame)
        if eyes_s is not None:
            loop.call_later(eyes_s, lambda: done.__setitem__(0, done[0] + 1))

    def looking() -> bool:
        return eyes_s is not None and done[0] < len(frames)

    with ThreadPoolExecutor(1) as pool:
        camera = LockStepCamera(clock, offer, lambda: done[0], looking, pool, VehicleStreams(FaultTimer(()), 1).frames, timing)
        camera.on = True
        for _ in range(round(seconds / STEP_S)):
            body.step((0.4, 0.4, 0.4, 0.4))
            clock.advance(STEP_S)
            camera.stepped(body)
            await camera.settle()
    return camera, frames, clock


@pytest.mark.parametrize("eyes_s", [0.03, 0.4])
async def test_images_arrive_late_by_their_delay_and_at_their_rate_however_slow_the_eyes(eyes_s: float) -> None:
    camera, frames, clock = await filmed(CameraTiming(period_s=0.05, delay_s=0.04, vision_s=0.02), eyes_s, 0.4)
    assert camera.waited_out == 0
    assert [f.stamp.delay_s for f in frames] == pytest.approx([0.04] * len(frames))
    exposed = [seconds_between(clock.started, f.stamp.measured_at) for f in frames]
    assert exposed == pytest.approx([0.005 + 0.05 * n for n in range(8)])
    assert [f.seq for f in frames] == list(range(1, 9))
    assert frames[0].px.shape == (360, 640, 3)


async def test_the_world_goes_on_when_the_service_waits_for_the_time() -> None:
    camera, frames, _ = await filmed(CameraTiming(period_s=0.05, delay_s=0.01, vision_s=0.01), None, 0.07)
    assert len(frames) >= 1
    assert camera.waited_out > 0


def script(folder: Path, body: str) -> Path:
    path = folder / "program"
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


async def test_a_stubborn_program_and_its_children_are_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl.emulators.autopilots.program._END_S", 0.2)
    binary = script(tmp_path, "trap '' TERM\nsleep 60 &\necho $$ $! > ids\nwhile :; do sleep 1; done")
    async with asyncio.timeout(60), running([str(binary)], tmp_path):
        await until(lambda: (tmp_path / "ids").exists() and (tmp_path / "ids").read_text().endswith("\n"))
    numbers = [int(word) for word in (tmp_path / "ids").read_text().split()]
    assert len(numbers) == 2
    await until(lambda: not any(map(alive, numbers)))


async def test_a_program_that_ends_is_reported_with_its_reason(tmp_path: Path) -> None:
    binary = script(tmp_path, "echo first; echo no such model >&2; exit 3")
    async with running([str(binary)], tmp_path) as program:
        with pytest.raises(Recoverable, match=r"code 3.*no such model"):
            await program.ended()


def test_a_reserved_port_is_nobody_elses_until_it_is_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    with reserved_port() as port:
        assert port < int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0]), "or the system hands it out"
        monkeypatch.setattr("sitl.emulators.autopilots.program._PORTS", range(port, port + 1))
        with pytest.raises(Recoverable, match=f"each port from {port} to {port}"), reserved_port():
            pass
    with reserved_port() as again:
        assert again == port
