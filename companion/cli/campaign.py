"""`decklander campaign`: fly many simulated landings and say how often and how well they end."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from pathlib import Path

from companion.cli.campaign_progress import CampaignProgress
from companion.config.settings import shipped
from companion.runtime.signals import Stopped
from estimator.contracts.errors import BadInput
from sitl.campaign.code import code_version
from sitl.campaign.local import LocalWorkers
from sitl.campaign.overrides import Overridable
from sitl.campaign.plan import CampaignPlan, Job, make_plan, seeds_of
from sitl.campaign.run import Session
from sitl.campaign.store import FolderStore, ResultStore
from sitl.campaign.summary import CampaignTally, in_words
from sitl.campaign.task import Flight, job_of
from sitl.one_flight import PERCEPTIONS, perception_level, settings_for
from sitl.perception.levels import perceive
from sitl.scenario import FAULTS
from sitl.scenario import load as load_scenario

_ALONE = "vision.method=registration"
"""The thesis' vision methods cost two thirds of the CPU time of a flight, and nobody looks at them in a campaign."""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander campaign` to the parser."""
    parser = subparsers.add_parser(
        "campaign",
        help="fly many simulated landings and summarize them",
        description="Fly many simulated landings of one scenario, each with its own seed, and summarize them. Results are kept "
        "in a folder as they come: the same command goes on where an earlier one ended, whatever ended it. Exit code 0 if every "
        "flight landed on the pad safely, or refused as the scenario expects; else 1. docs/campaigns.md has more.",
    )
    parser.add_argument(
        "scenario",
        help=f"scenario file, or the name of a shipped one ({', '.join(shipped('scenarios'))}; {FAULTS}/NAME for those "
        "with a fault)",
    )
    parser.add_argument("--runs", type=int, default=100, metavar="N", help="number of flights (default: 100)")
    parser.add_argument("--seed", type=int, default=0, metavar="FIRST", help="seed of the first flight (default: 0)")
    parser.add_argument(
        "--perception",
        default="pixels",
        metavar="LEVEL",
        help=f"how the service perceives the pad: {', '.join(PERCEPTIONS)} (default: pixels, rendered frames)",
    )
    parser.add_argument(
        "--perception-model",
        metavar="FILE",
        help="error model of --perception model or truth, from decklander perception fit (default: the shipped one of "
        "vision.method)",
    )
    parser.add_argument(
        "--config",
        metavar="FILE",
        help="settings file to fly with (default: the profile sim with the scenario's camera and pad, and registration as the "
        "only vision method)",
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="give a key of scenario or settings another value"
    )
    parser.add_argument("--workers", type=int, metavar="K", help="number of processes (default: one for each core)")
    parser.add_argument(
        "--out", metavar="DIR", help="keep the results in this folder (default: campaigns/NAME-DIGEST, by what is flown)"
    )
    parser.add_argument("--json", action="store_true", help="print a line of JSON for each flight, and one of the summary")


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    seeds = seeds_of(args.seed, args.runs)
    workers = len(os.sched_getaffinity(0)) if args.workers is None else args.workers
    if workers < 1:
        raise BadInput(f"--workers must be 1 or more, got {workers}")
    plan = _plan(args)
    jobs = [Job(seed) for seed in seeds]
    folder = Path(args.out) if args.out else Path("campaigns") / f"{Path(plan.name).stem}-{plan.digest()}"
    with closing(FolderStore(folder, plan, seeds)) as store:
        return _fly(args, plan, store, jobs, workers)


def _fly(args: argparse.Namespace, plan: CampaignPlan, store: ResultStore, jobs: Sequence[Job], workers: int) -> int:
    asked = {job.key for job in jobs}
    try:
        _fly_left(args, plan, store, jobs, asked, workers)
    except Stopped:
        done = len(asked & store.keys())
        sys.stderr.write(f"{done} of {len(asked)} flights are kept in {store.place}; the same command goes on from there\n")
        raise
    return _conclude(args, plan, store, asked)


def _fly_left(
    args: argparse.Namespace, plan: CampaignPlan, store: ResultStore, jobs: Sequence[Job], asked: set[str], workers: int
) -> None:
    left = len(asked - store.keys())
    workers = min(workers, max(1, left))
    if not args.json or left < len(asked):
        kept = f"{len(asked) - left} of {len(asked)} flights are there already; " if left < len(asked) else ""
        by = "process" if workers == 1 else "processes"
        sys.stderr.write(f"{kept}{left} flights to fly, by {workers} {by}; results in {store.place}\n")
    if args.json:
        for flight in _asked(store, asked):
            _say(flight)
    with (
        LocalWorkers(plan, code_version(), workers) as workforce,
        CampaignProgress(len(asked), len(asked) - left, quiet=args.json) as progress,
    ):

        def on_flight(flight: Flight) -> None:
            if args.json:
                _say(flight)
            progress.take(flight["grade"] == "failed")

        Session(workforce, store).fly(jobs, on_flight)


def _conclude(args: argparse.Namespace, plan: CampaignPlan, store: ResultStore, asked: set[str]) -> int:
    counted = CampaignTally()
    for flight in _asked(store, asked):
        counted.take(flight)
    summary = {**counted.summary(plan.name, plan.perception, store.wall_s()), "out": store.place}
    if args.json:
        sys.stdout.write(json.dumps({"summary": summary}) + "\n")
    else:
        sys.stdout.write(f"{in_words(summary)}\nresults: {store.place}\n")
    return 0 if counted.failed == 0 else 1


def _asked(store: ResultStore, asked: set[str]) -> Iterator[Flight]:
    """Return the kept flights that this command asked for: the place may hold more of the same campaign."""
    return (flight for flight in store.flights() if job_of(flight).key in asked)


def _plan(args: argparse.Namespace) -> CampaignPlan:
    perception = perception_level(args.perception)
    if args.perception_model is not None and perception == "pixels":
        raise BadInput("--perception-model goes with --perception model or truth")
    perceive(perception, args.perception_model)
    scenario = load_scenario(args.scenario)
    settings = settings_for(scenario, args.config)
    alone = args.config is None and perception == "pixels"
    values = [*([_ALONE] if alone else []), *args.set]
    given = Overridable(scenario, settings)
    overrides = [given.parse(text, "--set") for text in values]
    scenario, settings = given.with_values(overrides, "--set")
    options = tuple(_options(args, values))
    return make_plan(args.scenario, scenario, settings, perception, args.perception_model, options)


def _options(args: argparse.Namespace, values: Iterable[str]) -> Iterator[str]:
    """Return the arguments with which `decklander simulate` flies a flight of this campaign again."""
    if args.config:
        yield from ("--config", args.config)
    if args.perception != "pixels":
        yield from ("--perception", args.perception)
    if args.perception_model:
        yield from ("--perception-model", args.perception_model)
    for value in values:
        yield from ("--set", value)


def _say(flight: Flight) -> None:
    sys.stdout.write(json.dumps(flight) + "\n")
    sys.stdout.flush()
