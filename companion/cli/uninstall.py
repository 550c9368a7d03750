"""`decklander uninstall`: remove the installed service."""

from __future__ import annotations

import argparse

from companion.cli.install_options import add_common, machine_is_packaged, machine_of, options_of
from companion.tools.install import steps
from estimator.contracts.errors import BadInput


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander uninstall` to the parser."""
    parser = subparsers.add_parser(
        "uninstall",
        help="remove the installed service",
        description="Stop and remove the service and all its versions. Settings, keys and recordings stay. Never while the drone "
        "flies.",
    )
    parser.add_argument("--purge", action="store_true", help="remove settings, keys, recordings and the user too")
    add_common(parser)


def run(args: argparse.Namespace) -> int:
    """Uninstall.

    Raises:
        BadInput: a package installed it.
    """
    if machine_is_packaged(args.root) and not args.packaged:
        raise BadInput("a Debian package installed it: apt remove decklander (or apt purge decklander)")
    steps.uninstall(machine_of(args), options_of(args), purge=args.purge)
    return 0
