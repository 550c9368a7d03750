"""The options `--perception` and `--perception-model` of the commands that simulate flights."""

import argparse

from sitl.flight.one_flight import PERCEPTIONS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add both options to a parser."""
    parser.add_argument(
        "--perception",
        default="pixels",
        metavar="LEVEL",
        help=f"how the service perceives the pad: {', '.join(PERCEPTIONS)} (default: pixels, rendered frames)",
    )
    parser.add_argument(
        "--perception-model",
        metavar="FILE",
        help="error model of --perception model or truth, from decklander perception fit (default: the shipped one of "
        "vision.method)",
    )
