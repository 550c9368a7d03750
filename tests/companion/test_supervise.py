"""Parts restart alone and bugs end the group; a held loop is named; systemd is notified of what the service is about."""

import asyncio
import gc
import itertools
import logging
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import aiohttp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.base import event_loop
from companion.base.containment import RESTART, contain, keep_alive, run
from companion.base.health import Delays, Health
from companion.base.http_server import HttpServer
from companion.base.loop_lag import HELD_S, LAG_EDGES_S, STOOD_S, LoopWatch
from companion.base.memory import GroundedCollector, no_full_collections
from companion.base.observer import Decision, Observer
from companion.base.watchdog import Manager, Pulse, stuck, watchdog_interval_s
from companion.cycle.pace import FramePace
from companion.guidance.pilot import Look, Pilot
from companion.parts.metrics.endpoint import MetricsEndpoint
from companion.parts.recorder.setup import about, recorder_to_file
from companion.recording.reading import open_recording
from companion.service.daemon import Daemon, DaemonSetup
from companion.settings.guidance import GuidanceOptions
from companion.settings.links import HttpSettings
from companion.settings.load import camera_model
from companion.tools.replay.recorded_log import log_of
from drivers.clock import SystemClock
from drivers.reconnect import BackOff
from estimator.contracts.errors import BadInput, Recoverable
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs, after, seconds_between
from estimator.options import EstimatorOptions
from tests.companion.test_daemon import CLOCK, EYES, FakeVehicle
from tests.fly import sim_settings
from tests.support.clocks import SleepingClock
from tests.support.waiting import listening, until


async def test_a_recoverable_failure_restarts_that_part_alone_with_growing_rests() -> None:
    clock = SleepingClock()
    health = Health(clock)
    lives = {"weak": 0, "strong": 0}

    async def weak() -> None:
        lives["weak"] += 1

        async def inner() -> None:
            if lives["weak"] <= 5:
                raise Recoverable("cable")

        async with asyncio.TaskGroup() as group:
            group.create_task(inner())

    async def strong() -> None:
        lives["strong"] += 1

    await run({"weak": weak, "strong": strong}, BackOff(0.2, 1.0, 5.0), health, clock)
    assert lives == {"weak": 6, "strong": 1}
    assert clock.slept == [0.2, 0.4, 0.8, 1.0, 1.0]
    assert (health.parts["weak"].restarts, health.parts["weak"].last_error) == (5, "cable")
    assert health.parts["strong"].restarts == 0


async def test_a_part_that_was_healthy_for_long_rests_shortly_again() -> None:
    clock = SleepingClock()
    lives = 0

    async def body() -> None:
        nonlocal lives
        lives += 1
        if lives == 3:
            clock.advance(10.0)
        if lives < 5:
            raise Recoverable("gone")

    await keep_alive("part", body, BackOff(0.1, 9.0, 5.0), Health(clock), clock)
    assert clock.slept == [0.1, 0.2, 0.1, 0.2]


@pytest.mark.parametrize(("error", "found"), [(KeyError("ours"), KeyError), (asyncio.CancelledError(), RuntimeError)])
async def test_a_bug_or_a_cancellation_that_nobody_requested_takes_everything_down(error, found) -> None:
    clock = SleepingClock()
    stopped = asyncio.Event()

    async def buggy() -> None:
        await asyncio.sleep(0)
        raise error

    async def innocent() -> None:
        try:
            await asyncio.sleep(3600)
        finally:
            stopped.set()

    with pytest.raises(ExceptionGroup) as caught:
        await run({"buggy": buggy, "innocent": innocent}, RESTART, Health(clock), clock)
    assert caught.value.subgroup(found) is not None
    assert stopped.is_set()


def test_a_vital_part_whose_task_calls_sys_exit_ends_loudly_after_the_others_have_ended_in_order() -> None:
    """It was exit code 0 without a word, for which systemd starts nothing again."""
    ended = []

    async def vehicle() -> None:
        async def child() -> None:
            sys.exit(0)

        async with asyncio.TaskGroup() as group:
            group.create_task(child())

    async def guidance() -> None:
        try:
            await asyncio.sleep(3600)
        finally:
            await asyncio.sleep(0)
            ended.append("guidance")

    clock = SleepingClock()
    with pytest.raises(ExceptionGroup) as caught:
        event_loop.run(run({"vehicle": vehicle, "guidance": guidance}, RESTART, Health(clock), clock))
    assert [str(why) for why in caught.value.exceptions] == ["vehicle called sys.exit(0)"]
    assert ended == ["guidance"]


