"""`decklander doctor --fix` and `--undo`: ask for each change of a parameter, write it, read it back, and tell how to undo it."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from msgspec.structs import replace

from companion.base import event_loop
from companion.cli.doctor_links import GivenLinks, given_links
from companion.settings.load import load
from companion.tools.doctor.finding import Finding, Severity
from companion.tools.doctor.gather import wait_until
from companion.tools.doctor.snapshot import AutopilotSnapshot, Snapshot
from companion.tools.doctor.undo import PlannedWrite, UndoFile, decode_undo, encode_undo, same
from companion.tools.doctor.write_parameters import OnResult, WriteResult, why_not_written, write_parameters
from drivers.clock import SystemClock
from drivers.mavlink.autopilot import open_autopilot
from estimator.contracts.errors import BadInput

AT_BOOT = frozenset({
    "PLND_ENABLED", "PLND_TYPE", "PLND_LAG", "EK3_SRC1_POSZ", "EKF2_HGT_REF", "EKF2_EV_CTRL", "EKF2_OF_CTRL", "EKF2_RNG_CTRL",
    "IMU_GYRO_CUTOFF", "IMU_ACCEL_CUTOFF", "IMU_DGYRO_CUTOFF", "INS_HNTCH_FREQ",
    *(f"RNGFND{n}_{what}" for n in range(1, 5) for what in ("TYPE", "ORIENT")),
})  # fmt: skip
"""Parameters that the autopilot reads when it starts."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of both."""
    parser.add_argument(
        "--fix",
        action="store_true",
        help="ask for each change of a parameter that fixes a fault, write it, and read it back; never while armed",
    )
    parser.add_argument("--undo", metavar="FILE", help="set back what --fix wrote, from the undo file that it kept")
    parser.add_argument("--yes", action="store_true", help="with --fix or --undo: say yes to every change")
    parser.add_argument(
        "--undo-file",
        metavar="FILE",
        help="with --fix: keep what the parameters were in this file (default: decklander-undo-TIME.json)",
    )


def check_options(args: argparse.Namespace) -> None:
    """Refuse options that do not go together.

    Raises:
        BadInput: they do not.
    """
    if args.fix and args.undo:
        raise BadInput("--fix and --undo do not go together")
    if (args.fix or args.undo) and not (args.link or args.config):
        raise BadInput(f"{'--fix' if args.fix else '--undo'} needs the autopilot: give --link URL or --config FILE")
    if (args.fix or args.undo) and args.json and not args.yes:
        raise BadInput("--json asks nothing: give --yes with it")
    if args.yes and not (args.fix or args.undo):
        raise BadInput("--yes goes with --fix or --undo")
    if args.undo_file and not args.fix:
        raise BadInput("--undo-file goes with --fix")
    if (args.fix or args.undo) and args.snapshot:
        raise BadInput("a saved snapshot cannot be fixed: leave --snapshot out")


def offered(autopilot: AutopilotSnapshot, found: Sequence[Finding]) -> list[tuple[Finding, PlannedWrite]]:
    """Return the changes that fix findings, each parameter once, with the value that it has."""
    out: dict[str, tuple[Finding, PlannedWrite]] = {}
    for finding in found:
        for change in finding.changes:
            was = autopilot.parameters.get(change.parameter)
            if was is not None and change.parameter not in out and not same(was, change.value):
                out[change.parameter] = (finding, PlannedWrite(change.parameter, was, change.value))
    return list(out.values())


def fix(args: argparse.Namespace, snapshot: Snapshot, found: Sequence[Finding]) -> int:
    """Ask for each change, write what was agreed to, and return the exit code: 0 if no error and no warning is left."""
    autopilot = snapshot.autopilot
    offers = [] if autopilot is None else offered(autopilot, found)
    if autopilot is None or not offers:
        _say(args, "nothing is wrong that a parameter fixes")
        return _code(found, set())
    if autopilot.armed is not False:
        raise BadInput("--fix: no parameter is written while the vehicle is armed: land, disarm and begin again")
    agreed = [one for finding, one in offers if args.yes or _agreed(one, f"{finding.what} [{finding.rule}]")]
    if not agreed:
        _say(args, "nothing was written")
        return _code(found, set())
    path = Path(args.undo_file or time.strftime("decklander-undo-%Y%m%d-%H%M%S.json"))
    _keep(path, UndoFile(autopilot.stack, autopilot.system, tuple(agreed)))
    _say(args, f"what the parameters are is kept in {path}")
    try:
        results = _written(args, autopilot.system, agreed)
    except BadInput:
        path.unlink()  # nothing was written
        raise
    done = {r.planned.parameter for r in results if r.refused is None}
    if done:
        _say(args, f"undo: {_command(args)} --undo {shlex.quote(str(path))}")
    else:
        path.unlink()
    _boot(args, done)
    return _code(found, done)


