"""`decklander config`: check settings files, show them with every default, or print their reference."""

from __future__ import annotations

import argparse
import sys

from companion.guidance.mission.page import page
from companion.parts.mqtt import messages
from companion.settings import schema
from companion.settings.load import load, shipped
from companion.settings.referenced_files import check_files
from companion.settings.remarks import not_checked, remarks
from estimator.contracts.errors import BadInput


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander config` to the parser."""
    parser = subparsers.add_parser(
        "config", help="check, show or explain settings", description="Check, show or explain settings."
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    names = f"settings file, or the name of a shipped vehicle profile ({', '.join(shipped())})"
    check = actions.add_parser(
        "check",
        help="check settings files",
        description="Check settings files, and the camera, pad, key, password and certificate files that they name.",
    )
    check.add_argument("files", nargs="+", metavar="FILE", help=names)
    show = actions.add_parser(
        "show", help="print a settings file with every default", description="Print a settings file with every default."
    )
    show.add_argument("file", metavar="FILE", help=names)
    schema = actions.add_parser(
        "schema",
        help="print the JSON Schema of settings files or MQTT messages",
        description="Print the JSON Schema of settings files or MQTT messages.",
    )
    schema.add_argument("--mqtt", action="store_true", help="print that of the messages over MQTT")
    reference = actions.add_parser(
        "reference",
        help="print the reference of all settings",
        description="Print the reference of the settings (docs/configuration.md) in Markdown.",
    )
    reference.add_argument("--expert", action="store_true", help="print the expert keys instead")
    actions.add_parser(
        "mission",
        help="print the states and events of a landing",
        description="Print the states and events of a landing, and what follows from them (docs/mission.md), in Markdown.",
    )


def run(args: argparse.Namespace) -> int:
    """Run the action; return 0.

    Raises:
        BadInput: a settings file, or a file that it names, cannot be read or has a fault.
    """
    if args.action == "check":
        for file in args.files:
            settings = load(file)
            try:
                unchecked = check_files(settings)
            except BadInput as why:
                raise BadInput(f"{file}: {why}") from why
            sys.stdout.write(f"{file}: good{not_checked(unchecked)}\n")
            for line in remarks(settings):
                sys.stdout.write(f"{file}: {line}\n")
    elif args.action == "show":
        sys.stdout.write(schema.toml(load(args.file)))
    elif args.action == "schema":
        sys.stdout.write(messages.schema() if args.mqtt else schema.schema())
    elif args.action == "mission":
        sys.stdout.write(page())
    else:
        sys.stdout.write(schema.reference(expert=args.expert))
    return 0