async def test_a_part_beside_the_flight_that_does_not_end_is_abandoned(caplog: pytest.LogCaptureFixture) -> None:
    swallowed = 0

    async def stubborn() -> None:
        nonlocal swallowed
        while swallowed < 1000:
            try:
                await asyncio.sleep(3600)
            except asyncio.CancelledError:
                swallowed += 1

    async def vital() -> None:
        await asyncio.sleep(0)

    before = asyncio.all_tasks()
    await run({"vital": vital}, RESTART, Health(SleepingClock()), SleepingClock(), beside={"stubborn": stubborn})
    assert swallowed == 1
    assert "stubborn did not end within 1.0 s and is abandoned" in caplog.text
    swallowed = 1000
    for task in asyncio.all_tasks() - before:
        task.cancel()


async def test_the_vital_parts_have_ended_before_the_others_are_ordered_to() -> None:
    output: list[str] = []

    async def part(name: str) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(0.01)
            output.append(name)

    ended = asyncio.Event()
    asyncio.get_running_loop().call_soon(ended.set)
    parts, clock = {"vehicle": lambda: part("vehicle")}, SleepingClock()
    await run(parts, RESTART, Health(clock), clock, until=ended, beside={"mqtt": lambda: part("mqtt")})
    assert output == ["vehicle", "mqtt"]


async def test_a_failing_part_has_one_traceback_in_the_log_however_often_it_fails(caplog: pytest.LogCaptureFixture) -> None:
    health = Health(SleepingClock())

    async def body() -> None:
        raise KeyError("ours")

    await contain("mqtt", body, RESTART, health, SleepingClock())
    assert sum(record.exc_info is not None for record in caplog.records) == 1
    assert health.contained["mqtt"] == 10
    assert health.fault(of_flight=True) is None
    assert health.fault() == "mqtt is down: off after 10 failures: 'ours'"


def on_one_core(pace: FramePace, health: Health, span_s: tuple[int, int], look_ms: float, cycle_ms: float) -> tuple[int, float]:
    """Return the looks (at 30 frames a second) and the mean lateness of cycles (at 50 Hz), s, of one core that both share."""
    looks, late_s, look, cycle, looked, began = 0, list[float](), 0.0, 0.0, MonoNs(0), 1000 * span_s[0]
    for ms in range(began, 1000 * span_s[1]):
        now = MonoNs(1_000_000 * ms)
        if ms % 33 == 0:
            seen = look <= 0.0 and pace.admits(now)
            health.frame(Verdict.FUSED if seen else Verdict.SKIPPED)
            if seen:
                looks, look, looked = looks + 1, look_ms, now
        if cycle <= 0.0 and ms >= began + 20:
            late_s.append(1e-3 * (ms - began - 20))
            pace.cycle(now, late_s[-1])
            cycle, began = cycle_ms, ms
        share = 0.5 if look > 0.0 < cycle else 1.0
        if 0.0 < look <= share:
            pace.looked(looked, seconds_between(looked, now))
        look, cycle = look - share, cycle - share
    return looks, float(np.mean(late_s))


def test_a_slow_computer_looks_at_as_many_frames_as_leave_guidance_its_time_and_says_so_until_it_keeps_up_again() -> None:
    health = Health(SleepingClock())
    pace = FramePace(0.7, camera_model(sim_settings()), health)
    assert (on_one_core(pace, health, (0, 10), 6.0, 2.0)[0], health.too_slow) == (304, None)
    looks, late_s = on_one_core(pace, health, (10, 40), 66.0, 22.0)
    assert health.too_slow == "this computer manages 3 of 30 frames a second: choose 320x180"
    assert looks >= 90
    assert late_s < 0.01
    on_one_core(pace, health, (40, 55), 6.0, 2.0)
    assert (on_one_core(pace, health, (55, 60), 6.0, 2.0)[0], health.too_slow) == (152, None), "each frame again, once it can"
    assert on_one_core(pace, health, (60, 70), 45.0, 0.0)[0] == pytest.approx(10 * 0.7 / 0.045, abs=8), "the rest is for others"
    assert on_one_core(pace, health, (70, 80), 900.0, 0.0)[0] >= 9, "and no pause is longer than a fifth of a second"


