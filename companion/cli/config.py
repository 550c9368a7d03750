"""`decklander config`: check settings files, show them with every default, or print their reference."""

import argparse
import re
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from companion.base.mission import DESCENDS, ENDED, FAULTS, Event, State
from companion.cli.commands import CommandModule, actions_of
from companion.cli.options import option
from companion.guidance.advice import CAUSES
from companion.guidance.mission.machine import PHASES, TABLES
from companion.guidance.mission.phase import LANDING
from companion.guidance.mission.rules import Row
from companion.settings import schema
from companion.settings.load import Settings, complete, find_file, from_file, load, read_toml, shipped
from companion.settings.referenced_files import check_files
from companion.settings.remarks import not_checked, remarks
from decklander.place import SHIPPED
from estimator.contracts.errors import BadInput, refused
from estimator.contracts.estimates import Verdict
from estimator.contracts.tables import next_states

DESCRIPTION = "Check, show, import or look up settings."
_FAULTS_MOST = 20  # faults of a file that are reported


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    names = f"settings file, or the name of a shipped vehicle profile ({', '.join(shipped())})"
    check = actions.add_parser(
        "check",
        help="check settings files",
        description="Check settings files, and the camera, pad, key, password and certificate files that they name.",
    )
    option(check, "files FILE", names, nargs="+")
    show = actions.add_parser(
        "show", help="print a settings file with every default", description="Print a settings file with every default."
    )
    option(show, "file FILE", names)
    for name, action in actions_of("config").items():
        module: CommandModule = import_module(action.module)
        added = actions.add_parser(name, help=action.summary, description=module.DESCRIPTION)
        module.add_arguments(added)
        added.set_defaults(run=module.run)
    actions.add_parser(
        "schema", help="print the JSON Schema of settings files", description="Print the JSON Schema of settings files."
    )
    reference = actions.add_parser(
        "reference",
        help="look up a key, or print the reference of all settings",
        description="Print default, range, unit and meaning of the keys that contain a word, or the reference of all settings "
        "(docs/configuration.md) in Markdown.",
    )
    option(reference, "word WORD", "a key or a part of one, such as guidance.cone", nargs="?")
    option(reference, "--expert", "print the expert keys instead")
    actions.add_parser(
        "mission",
        help="print the states and events of a landing",
        description="Print the states and events of a landing, and what follows from them (docs/mission.md), in Markdown.",
    )


def run(args: argparse.Namespace) -> int:
    """Run the action; return 0, or what one of a capability returns.

    Raises:
        BadInput: a settings file, or a file that it names, cannot be read or has a fault.
    """
    if "run" in args:
        return int(args.run(args))
    if args.action == "check":
        faults: list[BadInput] = []
        for file in map(str, args.files):
            try:
                settings = _checked(find_file(file, "", Path(), "settings"))
                with refused(file, BadInput):
                    unchecked = check_files(settings)
            except BadInput as why:
                faults.append(why)
                continue
            sys.stdout.writelines(f"{file}: {line}\n" for line in (f"good{not_checked(unchecked)}", *remarks(settings)))
        sys.stderr.writelines(f"decklander: {why}\n" for why in faults[:-1])
        if faults:
            raise faults[-1]
    elif args.action == "show":
        sys.stdout.write(schema.toml(load(args.file)))
    elif args.action == "schema":
        sys.stdout.write(schema.schema())
    elif args.action == "mission":
        sys.stdout.write(mission_page())
    else:
        sys.stdout.write(schema.looked_up(args.word) if args.word else schema.reference(expert=args.expert))
    return 0


_OF_KEY = re.compile(r"([\w-]+(?:\.[\w-]+)+)[ :]")


def _checked(path: Path) -> Settings:
    """Return the settings of a file.

    Where it has several faults, all but the last are printed: each is mended by the key of a shipped profile, or left out.

    Raises:
        BadInput: as for `load`, of the last fault.
    """
    seen, data = set[str](), read_toml(path, "vehicle.kind")
    fault: BadInput | None = None
    vehicle = data.get("vehicle")
    autopilot = isinstance(vehicle, dict) and vehicle.get("kind") == "mavlink"
    usual = read_toml(SHIPPED / ("raspberry_ardupilot.toml" if autopilot else "sim.toml"))
    while True:
        try:
            settings = complete(from_file(data, str(path)), path)
        except BadInput as why:
            key = _OF_KEY.match(str(why).removeprefix(f"{path}: "))
            if fault is not None and (key is None or key[1] not in seen):
                sys.stderr.write(f"decklander: {fault}\n")
            if key is None or key[1] in seen or len(seen) == _FAULTS_MOST or not _mended(data, usual, key[1].split(".")):
                raise (fault if key is not None and key[1] in seen and fault is not None else why) from None
            fault = why
            seen.add(key[1])
            continue
        if fault is not None:
            raise fault
        return settings


