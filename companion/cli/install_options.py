"""Options that install, update, rollback and uninstall have in common."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from companion.tools.install.layout import PACKAGED_UNIT
from companion.tools.install.machine import Machine
from companion.tools.install.steps import InstallOptions
from estimator.contracts.errors import BadInput, SetupImpossible


def add_common(parser: argparse.ArgumentParser) -> None:
    """Add the options that all four commands have."""
    parser.add_argument("--dry-run", action="store_true", help="print what would be done, and change nothing")
    parser.add_argument(
        "--root",
        type=Path,
        default=Path("/"),
        metavar="DIR",
        help="work on the root below DIR, such as a card's, not on this computer",
    )
    parser.add_argument(
        "--on-ground",
        action="store_true",
        help="you see the drone stand: go on where the running service does not know whether it flies",
    )
    parser.add_argument("--packaged", action="store_true", help=argparse.SUPPRESS)


def add_release(parser: argparse.ArgumentParser, default: str) -> None:
    """Add the options that name a release."""
    parser.add_argument(
        "source",
        nargs="?",
        metavar="SOURCE",
        help=f"wheel, folder of wheels, checkout, decklander==VERSION or VERSION (default: {default})",
    )
    parser.add_argument(
        "--wheels", type=Path, metavar="DIR", help="folder with the wheels of the dependencies; nothing is fetched"
    )
    parser.add_argument(
        "--python", default="/usr/bin/python3", metavar="FILE", help="Python to run with (default: /usr/bin/python3)"
    )


def machine_of(args: argparse.Namespace) -> Machine:
    """Return the computer that the options name.

    Raises:
        BadInput: the root is no folder.
        SetupImpossible: this user may not change it.
    """
    root = args.root.resolve()
    if not root.is_dir():
        raise BadInput(f"--root {args.root}: no such folder")
    if os.geteuid() != 0 and not args.dry_run:
        raise SetupImpossible(f"{args.command} changes the system and needs root: sudo decklander {args.command} (or --dry-run)")
    return Machine(root, sys.stdout, dry=args.dry_run)


def options_of(args: argparse.Namespace) -> InstallOptions:
    """Return the options of the command line."""
    return InstallOptions(
        config=getattr(args, "config", None),
        secrets=_secrets(getattr(args, "credential", [])),
        python=getattr(args, "python", "/usr/bin/python3"),
        packaged=args.packaged or machine_is_packaged(args.root),
        on_ground=args.on_ground,
    )


def machine_is_packaged(root: Path) -> bool:
    """Return whether a Debian package of ours is installed, which then owns the unit and the other files of the system."""
    return (root / PACKAGED_UNIT.lstrip("/")).is_file()


def _secrets(words: list[str]) -> dict[str, Path]:
    found = {}
    for word in words:
        name, equals, file = word.partition("=")
        if not (name and equals and file):
            raise BadInput(f"--credential {word}: want NAME=FILE")
        found[name] = Path(file)
    return found
