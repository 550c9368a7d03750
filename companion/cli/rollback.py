"""`decklander rollback`: return to the version before the last update."""

from __future__ import annotations

import argparse

from companion.cli.install_options import add_common, machine_of, options_of
from companion.tools.install import steps


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander rollback` to the parser."""
    parser = subparsers.add_parser(
        "rollback",
        help="return to the version before the last update",
        description="Make the version before the last update the current one, after a check with the present settings, and start "
        "the service again. A second rollback returns to the newer one. Never while the drone flies.",
    )
    add_common(parser)


def run(args: argparse.Namespace) -> int:
    """Roll back."""
    steps.roll_back(machine_of(args), options_of(args))
    return 0
