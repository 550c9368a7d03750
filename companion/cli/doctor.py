"""`decklander doctor`: diagnose the setup and print the fix for each fault; `--fix` and `--undo` write parameters."""

import argparse
import json
import logging
import shlex
import sys
import textwrap
import time
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

from msgspec import structs

from companion.base import event_loop
from companion.cli.options import option, refuse_any
from companion.cli.outputs import PARAMETERS, SNAPSHOT, UNDO_FILE, output
from companion.parts.mavlink.signed_links import signed_links
from companion.settings.files import signing_key
from companion.settings.load import Settings, load, write_whole
from companion.tools.doctor import rules_switch
from companion.tools.doctor.diagnose import counted, diagnose
from companion.tools.doctor.finding import Finding, Severity
from companion.tools.doctor.gather import examine, wait_until
from companion.tools.doctor.gather_outside import examine_log, examine_service
from companion.tools.doctor.parameter_file import UP_TO_4_6, stack_named, wanted_by_default, wanted_of, write_parameters_file
from companion.tools.doctor.snapshot import AutopilotSnapshot, Snapshot, decode, encode
from companion.tools.doctor.undo import OnResult, PlannedWrite, UndoFile, WriteResult, same, why_not_written, write_parameters
from drivers.clock import SystemClock
from drivers.files import Largest, bytes_of
from drivers.log_history import LogHistory
from drivers.mavlink.autopilot import open_autopilot
from drivers.mavlink.links import LinkOptions
from drivers.mavlink.options import AutopilotOptions, autopilot_of
from drivers.mavlink.signing import Signing, SigningTimes
from drivers.ship_reports import REFUSED_FOR
from estimator.contracts.address import guarded
from estimator.contracts.errors import BadInput, file_errors, refused

_SHOWN = 12  # entries that are listed
_NONE_EXAMINED = "no autopilot was examined: nothing was written"
_UNUSED = {"other_sentence": "of a kind that is not read", "other_message": "of a kind that is not read"}
GivenLinks = tuple[AutopilotOptions, tuple[LinkOptions, ...]]


def given_links(args: argparse.Namespace, settings: Settings | None) -> GivenLinks | None:
    """Return the options and the links with their keys, as given or as the settings have them; None if there is no link.

    Raises:
        BadInput: a link, the system id or the key is wrong.
    """
    if args.system is not None and not 1 <= args.system <= 255:
        raise BadInput(f"--system must lie in 1 to 255, got {args.system}")
    if not args.link:
        vehicle = None if settings is None else autopilot_of(settings.vehicle)
        if vehicle is None:
            return None
        return vehicle if args.system is None else structs.replace(vehicle, system_id=args.system), signed_links(vehicle)
    try:
        options = AutopilotOptions(", ".join(args.link), system_id=args.system or 0)
    except ValueError as why:
        raise BadInput(str(why).replace("links:", "--link:", 1)) from why
    key = signing_key(args.signing_key) if args.signing_key else None
    times = SigningTimes(None)
    return options, tuple(
        LinkOptions(endpoint, None if key is None else Signing(lambda: key, times, number))
        for number, endpoint in enumerate(options.endpoints())
    )


AT_BOOT = frozenset({
    "PLND_ENABLED", "PLND_TYPE", "PLND_LAG", "EK3_SRC1_POSZ", "EKF2_HGT_REF", "EKF2_EV_CTRL", "EKF2_OF_CTRL", "EKF2_RNG_CTRL",
    "IMU_GYRO_CUTOFF", "IMU_ACCEL_CUTOFF", "IMU_DGYRO_CUTOFF", "INS_HNTCH_FREQ",
    *(f"RNGFND{n}_{what}" for n in range(1, 5) for what in ("TYPE", "ORIENT")),
})  # fmt: skip
"""Parameters that the autopilot reads when it starts."""


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
        _say(args, "nothing is wrong that a parameter fixes" if autopilot else _NONE_EXAMINED)
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
    data = bytes_of(Path(args.undo), Largest.TABLE, f"--undo {args.undo}")
    kept = decode(data, args.undo, UndoFile, "undo file of doctor --fix")
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
    with refused(f"nothing was written to the autopilot: --undo-file {path}", OSError), path.open("xb") as file:
        file.write(encode(undo_file))


def _written(
    args: argparse.Namespace, system: int, planned: Sequence[PlannedWrite], kept: UndoFile | None = None
) -> tuple[WriteResult, ...]:
    links = given_links(args, load(args.config) if args.config else None)
    if links is None:
        raise BadInput(f"--config {args.config}: its vehicle is no autopilot: no parameter can be written")
    return event_loop.run(_write(links, system, args.seconds, planned, kept, partial(_report, args)))


