"""A machine that is too slow for a flight in real time is named, with the figure; the figures here are simulated, not loads."""

import argparse
import asyncio
import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.base.containment import RESTART
from companion.base.health import Health
from companion.base.mission import FlightOutcome
from companion.cli import demo
from companion.service.daemon import Daemon, DaemonSetup
from drivers.clock import SystemClock
from estimator.contracts.errors import Recoverable
from estimator.contracts.estimates import Verdict
from sitl.emulators.ardrone.child import ArDroneInChild
from sitl.flight.ending import Ending, Load
from sitl.scenario.scenario import load
from sitl.world.truth import Touchdown
from tests.companion.virtual_flight import FakeFlight, SeeingPilot, VirtualClock, fly

SAID: dict[str, Any] = {"event": "ended", "stood_still_s": 0.25, "counters": {"video_due": 900, "video_sent": 880}}


def ended(outcome: FlightOutcome | None, late_s: float = 0.0, said: bytes | None = None, health: Health | None = None) -> Ending:
    """Return a demo of 30 s in which guidance cycles came that much late."""
    if health is None:
        health = Health(SystemClock())
        health.frames = Counter({Verdict.FUSED: 850, Verdict.NO_PAD: 30})
    for _ in range(9):
        health.delay("guidance_late", late_s)
    drone = ArDroneInChild("demo", load("demo"), 1, Path())
    drone.ended(json.dumps(SAID).encode() if said is None else said)
    return demo._ending(argparse.Namespace(scenario="demo", seed=1), outcome, 30.0, [], health, drone)


def test_a_demo_that_gave_up_on_a_machine_too_slow_reports_it_with_the_figure() -> None:
    late = ended(FlightOutcome.GAVE_UP, 0.085)
    assert late.in_words().splitlines()[-1] == (
        "this machine was too slow to fly in real time (half of the guidance cycles came 85 ms late or later): "
        "the result means nothing; decklander simulate needs no speed"
    )
    assert late.facts()[0] == ("warning", late.in_words().splitlines()[-1]), "at the head of the report"
    assert late.as_json()["machine_too_slow"] == "half of the guidance cycles came 85 ms late or later"


@pytest.mark.parametrize(
    ("changed", "figure"),
    [
        ({"stood_still_s": 4.0}, "the simulated drone stood still for 4.0 s"),
        ({"counters": {"video_due": 900, "video_sent": 200}}, "22% of the frames were rendered in time"),
        ({"counters": {"video_due": 900}}, "0% of the frames were rendered in time"),
    ],
)
def test_the_simulated_drone_s_own_time_is_reported(changed: dict[str, Any], figure: str) -> None:
    output = b'{"event":"ready"}\nno JSON\n' + json.dumps(SAID | changed).encode()
    assert f"({figure}): the result means nothing" in ended(None, said=output).in_words()


def test_a_landing_on_the_pad_says_what_may_come_of_a_slow_machine() -> None:
    load = Load(900, 200, 4.0, Counter(), 0.085)
    landed = Ending("demo", 1, FlightOutcome.LANDED, (), 30.0, Counter(), load=load)
    assert "means nothing" in landed.in_words(), "it touched nothing"
    on_pad = Touchdown(landed.started, "pad", np.zeros(3), 0.05, 0.0, 0.4, 0.1)
    good = Ending("demo", 1, FlightOutcome.LANDED, (on_pad,), 30.0, Counter(), load=load)
    assert "too slow" in good.in_words()
    assert "means nothing" not in good.in_words()


def test_a_flight_without_a_frame_names_the_connection_that_failed_and_accuses_no_machine() -> None:
    health = Health(SystemClock())
    for _ in range(3):
        health.failed("AR.Drone video", Recoverable("the drone closed the video"))
    without = ended(None, said=json.dumps(SAID | {"counters": {}}).encode(), health=health)
    why = ["no frame ever came", "AR.Drone video failed 3 times: the drone closed the video"]
    assert without.in_words().splitlines()[1:] == why
    assert without.as_json()["troubles"] == why
    assert without.as_json()["machine_too_slow"] is None
    assert [text for kind, text in without.facts() if kind == "warning"] == why


class LateClock(VirtualClock):
    """Wakes everybody up later than requested."""

    async def sleep(self, seconds: float) -> None:
        await super().sleep(seconds + 0.05)


@pytest.mark.parametrize(("clock", "late_s"), [(VirtualClock(), 0.0), (LateClock(), 0.05)])
def test_the_daemon_measures_how_late_guidance_comes(clock: VirtualClock, late_s: float) -> None:
    vehicle = FakeFlight(clock)
    daemon = Daemon(vehicle.open, SeeingPilot(vehicle), clock, DaemonSetup(RESTART, 50.0, health_period_s=0.0))
    asyncio.run(fly(daemon, vehicle, clock, 5.2))
    assert daemon.health.too_slow == ("this computer is too slow: guidance is 49 ms late" if late_s else None)
    stage = daemon.health.snapshot().stages["guidance_late"]
    assert stage.count >= 8
    assert stage.p50_s == pytest.approx(late_s, abs=1e-6)
