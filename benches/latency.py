"""Measure the time from a frame's arrival to its LANDING_TARGET, and the event loop's share of a core.

python -m benches.latency        p50 and p99 at 30 and 60 frames a second: the pad tracked, and searched for in each frame
python -m benches.latency --scenario night      the same of a pad that shows by its lamps
python -m benches.latency --loop        CPU time of the loop without video, in virtual time

Times stand in floors, too, with the limit that the notes print: a floor is one BGR to HSV conversion and one inRange of a frame.

Frames go through the service that flies and over MAVLink on loopback UDP: samples, guidance cycles, the thread of vision and
observers. Its camera shows what it is given, and its autopilot is a miniature. A decoder is left out.

In the loop 200 navdata datagrams of 28 options a second pass the driver, guard, filter, health and 50 guidance cycles a second.
No second is waited for, so a loaded machine measures it as well as a quiet one; reading sockets and waking up are left out.
"""

import argparse
import asyncio
import logging
import math
import selectors
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import numpy as np

from benches.search import floor_ms
from companion.base.health import Health
from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.guidance.make_pilot import make_pilot
from companion.parts.mavlink.commands import PilotTower
from companion.parts.mavlink.component import Component, speaking
from companion.parts.mavlink.outputs import Outputs
from companion.service.daemon import Daemon, DaemonSetup, VehicleLink
from companion.settings.links import OutputOptions
from companion.settings.load import load as load_settings
from companion.settings.service import RestartOptions
from drivers.ardrone import navdata as nd
from drivers.ardrone.counters import Counters
from drivers.ardrone.navdata_channel import NavdataChannel
from drivers.ardrone.options import ArDroneOptions
from drivers.clock import SystemClock
from drivers.mailbox import Latest, Line
from drivers.mavlink.autopilot import open_autopilot
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.vehicle import Stack
from estimator.contracts.commands import Command
from estimator.contracts.estimates import Verdict
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Frame, Sample
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp, after, seconds_between
from sitl.emulators.autopilots.body import Body
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from sitl.flight.one_flight import following
from sitl.scenario.scenario import Scenario, load
from tests.support.waiting import until

PERIOD_S = 0.005
HOST = "127.0.0.1"

LIMITS = {"tracked": (9.0, 18.0), "searched": (22.0, 36.0)}
"""Limits of p50 and p99 from frame in to bytes out, floors."""


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


class Timed(NullObserver):
    """Hands the service's events to the MAVLink component, and notes when a frame's target has left.

    Args:
        bytes_out: the number of bytes sent so far.
    """

    def __init__(self, component: Component, clock: Clock, bytes_out: Callable[[], int]) -> None:
        self._component = component
        self._clock = clock
        self._bytes_out = bytes_out
        self.whole_ms: list[float] = []

    def on_sample(self, sample: Sample) -> None:
        self._component.on_sample(sample)

    def on_decision(self, decision: Decision) -> None:
        self._component.on_decision(decision)

    def on_frame(self, processed: ProcessedFrame) -> None:
        sent = self._bytes_out()
        self._component.on_frame(processed)
        if processed.verdict is Verdict.FUSED and self._bytes_out() > sent:
            self.whole_ms.append(1e3 * seconds_between(processed.frame.stamp.received_at, self._clock.now()))


