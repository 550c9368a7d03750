"""`decklander gamepad`: list the gamepads of this computer, or show what one of them sends and what its mapping makes of it."""

import argparse
import json
import select
import sys
import time
from pathlib import Path

from companion.cli.options import option
from companion.parts.gamepad.mapping_file import mapping_of
from companion.settings.load import shipped
from drivers.clock import SystemClock
from drivers.gamepad.device import AXES, EV_ABS, EV_KEY, FOLDER, EventDevice, events_in, gamepads
from drivers.gamepad.mapping import STICKS, GamepadMapping, gamepad_step, positions, start
from estimator.contracts.errors import BadInput, Recoverable, refused

DESCRIPTION = (
    "List the gamepads of this computer, or show the events of one live, with the sticks and orders "
    "that its mapping makes of them. Nothing is sent to a drone. Exit code 1 if there is no gamepad."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="list the gamepads that are plugged in")
    option(listing, "--json", "print one JSON object a line")
    show = actions.add_parser("show", help="show the events of a gamepad until interrupted")
    option(show, "--device NAME", "a part of its name, or its path (default: the first one)", default="")
    names = ", ".join(shipped("gamepads"))
    option(show, "--mapping FILE", f"mapping file, or a shipped one ({names}; default: thesis)", default="thesis")
    option(show, "--seconds S", "stop after this many seconds", type=float)


def run(args: argparse.Namespace) -> int:
    """List or show.

    Raises:
        BadInput: the mapping file or an option is wrong.
        Recoverable: the gamepad was unplugged.
    """
    if args.action == "list":
        return _list(as_json=args.json)
    if args.seconds is not None and not 0 < args.seconds < 1e6:
        raise BadInput(f"--seconds must be more than 0, got {args.seconds:g}")
    mapping = mapping_of(args.mapping)
    found = [d for d in gamepads() if args.device == d.path or args.device.lower() in d.name.lower()]
    for device in found[1:]:
        device.close()
    if not found:
        sys.stderr.write(_none())
        return 1
    try:
        return _show(found[0], mapping, args.seconds)
    finally:
        found[0].close()


def _list(*, as_json: bool) -> int:
    found = 0
    for device in gamepads():
        found += 1
        facts = {"path": device.path, "name": device.name, "axes": len(device.axes), "buttons": len(device.buttons)}
        text = f"{device.path}: {device.name}, {len(device.axes)} axes, {len(device.buttons)} buttons"
        sys.stdout.write((json.dumps(facts) if as_json else text) + "\n")
        device.close()
    if not found:
        sys.stderr.write(_none())
    return 0 if found else 1


def _none() -> str:
    devices = len(list(Path(FOLDER).glob("event*")))
    return f"decklander gamepad: no gamepad among the {devices} event devices in {FOLDER}\n"


def _show(device: EventDevice, mapping: GamepadMapping, seconds: float | None) -> int:
    clock, rest = SystemClock(), b""
    ranges = {code: device.axis(code) for code in device.axes & {AXES[getattr(mapping.sticks, s).axis] for s in STICKS}}
    memory = start(mapping, ranges)
    sys.stdout.write(f"{device.path}: {device.name}; mapping {mapping.name}; Ctrl-C ends\n")
    end_s = None if seconds is None else time.monotonic() + seconds
    while end_s is None or time.monotonic() < end_s:
        left_s = None if end_s is None else max(0.0, end_s - time.monotonic())
        if not select.select([device], [], [], left_s)[0]:
            continue
        with refused(str(device.path), OSError, by=Recoverable):
            events, rest = events_in(rest + device.read())
        memory, orders = gamepad_step(mapping, memory, events, ranges, clock.now())
        named = [f"{event.name}={event.value}" for event in events if event.kind in (EV_ABS, EV_KEY)]
        sticks = " ".join(f"{stick} {value:+.2f}" for stick, value in positions(mapping, memory).items())
        given = f" -> {', '.join(orders)}" if orders else ""
        sys.stdout.write(f"{' '.join(named)} | {sticks}{given}\n")
        sys.stdout.flush()
    return 0
