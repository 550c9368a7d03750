"""`decklander campaign`: fly many simulated landings and say how often and how well they end."""

import argparse
import difflib
import json
import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, closing
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from companion.base.signals import Stopped
from companion.cli import flight_options
from companion.cli.options import WorkProgress, named_wait, option, refuse_any, require_drawing
from companion.cli.outputs import CAMPAIGN, REPORT_FOLDER, check_output, output
from companion.settings.load import shipped, write_whole
from estimator.contracts.errors import BadInput, file_errors, refused
from estimator.pipeline import RelativeEstimator
from sitl.campaign import plan as plans
from sitl.campaign.figures import WORST, added, by_scenario, effects_of, in_columns, in_rows, in_words, tallies_of, unmoved
from sitl.campaign.random_faults import Cases, FaultTally, fly_with_random_faults
from sitl.campaign.report import AXES, MAP, REPORT, render_map, render_report
from sitl.campaign.store import FLIGHTS, FolderStore, flights_in, fly_left, manifest_of, manifest_of_plan, wall_s_in
from sitl.campaign.workers import ClusterWorkers, Flight, Flyer, LocalWorkers, fly_flight, job_of
from sitl.faults.carried import refuse_others
from sitl.flight.one_flight import perception_level
from sitl.perception.levels import perceive
from sitl.scenario.overrides import Overridable
from sitl.scenario.scenario import FAULTS, Scenario
from sitl.scenario.scenario import load as load_scenario
from sitl.scenario.with_fault import with_random_faults

_RUNS = 100  # runs where none are given
_MAP_RUNS = 4  # runs of each cell of a map
_BESIDE = REPORT_FOLDER._replace(inside=(REPORT, MAP))


