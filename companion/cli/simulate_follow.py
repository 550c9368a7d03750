"""`decklander simulate SCENARIO --follow URL`: simulate deck and camera for a vehicle that another simulator flies."""

from __future__ import annotations

import argparse
import json
import sys

from companion.base import event_loop
from companion.base.observer import Observer
from companion.cli.progress import ProgressObserver
from companion.cli.simulate_autopilot import refuse_faults
from drivers.mavlink.endpoint import parse_endpoint
from estimator.contracts.errors import BadInput
from estimator.contracts.time import NS_PER_S, MonoNs
from sitl.emulators.autopilots.follow import FollowEnd, follow
from sitl.flight.ending import Contact, Ending
from sitl.flight.one_flight import settings_for
from sitl.scenario.scenario import load as load_scenario


def run(args: argparse.Namespace) -> int:
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