async def _write(
    links: GivenLinks, system: int, seconds: float, planned: Sequence[PlannedWrite], kept: UndoFile | None, on_result: OnResult
) -> tuple[WriteResult, ...]:
    options, opened = links
    clock = SystemClock()
    async with open_autopilot(structs.replace(options, system_id=system), clock, opened) as autopilot:
        await wait_until(clock, max(seconds, 4.0), lambda: autopilot.connected and autopilot.condition.armed is not None)
        identity = autopilot.identity
        if identity is None:
            raise BadInput(f"system {system} is silent: no parameter was written")
        received = AutopilotSnapshot(identity.stack.value, identity.system)
        if kept is not None and (foreign := kept.foreign_to(received)) is not None:
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
    change = f"is {one.to:g} already" if result.already else f"{one.was:g} -> {one.to:g}: {outcome}"
    sys.stdout.write(f"{one.parameter:<17} {change}\n")


def _boot(args: argparse.Namespace, done: set[str]) -> None:
    if names := sorted(done & AT_BOOT):
        _say(args, f"reboot the autopilot, then examine it again; read at its start: {', '.join(names)}")


def _command(args: argparse.Namespace) -> str:
    given = [("--link", url) for url in args.link] + [("--config", args.config), ("--signing-key", args.signing_key)]
    return shlex.join(["decklander", "doctor", *(word for pair in given if pair[1] for word in pair)])


def _say(args: argparse.Namespace, text: str) -> None:
    (sys.stderr if args.json else sys.stdout).write(text + "\n")


def _code(found: Sequence[Finding], done: set[str]) -> int:
    left = [f for f in found if not f.changes or not {c.parameter for c in f.changes} <= done]
    return 1 if any(f.severity is not Severity.ADVICE for f in left) else 0


