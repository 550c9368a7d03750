"""The daemon over fake ports in virtual time: a point mass under its commands, a pad that the pilot sees by truth."""

from __future__ import annotations

import asyncio
import heapq
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, nullcontext
from types import MappingProxyType
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from companion.cycle.ports import VehicleLink
from companion.guidance.pilot import Look, Pilot
from companion.service.daemon import Daemon
from companion.settings.guidance import GuidanceOptions
from drivers.mailbox import Latest, Line
from estimator.contracts.commands import Command, Velocity
from estimator.contracts.samples import Frame, Sample, VehicleStatus
from estimator.contracts.time import MonoNs, Stamp, after
from estimator.options import EstimatorOptions
from estimator.vision.detection import Detection
from tests.companion.test_daemon import EYES
from tests.make import attitude, imu, sighting, stamp_at, status, velocity

TICK_S = 0.01
NOISE = np.random.default_rng(0).integers(0, 9, (EYES.camera.height, EYES.camera.width, 3), np.uint8)
"""No frame, as a living camera has it: never the same twice."""


class VirtualClock:
    """Time passes when the flight says so."""

    def __init__(self) -> None:
        self.t = MonoNs(0)
        self._sleeping: list[tuple[MonoNs, int, asyncio.Future[None]]] = []
        self._count = 0

    def now(self) -> MonoNs:
        return self.t

    async def sleep(self, seconds: float) -> None:
        woken = asyncio.get_running_loop().create_future()
        self._count += 1
        heapq.heappush(self._sleeping, (after(self.t, seconds), self._count, woken))
        await woken

    async def pass_to(self, then: MonoNs) -> None:
        """Wake who sleeps until `then`, each at its own time."""
        while self._sleeping and self._sleeping[0][0] <= then:
            self.t, _, woken = heapq.heappop(self._sleeping)
            if not woken.done():
                woken.set_result(None)
            await settled()
        self.t = then
        await settled()


async def settled() -> None:
    """Everybody who can run has run."""
    for _ in range(12):
        await asyncio.sleep(0)


class SeeingPilot(Pilot):
    """Sees the pad where the fake vehicle knows it to be."""

    def __init__(self, vehicle: FakeFlight) -> None:
        super().__init__(EYES, EstimatorOptions(path="median_mean"), GuidanceOptions())
        self._truth = vehicle

    def detect(self, look: Look) -> Detection:
        seen = sighting(look.frame.stamp, -self._truth.p_level, seq=look.frame.seq)
        return Detection(seen, "arrow", MappingProxyType({}))


class FakeFlight:
    """A point mass, its sensors and its camera, as a driver would offer them."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self.p_level = np.array([-0.4, 0.3, -3.0])
        """(3,) m from the pad."""
        self._v_level = np.zeros(3)
        self.frames: Latest[Frame] = Latest()
        self.samples: Line[Sample] = Line(1000)
        self.commands: list[tuple[int, str]] = []
        """Time and command as text: equal text is an equal command to the bit."""
        self.left = 0
        self.push_up_m_s2 = 0.0
        """Specific force beyond that of flight, such as a deck's."""

    def command(self, command: Command) -> None:
        self.commands.append((int(self._clock.now()), repr(command)))
        self._v_level = np.asarray(command.v_level) if isinstance(command, Velocity) else np.zeros(3)

    def release(self) -> None:
        self.released = True

    @asynccontextmanager
    async def open(self) -> AsyncIterator[VehicleLink]:
        self.released = False
        try:
            yield self
        finally:
            self.left += 1

    def status(self, stamp: Stamp) -> VehicleStatus:
        return status(stamp)

    def tick(self, n: int) -> None:
        self.p_level = self.p_level + TICK_S * self._v_level
        self.sense(n)
        if n % 4 == 3:
            now = self._clock.now()
            self.frames.offer(Frame(stamp_at(now - 10_000_000, now), n, self.picture(n)))

    def picture(self, n: int) -> NDArray[np.uint8]:
        return np.roll(NOISE, n, axis=0)

    def sense(self, n: int) -> None:
        stamp = stamp_at(self._clock.now())
        noise = np.random.default_rng(n).normal(0.0, 1e-3, (4, 3))  # a sensor that repeats itself is not believed
        self.samples.offer(imu(stamp, noise[0], np.array([0.0, 0.0, -9.80665 - self.push_up_m_s2]) + noise[1]))
        if n % 2 == 0:
            self.samples.offer(self.status(stamp))
            self.samples.offer(attitude(stamp, *(0.1 * noise[2]), var=1e-5))
            self.samples.offer(velocity(stamp, self._v_level + noise[3]))


@patch("companion.service.daemon.no_full_collections", nullcontext)  # in virtual time a collection takes none
async def fly(daemon: Daemon, vehicle: FakeFlight, clock: VirtualClock, seconds: float) -> list[tuple[int, str]]:
    """Return the commands of that much flight. The daemon must still be alive at the end, and end well."""
    task = asyncio.create_task(daemon.run())
    await settled()
    for n in range(round(seconds / TICK_S)):
        await clock.pass_to(after(clock.now(), TICK_S))
        vehicle.tick(n)
        await settled()
        while daemon.looking and not task.done():  # noqa: ASYNC110 (the thread of vision)
            await asyncio.sleep(0)
        await settled()
    assert not task.done(), task.exception()
    daemon.stop()
    closing = asyncio.create_task(_pass(clock))
    await task
    closing.cancel()
    assert vehicle.left == 1
    return vehicle.commands


async def _pass(clock: VirtualClock) -> None:
    while True:
        await clock.pass_to(after(clock.now(), TICK_S))
        await asyncio.sleep(0.001)