def _mended(data: Any, usual: Any, key: list[str]) -> bool:
    """Give a key its usual value, or take it out; return whether either was done."""
    for table in key[:-1]:
        data = data.setdefault(table, {})
        usual = usual.get(table, {}) if isinstance(usual, dict) else {}
        if not isinstance(data, dict):
            return False
    had = key[-1] in data
    data.pop(key[-1], None)
    if isinstance(usual, dict) and key[-1] in usual:
        data[key[-1]] = usual[key[-1]]
    return had or key[-1] in data


# The page of the mission, written from its table

_HEAD = """# The mission

<!-- Made by `decklander config mission`; a test compares. -->

One machine flies the landing (`companion/guidance/mission/`). In each guidance cycle it takes the first event that leads to
another state. Each change carries a cause, the measured number and its limit.

Every state that waits has a time limit, after which the drone goes up or stays, never down. It never descends without a
fresh, consistent estimate of the pad, and holds still against the deck. Low without sight it only climbs, by range sensor, height
last known, time, or a contact felt in the last 20 s. Before the first order to land it stays in its own hover.
"""


def mission_page() -> str:
    """Return docs/mission.md."""
    others = (line for name in TABLES if name != "cone" for line in _other(name))
    return "\n".join((_HEAD, *_graph(), *_states(), *_events(), *_causes(), *_table("cone"), *others))


def _graph() -> Iterator[str]:
    yield from ("## The way down", "", "```mermaid", "stateDiagram-v2")
    drawn = [state for state in State if state not in _NOT_DRAWN]
    yield from (f"    {state.name}: {state.value}" for state in drawn)
    for state in drawn:
        ways = {target for event, target in TABLES["cone"][state].items() if event not in _ALWAYS} - {state}
        yield from (f"    {state.name} --> {target.name}" for target in drawn if target in ways and state not in ENDED)
    yield from ("```", "", "The tables below have the events and the ways that are left out here.", "")


_PLACES = re.compile(r"\{[^}]*\}")
_ALWAYS = (Event.HOLD, Event.STAY, Event.ABORT, Event.GROUNDED, Event.GROUNDED_BY_OTHERS)
_NOT_DRAWN = {*LANDING.values(), State.ANOTHER_PAD} - {State.PAUSED}


def _states() -> Iterator[str]:
    yield from ("## States", "", "| state | what the drone does | may come nearer to the deck |", "|---|---|---|")
    for state in State:
        yield f"| {state.value} | {PHASES[state].does} | {'yes' if state in DESCENDS else ''} |"
    yield ""


def _events() -> Iterator[str]:
    yield from ("## Events", "")
    yield f"Warnings are: {', '.join(event.value for event in Event if event in FAULTS)}. All others are notes."
    yield ""


def _causes() -> Iterator[str]:
    yield from ("## What to do", "", "The operator page shows it beside the event.", "", "| what to do | causes |", "|---|---|")
    for words, causes in CAUSES.items():
        if named := [_PLACES.sub("...", cause.value) for cause in causes if not isinstance(cause, Verdict)]:
            yield f"| {words} | {'; '.join(named)} |"
    yield ""


def _table(name: str) -> Iterator[str]:
    yield from (f'## Table of the mission "{name}"', "", "An event that is not named leaves the state as it is.", "")
    yield from _rows(name, {state: dict.fromkeys(Event, state) for state in State})


def _other(name: str) -> Iterator[str]:
    yield from (f'## What differs with `guidance.mission = "{name}"`', "")
    idle = [event for event in Event if all(TABLES[name][state][event] is state for state in State)]
    if idle:
        yield from (f"Without effect: {', '.join(event.value for event in idle)}.", "")
    yield from _rows(name, {state: {**row, **dict.fromkeys(idle, state)} for state, row in TABLES["cone"].items()})


def _rows(name: str, usual: Mapping[State, Row]) -> Iterator[str]:
    """Yield a row for each state: its next states, each with the events that lead there, where they are not the usual ones."""
    yield from ("| state | next state: events |", "|---|---|")
    if name == "cone":
        *most, last = (f"**{target.value}**: {event.value}" for event, target in LANDING.items())
        yield f"| all from waiting for the start to another pad | {'; '.join(most)} |"
        yield f"| all from paused to another pad | {last} |"
    for state in State:
        row = TABLES[name][state]
        flown = sum(row.get(event) is target for event, target in LANDING.items()) >= len(LANDING) - 2
        named = {event: target for event, target in row.items() if not flown or LANDING.get(event) is not target}
        if cells := [f"**{to.value}**: {', '.join(e.value for e in by)}" for to, by in next_states(named, usual[state])]:
            yield f"| {state.value} | {'; '.join(cells)} |"
    yield ""
