"""`decklander simulate SCENARIO --autopilot ...`: fly one scenario with a real autopilot program on the simulator's physics."""

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

from companion.base import event_loop
from companion.base.observer import Observer
from companion.cli.kept_flight import keeping
from companion.cli.progress import ProgressObserver
from drivers.endpoint import parse_endpoint
from estimator.contracts.errors import BadInput
from estimator.contracts.time import NS_PER_S, MonoNs
from sitl.campaign.overrides import Overridable
from sitl.emulators.autopilots.flight import AutopilotFlight, AutopilotProgram, FlightEnd
from sitl.emulators.autopilots.follow import FollowEnd, follow
from sitl.emulators.autopilots.program import executable
from sitl.faults.kinds import STREAMS
from sitl.flight.ending import Contact, Ending
from sitl.flight.one_flight import contact_of, settings_for
from sitl.flight.one_flight import ending_of as graded_ending
from sitl.perception.levels import perceive
from sitl.perception.port import Level
from sitl.scenario.scenario import Scenario
from sitl.scenario.scenario import load as load_scenario

CARRIED = frozenset({*STREAMS, "link_lost", "light_falls", "service_killed", "vessel_reports"})
"""Kinds of faults that act on a flight with an autopilot program: those of its streams, of the light on its camera, and of the
service itself."""

COMPANION_PORT = 14540
"""The companion's port in the settings that a recording keeps."""
STAND_IN = "stand-in"
"""The word for --binary that flies the stand-in for a program instead of a program."""


def run(args: argparse.Namespace, perception: Level) -> int:
    """Fly the scenario; return 0 if it landed on the pad, else 1."""
    binary = None if args.binary == STAND_IN else executable(args.binary, args.autopilot)
    scenario = load_scenario(args.scenario, args.base)
    refuse_faults(args.scenario, scenario, CARRIED)
    settings = settings_for(scenario, args.config, by_autopilot=True)
    given = Overridable(scenario, settings)
    scenario, settings = given.with_values([given.parse(text, "--set") for text in args.set], "--set")
    progress = None if args.json else ProgressObserver()
    observers: list[Observer] = [] if progress is None else [progress]
    autopilot = AutopilotProgram(args.autopilot, binary, parameters=parameters(args.param), unaided=args.unaided)
    seen_by, began = perceive(perception, args.perception_model), time.monotonic()
    with _folder(args.keep) as folder:
        flight = AutopilotFlight(scenario, args.seed, settings, autopilot, folder, observers, seen_by)
        facts = {"kind": "simulate", "autopilot": args.autopilot, "binary": STAND_IN if binary is None else binary.name}
        flown = flight.service_settings(COMPANION_PORT)
        with keeping(args, flown, scenario.title, perception, facts, flight.clock.started, from_truth=True) as kept:
            flight.observers, flight.shadows = (*observers, *kept.observers), kept.shadows
            flight.on_start, flight.on_truth = kept.on_start, kept.on_truth
            end = event_loop.run(flight.fly())
        said = (folder / "texts.txt").open("w")
        with said:
            said.writelines(f"{at:8.2f} s  component {component:3d}  {text}\n" for at, component, text in end.texts)
    if progress is not None:
        progress.close()
    ending = Ending(
        args.scenario, args.seed, end.outcome, tuple(map(contact_of, end.contacts)), end.duration_s, end.health.frames
    )
    if end.result is not None:
        ending = graded_ending(args.scenario, args.seed, scenario, end.result, time.process_time())
    ending = replace(ending, started=flight.graded.started, without_outcome=end.without_outcome)
    wall_s = time.monotonic() - began
    report = kept.write_report(ending, wall_s, f"in lock step with {facts['binary']}")
    if args.json:
        sys.stdout.write(json.dumps({**ending.as_json(), **_of_autopilot(args.autopilot, end)}) + "\n")
    else:
        sys.stdout.write("".join(f"{silence.in_words()}\n" for silence in end.silences))
        sys.stdout.write(f"{end.failure or ending.in_words()}\n")
        sys.stdout.write(f"{ending.duration_s:.1f} s from the order to land; {wall_s:.0f} s on the wall clock\n{report}")
    return 0 if ending.good else 1


def _of_autopilot(name: str, end: FlightEnd) -> dict[str, object]:
    """Return what is printed of an autopilot's flight besides."""
    armed_s = None if end.armed_after_contact_s is None else round(end.armed_after_contact_s, 2)
    return {
        "autopilot": name, "failure": end.failure or None, "armed_after_contact_s": armed_s, "failsafes": list(end.failsafes),
        "silences": [silence.as_json() for silence in end.silences],
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
        raise BadInput(f"{name}: its faults ({', '.join(dict.fromkeys(others))}) are for the simulated AR.Drone alone{can}")


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


def run_follow(args: argparse.Namespace) -> int:
    """Follow the vehicle until the landing has ended; return 0 if it landed on the pad, else 1."""
    if args.report is not None or args.record is not None:
        raise BadInput("--report and --record do not go with --follow")
    parse_endpoint(args.follow)
    scenario = load_scenario(args.scenario)
    refuse_faults(args.scenario, scenario)
    settings = settings_for(scenario, args.config, by_autopilot=True)
    progress = None if args.json else ProgressObserver()
    observers: list[Observer] = [] if progress is None else [progress]
    end = event_loop.run(follow(scenario, args.seed, settings, args.follow, observers))
    if progress is not None:
        progress.close()
    ending = _ending_of(args.scenario, args.seed, end)
    if args.json:
        more = {"follow": args.follow, "by_truth": end.by_truth, "failure": end.failure or None}
        sys.stdout.write(json.dumps({**ending.as_json(), **more}) + "\n")
    else:
        source = "the simulator's own truth" if end.by_truth else "the autopilot's own estimate of its place"
        sys.stdout.write(f"{end.failure or ending.in_words()}\njudged by {source}\n")
    return 0 if ending.on_pad else 1


def _ending_of(scenario: str, seed: int, end: FollowEnd) -> Ending:
    """Return how the flight ended, in the form that `simulate` prints."""
    contacts: tuple[Contact, ...] = ()
    if end.landing is not None:
        t = end.landing
        surface = "pad" if t.on_pad else "deck" if t.on_deck else "water"
        contacts = (Contact(MonoNs(round(t.t_s * NS_PER_S)), surface, t.lateral_m, t.yaw_rad, t.speed_m_s, t.slide_m_s),)
    return Ending(scenario, seed, end.outcome, contacts, end.duration_s, end.health.frames)
