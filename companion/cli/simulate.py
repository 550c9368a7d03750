"""`decklander simulate`: simulate one flight in virtual time."""

from __future__ import annotations

import argparse
import re
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from companion.cli import flight_options, kept_flight
from companion.cli.kept_flight import keeping, shown
from companion.cli.options import check_seed, option, print_result, refuse_any
from companion.cli.outputs import LOGS, REPORT_FOLDER, output
from companion.settings.load import find_file, shipped
from companion.settings.model import Settings
from companion.settings.overrides import finite
from drivers.endpoint import parse_endpoint
from estimator.contracts.errors import BadInput
from sitl.flight.ending import Ending
from sitl.flight.one_flight import FlyOptions, fly, perception_level
from sitl.perception.levels import perceive
from sitl.perception.port import Level, Perception
from sitl.scenario.scenario import FAULTS, Scenario
from sitl.scenario.scenario import load as load_scenario
from sitl.scenario.with_fault import with_random_faults

if TYPE_CHECKING:
    from sitl.emulators.autopilots.flight import AutopilotFlight
    from sitl.emulators.autopilots.stand_in.flight import StandInFlight

DESCRIPTION = (
    "Simulate one flight in virtual time, without sockets. The same scenario, seed and settings give the same "
    "flight to the bit. Exit code 0 if it landed on the pad safely, or refused as the scenario expects; else 1."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    option(
        parser,
        "scenario",
        f"scenario file, or the name of a shipped one ({', '.join(shipped('scenarios'))}; {FAULTS}/NAME for those with a fault)",
    )
    option(parser, "--seed N", "seed of all random numbers (default: 0)", default=0)
    flight_options.add_arguments(parser)
    option(parser, "--base SCENARIO", "fly it on this scenario instead of the base its file names, as a fault in another sea")
    option(parser, "--faults", "add one or two faults that the seed draws (docs/campaigns.md)", choices=("random",))
    option(parser, "--pad FILE", "pad file, or the name of a shipped one, on deck and looked for")
    option(parser, "--json", "print one JSON object")
    output(parser, "--report DIR", "write a report into this folder (report)", REPORT_FOLDER, nargs="?", const=Path("report"))
    kept_flight.add_arguments(parser)
    beside = parser.add_argument_group("autopilots (docs/sitl.md)")
    flown = "fly this autopilot over the simulated sea: in miniature and in virtual time, or with --binary the program itself"
    option(beside, "--autopilot", flown, choices=("arducopter", "arduplane", "px4"))
    option(beside, "--binary PATH", "path of the autopilot program")
    whose = "the vehicle is simulated by us, or by the program (its own)"
    option(beside, "--physics", whose, default="ours", choices=("ours", "own"))
    option(beside, "--follow URL", "follow a vehicle that another simulator flies, with the deck and camera of this one")
    option(beside, "--param NAME=VALUE", "set a parameter of the autopilot; may be repeated", default=[], action="append")
    option(beside, "--unaided", "let the autopilot land by its own landing mode, and nothing of ours reach it, to compare")
    output(beside, "--keep DIR", "keep the logs and output of the autopilot in this folder", LOGS)


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    check_seed(args)
    perception = perception_level(args.perception)
    flight_options.choose_vehicle(args)
    _refuse(args, perception)
    if args.pad is not None:
        args.set = [f"pad.file={find_file(args.pad, 'pads', Path(), '--pad')}", *args.set]
    if args.follow is not None:
        return run_follow(args)
    beside = args.autopilot is not None
    given = flight_options.chosen(args, load_scenario(args.scenario, args.base), by_autopilot=beside)
    scenario, settings = given.scenario, given.settings
    flight_options.warn(args, [settings], given.replaced, "a flight with an autopilot" if beside else "a simulated flight")
    if args.faults is not None:
        scenario = with_random_faults(scenario, args.seed, perception, autopilot=beside)
    if beside:
        return run_autopilot(args, perception, scenario, settings)
    with keeping(args, settings, scenario.title, perception, {"kind": "simulate"}) as kept:
        began = time.monotonic()
        how = FlyOptions(args.perception_model, kept.shadows, kept.on_start, kept.on_truth, render_beside=True)
        with shown(quiet=args.json) as observers:
            ending = fly(args.scenario, scenario, args.seed, settings, perception, [*observers, *kept.observers], how)
        wall_s = time.monotonic() - began
        report, pace = kept.end(ending, wall_s, "virtual time"), ending.duration_s / max(1e-9, wall_s)
    words = f"{ending.in_words()}\n{ending.duration_s:.1f} s flown in {wall_s:.1f} s ({pace:.1f} x real time)\n{report}"
    print_result(args, ending.as_json(), words)
    return 0 if ending.good and not kept.incomplete else 1


def _refuse(args: argparse.Namespace, perception: Level) -> None:
    """Refuse options that do not go together by `BadInput`."""
    follows, beside = args.follow is not None, args.autopilot is not None
    of_program = (args.binary, args.keep, args.physics) != (None, None, "ours")
    with_program = of_program or args.param or args.unaided
    program = "--binary, --physics, --param, --unaided"
    refuse_any(
        (args.perception_model and perception == "pixels", "--perception-model goes with --perception model or truth"),
        (args.set and follows, "--set does not go with --follow"),
        (args.pad is not None and follows, "--pad does not go with --follow"),
        (args.pad is not None and any("pad.file=" in one for one in args.set), "--pad sets pad.file: give one of them"),
        (args.faults and follows, "--faults does not go with --follow"),
        (args.faults and args.binary, "--faults does not go with --binary: a program flies few of the faults"),
        (follows and (beside or with_program), f"--follow does not go with --autopilot, {program} or --keep"),
        (with_program and not beside, f"{program} and --keep go with --autopilot"),
        (of_program and args.binary is None, "--physics own and --keep go with --binary PATH, a program"),
        (args.autopilot == "arduplane" and args.binary is None, "--autopilot arduplane needs --binary PATH (docs/sitl.md)"),
    )


def run_autopilot(args: argparse.Namespace, perception: Level, scenario: Scenario, settings: Settings) -> int:
    """Fly the scenario; return 0 if it landed on the pad, else 1."""
    from sitl.emulators.autopilots.programs.program import executable

    binary = None if args.binary is None else executable(args.binary)
    seen_by, began = perceive(perception, args.perception_model), time.monotonic()
    kind = "in miniature" if binary is None else binary.name
    facts = {"kind": "simulate", "autopilot": args.autopilot, "binary": kind}
    with _folder(args.keep) as folder:
        flight = _flight_of(args, binary, folder, scenario, settings, seen_by)
        with keeping(args, flight.service_settings(), scenario.title, perception, facts, from_truth=True) as kept:
            flight.shadows, flight.on_start, flight.on_truth = kept.shadows, kept.on_start, kept.on_truth
            with shown(quiet=args.json) as observers:
                flight.observers = (*observers, *kept.observers)
                end = flight.fly()
            texts = (f"{at:8.2f} s  component {component:3d}  {text}\n" for at, component, text in end.texts)
            (folder / "texts.txt").write_text("".join(texts))
            ending, wall_s = replace(end.ending, scenario=args.scenario), time.monotonic() - began
            report = kept.end(ending, wall_s, "virtual time" if binary is None else f"in lock step with {kind}")
    as_flown = replace(end, ending=ending)
    lines = [*(silence.in_words() for silence in end.silences), end.failure or ending.in_words()]
    lines.append(f"{ending.duration_s:.1f} s from the order to land; {wall_s:.0f} s on the wall clock\n{report}")
    print_result(args, {**as_flown.as_json(), "autopilot": args.autopilot, "physics": args.physics}, "\n".join(lines))
    return 0 if ending.good and not kept.incomplete else 1


def _flight_of(
    args: argparse.Namespace, binary: Path | None, folder: Path, scenario: Scenario, settings: Settings, seen_by: Perception
) -> StandInFlight | AutopilotFlight:
    """Return the flight of a program, or without one of the autopilot in miniature."""
    given = parameters(args.param)
    if binary is None:  # these load MAVLink, and a program's asyncio, which other flights do not need
        from sitl.emulators.autopilots.stand_in.flight import StandInFlight

        return StandInFlight(scenario, args.seed, settings, args.autopilot, dict(given), perception=seen_by, unaided=args.unaided)
    from sitl.emulators.autopilots.flight import AutopilotFlight, AutopilotProgram

    program = AutopilotProgram(args.autopilot, binary, given, own=args.physics == "own", unaided=args.unaided)
    return AutopilotFlight(scenario, args.seed, settings, program, folder, perception=seen_by)


def parameters(given: Sequence[str]) -> tuple[tuple[str, float], ...]:
    """Parse parameters from `NAME=VALUE`.

    Raises:
        BadInput: one that is not of that form.
    """
    out = []
    for text in given:
        if (found := re.fullmatch(r"([A-Z][A-Z0-9_]{0,15})=(.+)", text)) is None:
            raise BadInput(f"--param {text!r}: write NAME=VALUE, a name in capitals and a number")
        out.append((found[1], finite(found[2], f"--param {found[1]}")))
    return tuple(out)


@contextmanager
def _folder(keep: Path | None) -> Iterator[Path]:
    """Provide an empty folder for the program, and copy it to `keep` at the end if given."""
    with tempfile.TemporaryDirectory(prefix="decklander-") as name:
        try:
            yield Path(name)
        finally:
            if keep is not None:
                shutil.copytree(name, keep, dirs_exist_ok=True)


def run_follow(args: argparse.Namespace) -> int:
    """Follow the vehicle until the landing has ended; return 0 if it landed on the pad, else 1."""
    from companion.base import event_loop
    from sitl.emulators.autopilots.follow import follow

    if args.report is not None or args.record is not None:
        raise BadInput("--report and --record do not go with --follow")
    parse_endpoint(args.follow)
    scenario = load_scenario(args.scenario)
    if scenario.faults:
        kinds = ", ".join(dict.fromkeys(fault.kind for fault in scenario.faults))
        raise BadInput(f"{args.scenario}: its faults ({kinds}) cannot act with --follow")
    given = flight_options.chosen(args, scenario, by_autopilot=True)
    flight_options.warn(args, [given.settings], given.replaced, "a flight with an autopilot")
    with shown(quiet=args.json) as observers:
        end = event_loop.run(follow(given.scenario, args.seed, given.settings, args.follow, observers))
    contacts = () if end.landing is None else (end.landing,)
    ending = Ending(args.scenario, args.seed, end.outcome, contacts, end.duration_s, end.health.frames, end.started)
    more = {"follow": args.follow, "by_truth": end.by_truth, "failure": end.failure or None}
    source = "the simulator's own truth" if end.by_truth else "the autopilot's own estimate of its place"
    print_result(args, {**ending.as_json(), **more}, f"{end.failure or ending.in_words()}\njudged by {source}\n")
    return 0 if ending.on_pad else 1
