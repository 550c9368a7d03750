"""`decklander simulate SCENARIO --autopilot ...`: fly one scenario with a real autopilot program on the simulator's physics."""

from __future__ import annotations

import argparse
import json
import math
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from companion.cli.progress import ProgressObserver
from companion.runtime import event_loop
from companion.runtime.observer import Observer
from estimator.contracts.errors import BadInput
from estimator.contracts.time import NS_PER_S, MonoNs
from sitl.autopilots.flight import AutopilotFlight, AutopilotProgram, FlightEnd
from sitl.autopilots.follow import FollowEnd
from sitl.autopilots.program import executable
from sitl.campaign.overrides import Overridable
from sitl.ending import Contact, Ending
from sitl.one_flight import ending_of as graded_ending
from sitl.one_flight import settings_for
from sitl.perception.levels import perceive
from sitl.perception.port import Level
from sitl.scenario import Scenario
from sitl.scenario import load as load_scenario
from sitl.stream_faults import STREAMS

CARRIED = frozenset({*STREAMS, "link_lost", "light_falls"})
"""Kinds of faults that act on a flight with an autopilot program: those of its streams, and of the light on its camera."""


STAND_IN = "stand-in"
"""The word for --binary that flies the stand-in for a program instead of a program."""


def run(args: argparse.Namespace, perception: Level) -> int:
    """Fly the scenario; return 0 if it landed on the pad, else 1."""
    if args.report is not None or args.record is not None:
        raise BadInput("--report and --record do not go with --autopilot; --keep DIR keeps the program's own logs")
    binary = None if args.binary == STAND_IN else executable(args.binary, args.autopilot)
    scenario = load_scenario(args.scenario, args.base)
    refuse_faults(args.scenario, scenario, CARRIED)
    settings = settings_for(scenario, args.config)
    given = Overridable(scenario, settings)
    scenario, settings = given.with_values([given.parse(text, "--set") for text in args.set], "--set")
    progress = None if args.json else ProgressObserver()
    observers: list[Observer] = [] if progress is None else [progress]
    autopilot = AutopilotProgram(args.autopilot, binary, parameters=parameters(args.param))
    began = time.monotonic()
    with _folder(args.keep) as folder:
        flight = AutopilotFlight(
            scenario, args.seed, settings, autopilot, folder, observers, perceive(perception, args.perception_model)
        )
        end = event_loop.run(flight.fly())
        said = (folder / "texts.txt").open("w")
        with said:
            said.writelines(f"{at:8.2f} s  component {component:3d}  {text}\n" for at, component, text in end.texts)
    if progress is not None:
        progress.close()
    ending = ending_of(args.scenario, args.seed, end)
    if end.result is not None:
        cpu_s = time.process_time()
        ending = replace(graded_ending(args.scenario, args.seed, scenario, end.result, cpu_s), started=flight.graded.started)
    if args.json:
        sys.stdout.write(json.dumps({**ending.as_json(), **_of_autopilot(args.autopilot, end)}) + "\n")
    else:
        sys.stdout.write(f"{end.failure or ending.in_words()}\n")
        sys.stdout.write(
            f"{ending.duration_s:.1f} s from the order to land; {time.monotonic() - began:.0f} s on the wall clock\n"
        )
    return 0 if ending.good else 1


def _of_autopilot(name: str, end: FlightEnd) -> dict[str, object]:
    """Return what is printed of an autopilot's flight besides."""
    armed_s = None if end.armed_after_contact_s is None else round(end.armed_after_contact_s, 2)
    return {
        "autopilot": name, "failure": end.failure or None, "armed_after_contact_s": armed_s, "failsafes": list(end.failsafes),
    }  # fmt: skip


def refuse_faults(name: str, scenario: Scenario, carried: frozenset[str] = frozenset()) -> None:
    """Refuse a scenario with faults that only the simulated AR.Drone can have.

    Args:
        carried: kinds of faults that this flight can have.

    Raises:
        BadInput: the scenario has some others.
    """
    others = [f.kind for f in scenario.faults if f.kind not in carried]
    if others:
        can = f"; here only {', '.join(sorted(carried))} act" if carried else ""
        raise BadInput(f"{name}: its faults ({', '.join(others)}) are for the simulated AR.Drone alone{can}")


def parameters(given: Sequence[str]) -> tuple[tuple[str, float], ...]:
    """Parse parameters from `NAME=VALUE`.

    Raises:
        BadInput: one that is not of that form.
    """
    out = []
    for text in given:
        found = re.fullmatch(r"([A-Z][A-Z0-9_]{0,15})=(.+)", text)
        try:
            value = float(found[2]) if found else math.nan
        except ValueError:
            value = math.nan
        if found is None or not math.isfinite(value):
            raise BadInput(f"--param {text!r}: write NAME=VALUE, a name in capitals and a number")
        out.append((found[1], value))
    return tuple(out)


def ending_of(scenario: str, seed: int, end: FlightEnd | FollowEnd) -> Ending:
    """Return how the flight ended, in the form that `simulate` prints."""
    contacts: tuple[Contact, ...] = ()
    if end.landing is not None:
        t = end.landing
        surface = "pad" if t.on_pad else "deck" if t.on_deck else "water"
        contacts = (Contact(MonoNs(round(t.t_s * NS_PER_S)), surface, t.lateral_m, t.yaw_rad, t.speed_m_s, t.slide_m_s),)
    return Ending(scenario, seed, end.outcome, contacts, end.duration_s, end.health.frames)


@contextmanager
def _folder(keep: Path | None) -> Iterator[Path]:
    """Provide an empty folder for the program, and copy it to `keep` at the end if given."""
    if keep is not None and keep.exists() and (not keep.is_dir() or any(keep.iterdir())):
        raise BadInput(f"--keep: {str(keep)!r} is there already and is not an empty folder")
    with tempfile.TemporaryDirectory(prefix="decklander-") as name:
        try:
            yield Path(name)
        finally:
            if keep is not None:
                shutil.copytree(name, keep, dirs_exist_ok=True)