def test_a_full_collection_happens_on_the_ground_alone() -> None:
    collector = GroundedCollector()
    for at_s, flying, collections in (
        (0, False, 0),
        (59, None, 0),
        (61, True, 0),
        (600, True, 0),
        (601, False, 1),
        (630, None, 1),
    ):
        collector.tick(after(MonoNs(0), at_s), flying)
        assert collector.collections == collections, (at_s, flying)


def test_the_interpreter_starts_no_full_collection_while_the_service_runs() -> None:
    """A list of many young objects that stay makes the interpreter look through the oldest generation, as a flight's do."""
    fulls: list[int] = []

    def seen(phase: str, info: dict[str, int]) -> None:
        if phase == "start" and info["generation"] == 2:
            fulls.append(1)

    def churn() -> list[list[int]]:
        return [[n] for n in range(300_000)]

    before = gc.get_threshold()
    gc.callbacks.append(seen)
    try:
        kept = churn()
        assert fulls, "or this test proves nothing"
        with no_full_collections():
            fulls.clear()
            kept += churn()
            assert not fulls
    finally:
        gc.callbacks.remove(seen)
    assert gc.get_threshold() == before
    assert len(kept) == 600_000


@given(st.lists(st.floats(0.0, 20.0), min_size=1, max_size=300), st.floats(0.01, 1.0))
def test_a_quantile_is_known_to_five_percent(values: list[float], q: float) -> None:
    lags = Delays(LAG_EDGES_S)
    for value in values:
        lags.add(value)
    ordered = sorted(values)
    true = next(v for n, v in enumerate(ordered, 1) if n >= q * len(ordered) - 1e-9)
    assert lags.worst_s == ordered[-1]
    assert true <= lags.quantile(q) + 1e-12
    assert lags.quantile(q) <= max(1.05 * true, 1e-4) + 1e-12


def watch(flying: bool = False) -> tuple[LoopWatch, Health, list[str]]:
    health, held = Health(SystemClock()), list[str]()
    return LoopWatch(health, lambda: flying, lambda: held.append("hold")), health, held


async def test_a_long_hold_is_named_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    def grinds_the_loop() -> None:
        end = time.monotonic() + 3 * HELD_S
        while time.monotonic() < end:
            sum(range(1000))

    watching, health, held = watch(flying=True)
    task = asyncio.create_task(watching.run())
    await asyncio.sleep(0.1)
    assert watching.lags.count >= 1
    grinds_the_loop()
    await asyncio.sleep(0.1)
    task.cancel()
    reported = [r.getMessage() for r in caplog.records if "was held for" in r.getMessage()]
    assert len(reported) >= 1
    assert any("grinds_the_loop (test_supervise.py:" in text for text in reported)
    counts = health.snapshot().counters["loop"]
    assert counts["held"] >= 1
    assert counts["lag_worst_s"] >= 2 * HELD_S
    assert held == []


@pytest.mark.parametrize(
    ("flying", "late_s", "away_s", "said", "holds"),
    [
        (True, 0.0, 20.0, "this computer was suspended for 20.0 s: the drone is commanded to hold", 1),
        (
            True,
            3.0,
            3.0,
            "the service stood still (stopped, or without processor time) for 3.0 s: the drone is commanded to hold",
            1,
        ),
        (False, 0.0, 20.0, "this computer was suspended for 20.0 s", 0),
        (True, STOOD_S - 0.1, STOOD_S - 0.1, "was held for 1.90 s", 0),
    ],
)
def test_a_standstill_holds_what_flies(flying, late_s, away_s, said, holds, caplog):
    watching, _, held = watch(flying)
    watching._worked_s = time.process_time()
    with caplog.at_level(logging.WARNING):
        watching._note(late_s, away_s)
    assert said in caplog.messages[-1]
    assert caplog.messages[-1].endswith("hold") == (holds == 1)
    assert len(held) == holds


def test_each_flight_has_its_own_worst() -> None:
    flies = [False]
    health = Health(SystemClock())
    watching = LoopWatch(health, lambda: flies[0], lambda: None)
    watching._note(0.15, 0.17)
    flies[0] = True
    watching._note(0.01, 0.03)
    watching._note(0.02, 0.04)
    assert watching.counts()["lag_worst_s"] == 0.02
    flies[0] = False
    watching._note(0.001, 0.02)
    assert watching.counts()["lag_worst_s"] == 0.02, "it is told until the next flight"


