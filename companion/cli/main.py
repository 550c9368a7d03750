"""The command `decklander`: find the subcommand, run it, and turn errors into one line on stderr and an exit code.

Exit codes: 0 done; 1 it did not reach its goal; 2 wrong use or bad input; 130 interrupted from the keyboard; 141 the reader
of our output went away; 131, 143 ended by SIGQUIT, SIGTERM, with what was begun cleared away (`companion.base.signals` says how).

The subcommands stand in the table of `companion.cli.commands`; each is imported when it is requested.
"""

from __future__ import annotations

import argparse
import difflib
import errno
import gc
import importlib
import io
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NoReturn, TextIO

from companion.base import signals
from companion.cli.commands import COMMANDS, OWNERS, PACKAGE_GROUP, CommandModule, by_group
from companion.settings.capabilities import load_offered, of_packages
from drivers.extras import SERVICE, require
from estimator.contracts.address import masked
from estimator.contracts.errors import BadInput, DecklanderError, SetupImpossible, one_line

_READS_FILES_OF_OTHERS = frozenset({"calibrate", "config", "detect", "doctor", "pad", "record", "replay", "report"})
"""Commands that leave a part of the machine's memory to others, whatever a file holds."""
_EXAMPLES = (
    ("decklander demo --page", "a landing over a simulated ship, in your browser"),
    ("decklander start", "settings for your own drone"),
    ("decklander run --config rig.toml", "the service, then: decklander fly takeoff"),
    ("decklander simulate sea_state_4 --seed 1", "one flight, the same every time"),
)
Load = Callable[[str], CommandModule]
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
"""Errors of a disk that takes no more, whatever is written."""
DONE = 0
"""Exit code: done."""
FAILED = 1
"""Exit code: it did not reach its goal."""
WRONG = 2
"""Exit code: wrong use or bad input."""
INTERRUPTED = 130
"""Exit code: interrupted from the keyboard, 128 and SIGINT."""
BROKEN_PIPE = 141
"""Exit code: the reader of the output is gone, 128 and SIGPIPE."""


_PLAIN = {
    r"^argument ([^:]+): invalid int value: (.*)": r"\1 must be a whole number, found \2",
    r"^argument ([^:]+): invalid float value: (.*)": r"\1 must be a number, found \2",
    r"^argument ([^:]+): invalid choice: (.*) \(choose from (.*)\)": r"\1 must be one of \3, found \2",
}
"""Errors of argparse, and how a person would put them."""


