"""Measure how soon the service is ready, and its CPU load at a frame rate."""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from itertools import chain

from companion.guidance.make_pilot import make_pilot
from companion.service.daemon import Daemon, DaemonOptions, VehicleLink
from companion.settings.model import Settings, ardrone_options
from drivers.ardrone import at
from drivers.ardrone.navdata import Navdata
from drivers.ardrone.samples import NavdataSampler
from drivers.ardrone.setup import configuration_commands
from drivers.clock import SystemClock
from drivers.mailbox import Latest, Line
from estimator.contracts.commands import Command
from estimator.contracts.errors import Recoverable
from estimator.contracts.estimates import Verdict
from estimator.contracts.samples import Frame, Sample
from estimator.contracts.time import Stamp, after, seconds_between
from sitl.ardrone.drone import TICK_S, Drone, DroneClock
from sitl.scenario.scenario import Scenario
from sitl.world.truth import RenderedFrame
from sitl.world.world import World

_READY_S = 60.0
_FILM_S = 2.0
"""Length of the hover that is played forward and backward in turn, so that nothing jumps, s."""
_DELAY_S = 0.05
_SIGMA_S = 0.002


def start_time_s(config: str) -> float:
    """Return the seconds from starting `decklander run` to READY=1, which the first guidance cycle sends.

    Raises:
        Recoverable: it ended, or was not ready in a minute.
    """
    with tempfile.TemporaryDirectory(prefix="decklander-") as folder:
        path = f"{folder}/notify"
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
            manager.bind(path)
            manager.settimeout(0.2)
            began = time.monotonic()
            child = subprocess.Popen(
                [sys.executable, "-m", "companion.cli.main", "run", "--config", config],
                env={**os.environ, "NOTIFY_SOCKET": path},
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            try:
                while (spent := time.monotonic() - began) < _READY_S and child.poll() is None:
                    try:
                        if b"READY=1" in manager.recv(4096).split(b"\n"):
                            return time.monotonic() - began
                    except TimeoutError:
                        continue
                raise Recoverable(f"the daemon was not ready after {spent:.0f} s (exit code {child.poll()})")
            finally:
                child.terminate()
                child.wait()


@dataclass(frozen=True, slots=True)
class Cost:
    """CPU load and delay at a frame rate."""

    share: float
    """CPU time of the process over wall time, in shares of one core."""
    seen: float
    """Share of the frames that vision processed; newer ones replaced the others."""
    belief_p50_s: float | None
    """Median time from the arrival of a frame to the estimate, seconds."""


class _Reel:
    """A vehicle that hovers over the pad, with frames rendered beforehand."""

    def __init__(self, rate_hz: int, scenario: Scenario, settings: Settings, clock: SystemClock) -> None:
        world = World(scenario, 1)
        drone = Drone(world, DroneClock(world.now))
        asked = [(*commands, at.Ctrl(at.CTRL_ACK)) for _, commands in configuration_commands(ardrone_options(settings))]
        for n, command in enumerate(chain.from_iterable(asked)):
            drone.take(at.encode(n + 1, command), world.now)
        self._navdata: list[Navdata] = []
        self._images: list[RenderedFrame] = []
        self._clock, self._rate_hz = clock, rate_hz
        for tick in range(round(_FILM_S / TICK_S)):
            drone.tick(after(world.now, TICK_S))
            self._navdata.append(drone.navdata())
            if (tick + 1) * TICK_S * rate_hz >= len(self._images):
                self._images.append(world.render())
        self._sampler = NavdataSampler(ardrone_options(settings))
        self.frames: Latest[Frame] = Latest()
        self.samples: Line[Sample] = Line(settings.service.sample_queue_items)

    def command(self, command: Command) -> None:
        return None

    def release(self) -> None:
        return None

    @asynccontextmanager
    async def open(self) -> AsyncIterator[VehicleLink]:
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(self._speak()), group.create_task(self._film())]
            try:
                yield self
            finally:
                for task in tasks:
                    task.cancel()

    async def _speak(self) -> None:
        due, n = self._clock.now(), 0
        while True:
            now = self._clock.now()
            for sample in self._sampler.samples(
                self._navdata[_back_and_forth(n, len(self._navdata))], Stamp(now, now, _SIGMA_S, "sim")
            ):
                self.samples.offer(sample)
            due, n = after(due, TICK_S), n + 1
            await self._clock.sleep(max(0.0, seconds_between(self._clock.now(), due)))

    async def _film(self) -> None:
        due, n = self._clock.now(), 0
        while True:
            image, now = self._images[_back_and_forth(n, len(self._images))], self._clock.now()
            stamp = Stamp(after(now, -_DELAY_S), now, _SIGMA_S, "sim")
            self.frames.offer(Frame(stamp, n, image.px, image.exposure_s))
            due, n = after(due, 1.0 / self._rate_hz), n + 1
            await self._clock.sleep(max(0.0, seconds_between(self._clock.now(), due)))


async def cpu_at(rate_hz: int, scenario: Scenario, settings: Settings, duration_s: float = 15.0) -> Cost:
    """Run the service for `duration_s` at this frame rate and measure its load, without video decoding."""
    clock = SystemClock()
    reel = _Reel(rate_hz, scenario, settings, clock)
    daemon = Daemon(
        reel.open,
        make_pilot(settings),
        clock,
        DaemonOptions(settings.service, settings.guidance.rate_hz, threads=settings.vision.threads),
    )
    async with asyncio.TaskGroup() as group:
        group.create_task(daemon.run())
        await asyncio.sleep(1.0)
        began, spent, frames = time.monotonic(), time.process_time(), dict(daemon.health.frames)
        await asyncio.sleep(duration_s)
        share = (time.process_time() - spent) / (time.monotonic() - began)
        counted = {verdict: n - frames.get(verdict, 0) for verdict, n in daemon.health.frames.items()}
        daemon.stop()
    every = sum(counted.values())
    delay = daemon.health.delays.get("exposure_to_belief")
    p50_s = None if delay is None else delay.quantile(0.5)
    unseen = counted.get(Verdict.REPLACED, 0) + counted.get(Verdict.SKIPPED, 0)
    return Cost(share, 1.0 - unseen / every if every else 0.0, None if p50_s is None else p50_s - _DELAY_S)


def _back_and_forth(n: int, length: int) -> int:
    """Return the n-th item of 0, 1, ..., length - 1, length - 2, ..., 0, 1, ..."""
    if length < 2:
        return 0
    n %= 2 * (length - 1)
    return n if n < length else 2 * (length - 1) - n