def test_a_recorded_flight_says_in_its_report_how_late_the_loop_was(tmp_path: Path) -> None:
    health, settings = Health(SystemClock()), sim_settings()
    watching = LoopWatch(health, lambda: True, lambda: None)
    for late_s in (*[0.002] * 2000, 0.3):
        watching._note(late_s, late_s)
    with recorder_to_file(tmp_path / "flight.mcap", camera_model(settings), about(settings, {"kind": "test"}), live=True) as kept:
        kept.watch(health)
        kept.on_decision(Decision(health.now(), "search", None, None))
    facts = dict(log_of(open_recording([tmp_path / "flight.mcap"]), "one").facts)
    assert facts["event loop"] == "late by at most 300 ms, 99.9 % within 2.1 ms, held longer than 0.2 s 1 times"


async def test_a_wall_clock_that_is_set_is_reported_once(caplog, monkeypatch):
    ahead, real = [0.0], time.time
    monkeypatch.setattr(time, "time", lambda: real() + ahead[0])
    watching, *_ = watch()
    task = asyncio.create_task(watching.run())
    await asyncio.sleep(0.05)
    ahead[0] = 200 * 86400.0
    await asyncio.sleep(0.1)
    task.cancel()
    reported = [m for m in caplog.messages if "wall clock" in m]
    assert reported == ["the wall clock was set by +17280000.0 s: the flight does not go by it"]