class Parser(argparse.ArgumentParser):
    """A parser that reports an error in one line."""

    def error(self, message: str) -> NoReturn:
        printed = one_line(message)
        for words, meant in _PLAIN.items():
            printed = re.sub(words, meant, printed)
        self.exit(WRONG, f"{self.prog}: {printed} (see {self.prog} --help)\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        print(message, end="", file=file or sys.stderr, flush=True)  # argparse is silent about a disk that is full


class _MainParser(Parser):
    """The parser of the whole command line, whose help has the commands by what a person wants."""

    def format_help(self) -> str:
        listed = {title: {name: one.summary for name, one in group.items()} for title, group in by_group().items()}
        if offered := of_packages(PACKAGE_GROUP):
            listed["of other packages"] = {name: f"from {entry.value}" for name, entry in offered.items()}
        width = max(map(len, {*COMMANDS, *offered}))
        lines = [f"usage: {self.prog} COMMAND ...", "", str(self.description)]
        for title, group in listed.items():
            lines += ["", _style(title, "1"), *(f"  {name:<{width}}  {summary}" for name, summary in group.items())]
        wide = max(len(command) for command, _ in _EXAMPLES)
        lines += ["", _style("examples", "1"), *(f"  {command:<{wide}}  {what}" for command, what in _EXAMPLES)]
        return "\n".join(
            [*lines, "", "decklander COMMAND --help has the options of a command; --version prints the version.", ""]
        )


class _Version(argparse.Action):
    """An action that looks up the version only if `--version` is given."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from companion.base.version import version

        parser._print_message(f"decklander {version()}\n", sys.stdout)
        parser.exit()


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line (this process' own when `argv` is None) and return the exit code.

    Raises:
        SystemExit: help or the version was requested, or the arguments are wrong.
    """
    if argv is not None:
        return _run(list(argv), importlib.import_module)
    _lend_streams()
    try:
        try:
            if sys.argv[1:2] and sys.argv[1] in _READS_FILES_OF_OTHERS:
                from drivers.confined import confine

                confine()
            signals.install()
            code = _run(sys.argv[1:], _load_for_good)
        except (SystemExit, signals.Stopped):
            raise
        except BaseException as why:  # a bug of ours: print Python's traceback, but no thread that hangs may keep the process
            # A signal that comes while a class is made reaches us as the cause of Python's own error.
            if isinstance(why.__cause__, signals.Stopped):
                raise why.__cause__ from None
            traceback.print_exc()
            code = FAILED
        return signals.leave(code)
    except signals.Stopped as why:
        return signals.leave(why.exit_code)


def _run(argv: list[str], load: Load) -> int:
    try:
        code = _dispatch(argv, load)
        sys.stdout.flush()
    except BrokenPipeError:
        _drop_output()
        return BROKEN_PIPE
    except OSError as why:
        if why.errno not in _FULL:
            raise
        _drop_output()
        sys.stderr.write(f"decklander: cannot write {why.filename or 'the output'}: {why.strerror}\n")
        return FAILED
    except signals.Stopped as why:
        return why.exit_code
    except KeyboardInterrupt:
        return INTERRUPTED
    except DecklanderError as why:
        return _refuse(why)
    except MemoryError:
        return _refuse(BadInput("it takes more memory than a command may take on this machine (three quarters of all)"))
    except BaseExceptionGroup as group:
        causes = list(_leaves(group))
        for cause in causes:
            if isinstance(cause, signals.Stopped):
                return cause.exit_code
        if any(isinstance(cause, KeyboardInterrupt) for cause in causes):
            return INTERRUPTED
        ours = [cause for cause in causes if isinstance(cause, DecklanderError)]
        if len(ours) != len(causes):
            raise
        return _refuse(ours[0])
    return code


def _lend_streams() -> None:
    """Put the null device where a standard stream is closed: else a print raises, and a file that is opened takes its number."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDONLY if mode == "r" else os.O_WRONLY), mode))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a name that the terminal's encoding lacks is no reason to end
            stream.reconfigure(errors="backslashreplace")


def _drop_output() -> None:
    """Send what standard output still holds nowhere: the interpreter writes it once more when it ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _dispatch(argv: list[str], load: Load) -> int:
    parser = _MainParser(
        prog="decklander", description="Land a quadcopter on a small helipad on a moving ship.", allow_abbrev=False
    )
    parser.add_argument("--version", action=_Version)
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands", parser_class=Parser)
    words = [word for word in argv if not word.startswith("-")]
    typed = words[0] if words else None
    loaded = _loader_of(parser, words, load) if words else None
    for name, command in COMMANDS.items():
        if name != typed:
            subparsers.add_parser(name, help=command.summary)
    if typed is None or loaded is None:
        parser.parse_args(argv)
        parser.exit(WRONG, parser.format_help())
    if sys.maxsize < 2**32:
        raise SetupImpossible(
            "this is a 32-bit Python; decklander needs a 64-bit operating system and Python (on a Raspberry Pi: arm64)"
        )
    # No matrix here has more than some thirty rows, and the library would start a thread and set memory aside for each core.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    module = loaded()
    add_command(subparsers, typed, module)
    args, unknown = parser.parse_known_args(argv)
    if unknown:
        _refuse_words(subparsers.choices[typed], unknown)
    from companion.cli.outputs import checked_outputs  # a help needs none of it

    with checked_outputs(args):
        return int(module.run(args))


def _loader_of(parser: Parser, words: Sequence[str], load: Load) -> Callable[[], CommandModule]:
    """Return what loads the command that the words begin with; end because of a word that is none."""
    for wanted in (" ".join(words[:n]) for n in (1, 2)):
        if wanted in OWNERS:
            OWNERS[wanted].require(f"decklander {wanted}")
    typed = words[0]
    if typed in COMMANDS:
        require(f"decklander {typed}", "service", *SERVICE)
        return partial(load, COMMANDS[typed].module)
    offered = of_packages(PACKAGE_GROUP)
    if typed not in offered:
        near = difflib.get_close_matches(typed, known := [*COMMANDS, *offered], n=1)
        meant = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}"
        parser.error(f"unknown command {typed!r}; {meant}")
    return partial(load_offered, offered[typed], f"decklander {typed}")


def add_command(subparsers: argparse._SubParsersAction[Any], name: str, module: CommandModule) -> None:
    """Add a command with its options to the parser."""
    summary = COMMANDS[name].summary if name in COMMANDS else module.DESCRIPTION
    module.add_arguments(subparsers.add_parser(name, help=summary, description=module.DESCRIPTION))


