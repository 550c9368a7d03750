"""Measure the time from a frame's arrival to its LANDING_TARGET, through the service and over MAVLink on loopback UDP.

The service is the one that flies: samples, guidance cycles, the thread of vision and observers. Its camera shows what it is
given, and its autopilot is a miniature. A decoder is left out.

python -m benches.mavlink_latency        p50 and p99 at 30 and 60 frames a second: the pad tracked, and searched for in each frame
python -m benches.mavlink_latency --scenario night      the same of a pad that shows by its lamps
"""

import argparse
import asyncio
import time
from collections.abc import Callable
from itertools import cycle

import numpy as np

import companion.settings.load as settings_of
from benches.service_loop import Vehicle
from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.guidance.make_pilot import make_pilot
from companion.parts.mavlink.component import Component, ComponentOptions, speaking
from companion.parts.mavlink.operator import PilotTower
from companion.service.daemon import Daemon, DaemonSetup
from companion.settings.restart import RestartOptions
from drivers.clock import SystemClock
from drivers.mavlink.autopilot import open_autopilot
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.vehicle import Stack
from estimator.contracts.estimates import Verdict
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Frame, Sample
from estimator.contracts.time import Stamp, after, seconds_between
from sitl.emulators.autopilots.body import Body
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from sitl.flight.one_flight import following
from sitl.scenario.scenario import Scenario, load
from tests.support.waiting import until

HOST = "127.0.0.1"

TURNS = (100, -200, 300)
"""A gyro, mrad/s, that contradicts the pictures: the belief never leads to the pad, and each frame is searched."""


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
        self.speech_ms: list[float] = []

    def on_sample(self, sample: Sample) -> None:
        self._component.on_sample(sample)

    def on_decision(self, decision: Decision) -> None:
        self._component.on_decision(decision)

    def on_frame(self, processed: ProcessedFrame) -> None:
        sent, reported = self._bytes_out(), self._clock.now()
        self._component.on_frame(processed)
        if processed.verdict is Verdict.FUSED and self._bytes_out() > sent:
            done = self._clock.now()
            self.whole_ms.append(1e3 * seconds_between(processed.frame.stamp.received_at, done))
            self.speech_ms.append(1e3 * seconds_between(reported, done))


async def measure(scenario: Scenario, rate_hz: float, gyro_mrad_s: tuple[int, int, int], seconds: float) -> None:
    """Measure and print one frame rate with one gyro beside a camera that stands still."""
    clock = SystemClock()
    pilot = make_pilot(following(scenario, settings_of.load("sim")))
    pilot.search.rehearse()
    body = Body(scenario, 1, 0.005)
    images = [body.expose()().px for _ in range(4)]
    state = body.state()
    x, y, z = state.f_body
    fake = MiniatureAutopilot(Stack.ARDUPILOT, p_ned=state.p_ned, gyro_mrad_s=gyro_mrad_s, f_body=(x, y, z))
    fake.rpy = lambda t: state.R_ned_body.rpy_rad
    component = Component(
        ComponentOptions(0.39, 0.5),
        PilotTower(pilot, lambda: None, clock),
        None,
        healthy=lambda: None,
        believe=pilot.belief,
        clock=clock,
    )
    options = AutopilotOptions(f"udpin://{HOST}:0", command_period_s=0.02)
    async with open_autopilot(options, clock) as autopilot:
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
            await until(lambda: autopilot.attitude is not None and len(autopilot.positions) > 5)
            await until(lambda: "Decision" in daemon.health.flows and "Attitude" in daemon.health.flows and not daemon.looking)
            began, used = time.monotonic(), time.thread_time()
            for number, image in enumerate(cycle(images), 1):
                px = image.copy()
                px[8, number % px.shape[1]] ^= 1  # no frame of a camera is that of another exposure
                now = clock.now()
                if time.monotonic() - began > seconds:
                    break
                link.frames.offer(Frame(Stamp(after(now, -0.03), now, 0.001, "sim"), number, px))
                await asyncio.sleep(max(0.0, began + number / rate_hz - time.monotonic()))
            share = (time.thread_time() - used) / (time.monotonic() - began)
            sent_hz = len(fake.of("LANDING_TARGET")) / seconds
            daemon.stop()
    how = "searched" if gyro_mrad_s == TURNS else "tracked"
    for name, values in (("frame in to bytes out", timed.whole_ms), ("of that speech", timed.speech_ms)):
        p50, p99 = np.quantile(values, [0.5, 0.99])
        print(f"{rate_hz:3.0f} fps  {how:<8}  {name:<22} p50 {p50:6.2f} ms  p99 {p99:6.2f} ms  ({len(values)} frames)")
    print(f"{rate_hz:3.0f} fps  {how:<8}  LANDING_TARGET {sent_hz:.0f} Hz; the loop {100 * share:.1f} % of a core")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--scenario", default="calm", help="whose frames the camera shows")
    parser.add_argument("--tracked", action="store_true", help="only the tracked pad at 30 frames a second")
    args = parser.parse_args()
    for gyro in ((0, 0, 0),) if args.tracked else ((0, 0, 0), TURNS):
        for rate in (30.0,) if args.tracked else (30.0, 60.0):
            asyncio.run(measure(load(args.scenario), rate, gyro, args.seconds))


if __name__ == "__main__":
    main()
