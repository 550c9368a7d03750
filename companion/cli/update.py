"""`decklander update`: update the installed service."""

from __future__ import annotations

import argparse

from companion.cli.install_options import add_common, add_release, machine_of, options_of
from companion.tools.install import steps
from companion.tools.install.release import NAME, release


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander update` to the parser."""
    parser = subparsers.add_parser(
        "update",
        help="update the installed service",
        description="Install a version beside the one that runs, check it with the present settings, make it the current one, "
        "start the service again and watch it. If it does not come up, the version before is current again. Never while the "
        "drone flies.",
    )
    add_release(parser, "the newest release")
    add_common(parser)


def run(args: argparse.Namespace) -> int:
    """Update."""
    machine = machine_of(args)
    with release(args.source or NAME, args.wheels) as found:
        steps.update(machine, found, options_of(args))
    return 0
