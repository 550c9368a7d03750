"""`decklander config`: check settings, show them with every default, or explain them."""

from __future__ import annotations

import argparse
import sys

from companion.config import reference
from companion.config.settings import load, shipped


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "config", help="check settings, show them, or explain them", description="Check settings, show them, or explain them."
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    names = f"a settings file, or the name of a shipped rig ({', '.join(shipped())})"
    check = actions.add_parser(
        "check", help="say whether settings files are good", description="Say whether settings files are good."
    )
    check.add_argument("files", nargs="+", metavar="FILE", help=names)
    show = actions.add_parser(
        "show", help="print one with every default filled in", description="Print one with every default filled in."
    )
    show.add_argument("file", metavar="FILE", help=names)
    actions.add_parser(
        "schema", help="print a JSON Schema of settings files", description="Print a JSON Schema of settings files."
    )
    actions.add_parser("reference", help="print the reference page", description="Print the reference page (Markdown).")


def run(args: argparse.Namespace) -> int:
    if args.action == "check":
        for file in args.files:
            load(file)
            sys.stdout.write(f"{file}: good\n")
    elif args.action == "show":
        sys.stdout.write(reference.toml(load(args.file)))
    elif args.action == "schema":
        sys.stdout.write(reference.schema())
    else:
        sys.stdout.write(reference.reference())
    return 0
