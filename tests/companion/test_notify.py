"""Notifications to systemd over a real datagram socket, by a daemon over a fake vehicle: pings stop with the pipeline."""

import asyncio
import itertools
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import aiohttp
import pytest

from companion.base.health import Health
from companion.base.http_server import HttpServer
from companion.base.liveness import Manager, Pulse, stuck, watchdog_interval_s
from companion.base.observer import Observer
from companion.guidance.pad_search import Look
from companion.guidance.pilot import Pilot
from companion.parts.metrics.endpoint import MetricsEndpoint
from companion.service.daemon import Daemon, DaemonSetup
from companion.settings.guidance import GuidanceOptions
from companion.settings.links import HttpSettings
from companion.settings.service import RestartOptions
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs
from estimator.options import EstimatorOptions
from tests.companion.test_daemon import CLOCK, EYES, FakeVehicle
from tests.support.waiting import listening, until


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
    setup = DaemonSetup(RestartOptions(0.01, 1.0, 0.01, 5.0), 50.0)
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
    monkeypatch.setattr("companion.base.liveness.FRAME_S", 0.2)
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
    assert manager is not None
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
