"""Measure the CPU time of the service's event loop without video, in virtual time: python -m benches.service_loop.

200 navdata datagrams of 28 options a second pass the driver, guard, filter, health and 50 guidance cycles a second. No second is
waited for, so a loaded machine measures it as well as a quiet one; reading sockets and waking up are left out.
"""

import argparse
import asyncio
import logging
import math
import selectors
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from msgspec.structs import replace

from companion.guidance.make_pilot import make_pilot
from companion.service.daemon import Daemon, DaemonSetup, VehicleLink
from companion.settings.load import load
from companion.settings.restart import RestartOptions
from drivers.ardrone import navdata as nd
from drivers.ardrone.counters import Counters
from drivers.ardrone.navdata_channel import NavdataChannel
from drivers.ardrone.navdata_layout import LAYOUT_OF_CLASS
from drivers.ardrone.options import ArDroneOptions
from drivers.mailbox import Latest, Line
from estimator.contracts.commands import Command
from estimator.contracts.samples import Frame, Sample
from estimator.contracts.time import NS_PER_S, MonoNs

PERIOD_S = 0.005


class VirtualTime(selectors.DefaultSelector):
    """A selector, and the clock of its loop: a wait ends at once and moves the time, except that threads get a moment."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 1000.0
        self.threads_work = True

    def select(self, timeout: float | None = None) -> Any:
        ready = super().select(0)
        if not ready and timeout:
            if self.threads_work:
                time.sleep(min(timeout, 0.002))
            self.now_s += timeout
        return ready

    def now(self) -> MonoNs:
        return MonoNs(round(self.now_s * NS_PER_S))

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)


class Vehicle:
    """A link that takes commands, holds samples, and has the frames that are put in."""

    def __init__(self, samples: Line[Sample]) -> None:
        self.frames: Latest[Frame] = Latest()
        self.samples = samples

    def command(self, command: Command) -> None:
        pass

    def release(self) -> None:
        pass

    @asynccontextmanager
    async def open(self) -> AsyncIterator[VehicleLink]:
        yield self


def datagrams(n: int) -> list[bytes]:
    """Return datagrams of a drone that hovers and sways a little."""
    rest = {layout.tag: layout.unpack(bytes(layout.size), 0) for layout in LAYOUT_OF_CLASS.values()}
    demo, measures = LAYOUT_OF_CLASS[nd.Demo].tag, LAYOUT_OF_CLASS[nd.PhysMeasures].tag
    hovers = nd.ControlState.HOVERING.word
    out = []
    for i in range(n):
        a = 0.02 * i
        options = rest | {
            LAYOUT_OF_CLASS[nd.NavdataTime].tag: nd.NavdataTime.of_us(round(1e6 * (10.0 + PERIOD_S * i))),
            demo: replace(
                rest[demo], ctrl_state=hovers, battery_percent=80, theta_mdeg=1e3 * math.sin(a), phi_mdeg=900.0 * math.cos(a),
                vx_mm_s=20.0 * math.sin(a), vy_mm_s=9.0 * math.cos(a), altitude_mm=2000,
            ),
            measures: replace(
                rest[measures], phys_accs_mg=(10.0 * math.sin(i), 5.0 + i % 3, -1000.0 + i % 5),
                phys_gyros_deg_s=(math.sin(i), math.cos(i), 0.1 * (i % 7)),
            ),
        }  # fmt: skip
        out.append(nd.encode(nd.Navdata(1, i + 1, 1, options)))
    return out


async def measured(clock: VirtualTime, seconds: int) -> float:
    """Return the CPU time of the loop's thread for each second of the flight, s."""
    vehicle, settings = Vehicle(Line(1000)), load("sim")
    daemon = Daemon(vehicle.open, make_pilot(settings), clock, DaemonSetup(RestartOptions(), 50.0))

    def received(navdata: nd.Navdata, samples: list[Sample], at: MonoNs) -> None:
        for sample in samples:
            vehicle.samples.offer(sample)

    channel = NavdataChannel(ArDroneOptions(), clock, Counters(), received, lambda: None)
    flight = datagrams(round(seconds / PERIOD_S))
    async with asyncio.TaskGroup() as group:
        group.create_task(daemon.run())
        while daemon.looking or "Decision" not in daemon.health.flows:  # noqa: ASYNC110 - vision loads on its thread
            await asyncio.sleep(0.02)
        clock.threads_work = False
        began = time.thread_time()
        for datagram in flight:
            await asyncio.sleep(PERIOD_S)
            channel.take(datagram, clock.now())
        took_s = time.thread_time() - began
        daemon.stop()
    return took_s / seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=10)
    parser.add_argument("--runs", type=int, default=5)
    args = parser.parse_args()
    logging.disable()
    took = []
    for _ in range(args.runs):
        clock = VirtualTime()
        loop = asyncio.SelectorEventLoop(clock)
        loop.time = lambda at=clock: at.now_s  # type: ignore[method-assign, misc]
        took.append(loop.run_until_complete(measured(clock, args.seconds)))
        loop.close()
    print(", ".join(f"{100 * share:.2f}" for share in took), f"% of a core; the least {100 * min(took):.2f} %")


if __name__ == "__main__":
    main()
