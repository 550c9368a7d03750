"""`decklander simulate`: simulate one flight in virtual time."""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

from companion.base.observer import Observer
from companion.cli import kept_flight, perception_option
from companion.cli.kept_flight import keeping
from companion.cli.progress import ProgressObserver
from companion.settings.load import find_file, shipped
from estimator.contracts.errors import BadInput
from estimator.contracts.time import MonoNs
from sitl.campaign.overrides import Overridable
from sitl.flight.one_flight import FlyOptions, fly, perception_level, settings_for
from sitl.scenario.scenario import FAULTS
from sitl.scenario.scenario import load as load_scenario
from sitl.scenario.with_fault import with_random_faults


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander simulate` to the parser."""
    parser = subparsers.add_parser(
        "simulate",
        help="simulate one flight in virtual time",
        description="Simulate one flight in virtual time, without sockets. The same scenario, seed and settings give the same "
        "flight to the bit. Exit code 0 if it landed on the pad safely, or refused as the scenario expects; else 1.",
    )
    parser.add_argument(
        "scenario",
        help=f"scenario file, or the name of a shipped one ({', '.join(shipped('scenarios'))}; {FAULTS}/NAME for those "
        "with a fault)",
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of all random numbers (default: 0)")
    parser.add_argument(
        "--config", metavar="FILE", help="settings file to fly with (default: the profile sim with the scenario's camera and pad)"
    )
    perception_option.add_arguments(parser)
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="give a key of scenario or settings another value, as in wind.speed_m_s=4; may be repeated",
    )
    parser.add_argument(
        "--wrong-model",
        type=float,
        metavar="SIGMA",
        help="let the seed draw by how much the vehicle differs from its file, in standard deviations of what an owner's "
        "identification leaves; 0 for not at all (default: as the scenario says, 1 in weather_2 to weather_6)",
    )
    parser.add_argument(
        "--base",
        metavar="SCENARIO",
        help="fly it on this scenario instead of the base that its file names, as a fault in another sea",
    )
    parser.add_argument(
        "--faults", choices=("random",), help="add one or two faults to what sensors, frames and commands say, drawn by the seed"
    )
    parser.add_argument("--pad", metavar="FILE", help="pad file, or the name of a shipped one, on deck and looked for")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--report", type=Path, metavar="DIR", help="write a report into this folder")
    kept_flight.add_arguments(parser)
    beside = parser.add_argument_group("real autopilots (docs/sitl.md)")
    beside.add_argument(
        "--autopilot", choices=("arducopter", "px4"), help="fly this autopilot program over the simulated sea and vehicle"
    )
    beside.add_argument("--binary", metavar="PATH", help="path of the autopilot program; `stand-in` flies a stand-in for it")
    beside.add_argument(
        "--follow", metavar="URL", help="follow a vehicle that another simulator flies, with the deck and camera of this one"
    )
    beside.add_argument(
        "--param", action="append", default=[], metavar="NAME=VALUE", help="set a parameter of the autopilot; may be repeated"
    )
    beside.add_argument(
        "--unaided",
        action="store_true",
        help="let the autopilot land by its own landing mode, and nothing of ours reach it, to compare",
    )
    beside.add_argument("--keep", type=Path, metavar="DIR", help="keep the logs and output of the autopilot in this folder")


def _with_program(args: argparse.Namespace) -> bool:
    """Return whether an option is given that only a flight with an autopilot program has."""
    return args.binary is not None or args.keep is not None or bool(args.param) or args.unaided


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    if args.seed < 0:
        raise BadInput(f"--seed must be 0 or more, got {args.seed}")
    perception = perception_level(args.perception)
    if args.perception_model is not None and perception == "pixels":
        raise BadInput("--perception-model goes with --perception model or truth")
    if args.wrong_model is not None:
        args.set = [*args.set, f"wrong_model.sigma={args.wrong_model:g}"]
    if args.set and args.follow is not None:
        raise BadInput("--set does not go with --follow")
    if args.pad is not None and args.follow is not None:
        raise BadInput("--pad does not go with --follow")
    if args.pad is not None:
        args.set = [f"pad.file={find_file(args.pad, 'pads', Path(), '--pad')}", *args.set]
    if args.faults is not None and (args.follow is not None or args.autopilot is not None):
        raise BadInput("--faults does not go with --autopilot or --follow")
    if args.follow is not None:
        from companion.cli.simulate_autopilot import run_follow

        if args.autopilot is not None or _with_program(args):
            raise BadInput("--follow does not go with --autopilot, --binary, --param, --unaided or --keep")
        return run_follow(args)
    if args.autopilot is not None:
        from companion.cli import simulate_autopilot

        return simulate_autopilot.run(args, perception)
    if _with_program(args):
        raise BadInput("--binary, --param, --unaided and --keep go with --autopilot")
    scenario = load_scenario(args.scenario, args.base)
    settings = settings_for(scenario, args.config)
    given = Overridable(scenario, settings)
    scenario, settings = given.with_values([given.parse(text, "--set") for text in args.set], "--set")
    if args.faults is not None:
        scenario = with_random_faults(scenario, args.seed, perception)
    progress = None if args.json else ProgressObserver()
    observers: list[Observer] = [] if progress is None else [progress]
    with keeping(args, settings, scenario.title, perception, {"kind": "simulate"}, MonoNs(0)) as kept:
        began = time.monotonic()
        ending = fly(
            args.scenario,
            scenario,
            args.seed,
            settings,
            perception,
            [*observers, *kept.observers],
            FlyOptions(args.perception_model, kept.shadows, kept.on_start, kept.on_truth, render_beside=True),
        )
    wall_s = time.monotonic() - began
    if progress is not None:
        progress.close()
    report = kept.write_report(ending, wall_s, "virtual time")
    if args.json:
        sys.stdout.write(json.dumps(ending.as_json()) + "\n")
    else:
        pace = ending.duration_s / max(1e-9, wall_s)
        sys.stdout.write(f"{ending.in_words()}\n{ending.duration_s:.1f} s flown in {wall_s:.1f} s ({pace:.1f} x real time)\n")
        sys.stdout.write(report)
    return 0 if ending.good else 1
