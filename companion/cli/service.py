"""`decklander service`: install, update, roll back and uninstall the service on this computer."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from companion.tools.install import steps, versions
from companion.tools.install.layout import PACKAGED_UNIT
from companion.tools.install.machine import Machine
from companion.tools.install.steps import InstallOptions
from companion.tools.install.versions import NAME, release
from estimator.contracts.errors import BadInput, SetupImpossible


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander service` to the parser."""
    parser = subparsers.add_parser("service", help="install, update, roll back or uninstall the service on this computer")
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True, title="actions")
    install = actions.add_parser(
        "install",
        help="install the service",
        description="Install the service: an environment below /opt/decklander, the unit, device rules, user, keys and settings. "
        "What is there already is left; settings are never overwritten. Exit code 1 if a step failed or the drone flies.",
    )
    _add_release(install, "what this program was installed from")
    install.add_argument("--config", type=Path, metavar="FILE", help="settings to copy to /etc/decklander/rig.toml")
    install.add_argument(
        "--credential",
        action="append",
        default=[],
        metavar="NAME=FILE",
        help="secret to copy to /etc/credstore, for root alone (mqtt-password, mavlink-key, page, ...); may be repeated",
    )
    update = actions.add_parser(
        "update",
        help="update the installed service",
        description="Install a version beside the one that runs and check it with the present settings. Make it the current one, "
        "start the service again and watch it. If it does not come up, the version before is current again. Never while the "
        "drone flies.",
    )
    _add_release(update, "the newest release")
    rollback = actions.add_parser(
        "rollback",
        help="return to the version before the last update",
        description="Make the version before the last update the current one, after a check with the present settings, and start "
        "the service again. A second rollback returns to the newer one. Never while the drone flies.",
    )
    uninstall = actions.add_parser(
        "uninstall",
        help="remove the installed service",
        description="Stop and remove the service and all its versions. Settings, keys and recordings stay. Never while the drone "
        "flies.",
    )
    uninstall.add_argument("--purge", action="store_true", help="remove settings, keys, recordings and the user too")
    for action in (install, update, rollback, uninstall):
        _add_common(action)


def _add_common(parser: argparse.ArgumentParser) -> None:
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


def _add_release(parser: argparse.ArgumentParser, default: str) -> None:
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
        "--video",
        action="store_true",
        help="install PyAV too, for an AR.Drone 2.0, a network camera, or H.264 in recordings; updates keep it",
    )
    parser.add_argument(
        "--python", default="/usr/bin/python3", metavar="FILE", help="Python to run with (default: /usr/bin/python3)"
    )


def run(args: argparse.Namespace) -> int:
    """Run the action.

    Raises:
        BadInput: the root is no folder, or a package installed what is to be uninstalled.
        SetupImpossible: this user may not change the computer.
    """
    packaged = args.packaged or (args.root / PACKAGED_UNIT.lstrip("/")).is_file()
    if args.action == "uninstall" and packaged and not args.packaged:
        raise BadInput("a Debian package installed it: apt remove decklander (or apt purge decklander)")
    machine = _machine(args)
    options = InstallOptions(
        config=getattr(args, "config", None),
        secrets=_secrets(getattr(args, "credential", [])),
        python=getattr(args, "python", "/usr/bin/python3"),
        packaged=packaged,
        on_ground=args.on_ground,
    )
    video = getattr(args, "video", False) or (versions.current(machine) or "").endswith(versions.VIDEO)
    match args.action:
        case "install":
            with release(args.source, args.wheels, video=video) as found:
                steps.install(machine, found, options)
        case "update":
            with release(args.source or NAME, args.wheels, video=video) as found:
                steps.update(machine, found, options)
        case "rollback":
            steps.roll_back(machine, options)
        case _:
            steps.uninstall(machine, options, purge=args.purge)
    return 0


def _machine(args: argparse.Namespace) -> Machine:
    root = args.root.resolve()
    if not root.is_dir():
        raise BadInput(f"--root {args.root}: no such folder")
    if os.geteuid() != 0 and not args.dry_run:
        command = f"decklander service {args.action}"
        raise SetupImpossible(f"{command} changes the system and needs root: sudo {command} (or --dry-run)")
    return Machine(root, sys.stdout, dry=args.dry_run)


def _secrets(words: list[str]) -> dict[str, Path]:
    found = {}
    for word in words:
        name, equals, file = word.partition("=")
        if not (name and equals and file):
            raise BadInput(f"--credential {word}: want NAME=FILE")
        found[name] = Path(file)
    return found
