"""The options `--perception` and `--perception-model` of the commands that simulate flights."""

import argparse

from companion.cli.options import option
from sitl.flight.one_flight import PERCEPTIONS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add both options to a parser."""
    option(
        parser,
        "--perception LEVEL",
        f"how the service perceives the pad: {', '.join(PERCEPTIONS)} (default: pixels, rendered frames)",
        default="pixels",
    )
    option(
        parser,
        "--perception-model FILE",
        "error model of --perception model or truth, from decklander perception fit (default: the shipped one of vision.method)",
    )
