"""`decklander run`: run the landing service."""

import argparse
import logging
import sys
from contextlib import nullcontext
from pathlib import Path

import msgspec

from companion.base import event_loop, memory
from companion.base.mission import FlightOutcome
from companion.base.service_log import logging_to_stderr
from companion.cli.options import WorkProgress, option
from companion.guidance.pilot import make_pilot
from companion.service.assemble import Proven, live, make_daemon
from companion.service.sole_service import sole_service
from companion.settings.load import Settings, calibration_file, find_file, load, pad_of_file, shipped, with_known_calibration
from companion.settings.overrides import with_overrides
from companion.settings.part_table import PartTable
from companion.settings.referenced_files import check_files, check_installed
from companion.settings.remarks import not_checked, remarks

log = logging.getLogger(__name__)

VIEWS_AT_START = 252
"""Views that a pad without a calibration is priced by when the service starts; pad check takes twice as many."""
FROM_TERMINAL = (
    "started from a terminal: when it hangs up the service flies on, and nobody reads its log; for a flight: "
    "sudo systemd-run --unit decklander-flight --same-dir $(command -v decklander) run --config FILE"
)
"""Hint at the start for a person who runs the service by hand."""


DESCRIPTION = (
    "Run the landing service: find the pad, approach it, land on it. SIGTERM stops the service and leaves the "
    "drone hovering; a terminal that hangs up does not. SIGUSR1 begins the approach if guidance.start is "
    '"signal", and resumes it after SIGUSR2 held it.'
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    option(
        parser,
        "--config FILE",
        f"settings file, or the name of a shipped vehicle profile ({', '.join(shipped())})",
        required=True,
    )
    option(parser, "--set KEY=VALUE", "give a key of the settings another value; may be repeated", default=[], action="append")
    option(parser, "--once", "stop after the first flight; exit code 0 if it landed, else 1")
    option(parser, "--check", "check settings and files, print what would run, and stop")


def run(args: argparse.Namespace) -> int:
    """Run the service until it is stopped, or until the first flight has ended with `--once`.

    Raises:
        BadInput: the settings, or a file that they name, cannot be read or have a fault; or another service has the vehicle.
    """
    settings = with_overrides(load(args.config), args.set, "--set")
    file = find_file(args.config, "", Path(), "settings")
    proven = Proven(settings)
    with nullcontext() if args.check else sole_service(settings, file), proven.excusing():
        return _run(args, settings, file, proven)


def _run(args: argparse.Namespace, settings: Settings, file: Path, proven: Proven) -> int:
    check_installed(settings)
    if not args.check:
        _calibrate_pad(settings)
    pilot = make_pilot(settings)
    if args.check:
        c, camera, vision = pilot.camera, settings.camera, settings.vision
        frames = "frames come from the vehicle" if camera.source == "vehicle" else f"frames from {camera.source} {camera.device}"
        unchecked = check_files(settings)
        sys.stdout.write(
            f"vehicle: {settings.vehicle.in_words}\n"
            f"camera: {camera.file}, {c.width}x{c.height} px, {frames}\n"
            f"pad: {settings.pad.file}\n"
            f"colours: {vision.colours}\n"
            f"second opinion: {'off' if vision.learned == 'off' else vision.learned_file or 'the shipped network'}\n"
            f"estimator: {settings.estimator.path} steers\n"
            f"start of the approach: {'; '.join(_starts(settings))}\n"
            f"limits: height {settings.limits.height_max_m:g} m, fence {settings.limits.fence}\n"
            f"recorder: {'on, into ' + settings.recorder.folder if settings.recorder.enabled else 'off'}\n"
            f"{_of_capabilities(settings)}"
            f"http: {settings.http.endpoint}\n"
            f"files: found{not_checked(unchecked)}\n" + "".join(f"{line}\n" for line in remarks(settings))
        )
        return 0
    with logging_to_stderr(settings.service.log_level) as reported:
        for line in remarks(settings):
            log.warning(line)
        if sys.stdin is not None and sys.stdin.isatty():
            log.warning(FROM_TERMINAL)
        memory.share_one_arena()
        daemon = make_daemon(settings, pilot, observers=[proven], once=args.once, settings_file=file, log_counts=reported.counts)
        outcome = event_loop.run(live(daemon, pilot, stays=True))
        if outcome is not None:
            log.info("flight ended: %s", outcome.value)
    return 0 if not args.once or outcome in (FlightOutcome.LANDED, FlightOutcome.LANDED_BY_OTHERS) else 1


def _calibrate_pad(settings: Settings) -> None:
    """Search clutter for a pad that was never priced, and keep the result for later starts."""
    pad = with_known_calibration(pad_of_file(find_file(settings.pad.file, "pads", Path(), "pad.file")))
    if pad.is_calibrated or pad.lamps or pad.has_known_parts:
        return
    if (file := calibration_file(pad)) is None:
        sys.stderr.write(f"pad {pad.name} has no calibration, and this user no home to keep one in: set HOME\n")
        return
    # Few starts need it.
    from companion.tools.pad_price import price

    sys.stderr.write(f"pad {pad.name} has no calibration: searching clutter for it, once\n")
    progress = WorkProgress("searching views without and with the pad", "views").take
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(msgspec.json.encode(price(pad, {}, VIEWS_AT_START, progress).calibration))
    except OSError as why:
        sys.stderr.write(f"its calibration cannot be kept in {file}: {why.strerror or why}\n")


def _starts(settings: Settings) -> list[str]:
    """Return what begins a landing: the start, and the switch and the handover if they are on."""
    switch, handover = settings.operator.switch, settings.operator.handover
    ways: list[str] = [settings.guidance.start]
    if switch.channel:
        ways.append(f"switch of channel {switch.channel} (low {switch.low}, middle {switch.middle}, high {switch.high})")
    if handover.after != "nothing":
        with_failsafe = ", with a failsafe in force too" if handover.failsafe else ""
        ways.append(f"by itself after the autopilot's own {handover.after}{with_failsafe}")
    return ways


def _of_capabilities(settings: Settings) -> str:
    named = ((name, getattr(settings, name)) for name in settings.__struct_fields__)
    return "".join(f"{name}: {table.in_words}\n" for name, table in named if isinstance(table, PartTable) and table.in_words)