DESCRIPTION = (
    "Diagnose the setup: read firmware, parameters, message rates, links, camera and broker, and print "
    "each known fault with its fix. The command flies nothing, and sets no parameter but those that you agree to with "
    "--fix; it requests message streams. Stop the service first if it holds the serial port. "
    "Exit code 0 if nothing was found (or is left), or advice only; else 1."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    option(
        parser,
        "log LOG",
        "examine a file instead: a flight log (.bin, .log, .ulg, .tlog) with parameters and events, or a file of parameters",
        nargs="?",
    )
    option(
        parser,
        "--link URL",
        "MAVLink link: udpin://ADDRESS:PORT, udpout://HOST:PORT, tcp://HOST:PORT, serial:///dev/NAME:BAUD; may be repeated",
        default=[],
        action="append",
    )
    option(
        parser,
        "--config FILE",
        "settings file, or the name of a shipped vehicle profile: check its files too, and its links unless --link is given",
    )
    option(parser, "--broker HOST:PORT", "check this MQTT broker")
    option(parser, "--system N", "system id of the autopilot to examine", type=int)
    option(parser, "--signing-key FILE", "key file (or credential:NAME) of signed links")
    option(parser, "--seconds S", "listen this long for each answer (default: 4)", default=4.0)
    option(parser, "--still-pad", "skip the checks that matter on a moving ship only")
    option(parser, "--ship-speed M_S", "the ship's greatest speed, m/s: judge limits of speed against it", type=float)
    option(parser, "--snapshot FILE", "examine a saved snapshot instead of this machine; - for stdin")
    output(parser, "--save FILE", "save the snapshot into this file, to examine it elsewhere", SNAPSHOT)
    output(
        parser,
        "--write FILE",
        "write the parameters that fix what was found into a file that ground stations load; without an autopilot and a LOG, "
        "what one with its firmware's defaults needs (ardupilot.param or px4.params: the name says for which)",
        PARAMETERS,
    )
    option(parser, "--json", "print JSON Lines, one object per finding")
    option(parser, "--fix", "ask for each change of a parameter that fixes a fault, write it, read it back; never while armed")
    option(parser, "--undo FILE", "set back what --fix wrote, from the undo file that it kept")
    option(parser, "--yes", "with --fix or --undo: say yes to every change")
    kept = "with --fix: keep what the parameters were in this file (default: decklander-undo-TIME.json)"
    output(parser, "--undo-file FILE", kept, UNDO_FILE)


def run(args: argparse.Namespace, *, last: bool = True) -> int:
    """Run the command and return its exit code; unless it is the last, another one says what to do next."""
    logging.basicConfig(level=logging.ERROR)  # that a link does not open is a finding, not news
    _refuse(args)
    if args.undo:
        return undo(args)
    if args.write and not any((args.log, args.link, args.config, args.snapshot)):
        return _write_defaults(args)
    snapshot = _snapshot(args)
    if args.save:
        with file_errors(f"--save {args.save}"):
            write_whole(args.save, encode(snapshot))
    found = diagnose(snapshot)
    autopilot = snapshot.autopilot
    if args.write and autopilot is not None:
        write_parameters_file(args.write, autopilot.stack, wanted_of(found), autopilot.system)
    if args.json:
        _print_json(snapshot, found)
    else:
        sys.stdout.write(_page(snapshot, found) + (_next(args, found) if last and not args.fix else ""))
    if args.fix:
        return fix(args, snapshot, found)
    if args.write and autopilot is None:
        _say(args, _NONE_EXAMINED)
    return _code(found, set())


def _refuse(args: argparse.Namespace) -> None:
    """Refuse options that do not go together by `BadInput`."""
    writes = "--fix" if args.fix else "--undo" if args.undo else ""
    refuse_any(
        (args.fix and args.undo, "--fix and --undo do not go together"),
        (writes and not (args.link or args.config), f"{writes} needs the autopilot: give --link URL or --config FILE"),
        (writes and args.json and not args.yes, "--json asks nothing: give --yes with it"),
        (args.yes and not writes, "--yes goes with --fix or --undo"),
        (args.undo_file and not args.fix, "--undo-file goes with --fix"),
        (writes and args.snapshot, "a saved snapshot cannot be fixed: leave --snapshot out"),
        (not 0 <= (args.ship_speed or 0) <= 15, f"--ship-speed must lie in 0 to 15 m/s, got {args.ship_speed}"),
        (args.log is not None and writes, "a log cannot be fixed: examine the autopilot with --link URL --fix"),
    )


def _print_json(snapshot: Snapshot, found: Sequence[Finding]) -> None:
    """Print an object a line for each finding, source, difference and line that was not read."""
    for finding in found:
        sys.stdout.write(json.dumps(asdict(finding) | {"severity": finding.severity.name.lower()}) + "\n")
    for one in snapshot.service.ship_sources:
        sys.stdout.write(json.dumps({"source": one.name} | structs.asdict(one)) + "\n")
    for name, (value, default) in _differs(snapshot).items():
        sys.stdout.write(json.dumps({"differs": name, "value": value, "default": default}) + "\n")
    for what, line in _unused(snapshot.autopilot):
        sys.stdout.write(json.dumps({"unused": line, "why": what}) + "\n")


def _next(args: argparse.Namespace, found: Sequence[Finding]) -> str:
    """Return a line with the next thing to do after an examination; none after that of a log without a fault."""
    faults, live = [f for f in found if f.severity is not Severity.ADVICE], bool(args.link or args.config)
    if live and any(f.changes for f in faults):
        return f"next: {_command(args)} --fix sets parameters, each when you agree to it\n"
    if faults:
        return "next: mend what is named above, from the top, and examine it again\n"
    run = f"decklander run --config {shlex.quote(args.config)}" if args.config else "decklander start, for the settings"
    return f"next: {run}\n" if live else ""


def _write_defaults(args: argparse.Namespace) -> int:
    stack = stack_named(args.write)
    wanted = wanted_by_default(stack, moving_pad=not args.still_pad)
    release = UP_TO_4_6 if stack == "ArduPilot" else ""
    write_parameters_file(args.write, stack, wanted, note=f"# {release}\n" if release else "")
    _say(args, f"{args.write}: " + "   ".join(f"{name} {value:g}" for name, (value, _) in wanted.items() if value is not None))
    for why in (*(why for value, why in wanted.values() if value is None), *filter(None, (release,))):
        _say(args, why)
    _say(args, f"load it in a ground station, reboot, then examine the autopilot: {_command(args)} --link URL")
    return 0


def _snapshot(args: argparse.Namespace) -> Snapshot:
    snapshot = _gathered(args)
    speed_m_s = snapshot.ship_speed_m_s if args.ship_speed is None else args.ship_speed
    return structs.replace(snapshot, moving_pad=snapshot.moving_pad and not args.still_pad, ship_speed_m_s=speed_m_s)


def _gathered(args: argparse.Namespace) -> Snapshot:
    if args.log is None:
        return _saved(args.snapshot) if args.snapshot else event_loop.run(_examined(args))
    if args.link or args.config or args.broker or args.snapshot:
        raise BadInput(f"a log is examined by itself: give {args.log} without --link, --config, --broker and --snapshot")
    return examine_log(Path(args.log))


def _saved(where: str) -> Snapshot:
    data = sys.stdin.buffer.read() if where == "-" else bytes_of(Path(where), Largest.TABLE, f"--snapshot {where}")
    return decode(data, where, Snapshot, "snapshot of a set-up")


async def _examined(args: argparse.Namespace) -> Snapshot:
    if not (args.link or args.config or args.broker):
        raise BadInput("nothing to examine: give --link URL, --config FILE, --broker HOST:PORT, --snapshot FILE or a LOG")
    if not 0.5 <= args.seconds <= 600:
        raise BadInput(f"--seconds must lie in 0.5..600, got {args.seconds:g}")
    if args.broker and ":" in args.broker and not args.broker.rpartition(":")[2].isdigit():
        raise BadInput(f"--broker {args.broker}: write HOST:PORT")
    settings = load(args.config) if args.config else None
    service = await examine_service(settings, args.broker and str(guarded(args.broker)), SystemClock())
    found = given_links(args, settings)
    if found is None:
        return Snapshot(0.0, service=service)
    options, links = found
    gimbal = None if settings is None else settings.camera.gimbal
    channel = 0 if settings is None else settings.operator.switch.channel
    snapshot = await examine(options, SystemClock(), args.seconds, _progress, links, gimbal, channel)
    return structs.replace(snapshot, service=service)


def _progress(text: str) -> None:
    if sys.stderr.isatty():
        sys.stderr.write(f"{text} ...\n")


def _log_lines(of: str, parameters: int, log: LogHistory) -> list[str]:
    lines = [f"{of}: log of {log.lasted_s:.0f} s, {parameters} of the parameters that are judged"]
    lines += [
        f"  landing at {one.at_s:.1f} s, taken back by the detector {one.lost} times, armed for {one.armed_s:.1f} s after"
        for one in log.landings
    ]
    lines += [f"  EKF {name}: worst ratio {r.worst:.2f}, above 1 for {r.over_s:.1f} s" for name, r in log.ratios.items()]
    return lines


def _ship_lines(snapshot: Snapshot) -> list[str]:
    """Return which of the ship's reports are used and which are not, a line for each source."""
    sources = snapshot.service.ship_sources
    width = max((len(one.name) for one in sources), default=0)
    lines = ["the ship's reports:"] if sources else []
    for one in sources:
        counted = [f"{one.used} used"] if one.used else []
        counted += [
            f"{n} not used: {_UNUSED.get(why) or REFUSED_FOR.get(why, why.replace('_', ' '))}" for why, n in one.unused.items()
        ]
        lines.append(f"  {one.name:<{width}} {one.rate_hz:6.1f} Hz  {'; '.join(counted)}")
    return lines


def _differs(snapshot: Snapshot) -> dict[str, tuple[float, float]]:
    return {} if snapshot.autopilot is None else snapshot.autopilot.differs


def _unused(a: AutopilotSnapshot | None) -> list[tuple[str, str]]:
    """Return what of a file of parameters was not used, each with its reason."""
    if a is None:
        return []
    return [("not read", line) for line in a.unread] + [("misspelt, or known to no rule", name) for name in a.unjudged]


def _unused_lines(a: AutopilotSnapshot) -> list[str]:
    lines = [f"  {line}" for line in a.unread[:_SHOWN]]
    if len(a.unread) > _SHOWN:
        lines.append(f"  {len(a.unread) - _SHOWN} more lines")
    if a.unjudged:
        more = f" and {len(a.unjudged) - _SHOWN} more (--json names all)" if len(a.unjudged) > _SHOWN else ""
        lines.append(f"  misspelt, or known to no rule: {', '.join(a.unjudged[:_SHOWN])}{more}")
    return [f"not used of the file: {len(a.unread) + len(a.unjudged)} lines", *lines] if lines else []


def _page(snapshot: Snapshot, found: tuple[Finding, ...]) -> str:
    lines = []
    if (a := snapshot.autopilot) is not None:
        version = "" if a.firmware is None else " " + ".".join(map(str, a.firmware))
        if snapshot.log is None:
            lines.append(f"{a.stack}{version}, system {a.system}, mode {a.mode}, {len(a.parameters)} parameters read")
            lines += _unused_lines(a)
        else:
            lines += _log_lines(f"{a.stack}{version}, system {a.system}", len(a.parameters), snapshot.log)
        lines += [f"  {name:<22} {rate:6.1f} Hz" for name, rate in sorted(a.rates_hz.items(), key=lambda i: -i[1])[:8]]
    elif snapshot.systems:
        lines += [f"found: {one}, component {one.component}" for one in snapshot.systems]
    if snapshot.sync is not None and snapshot.sync.round_trip_s is not None:
        lines.append(
            f"clock: round trip {1e3 * snapshot.sync.round_trip_s:.1f} ms, {'locked' if snapshot.sync.locked else 'not locked'}"
        )
    if differs := _differs(snapshot):
        lines.append(f"{len(differs)} parameters of modes, time limits, EKF and loops are not what the firmware begins with:")
        lines += textwrap.wrap(
            ", ".join(f"{name} {value:.6g} ({default:.6g})" for name, (value, default) in differs.items()),
            120, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False,
        )  # fmt: skip
    lines += rules_switch.line(snapshot) + _ship_lines(snapshot)
    lines += [f"{f.severity.name.lower()}: {f.what} [{f.rule}]\n    fix: {f.fix}" for f in found]
    lines.append(counted(snapshot, len(found)))
    return "\n".join(lines) + "\n"
