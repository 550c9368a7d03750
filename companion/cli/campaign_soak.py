"""`decklander campaign SCENARIO --soak`: fly repeated landings in one process for hours and watch for leaks."""

import argparse
from pathlib import Path

from companion.tools.report.drawing import require_drawing
from estimator.contracts.errors import BadInput
from sitl.campaign.overrides import Overridable
from sitl.campaign.plan import CampaignPlan
from sitl.campaign.soak import SoakOptions, soak

_OURS = ("hours", "virtual", "no_faults", "fault", "no_cpu", "failed_max", "plot", "readings")
_OTHERS = ("workers", "scheduler", "out", "vary", "design", "points", "search", "report", "against", "faults")
"""Options that go with `--soak` alone, and that do not go with it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add `--soak` and the options that go with it."""
    group = parser.add_argument_group(
        "repeated flights in one process",
        "Each flight has its own seed and its own fault, and is graded: on the pad, refused rightly, failed, or not judged "
        "because the machine was too slow. Exit code 1 if more flights failed than --failed-max allows, if most could not be "
        "judged, or if memory grew by 1 % or descriptors, threads or tasks by one after warm-up. Ctrl-C stops the run and prints "
        "the results so far.",
    )
    group.add_argument(
        "--soak",
        action="store_true",
        help="fly in one process and watch for leaks: the landing service flies the simulated drone through sockets in real time",
    )
    group.add_argument(
        "--hours", type=float, metavar="H", help="hours to run; with --virtual hours of flight time (default: 1, or --runs)"
    )
    group.add_argument("--virtual", action="store_true", help="fly in virtual time, without sockets")
    faults = group.add_mutually_exclusive_group()
    faults.add_argument("--no-faults", action="store_true", help="fly without faults")
    faults.add_argument("--fault", metavar="NAME", help="fly this fault in every flight (needs --virtual; default: at random)")
    group.add_argument("--no-cpu", action="store_true", help="skip the measurements of start time and CPU load")
    group.add_argument("--failed-max", type=int, metavar="N", help="allow this many failed flights (default: 0)")
    group.add_argument("--plot", type=Path, metavar="FILE", help="plot memory, counts and outcomes over time (png, svg, pdf)")
    group.add_argument("--readings", type=Path, metavar="FILE", help="write every reading as a line of JSON into this file")


def refuse(args: argparse.Namespace) -> None:
    """Refuse options that do not go together.

    Raises:
        BadInput: an option goes with `--soak` and that is not given, or the other way round.
    """
    for name in _OTHERS if args.soak else _OURS:
        if getattr(args, name) not in (None, False, []):
            word = "does not go with" if args.soak else "goes with"
            raise BadInput(f"--{name.replace('_', '-')} {word} --soak")


def run(args: argparse.Namespace, plan: CampaignPlan, given: Overridable) -> int:
    """Run the command and return its exit code."""
    seed, hours = 1 if args.seed is None else args.seed, 1.0 if args.hours is None else args.hours
    if seed < 0:
        raise BadInput(f"--seed must be 0 or more, got {seed}")
    if not 0.001 <= hours <= 1000:
        raise BadInput(f"--hours must lie in 0.001 to 1000, got {hours:g}")
    if args.runs is not None and (args.runs < 1 or not args.virtual or args.hours is not None):
        raise BadInput("--runs with --soak needs --virtual, takes the place of --hours, and is 1 or more")
    if not args.virtual:
        if args.fault is not None:
            raise BadInput("--fault needs --virtual; in real time the drone chooses its faults by its seeds")
        if plan.perception != "pixels":
            raise BadInput("--perception needs --virtual; in real time the drone sends images")
        if args.set:
            raise BadInput("--set with --soak needs --virtual; in real time the drone is a process of its own")
    failed_max = args.failed_max or 0
    if failed_max < 0:
        raise BadInput(f"--failed-max must be 0 or more, got {failed_max}")
    if args.plot is not None:
        require_drawing("--plot")
    options = SoakOptions(
        seed=seed,
        hours=hours,
        flights=args.runs,
        virtual=args.virtual,
        faults=not args.no_faults,
        fault=args.fault,
        failed_max=failed_max,
        config=args.config or "sim",
        cost=not args.no_cpu,
        plot=args.plot,
        readings=args.readings,
        json=args.json,
    )
    return soak(options, plan, *given.with_values((), "--set"))
