"""Read a recording: how far off every fused sighting and decision saw the pad: `python -m examples.read_recording FILE.mcap`.

It is a command of Decklander's, too, once a package offers it (docs/extending.md): `decklander approach FILE.mcap`.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

from companion.base.observer import Decision
from companion.recording.reading import RecordedFrame, instant, open_recording

DESCRIPTION = "Print how far from the pad every decision of a recording saw the drone, and the verdicts on its frames."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("recording", metavar="FILE", help="recording (.mcap)", type=Path)


def run(args: argparse.Namespace) -> int:
    """Print the approach; return the exit code."""
    recording = open_recording([args.recording])
    verdicts: Counter[str] = Counter()
    start = None
    for event in recording.events():
        start = instant(event) if start is None else start
        if isinstance(event, RecordedFrame):
            verdicts[event.record.verdict.value] += 1
        elif isinstance(event, Decision) and event.belief is not None:
            belief = event.belief
            print(f"{(event.at - start) * 1e-9:6.2f} s {event.phase}: {belief.height_m:.2f} m up, {belief.lateral_m:.2f} m off")
    print(f"frames: {dict(verdicts)}")
    return 0


if __name__ == "__main__":
    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_file():
        sys.exit(__doc__)
    run(argparse.Namespace(recording=Path(sys.argv[1])))
