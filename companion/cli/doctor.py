"""`decklander doctor`: diagnose the setup and print the fix for each fault."""

from __future__ import annotations

import argparse
import json
import logging
import sys
from dataclasses import asdict
from pathlib import Path

import msgspec

from companion.base import event_loop
from companion.cli import doctor_fix
from companion.cli.doctor_links import given_links
from companion.settings.load import load
from companion.tools.doctor.diagnose import RULES, diagnose
from companion.tools.doctor.finding import Finding, Severity
from companion.tools.doctor.gather import examine
from companion.tools.doctor.gather_log import examine_log
from companion.tools.doctor.gather_service import examine_service
from companion.tools.doctor.snapshot import Snapshot, decode, encode
from drivers.clock import SystemClock
from drivers.imports.log_history import LogHistory
from estimator.contracts.errors import BadInput


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander doctor` to the parser."""
    parser = subparsers.add_parser(
        "doctor",
        help="diagnose the setup: autopilot, links, camera, broker",
        description="Diagnose the setup: read firmware, parameters, message rates, links, camera and broker, and print "
        "each known fault with its fix. The command flies nothing, and sets no parameter but those that you agree to with "
        "--fix; it requests message streams. Stop the service first if it holds the serial port. "
        "Exit code 0 if nothing was found (or is left), or advice only; else 1.",
    )
    parser.add_argument(
        "log",
        nargs="?",
        metavar="LOG",
        help="examine a flight log instead: dataflash (.bin) or PX4 (.ulg); parameters and events",
    )
    parser.add_argument(
        "--link",
        action="append",
        default=[],
        metavar="URL",
        help="MAVLink link: udpin://ADDRESS:PORT, udpout://HOST:PORT, tcp://HOST:PORT, serial:///dev/NAME:BAUD; may be repeated",
    )
    parser.add_argument(
        "--config",
        metavar="FILE",
        help="settings file, or the name of a shipped vehicle profile: check its files too, and its links unless --link is given",
    )
    parser.add_argument("--broker", metavar="HOST:PORT", help="check this MQTT broker")
    parser.add_argument("--system", type=int, metavar="N", help="system id of the autopilot to examine")
    parser.add_argument("--signing-key", metavar="FILE", help="key file (or credential:NAME) of signed links")
    parser.add_argument("--seconds", type=float, default=4.0, metavar="S", help="listen this long for each answer (default: 4)")
    parser.add_argument("--still-pad", action="store_true", help="skip the checks that matter on a moving ship only")
    parser.add_argument(
        "--ship-speed", type=float, metavar="M_S", help="the ship's greatest speed, m/s: judge limits of speed against it"
    )
    parser.add_argument("--snapshot", metavar="FILE", help="examine a saved snapshot instead of this machine; - for stdin")
    parser.add_argument("--save", metavar="FILE", help="save the snapshot into this file, to examine it elsewhere")
    parser.add_argument("--json", action="store_true", help="print JSON Lines, one object per finding")
    doctor_fix.add_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    logging.basicConfig(level=logging.ERROR)  # that a link does not open is a finding, not news
    doctor_fix.check_options(args)
    if args.ship_speed is not None and not 0 <= args.ship_speed <= 15:
        raise BadInput(f"--ship-speed must lie in 0 to 15 m/s, got {args.ship_speed:g}")
    if args.log is not None and (args.fix or args.undo):
        raise BadInput("a log cannot be fixed: examine the autopilot with --link URL --fix")
    if args.undo:
        return doctor_fix.undo(args)
    snapshot = _snapshot(args)
    speed_m_s = snapshot.ship_speed_m_s if args.ship_speed is None else args.ship_speed
    moving = snapshot.moving_pad and not args.still_pad
    snapshot = msgspec.structs.replace(snapshot, moving_pad=moving, ship_speed_m_s=speed_m_s)
    if args.save:
        try:
            Path(args.save).write_bytes(encode(snapshot))
        except OSError as why:
            raise BadInput(f"--save {args.save}: {why.strerror or why}") from why
    found = diagnose(snapshot)
    if args.json:
        for finding in found:
            sys.stdout.write(json.dumps(asdict(finding) | {"severity": finding.severity.name.lower()}) + "\n")
    else:
        sys.stdout.write(_page(snapshot, found))
    if args.fix:
        return doctor_fix.fix(args, snapshot, found)
    return 1 if any(f.severity is not Severity.ADVICE for f in found) else 0


def _snapshot(args: argparse.Namespace) -> Snapshot:
    if args.log is None:
        return _saved(args.snapshot) if args.snapshot else event_loop.run(_examined(args))
    if args.link or args.config or args.broker or args.snapshot:
        raise BadInput(f"a log is examined by itself: give {args.log} without --link, --config, --broker and --snapshot")
    return examine_log(Path(args.log))


def _saved(where: str) -> Snapshot:
    try:
        data = sys.stdin.buffer.read() if where == "-" else Path(where).read_bytes()
    except OSError as why:
        raise BadInput(f"--snapshot {where}: {why.strerror or why}") from why
    return decode(data, where)


async def _examined(args: argparse.Namespace) -> Snapshot:
    if not (args.link or args.config or args.broker):
        raise BadInput("nothing to examine: give --link URL, --config FILE, --broker HOST:PORT, --snapshot FILE or a LOG")
    if not 0.5 <= args.seconds <= 600:
        raise BadInput(f"--seconds must lie in 0.5..600, got {args.seconds:g}")
    if args.broker and ":" in args.broker and not args.broker.rpartition(":")[2].isdigit():
        raise BadInput(f"--broker {args.broker}: write HOST:PORT")
    settings = load(args.config) if args.config else None
    service = await examine_service(settings, args.broker, SystemClock())
    found = given_links(args, settings)
    if found is None:
        return Snapshot(0.0, service=service)
    options, links = found
    gimbal = None if settings is None else settings.camera.gimbal
    snapshot = await examine(options, SystemClock(), args.seconds, _progress, links, gimbal)
    return msgspec.structs.replace(snapshot, service=service)


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


def _page(snapshot: Snapshot, found: tuple[Finding, ...]) -> str:
    lines = []
    if (a := snapshot.autopilot) is not None:
        version = "" if a.firmware is None else " " + ".".join(map(str, a.firmware))
        if snapshot.log is None:
            lines.append(f"{a.stack}{version}, system {a.system}, mode {a.mode}, {len(a.parameters)} parameters read")
        else:
            lines += _log_lines(f"{a.stack}{version}, system {a.system}", len(a.parameters), snapshot.log)
        lines += [f"  {name:<22} {rate:6.1f} Hz" for name, rate in sorted(a.rates_hz.items(), key=lambda i: -i[1])[:8]]
    elif snapshot.heard:
        lines += [f"heard: {one}, component {one.component}" for one in snapshot.heard]
    if snapshot.sync is not None and snapshot.sync.round_trip_s is not None:
        lines.append(
            f"clock: round trip {1e3 * snapshot.sync.round_trip_s:.1f} ms, {'locked' if snapshot.sync.locked else 'not locked'}"
        )
    lines += [f"{f.severity.name.lower()}: {f.what} [{f.rule}]\n    fix: {f.fix}" for f in found]
    lines.append(f"{len(found)} of {len(RULES)} known faults found" if found else f"none of {len(RULES)} known faults found")
    return "\n".join(lines) + "\n"