class Systemd:
    """The other end of $NOTIFY_SOCKET."""

    def __init__(self, path: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind("\0" + path[1:] if path.startswith("@") else path)
        self.socket.setblocking(False)
        self.messages: list[dict[str, str]] = []

    def read(self) -> list[dict[str, str]]:
        """Everything received so far."""
        while True:
            try:
                text = self.socket.recv(4096).decode()
            except BlockingIOError:
                return self.messages
            self.messages.append(dict(line.split("=", 1) for line in text.splitlines()))

    def pings(self) -> int:
        return sum("WATCHDOG" in said for said in self.read())


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[Systemd]:
    listening = Systemd(str(tmp_path / "notify"))
    yield listening
    listening.socket.close()


def watched(
    vehicle: FakeVehicle, pilot: Pilot, address: str, interval_s: float | None, more: tuple[Observer, ...] = ()
) -> Daemon:
    health = Health(CLOCK)
    pulse = Pulse(Manager(address), health, CLOCK, lambda: bool(pilot.vehicle and pilot.vehicle.flying), interval_s)
    setup = DaemonSetup(BackOff(0.01, 0.01, 5.0, 1.0), 50.0)
    extras = {"manager": pulse.run}
    return Daemon(vehicle.open, pilot, CLOCK, setup, observers=(*more, pulse), health=health, extras=extras)


def pilot_of() -> Pilot:
    return Pilot(EYES, EstimatorOptions(), GuidanceOptions())


async def test_ready_once_then_pings_then_stopping(systemd: Systemd) -> None:
    daemon = watched(FakeVehicle(), pilot_of(), systemd.socket.getsockname(), 0.2)
    async with asyncio.TaskGroup() as group:
        group.create_task(daemon.run())
        await until(lambda: systemd.pings() >= 4)
        daemon.stop()
    output = systemd.read()
    assert output[0]["READY"] == "1"
    assert sum("READY" in one for one in output) == 1
    assert output[0]["STATUS"].startswith("waiting for the vehicle: no status from the vehicle yet, no attitude")
    assert output[-1]["STOPPING"] == "1"


async def test_an_image_that_vision_never_gives_back_ends_the_pings(systemd: Systemd, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("companion.base.watchdog.FRAME_S", 0.2)
    vehicle, pilot, begun, held = FakeVehicle(), pilot_of(), threading.Event(), threading.Event()
    look = pilot.detect

    def held_up(what: Look) -> object:
        begun.set()
        held.wait(100.0)
        return look(what)

    monkeypatch.setattr(pilot, "detect", held_up)
    daemon = watched(vehicle, pilot, systemd.socket.getsockname(), 0.1)
    try:
        async with asyncio.TaskGroup() as group:
            group.create_task(daemon.run())
            await until(lambda: vehicle.opened == 1 and systemd.pings() >= 3)
            for seq in itertools.count(1):  # a frame for which a busy machine has no attitude is done at once
                for _ in range(3):
                    vehicle.say(flying=True)
                    await asyncio.sleep(0.03)
                judged = daemon.health.frames.total()
                vehicle.film(seq)
                await until(lambda judged=judged: begun.is_set() or daemon.health.frames.total() > judged)
                if begun.is_set():
                    break
            await until(lambda: "vision has not been done" in systemd.read()[-1].get("STATUS", ""))
            stopped_at, rounds = systemd.pings(), daemon.health.flows["Decision"].count
            await until(lambda: daemon.health.flows["Decision"].count > rounds + 15)  # guidance itself goes on
            assert systemd.pings() == stopped_at, "fed although vision is stuck"
            held.set()
            await until(lambda: systemd.pings() > stopped_at)
            daemon.stop()
    finally:
        held.set()


def at_age(health: Health, flow: str, age_s: float) -> None:
    health.beat(flow)
    health.flows[flow]._recent[-1] = MonoNs(CLOCK.now() - round(age_s * 1e9))


@pytest.mark.parametrize(
    ("ages", "frames_done", "flying", "why"),
    [
        ({}, 0, False, "guidance has not begun"),
        ({"Decision": 2.0}, 0, False, "guidance has decided nothing"),
        ({"Decision": 0.0}, 0, False, None),
        ({"Decision": 0.0, "Frame": 5.0}, 0, True, "vision has not been done"),
        ({"Decision": 0.0, "Frame": 5.0}, 1, True, None),
        ({"Decision": 0.0, "Frame": 0.1}, 0, True, None),
        ({"Decision": 0.0, "Imu": 30.0}, 0, True, "no sample of the flying vehicle"),
        ({"Decision": 0.0, "Imu": 30.0, "Attitude": 0.1}, 0, True, None),
        ({"Decision": 0.0, "Imu": 30.0}, 0, False, None),
    ],
)
def test_what_counts_as_stuck(ages: dict[str, float], frames_done: int, flying: bool, why: str | None) -> None:
    health = Health(CLOCK)
    for flow, age_s in ages.items():
        at_age(health, flow, age_s)
    for _ in range(frames_done):
        health.frame(Verdict.NO_PAD)
    health.frame(Verdict.REPLACED)
    output = stuck(health.snapshot(), flying)
    assert output is None if why is None else output is not None and output.startswith(why)


def test_the_manager_is_found_as_systemd_writes_it_and_may_be_gone(tmp_path: Path) -> None:
    systemd = Systemd(f"@decklander-{tmp_path.name}-{id(tmp_path)}")
    manager = Manager.of({"NOTIFY_SOCKET": "@" + systemd.socket.getsockname()[1:].decode()})
    manager.say(STATUS="two\nlines", READY="1")
    assert systemd.read() == [{"STATUS": "two lines", "READY": "1"}]
    systemd.socket.close()
    manager.say(WATCHDOG="1")
    assert manager.lost == 1
    manager.close()
    assert Manager.of({}) is None
    with pytest.raises(BadInput, match="NOTIFY_SOCKET"):
        Manager.of({"NOTIFY_SOCKET": "vsock:2:1234"})
    assert watchdog_interval_s({}) is None
    assert watchdog_interval_s({"WATCHDOG_USEC": "5000000", "WATCHDOG_PID": "7"}, pid=7) == 5.0
    assert watchdog_interval_s({"WATCHDOG_USEC": "5000000", "WATCHDOG_PID": "8"}, pid=7) is None
    for wrong in ("0", "-5", "soon", "1e6"):
        with pytest.raises(BadInput, match="WATCHDOG_USEC"):
            watchdog_interval_s({"WATCHDOG_USEC": wrong})


async def test_the_health_check_of_a_container_sees_what_the_watchdog_sees() -> None:
    health = Health(CLOCK)
    health.up("guidance")
    server = HttpServer(HttpSettings(endpoint="http", port=0, page=False), health)
    MetricsEndpoint(server, health)
    async with listening(server) as port, aiohttp.ClientSession() as session:
        for age_s, status in ((0.0, 200), (30.0, 503), (0.0, 200)):
            at_age(health, "Decision", age_s)
            async with session.get(f"http://127.0.0.1:{port}/health") as answer:
                assert answer.status == status
                assert ("pipeline" in (await answer.json())["down"]) is (status == 503)
