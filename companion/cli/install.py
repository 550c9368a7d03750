"""`decklander install`: install the service on this computer."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion.cli.install_options import add_common, add_release, machine_of, options_of
from companion.tools.install import steps
from companion.tools.install.release import release


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander install` to the parser."""
    parser = subparsers.add_parser(
        "install",
        help="install the service on this computer",
        description="Install the service: an environment below /opt/decklander, the unit, device rules, user, keys and settings. "
        "What is there already is left; settings are never overwritten. Exit code 1 if a step failed or the drone flies.",
    )
    add_release(parser, "what this program was installed from")
    parser.add_argument("--config", type=Path, metavar="FILE", help="settings to copy to /etc/decklander/rig.toml")
    parser.add_argument(
        "--credential",
        action="append",
        default=[],
        metavar="NAME=FILE",
        help="secret to copy to /etc/credstore, for root alone (mqtt-password, mavlink-key, page, ...); may be repeated",
    )
    add_common(parser)


def run(args: argparse.Namespace) -> int:
    """Install."""
    machine = machine_of(args)
    with release(args.source, args.wheels) as found:
        steps.install(machine, found, options_of(args))
    return 0
