"""`decklander report`: the report of a recorded flight as one HTML file, or two flights compared."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from companion.cli import report_option
from companion.recording.reading import open_recording
from companion.tools.replay.recorded_log import log_of
from companion.tools.report.animation import write_animation
from companion.tools.report.page import render, render_comparison, write_page
from companion.tools.report.video import film_of


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander report` to the parser."""
    parser = subparsers.add_parser(
        "report",
        help="write the report of a recorded flight, or compare two",
        description="Write the report of a recorded flight as one HTML file: what the flight saw, decided and did then. With a "
        "second recording both are compared over the time since each landing began. Nothing is computed again; `decklander "
        "replay --report` does that.",
    )
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="MCAP file")
    parser.add_argument("other", nargs="?", type=Path, metavar="OTHER", help="another flight to compare it with")
    parser.add_argument(
        "--output", type=Path, metavar="FILE", help="file to write (default: the recording's name with .html, in this folder)"
    )
    parser.add_argument("--no-video", action="store_true", help="leave the video out, which is most of the file")
    parser.add_argument(
        "--animation", type=Path, metavar="FILE", help="write an animated GIF of the landing instead (camera, track and height)"
    )


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    paths = [args.recording] if args.other is None else [args.recording, args.other]
    recordings = [open_recording([path]) for path in paths]
    output = args.output or Path("-".join(path.stem for path in paths) + ".html")
    logs = [log_of(recording, path.stem, images=not args.no_video) for recording, path in zip(recordings, paths, strict=True)]
    for recording in recordings:
        for path, why in recording.cut.items():
            sys.stderr.write(f"{path} is cut short ({why}): reported up to there\n")
    if args.animation is not None:
        size = write_animation(logs[0], args.animation)
        sys.stdout.write(f"animation: {args.animation} ({size / 1e6:.1f} MB)\n")
        return 0
    films = [film_of(log) for log in logs]
    page = render(logs[0], films[0]) if args.other is None else render_comparison(logs, films)
    sys.stdout.write(report_option.written(write_page(output, page)))
    return 0
