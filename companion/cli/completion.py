"""`decklander completion`: print a script that completes commands and options in a shell."""

import argparse
import importlib
import sys

import shtab

from companion.cli.commands import COMMANDS, PACKAGE_GROUP
from companion.cli.options import option
from companion.settings.capabilities import load_offered, of_packages

SHELLS = ("bash", "zsh", "fish")


DESCRIPTION = (
    "Print a script that completes commands, options and file names. For bash: decklander completion bash > "
    "~/.local/share/bash-completion/completions/decklander. For zsh: decklander completion zsh > _decklander in a folder of "
    "$fpath. For fish: decklander completion fish > ~/.config/fish/completions/decklander.fish."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    option(parser, "shell", "shell", choices=SHELLS)


def run(args: argparse.Namespace) -> int:
    """Print the script and return 0.

    Raises:
        BadInput: a command of another package cannot be loaded.
    """
    from companion.cli.main import add_command

    parser = argparse.ArgumentParser(prog="decklander")
    subparsers = parser.add_subparsers()
    for name, command in COMMANDS.items():
        add_command(subparsers, name, importlib.import_module(command.module))
    for name, entry in of_packages(PACKAGE_GROUP).items():
        if name not in COMMANDS:
            add_command(subparsers, name, load_offered(entry, f"decklander {name}"))
    sys.stdout.write(shtab.complete(parser, shell=args.shell) + "\n")
    return 0