def _refuse_words(parser: argparse.ArgumentParser, unknown: list[str]) -> NoReturn:
    """End because of words that a command does not know, with the option that was meant if one is alike."""
    option = unknown[0].partition("=")[0]
    known = {name for action in parser._actions for name in action.option_strings}
    near = difflib.get_close_matches(option, known, n=1, cutoff=0.75)
    parser.error(f"unrecognized arguments: {' '.join(unknown)}" + (f"; did you mean {near[0]!r}?" if near else ""))


def _load_for_good(name: str) -> CommandModule:
    """Import a module without garbage collections: what an import makes stays, and a collection would visit all of it.

    No later collection of this process visits it either.
    """
    gc.disable()
    try:
        return importlib.import_module(name)
    finally:
        gc.freeze()
        gc.enable()


def _refuse(why: DecklanderError) -> int:
    printed = masked(one_line(str(why)))
    erased = "\r\x1b[2K" if sys.stderr.isatty() else ""  # a line of progress
    sys.stderr.write(f"{erased}{_style('decklander:', '1;31', sys.stderr)} {printed}{_cure(why)}\n")
    if sys.stderr.isatty() and isinstance(why, BadInput):
        sys.stderr.write(pointed(printed))
    return WRONG if isinstance(why, BadInput) else FAILED


_SYNTAX = re.compile(r"\(at line (\d+), column (\d+)\)")
_KEY = re.compile(r'([\w-]+(?:\.(?:[\w-]+|"[^"]*"))*)[ :]')
_PAGE = "docs/configuration.md, or: decklander config reference"


def pointed(message: str) -> str:
    """Return some lines with the place in the TOML file that the message names; empty if it names none.

    Args:
        message: "FILE: KEY ..." as settings are refused.
    """
    from drivers.files import Largest, bytes_of
    from estimator.contracts.text import utf8_of

    found = re.match(r"(?P<file>[^:]+\.toml): (?P<what>.*)", message)
    if found is None:
        return ""
    try:
        lines = utf8_of(bytes_of(Path(found["file"]), Largest.SETTINGS)).decode("utf-8", "replace").splitlines()
    except DecklanderError:
        return ""
    if syntax := _SYNTAX.search(found["what"]):
        row, column, width = int(syntax[1]), int(syntax[2]), 1
    else:
        key = _KEY.match(found["what"])
        place = _of_key(key[1], lines) if key else None
        if place is None:
            return ""
        row, column, width = place
    if not 1 <= row <= len(lines):
        return ""
    margin = len(str(row))
    return (
        f"  --> {found['file']}:{row}:{column}\n"
        f"  {row} | {masked(lines[row - 1])}\n"
        f"  {'':{margin}} | {' ' * (column - 1)}{'^' * width}\n"
        f"  {'':{margin}} = page: {_PAGE}\n"
    )


def _of_key(key: str, lines: list[str]) -> tuple[int, int, int] | None:
    """Return the row, column and width of a dotted key, or of its table's header where the key is missing; None without both."""
    table = ""
    best: tuple[int, int, int] | None = None
    for number, line in enumerate(lines, 1):
        if header := re.match(r"\s*\[\s*([^\[\]]+?)\s*\]", line):
            table = header[1]
            if key == table or (best is None and key.startswith(f"{table}.")):
                best = (number, header.start(1) + 1, len(header[1]))
            continue
        assigned = re.match(r"\s*([\w.\"-]+)\s*=", line)
        if assigned and ".".join(filter(None, (table, assigned[1]))) == key:
            return number, assigned.start(1) + 1, len(assigned[1])
    return best


def _cure(why: DecklanderError) -> str:
    """Return the cure for a missing file: the missing folder, or a similar name."""
    missing = why.__cause__
    if not isinstance(missing, FileNotFoundError) or not isinstance(missing.filename, str | os.PathLike):
        return ""
    path = Path(missing.filename)
    absent = [folder for folder in path.parents if not folder.exists()]
    if absent:
        return f"; there is no folder {absent[-1]}: make it, or correct the path"
    near = difflib.get_close_matches(path.name, [entry.name for entry in path.parent.iterdir()], n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


def _style(text: str, code: str, out: TextIO | None = None) -> str:
    """Return the text in a style of ANSI (ECMA-48, SGR), or as it is without colours and by NO_COLOR (no-color.org)."""
    coloured = (out or sys.stdout).isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM", "dumb") != "dumb"
    return f"\x1b[{code}m{text}\x1b[0m" if coloured else text


def _leaves(group: BaseExceptionGroup[BaseException]) -> Iterator[BaseException]:
    for error in group.exceptions:
        if isinstance(error, BaseExceptionGroup):
            yield from _leaves(error)
        else:
            yield error


if __name__ == "__main__":
    sys.exit(main())