def undo(args: argparse.Namespace) -> int:
    """Set back what an undo file holds, the last first, and return the exit code: 0 if all is as it was."""
    try:
        kept = decode_undo(Path(args.undo).read_bytes(), args.undo)
    except OSError as why:
        raise BadInput(f"--undo {args.undo}: {why.strerror or why}") from why
    backwards = [one.back for one in reversed(kept.written)]
    agreed = [one for one in backwards if args.yes or _agreed(one, f"--fix set {one.parameter} from {one.to:g} to {one.was:g}")]
    if not agreed:
        _say(args, "nothing was written")
        return 1
    results = _written(args, kept.system, agreed, kept)
    _boot(args, {r.planned.parameter for r in results if r.refused is None})
    return 0 if len(agreed) == len(backwards) and all(r.refused is None for r in results) else 1


def _agreed(one: PlannedWrite, why: str) -> bool:
    sys.stdout.write(f"\n{why}\n    set {one.parameter} {one.was:g} -> {one.to:g}? [y/N] ")
    sys.stdout.flush()
    answer = sys.stdin.readline()
    if not (sys.stdin.isatty() and answer):
        sys.stdout.write("\n")  # nobody's return key ended the line
    return answer.strip().lower() in ("y", "yes")


def _keep(path: Path, undo_file: UndoFile) -> None:
    try:
        with path.open("xb") as file:
            file.write(encode_undo(undo_file))
    except FileExistsError as why:
        raise BadInput(f"--undo-file {path}: it exists, and what it undoes would be lost") from why
    except OSError as why:
        raise BadInput(f"--undo-file {path}: {why.strerror or why}; nothing was written to the autopilot") from why


def _written(
    args: argparse.Namespace, system: int, planned: Sequence[PlannedWrite], kept: UndoFile | None = None
) -> tuple[WriteResult, ...]:
    links = given_links(args, load(args.config) if args.config else None)
    if links is None:
        raise BadInput(f"--config {args.config}: its vehicle is no autopilot: no parameter can be written")

    return event_loop.run(_write(links, system, args.seconds, planned, kept, partial(_report, args)))


async def _write(
    links: GivenLinks,
    system: int,
    seconds: float,
    planned: Sequence[PlannedWrite],
    kept: UndoFile | None,
    on_result: OnResult,
) -> tuple[WriteResult, ...]:
    options, opened = links
    clock = SystemClock()
    async with open_autopilot(replace(options, system_id=system), clock, opened) as autopilot:
        await wait_until(clock, max(seconds, 4.0), lambda: autopilot.connected and autopilot.condition.armed is not None)
        identity = autopilot.identity
        if identity is None:
            raise BadInput(f"system {system} is not heard: no parameter was written")
        heard = AutopilotSnapshot(identity.stack.value, identity.system)
        if kept is not None and (foreign := kept.foreign_to(heard)) is not None:
            raise BadInput(f"--undo: {foreign}")
        if (why_not := why_not_written(autopilot)) is not None:
            raise BadInput(f"{why_not}: no parameter was written")
        return await write_parameters(autopilot, clock, planned, on_result)


def _report(args: argparse.Namespace, result: WriteResult) -> None:
    one, refused = result.planned, result.refused
    if args.json:
        line = {"parameter": one.parameter, "was": one.was, "to": one.to, "value": result.value, "refused": refused}
        sys.stdout.write(json.dumps(line) + "\n")
        return
    outcome = "written and read back" if refused is None else f"NOT written: {refused}"
    sys.stdout.write(f"{one.parameter:<17} {one.was:g} -> {one.to:g}: {outcome}\n")


def _boot(args: argparse.Namespace, done: set[str]) -> None:
    if names := sorted(done & AT_BOOT):
        _say(args, f"reboot the autopilot, then examine it again; read at its start: {', '.join(names)}")


def _command(args: argparse.Namespace) -> str:
    words = ["decklander", "doctor"]
    for url in args.link:
        words += ["--link", url]
    if args.config:
        words += ["--config", args.config]
    if args.signing_key:
        words += ["--signing-key", args.signing_key]
    return shlex.join(words)


def _say(args: argparse.Namespace, text: str) -> None:
    (sys.stderr if args.json else sys.stdout).write(text + "\n")


def _code(found: Sequence[Finding], done: set[str]) -> int:
    left = [f for f in found if not f.changes or not {c.parameter for c in f.changes} <= done]
    return 1 if any(f.severity is not Severity.ADVICE for f in left) else 0
