"""The ways to fly a simulated scenario in a test.

- `new_flight`: a flight that a test steps; `advance` steps it for a time, `fly_for` does both
- `land`: a whole flight of one scenario, as a campaign flies it, and how it ended
- `simulate`: a whole flight by the command line, with its exit code and what `--json` prints
- `near`: a scenario of a few seconds; `NEAR` is its text
- `recorded`: what records a flight of the command line, for the fixture `kept`
- `fly_recorded`: the first seconds of a flight with a recorder; `record_to` writes them into a file
- `ObservedCalls`: an observer that keeps every call
"""

import json
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from companion.base.observer import Decision, NullObserver, Observer, ProcessedFrame
from companion.base.orders import OperatorOrder, OrderSender, OrderSource
from companion.cli.main import main
from companion.facts.records import TruthRecord
from companion.guidance.pilot import Pilot, make_pilot
from companion.parts.recorder.recorder import Recorder
from companion.parts.recorder.setup import about, recorder_to_file
from companion.settings.load import Settings, load
from companion.settings.model import CameraSettings, PadSettings
from estimator.contracts.estimates import FusionResult, PathName
from estimator.contracts.samples import Sample
from estimator.contracts.time import MonoNs
from sitl.ardrone.flight import Flight
from sitl.flight.ending import Ending
from sitl.flight.one_flight import FlyOptions, fly
from sitl.perception.levels import perceive
from sitl.perception.port import Level
from sitl.scenario.scenario import Scenario, from_mapping
from sitl.scenario.scenario import load as load_scenario
from sitl.scenario.settings import settings_for
from tests.make import change

STEP_S = 0.005
"""Period of a flight's steps, s."""
NEAR = """
title = "A motionless pad close by"
duration_limit_s = 40.0
[sea]
significant_height_m = 0.0
[vessel]
moored = false
[wind]
speed_m_s = 0.0
gust_sigma_m_s = 0.0
[start]
height_m = 2.0
pad_right_m = 0.3
pad_forward_m = -0.2
heading_deg = 20.0
"""
"""The text of a scenario file: a flight of a few seconds, for tests that are about something else."""
_RECORDED = "demo"
_ORDER_AT_STEP = 10


class ObservedCalls(NullObserver):
    """Records every call that the observers received."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.frames: list[ProcessedFrame] = []
        self.decisions: list[Decision] = []
        self.results: list[tuple[MonoNs, FusionResult]] = []

    def on_sample(self, sample: Sample) -> None:
        self.samples.append(sample)

    def on_frame(self, processed: ProcessedFrame) -> None:
        self.frames.append(processed)

    def on_decision(self, decision: Decision) -> None:
        self.decisions.append(decision)

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        self.results.append((at, result))


def near(**over: Any) -> Scenario:
    """Return the scenario `NEAR` with other sections or keys."""
    return from_mapping({**tomllib.loads(NEAR), **over}, "near")


def new_flight(
    scenario: Scenario | str,
    seed: int = 1,
    *,
    level: Level = "pixels",
    settings: Settings | None = None,
    shadows: Sequence[PathName] = (),
    observers: Sequence[Observer] = (),
    **over: Any,
) -> Flight:
    """Return a flight before its first step; a service that was killed comes back with a pilot of the same kind.

    Args:
        scenario: one, or the name of a shipped one; `over` replaces keys of it.
        settings: those of the profile `sim` if None.
    """
    scenario = load_scenario(scenario) if isinstance(scenario, str) else scenario
    settings, perception = settings or load("sim"), perceive(level)

    def pilot() -> Pilot:
        return perception.pilot(settings, shadows)

    return Flight(change(scenario, **over), seed, settings, pilot(), observers=observers, renew=pilot, perception=perception)


def advance(flight: Flight, seconds: float) -> Flight:
    """Step a flight for a time, or until it ends."""
    for _ in range(round(seconds / STEP_S)):
        flight.step()
    return flight


def fly_for(seconds: float, scenario: Scenario | str, *args: Any, **options: Any) -> Flight:
    """Return a flight, as of `new_flight`, after a time."""
    return advance(new_flight(scenario, *args, **options), seconds)


def land(
    scenario: Scenario | str,
    seed: int = 1,
    *,
    level: Level = "truth",
    settings: Settings | None = None,
    observers: Sequence[Observer] = (),
    options: FlyOptions | None = None,
    **over: Any,
) -> Ending:
    """Fly a scenario to its end as `simulate` and campaigns do, and return how it ended.

    Args:
        scenario: one, or the name of a shipped one; `over` replaces keys of it.
        settings: those that follow the scenario if None.
    """
    name = scenario if isinstance(scenario, str) else "near"
    scenario = change(load_scenario(scenario) if isinstance(scenario, str) else scenario, **over)
    return fly(name, scenario, seed, settings or settings_for(scenario, None), level, observers, options)


def simulate(
    capsys: pytest.CaptureFixture[str], scenario: str | Path, *arguments: str, level: Level = "truth"
) -> tuple[int, dict[str, Any]]:
    """Fly by the command line; return the exit code and what it prints as JSON."""
    code = main(["simulate", str(scenario), "--perception", level, "--json", *arguments])
    return code, json.loads(capsys.readouterr().out)


def recorded(*words: str) -> Callable[[Path], int]:
    """Return what flies by the command line with these words and records into a path; for `kept`."""
    return lambda path: main(["simulate", *words, "--record", str(path), "--json"])


def sim_settings() -> Settings:
    """Return the settings of the flights that are recorded."""
    scenario = load_scenario(_RECORDED)
    camera, pad = CameraSettings(scenario.camera.file), PadSettings(scenario.pad.file)
    return change(load("sim"), camera=camera, pad=pad, estimator={"path": "dead_reckoning"})


def fly_recorded(observers: Sequence[Observer], seconds: float, recorder: Recorder | None = None) -> Flight:
    """Return the first seconds of a flight, with the truth passed to the recorder at 50 Hz and two orders of a terminal."""
    flight = new_flight(_RECORDED, settings=sim_settings(), shadows=("median_mean",), observers=observers)
    if recorder is not None:
        recorder.watch(flight.health)
    for step in range(round(seconds / STEP_S)):
        flight.step()
        if step == _ORDER_AT_STEP:
            for order, detail in ((OperatorOrder.RECORD, "on"), (OperatorOrder.CLEAR, "")):
                flight.pilot.operator.take(order, OrderSender(OrderSource.TERMINAL, "1"), flight.world.now, detail)
        if recorder is not None and step % 4 == 0:
            t = flight.world.truth()
            recorder.on_truth(TruthRecord(int(t.at), t.d_body_pad_level.tolist(), t.v_pad_level.tolist(), t.yaw_rad))
    return flight


def record_to(path: Path, seconds: float = 2.0, **options: Any) -> ObservedCalls:
    """Fly, record into `path`, and return the calls that another observer received."""
    settings, observed = sim_settings(), ObservedCalls()
    opened = recorder_to_file(path, make_pilot(settings).camera, about(settings, {"scenario": _RECORDED, "seed": "1"}), **options)
    with opened as recorder:
        fly_recorded([observed, recorder], seconds, recorder)
    return observed