async def measure(scenario: Scenario, rate_hz: float, how: str, seconds: float) -> None:
    """Measure and print one frame rate below a vehicle that stands still; `how` is a key of `LIMITS`."""
    clock = SystemClock()
    pilot = make_pilot(following(scenario, load_settings("sim")))
    if how == "searched":
        pilot.look_at = lambda frame, attitude, held=None: pilot.search.anywhere(frame, attitude)  # type: ignore[method-assign]
    pilot.search.rehearse()
    body = Body(scenario, 1, 0.005)
    images = [body.expose()().px for _ in range(4)]
    floor = min(floor_ms(images[0]) for _ in range(40))
    state = body.state()
    x, y, z = state.f_body
    fake = MiniatureAutopilot(Stack.ARDUPILOT, p_ned=state.p_ned, gyro_mrad_s=(0, 0, 0), f_body=(x, y, z))
    fake.rpy = lambda t: state.R_ned_body.rpy_rad
    outputs, tower = Outputs(OutputOptions(), 0.39, 0.5), PilotTower(pilot, lambda: None, clock)
    component = Component(outputs, tower, None, believe=pilot.belief, clock=clock, health=Health(clock))
    async with open_autopilot(AutopilotOptions(f"udpin://{HOST}:0", command_period_s=0.02), clock) as autopilot:
        await until(lambda: autopilot.links.all[0].local is not None)
        host, port = autopilot.links.all[0].local or ("", 0)
        link, timed = Vehicle(autopilot.samples), Timed(component, clock, lambda: autopilot.links.all[0].counters.bytes_out)
        daemon = Daemon(link.open, pilot, clock, DaemonSetup(RestartOptions(), 50.0), observers=[timed])
        async with (
            fake.talking_to(f"udpout://{host}:{port}"),
            speaking(component, autopilot, clock),
            asyncio.TaskGroup() as group,
        ):
            group.create_task(daemon.run())
            await until(lambda: len(autopilot.positions) > 5 and {"Decision", "Attitude"} <= daemon.health.flows.keys())
            await until(lambda: not daemon.looking)
            began, used, whole = time.monotonic(), time.thread_time(), time.process_time()
            for number in range(1, round(seconds * rate_hz) + 1):
                px, now = images[number % len(images)].copy(), clock.now()
                px[8, number % px.shape[1]] ^= 1  # no frame of a camera is that of another exposure
                link.frames.offer(Frame(Stamp(after(now, -0.03), now, 0.001, "sim"), number, px))
                await asyncio.sleep(max(0.0, began + number / rate_hz - time.monotonic()))
            loop_s, whole_s, took_s = time.thread_time() - used, time.process_time() - whole, time.monotonic() - began
            daemon.stop()
    ms, limit = np.quantile(timed.whole_ms, [0.5, 0.99]), np.array(LIMITS[how])
    held = f"limit {limit[0]:.0f} and {limit[1]:.0f} {'held' if (ms <= floor * limit).all() else 'not held'}"
    said = f"p50 {ms[0]:6.2f} ms  p99 {ms[1]:6.2f}  most {max(timed.whole_ms):6.2f} of {len(timed.whole_ms)} frames"
    floors = f"{ms[0] / floor:.1f} and {ms[1] / floor:.1f} floors of {floor:.2f} ms ({held})"
    print(f"{rate_hz:3.0f} fps  {how:<8}  frame in to bytes out {said}; {floors}")
    cpu = f"{100 * loop_s / took_s:.1f} % of a core for the loop, {1e3 * (whole_s - loop_s) / number:.2f} ms a frame for vision"
    print(f"{rate_hz:3.0f} fps  {how:<8}  LANDING_TARGET {len(fake.of('LANDING_TARGET')) / seconds:.0f} Hz; {cpu}")


def datagrams(n: int) -> list[bytes]:
    """Return datagrams of a drone that hovers and sways a little."""
    out = []
    for i in range(n):
        a = 0.02 * i
        navdata = nd.Navdata(
            1, i + 1, tuple(nd.LAYOUTS), (), nd.ControlState.HOVERING.word, 80, 1e3 * math.sin(a), 900.0 * math.cos(a), 0.0, 2000,
            20.0 * math.sin(a), 9.0 * math.cos(a), nd.clock_of_us(round(1e6 * (10.0 + PERIOD_S * i))),
            ax_mg=10.0 * math.sin(i), ay_mg=5.0 + i % 3, az_mg=-1000.0 + i % 5,
            wx_deg_s=math.sin(i), wy_deg_s=math.cos(i), wz_deg_s=0.1 * (i % 7),
        )  # fmt: skip
        out.append(nd.encode(navdata))
    return out


async def measured(clock: VirtualTime, seconds: int) -> float:
    """Return the CPU time of the loop's thread for each second of the flight, s."""
    vehicle, settings = Vehicle(Line(1000)), load_settings("sim")
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


def loop_share(seconds: int, runs: int) -> None:
    """Print the share of a core that the loop takes."""
    logging.disable()
    took = []
    for _ in range(runs):
        clock = VirtualTime()
        loop = asyncio.SelectorEventLoop(clock)
        loop.time = lambda at=clock: at.now_s  # type: ignore[method-assign, misc]
        took.append(loop.run_until_complete(measured(clock, seconds)))
        loop.close()
    print(", ".join(f"{100 * share:.2f}" for share in took), f"% of a core; the least {100 * min(took):.2f} %")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--scenario", default="calm", help="whose frames the camera shows")
    parser.add_argument("--tracked", action="store_true", help="only the tracked pad at 30 frames a second")
    parser.add_argument("--loop", action="store_true", help="measure the event loop alone")
    args = parser.parse_args()
    if args.loop:
        loop_share(round(args.seconds), 5)
        return
    for how in ("tracked",) if args.tracked else LIMITS:
        for rate in (30.0,) if args.tracked else (30.0, 60.0):
            asyncio.run(measure(load(args.scenario), rate, how, args.seconds))


if __name__ == "__main__":
    main()
