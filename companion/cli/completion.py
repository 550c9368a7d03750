"""`decklander completion`: print a script that completes commands and options in a shell."""

from __future__ import annotations

import argparse
import importlib
import sys

import shtab

SHELLS = ("bash", "zsh", "fish")


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander completion` to the parser."""
    parser = subparsers.add_parser(
        "completion",
        help="print the completion of commands for bash, zsh or fish",
        description="Print a script that completes commands, options and file names. For bash: decklander completion bash > "
        "~/.local/share/bash-completion/completions/decklander. For zsh: decklander completion zsh > _decklander in a folder of "
        "$fpath. For fish: decklander completion fish > ~/.config/fish/completions/decklander.fish.",
    )
    parser.add_argument("shell", choices=SHELLS, help="shell")


def run(args: argparse.Namespace) -> int:
    """Print the script and return 0."""
    from companion.cli.main import COMMANDS

    parser = argparse.ArgumentParser(prog="decklander")
    subparsers = parser.add_subparsers()
    for module, _ in COMMANDS.values():
        importlib.import_module(module).add_parser(subparsers)
    sys.stdout.write(shtab.complete(parser, shell=args.shell) + "\n")
    return 0