DESCRIPTION = (
    "Fly many simulated landings of one scenario, each with its own seed, and summarize them. Results are kept "
    "in a folder as they come: the same command goes on where an earlier one ended, whatever ended it. Exit code 0 if every "
    "flight landed on the pad safely, or refused as the scenario expects; else 1. docs/campaigns.md has more. "
    "'decklander campaign report DIR' writes the report of what is in a folder."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    option(
        parser,
        "scenario",
        f"scenario file, or the name of a shipped one ({', '.join(shipped('scenarios'))}; {FAULTS}/NAME for those "
        f"with a fault); or a set of scenarios ({', '.join(plans.shipped_sets())}, or its file); or the word report",
    )
    option(parser, "more SCENARIO", "further scenarios; with report: the folder of a campaign", nargs="*")
    option(parser, "--runs N", "number of flights, at each point (default: 100)", type=int)
    option(parser, "--seed FIRST", "seed of the first flight (default: 0)", type=int)
    flight_options.add_arguments(parser)
    parser.set_defaults(perception=None)
    where = parser.add_argument_group("where to fly and to keep")
    option(where, "--workers K", "number of processes (default: one for each core)", type=int)
    option(where, "--scheduler URL", "fly on the Dask cluster of this scheduler, as tcp://host:8786")
    output(where, "--out DIR", "keep the results in this folder (default: campaigns/NAME-DIGEST, by what is flown)", CAMPAIGN)
    more = parser.add_argument_group("vary")
    option(
        more,
        "--vary KEY=SPAN",
        "fly all seeds at each value of a key: LOW:HIGH:STEP or A,B,C; repeated, at all combinations",
        default=[],
        action="append",
    )
    option(
        more,
        "--faults",
        "let each seed draw one or two faults: of sensors, frames, commands, lens, rotor, battery or service, or a person's "
        f"act; the first {WORST} failing flights become scenario files beside the results, with the fewest and weakest faults",
        choices=("random",),
    )
    option(
        more,
        "--autopilot",
        "fly this autopilot in miniature instead of an AR.Drone (docs/sitl.md)",
        choices=("arducopter", "px4"),
    )
    results = parser.add_argument_group("results")
    option(results, "--json", "print a line of JSON for each flight, and one of the summary")
    beside = f"write {REPORT} beside the results, or index.html into this folder"
    output(results, "--report DIR", beside, REPORT_FOLDER, type=str, nargs="?", const="")
    option(
        results,
        "--map",
        f"fly all winds, seas and vehicles of a scenario with weather and draw what lands as {MAP} (default of --vary: "
        f"{' '.join(AXES)}; of --runs: {_MAP_RUNS})",
    )
    option(results, "--against DIR", "compare with this earlier campaign in the report, seed by seed")


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    if args.scenario == "report":
        return _report(args)
    if args.map:
        _vary_axes(args)
    flight_options.choose_vehicle(args)
    args.runs, args.seed = args.runs if args.runs is not None else _MAP_RUNS if args.map else _RUNS, args.seed or 0
    seeds = plans.seeds_of(args.seed, args.runs)
    workers = len(os.sched_getaffinity(0)) if args.workers is None else args.workers
    _refuse(args, workers)
    plan, points = _set_plan(args) if args.more or plans.is_set(args.scenario) else _design(args, *_plan(args))
    names = list(plan.members) if isinstance(plan, plans.SetPlan) else [""]
    jobs = [plans.Job(seed, point, name) for name, seed, point in product(names, seeds, points)]
    keys = {job.key for job in jobs}
    _compared_with(args.against, keys)
    with closing(_store(args, plan, seeds)) as store:
        try:
            with _workforce(args, plan, workers) as workforce:
                by = "1 process" if 1 in (workers, len(jobs)) else f"{min(workers, len(jobs))} processes"
                _fly_left(args, store, workforce, jobs, f"the cluster at {args.scheduler}" if args.scheduler else by)
        except Stopped:
            kept = len(store.keys())
            sys.stderr.write(f"{kept} flights are kept in {store.place}; the same command goes on from there\n")
            raise
        return _conclude(args, plan, store, keys)


def _vary_axes(args: argparse.Namespace) -> None:
    """Let a map vary every axis that `--vary` does not name."""
    if args.more:
        raise BadInput(f"--map takes one scenario, found {args.more[0]!r} besides")
    output = {text.partition("=")[0] for text in args.vary}
    args.vary = [*args.vary, *(axis for axis in AXES if axis.partition("=")[0] not in output)]


def _refuse(args: argparse.Namespace, workers: int) -> None:
    """Refuse options that do not go together by `BadInput`."""
    refuse_any(
        (workers < 1, f"--workers must be 1 or more, got {workers}"),
        (args.workers is not None and args.scheduler, "--workers does not go with --scheduler: the cluster has its own"),
        (args.against and args.report is None, "--against goes with --report"),
    )
    if args.report is not None:
        require_drawing("--report")


def _set_plan(args: argparse.Namespace) -> tuple[plans.SetPlan, list[plans.Point]]:
    if args.vary:
        raise BadInput("--vary goes with one scenario, not with several")
    if args.more:
        args.scenario, args.perception = ", ".join(names := [args.scenario, *args.more]), args.perception or "pixels"
        chosen, scenarios = plans.set_of(names), {name: load_scenario(name) for name in names}
    else:
        chosen, scenarios = plans.load_set(args.scenario)
    members, flown, replaced = {}, [], list[str]()
    for member in chosen.scenario:
        name = member.name
        level = chosen.level(member) if args.perception is None else args.perception
        with refused(f"{args.scenario}: {name}", BadInput):
            members[name], given = _plan_of(args, name, scenarios[name], level)
            flown.append(given.settings)
            replaced += given.replaced
            perceive(members[name].perception, args.perception_model).refuse(scenarios[name].faults)
            if args.faults is not None:
                members[name] = _with_random_faults(args, members[name], scenarios[name])
    flight_options.warn(args, flown, replaced)
    base = () if chosen.base is None else ("--base", chosen.base)
    args.perception = None  # each flight says its own when it is to be flown again
    found = {} if args.more else {name: plans.place_of(args.scenario, name) for name in members}
    places = {name: place for name, place in found.items() if place != name}
    return plans.SetPlan(args.scenario, chosen.title, members, (*base, *_options(args)), places), [()]


def _plan(args: argparse.Namespace) -> tuple[plans.CampaignPlan, Overridable]:
    args.perception = args.perception or "pixels"
    try:
        scenario = load_scenario(args.scenario)
    except BadInput as why:
        if near := difflib.get_close_matches(args.scenario, plans.shipped_sets(), n=1):
            raise BadInput(f"{why}; there is a set {near[0]!r}") from why
        raise
    return _plan_of(args, args.scenario, scenario, args.perception)


def _plan_of(args: argparse.Namespace, name: str, scenario: Scenario, level: str) -> tuple[plans.CampaignPlan, Overridable]:
    perception = perception_level(level)
    if args.perception_model is not None and perception == "pixels":
        raise BadInput("--perception-model goes with --perception model or truth")
    perceive(perception, args.perception_model)
    given = flight_options.chosen(args, scenario, by_autopilot=args.autopilot is not None)
    RelativeEstimator(given.settings.estimator)  # a path that lacks its library is refused before any flight
    plan = plans.make_plan(name, given.scenario, given.settings, perception, args.perception_model, tuple(_options(args)))
    if args.autopilot is not None:
        refuse_others(name, given.scenario.faults, "stand-in")
        plan = replace(plan, design=plans.described(_flown_as(args, "single scenario"), []))
    return replace(plan, own=args.config is not None), given


def _flown_as(args: argparse.Namespace, kind: str) -> str:
    """Return the kind of a design; another vehicle's flights are another campaign."""
    return kind if args.autopilot is None else f"{kind}, {args.autopilot} in miniature"


def _options(args: argparse.Namespace) -> Iterator[str]:
    """Return the arguments with which `decklander simulate` flies a flight of this campaign again."""
    perception = None if args.perception == "pixels" else args.perception
    options = [("--config", args.config), ("--perception", perception), ("--perception-model", args.perception_model)]
    options += [*(("--set", value) for value in args.set), ("--faults", args.faults)]
    options.append(("--autopilot", args.autopilot))
    yield from (word for option in options if option[1] for word in option)


def _design(
    args: argparse.Namespace, plan: plans.CampaignPlan, given: Overridable
) -> tuple[plans.CampaignPlan, list[plans.Point]]:
    """Return the plan with its design, and the points at which all seeds are flown."""
    refuse_any((args.faults is not None and args.vary, "--faults does not go with --vary"))
    axes = [plans.parse_axis(text, given, "--vary") for text in args.vary]
    twice = {axis.key for axis in axes} & {text.partition("=")[0] for text in args.set}
    refuse_any((twice, f"--set and --vary both give {', '.join(sorted(twice))}: take one out"))
    points = plans.factorial(axes)
    flight_options.warn(args, [given.with_values(point, "--vary")[1] for point in points], given.replaced)
    if args.faults is not None:
        return _with_random_faults(args, plan, given.scenario), points
    return (replace(plan, design=plans.described(_flown_as(args, "factorial"), axes)) if axes else plan), points


def _with_random_faults(args: argparse.Namespace, plan: plans.CampaignPlan, scenario: Scenario) -> plans.CampaignPlan:
    """Return the plan with faults that each seed draws; raises BadInput where there can be none."""
    with_random_faults(scenario, args.seed, plan.perception, autopilot=args.autopilot is not None)
    return replace(plan, design=plans.described(_flown_as(args, "random faults"), []))


def _store(args: argparse.Namespace, plan: plans.AnyPlan, seeds: range) -> FolderStore:
    folder = Path(args.out) if args.out else Path("campaigns") / f"{Path(plan.name).stem}-{plans.digest_of(plan)}"
    if args.report == "":
        check_output(folder, _BESIDE, "--report", [], force=args.force)
    return FolderStore(folder, plan, seeds)


def _workforce(
    args: argparse.Namespace, plan: plans.AnyPlan, workers: int
) -> AbstractContextManager[LocalWorkers | ClusterWorkers]:
    flyer = _flyer(args, drawn=args.faults is not None)
    if args.scheduler is None:
        return LocalWorkers(plan, plans.code_version(), workers, flyer)
    return ClusterWorkers(plan, plans.code_version(), args.scheduler, flyer)


def _flyer(args: argparse.Namespace, *, drawn: bool) -> Flyer:
    """Return what flies one scenario once; `drawn`: with the faults that its seed draws."""
    if args.autopilot is None:
        return fly_with_random_faults if drawn else fly_flight
    from sitl.emulators.autopilots.stand_in.flight import fly_stand_in  # loads MAVLink, which an AR.Drone does not need

    return partial(fly_stand_in, args.autopilot, drawn)


def _fly_left(
    args: argparse.Namespace, store: FolderStore, workforce: LocalWorkers | ClusterWorkers, jobs: Sequence[plans.Job], by: str
) -> None:
    asked = {job.key for job in jobs}
    left = len(asked - store.keys())
    if not args.json or left < len(asked):
        kept = f"{len(asked) - left} of {len(asked)} flights are there already; " if left < len(asked) else ""
        sys.stderr.write(f"{kept}{left} flights to fly, by {by}; results in {store.place}\n")
    if args.json:
        for flight in _asked(store, asked):
            _say(flight)
    progress, grades = WorkProgress("campaign", "flights"), Counter[str]()

    with named_wait("flying the first", quiet=args.json) as begun:

        def on_flight(flight: Flight) -> None:
            begun()
            grades[flight["grade"]] += 1
            if args.json:
                _say(flight)
            else:
                progress.take(grades.total(), left, f", {grades['failed']} failed")

        fly_left(workforce.results, store, jobs, on_flight)


def _conclude(args: argparse.Namespace, plan: plans.AnyPlan, store: FolderStore, asked: set[str]) -> int:
    tallies = tallies_of(_asked(store, asked))
    effects = effects_of(tallies)
    whole = added(tallies.values())
    wall_s = store.wall_s(whole.counts["runs"])
    summary = {**whole.summary(plan.name, plan.perception, wall_s), "out": store.place}
    each = by_scenario(plan.identity()["members"], tallies) if isinstance(plan, plans.SetPlan) else []
    summary |= {name: found for name, found in (("scenarios", each), ("varied", effects)) if found}
    files, tally = [], None
    if args.faults is not None:
        tally = FaultTally()
        for flight in _asked(store, asked):
            tally.take(flight)
        summary["random_faults"] = tally.as_json()
        files += _cases(args, plan, store, tally)
    if args.map:
        files.append(store.put(MAP, render_map(plan.name, plan.perception, _asked(store, asked)).encode()))
    if args.report is not None:
        manifest = manifest_of_plan(plan, range(args.seed, args.seed + args.runs), None)
        page = render_report(manifest, _asked(store, asked), wall_s, _compared_with(args.against, asked))
        files.append(store.put(str(Path(args.report).resolve() / "index.html") if args.report else REPORT, page.encode()))
    if args.json:
        sys.stdout.write(json.dumps({"summary": summary}) + "\n")
        sys.stderr.writelines(f"{note}\n" for key, rows in effects.items() if (note := unmoved(key, rows)))
    else:
        tables = each and in_columns(each), effects and in_rows(effects), tally and tally.in_words(), in_words(summary)
        sys.stdout.writelines(f"{table}\n" for table in (*filter(None, tables), f"results: {', '.join([store.place, *files])}"))
    return 0 if whole.counts["failed"] == 0 else 1


def _cases(args: argparse.Namespace, plan: plans.AnyPlan, store: FolderStore, tally: FaultTally) -> list[str]:
    """Write a scenario file for each of the first failing flights of each scenario, and return where they are."""
    written = []
    for one in plan.members.values() if isinstance(plan, plans.SetPlan) else (plan,):
        name, base, perception, model = plans.unpacked(one.base())
        flyer, beside = _flyer(args, drawn=False), args.autopilot is not None
        cases = Cases(name, base.scenario, base.settings, perception, model, one.options, flyer, beside)
        failing = [flight for flight in tally.failing if flight["scenario"] == name]
        if failing:
            sys.stderr.write(f"campaign: looking for the fewest and weakest faults with which {name} still fails ...\n")
        written += [store.put(file, content) for file, content in cases.of(failing)]
    return written


def _asked(store: FolderStore, asked: set[str]) -> Iterator[Flight]:
    """Return the kept flights that this command requested: the place may hold more of the same campaign."""
    return (flight for flight in store.flights() if job_of(flight).key in asked)


def _say(flight: Flight) -> None:
    sys.stdout.write(json.dumps(flight) + "\n")
    sys.stdout.flush()


def _report(args: argparse.Namespace) -> int:
    """Write the report of the folder; return 0."""
    chooses = args.set or args.vary or args.runs or args.seed or args.perception or args.faults
    refuse_any(
        (len(args.more) != 1, "campaign report needs the folder of one campaign"),
        (bool(chooses), "campaign report draws all flights of a folder, without --set, --vary, --runs, --seed or --perception"),
    )
    require_drawing("campaign report")
    folder = Path(args.more[0])
    check_output(folder, _BESIDE, "report", [], force=args.force)
    manifest = manifest_of(folder)
    path = folder / FLIGHTS
    against = _compared_with(args.against, {job_of(flight).key for flight in flights_in(path)} if args.against else set())
    if changed := _changed(manifest):
        sys.stderr.write(f"the commands in the report may fly other flights now: {changed}\n")
    page = render_report(manifest, flights_in(path), wall_s_in(path), against, changed)
    pages = {REPORT: page}
    if args.map:
        pages[MAP] = render_map(manifest["name"], manifest["perception"], flights_in(path))
    for name, text in pages.items():
        with file_errors(str(folder / name)):
            write_whole(folder / name, text)
        sys.stdout.write(f"{name.partition('.')[0]}: {folder / name}\n")
    return 0


def _changed(manifest: dict[str, Any]) -> str:
    """Return in words what scenario, settings, their files and the code are now instead of what was flown; empty if the same."""
    add_arguments(parser := argparse.ArgumentParser())
    args, _ = parser.parse_known_args([*manifest["name"].split(", "), *manifest.get("options", ())])
    levels = {one["perception"] for one in manifest.get("members", {"": manifest}).values()}
    args.perception = levels.pop() if len(levels) == 1 else None
    try:
        now = (_set_plan if "members" in manifest else _plan)(args)[0].identity()
    except BadInput as why:
        return str(why)
    keys = now.keys() - {"design"}
    return plans.differences({key: manifest.get(key) for key in keys}, {key: now[key] for key in keys})


def _compared_with(against: str | None, asked: set[str]) -> tuple[str, dict[str, Any], list[Flight]] | None:
    """Return the name, manifest and flights of an earlier campaign.

    Raises:
        BadInput: the folder is that of none, or has none of the flights that are requested.
    """
    if against is None:
        return None
    manifest, flights = manifest_of(Path(against)), list(flights_in(Path(against) / FLIGHTS))
    if asked.isdisjoint(job_of(flight).key for flight in flights):
        raise BadInput(f"--against {against}: no seed was flown in both campaigns with the same varied values")
    return against, manifest, flights
