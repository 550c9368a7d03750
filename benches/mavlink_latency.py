"""Measure the time from a frame's arrival to its LANDING_TARGET: vision, estimator and MAVLink in one process over loopback UDP.

python -m benches.mavlink_latency        p50 and p99 at 30 and 60 frames a second: the pad tracked, and searched for in each frame
"""

from __future__ import annotations

import asyncio
import time
from itertools import cycle
from types import SimpleNamespace

import numpy as np

import companion.config.settings as settings_of
from companion.mavlink.component import Component, ComponentOptions, speaking
from companion.mavlink.pilot_operator import PilotTower
from companion.runtime.make_pilot import make_pilot
from companion.runtime.observer import Decision
from drivers.clock import SystemClock
from drivers.mavlink.autopilot import open_autopilot
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.vehicle import Stack
from estimator.contracts.estimates import Verdict
from estimator.contracts.samples import Frame
from estimator.contracts.time import Stamp, after
from sitl.autopilots.body import Body
from sitl.autopilots.miniature import MiniatureAutopilot
from sitl.scenario import load
from tests.support.fake_ardrone import until

HOST = "127.0.0.1"
SECONDS = 6.0


TURNS = (100, -200, 300)
"""A gyro, mrad/s, that contradicts the pictures: the belief never leads to the pad, and each frame is searched."""


async def measure(rate_hz: float, gyro_mrad_s: tuple[int, int, int]) -> None:
    """Measure and print one frame rate with one gyro beside a camera that stands still."""
    clock = SystemClock()
    settings = settings_of.load("sim")
    pilot = make_pilot(settings)
    body = Body(load("calm"), 1, 0.005)
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
    whole, speech = [], []
    async with open_autopilot(options, clock) as autopilot:
        await until(lambda: autopilot.links.all[0].local is not None)
        host, port = autopilot.links.all[0].local or ("", 0)
        async with (
            fake.talking_to(f"udpout://{host}:{port}"),
            speaking(component, autopilot, clock),
            asyncio.TaskGroup() as group,
        ):

            async def pump() -> None:
                async for sample in autopilot.samples:
                    pilot.on_sample(sample)
                    component.on_sample(sample)

            pumping = group.create_task(pump())
            await until(lambda: autopilot.attitude is not None and len(autopilot.positions) > 5)
            loop = asyncio.get_running_loop()
            began = time.monotonic()
            for number, px in enumerate(cycle(images), 1):
                now = clock.now()
                if time.monotonic() - began > SECONDS:
                    break
                component.on_decision(Decision(now, "bench", None, None))
                frame = Frame(Stamp(after(now, -0.03), now, 0.001, "sim"), number, px)
                attitude = pilot.attitude_at(frame.stamp)
                if attitude is not None:
                    look = await loop.run_in_executor(None, pilot.detect, frame, attitude)
                    verdict, _ = pilot.on_detection(look)
                    understood = clock.now()
                    sent = autopilot.links.all[0].counters.bytes_out
                    component.on_frame(SimpleNamespace(verdict=verdict))  # type: ignore[arg-type]
                    done = clock.now()
                    if verdict is Verdict.FUSED and autopilot.links.all[0].counters.bytes_out > sent:
                        whole.append((done - now) * 1e-6)
                        speech.append((done - understood) * 1e-6)
                await asyncio.sleep(max(0.0, began + number / rate_hz - time.monotonic()))
            sent_hz = len(fake.of("LANDING_TARGET")) / SECONDS
            pumping.cancel()
    how = "searched" if gyro_mrad_s == TURNS else "tracked"
    for name, values in (("frame in to bytes out", whole), ("of that speech", speech)):
        p50, p99 = np.quantile(values, [0.5, 0.99])
        print(f"{rate_hz:3.0f} fps  {how:<8}  {name:<22} p50 {p50:6.2f} ms  p99 {p99:6.2f} ms  ({len(values)} frames)")
    print(f"{rate_hz:3.0f} fps  {how:<8}  LANDING_TARGET {sent_hz:.0f} Hz")


if __name__ == "__main__":
    for gyro in ((0, 0, 0), TURNS):
        for rate in (30.0, 60.0):
            asyncio.run(measure(rate, gyro))
