"""`decklander completion`: print a script that completes commands and options in a shell."""

from __future__ import annotations

import argparse
import importlib
import sys

_BASH = """_decklander() {{
  local line="${{COMP_WORDS[1]}}" word="${{COMP_WORDS[COMP_CWORD]}}"
  [ "$COMP_CWORD" = 1 ] && {{ COMPREPLY=($(compgen -W "{commands}" -- "$word")); return; }}
  case "$line" in
{cases}
  esac
}}
complete -o default -F _decklander decklander
"""
SHELLS = ("bash", "zsh", "fish")


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander completion` to the parser."""
    parser = subparsers.add_parser(
        "completion",
        help="print the completion of commands for bash, zsh or fish",
        description="Print a script that completes commands, options and file names. For bash: decklander completion bash > "
        "~/.local/share/bash-completion/completions/decklander. For zsh: source it from ~/.zshrc. For fish: "
        "decklander completion fish > ~/.config/fish/completions/decklander.fish.",
    )
    parser.add_argument("shell", choices=SHELLS, help="shell")


def run(args: argparse.Namespace) -> int:
    """Print the script and return 0."""
    words = completions()
    if args.shell == "fish":
        lines = [f"complete -c decklander -n __fish_use_subcommand -f -a {name}" for name in words]
        for name, options in words.items():
            lines += [
                f"complete -c decklander -n '__fish_seen_subcommand_from {name}' "
                + (f"-l {word[2:]}" if word.startswith("--") else f"-f -a {word}")
                for word in options
            ]
        sys.stdout.write("\n".join(lines) + "\n")
        return 0
    cases = "\n".join(f'    {name}) COMPREPLY=($(compgen -W "{" ".join(of)}" -- "$word"));;' for name, of in words.items())
    zsh = "autoload -U +X bashcompinit && bashcompinit\n" if args.shell == "zsh" else ""
    sys.stdout.write(zsh + _BASH.format(commands=" ".join(words), cases=cases))
    return 0


def completions() -> dict[str, list[str]]:
    """Return what follows each command: its actions and its long options."""
    from companion.cli.main import COMMANDS

    found = {}
    for name, (module, _) in COMMANDS.items():
        parser = argparse.ArgumentParser()
        importlib.import_module(module).add_parser(parser.add_subparsers())
        (of_commands,) = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
        found[name] = list(dict.fromkeys(_words(of_commands.choices[name])))
    return found


def _words(parser: argparse.ArgumentParser) -> list[str]:
    words = []
    for action in parser._actions:
        words += [option for option in action.option_strings if option.startswith("--")]
        if isinstance(action, argparse._SubParsersAction):
            words += [word for name, inner in action.choices.items() for word in (name, *_words(inner))]
    return words
