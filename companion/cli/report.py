"""`decklander report`: the report of a recorded flight as one HTML file, or two flights compared."""

import argparse
import sys
from pathlib import Path

from companion.cli.options import named_wait, option, reading, tell_damage, writing, written
from companion.cli.outputs import ANIMATION, REPORT, check_output, output
from companion.recording.reading import open_recording
from companion.tools.replay.recorded_log import log_of
from companion.tools.report.page import write_flights
from companion.tools.report.video import write_animation

DESCRIPTION = (
    "Write the report of a recorded flight as one HTML file: what the flight saw, decided and did then. With a "
    "second recording both are compared over the time since each landing began. Nothing is computed again; `decklander "
    "replay --report` does that."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    option(parser, "recording RECORDING", "MCAP file", type=Path)
    option(parser, "other OTHER", "another flight to compare it with", nargs="?", type=Path)
    output(parser, "--output FILE", "file to write (default: the recording's name with .html, beside it)", REPORT)
    option(parser, "--no-video", "leave the video out, which is most of the file")
    output(parser, "--animation FILE", "write an animated GIF of the landing instead (camera, track and height)", ANIMATION)


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    paths = [args.recording] if args.other is None else [args.recording, args.other]
    page = args.output or paths[0].with_name("-".join(path.stem for path in paths) + ".html")
    if args.output is None and args.animation is None:
        check_output(page, REPORT, "--output", paths, force=args.force)
    recordings = [open_recording([path]) for path in paths]
    for recording in recordings:
        recording.watch = reading(recording.name)
    logs = [log_of(recording, path.stem, images=not args.no_video) for recording, path in zip(recordings, paths, strict=True)]
    for recording in recordings:
        tell_damage(recording.cut, "reported")
    if args.animation is not None:
        with named_wait("drawing the animation"):
            size = write_animation(logs[0], args.animation)
        sys.stdout.write(f"animation: {args.animation} ({size / 1e6:.1f} MB)\n")
        return 0
    with writing(page, quiet=False) as watch:
        write_flights(page, logs, watch)
    sys.stdout.write(written(page))
    return 0
