"""Declare the options of commands, and do what several commands do alike: check folders, write files, print results.

The progress of long work is a line that is redrawn on a terminal, lines now and then elsewhere.
"""

import argparse
import json
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from companion.settings.links import HttpSettings, is_address
from estimator.contracts.errors import BadInput

_PRINT_EACH_S = 30.0  # interval of progress where there is no terminal
_REDRAW_S = 0.2  # interval of progress on a terminal
_SILENT_S = 2.0
"""Work that takes less is not shown."""
_LEAST_SHARE = 0.05
"""The share of the work after which the time left is worth printing."""


def option(parser: argparse._ActionsContainer, spec: str, meaning: str, **more: Any) -> None:
    """Declare an option or an argument.

    Args:
        spec: its name and, after a blank, the name of its value: "--size WxH". An option without a value is a flag; an
            argument has a name without hyphens: "file FILE".
        meaning: its help, a verb and an object.
        more: what argparse takes besides; a default that is a number or a path gives the type.
    """
    name, _, value = spec.partition(" ")
    if value:
        more["metavar"] = value
    elif name.startswith("-") and not more.keys() & {"action", "choices", "nargs", "type"}:
        more["action"] = "store_true"
    default = more.get("default")
    if "action" not in more and isinstance(default, int | float | Path):
        more.setdefault("type", Path if isinstance(default, Path) else type(default))
    parser.add_argument(name, help=meaning, **more)


def recording_argument(parser: argparse.ArgumentParser) -> None:
    """Declare the recording that a command reads."""
    option(parser, "recording RECORDING", "MCAP file, or the files of one recording in order", nargs="+", type=Path)


def refuse_any(*cases: tuple[object, str]) -> None:
    """Refuse what holds among cases, each with its reason.

    Raises:
        BadInput: one holds.
    """
    for holds, reason in cases:
        if holds:
            raise BadInput(reason)


def listening(text: str, what: str) -> tuple[str, int]:
    """Return the address and port that PORT, ADDRESS or ADDRESS:PORT means; `what` begins the error.

    Raises:
        BadInput: it is none of these.
    """
    text, usual = text.replace("localhost", "127.0.0.1"), HttpSettings()
    host, port = (usual.host, text) if text.isdecimal() else (text, str(usual.port))
    if not is_address(host):
        host, _, port = text.rpartition(":")
    if not (is_address(host) and port.isdecimal() and 1 <= int(port) <= 65535):
        raise BadInput(f"{what} {text}: write a port, an address of this computer, or both as in {usual.host}:{usual.port}")
    return host, int(port)


def tell_damage(cut: Mapping[Path, str], done: str) -> None:
    """Write to standard error what is missing of a recording that was read (`Recording.cut`), and what was done without that."""
    for path, why in cut.items():
        sys.stderr.write(f"decklander: {path} is cut short or damaged ({why}): {done} without that\n")


def check_seed(args: argparse.Namespace) -> None:
    """Refuse a seed below 0 by `BadInput`."""
    refuse_any((args.seed < 0, f"--seed must be 0 or more, got {args.seed}"))


ERASED = "\r\x1b[2K"
"""Control sequence that empties the line of a terminal where progress stands (ECMA-48, EL)."""


def print_line(text: str) -> None:
    """Write a line to standard error, in the place of a line of progress."""
    sys.stderr.write(f"{ERASED if sys.stderr.isatty() else ''}{text}\n")
    sys.stderr.flush()


def print_result(args: argparse.Namespace, record: object, text: str) -> None:
    """Print a result as one line of JSON with `--json`, else as text."""
    sys.stdout.write((json.dumps(record) if args.json else text.removesuffix("\n")) + "\n")


def written(page: Path) -> str:
    """Return the line that says where the report is and how large."""
    return f"report: {page} ({page.stat().st_size / 1e6:.1f} MB, one file; open it in a browser)\n"


def require_drawing(option: str) -> None:
    """Refuse an option that draws where matplotlib is not installed.

    Raises:
        BadInput: matplotlib is not installed; the message says how to install it.
    """
    if find_spec("matplotlib") is None:
        raise BadInput(
            f"{option} draws with matplotlib, which is not installed: in a checkout "
            f".venv/bin/pip install --require-hashes -r requirements/report.txt, else the extra decklander[report]"
        )


class WorkProgress:
    """Progress of long work on standard error: one line that is redrawn on a terminal, else a line now and then.

    Args:
        title: the work.
        items: what is counted.
    """

    def __init__(self, title: str, items: str) -> None:
        self._title, self._items = title, items
        self._began_s = time.monotonic()
        self._due_s = self._began_s + _SILENT_S
        self._shown, self._done = False, 0
        self._live = sys.stderr.isatty()

    def take(self, done: int, of: int | None, more: str = "") -> None:
        """Print how much is done: at once if that is nothing yet, else after two seconds; `of` is None while it is not known."""
        now_s = time.monotonic()
        if done < self._done or done == 0:  # it begins again
            self._began_s, self._due_s, self._shown = now_s, now_s + _SILENT_S, False
        self._done = done
        if now_s < self._due_s and done > 0 and (done != of or not self._shown):
            return
        self._shown, self._due_s = True, now_s + (_REDRAW_S if self._live else _PRINT_EACH_S)
        text = f"{self._title}: {done} of {of} {self._items}" if of is not None else f"{self._title}: {done} {self._items}"
        if of is not None and _LEAST_SHARE * of <= done < of:
            left_s = (now_s - self._began_s) * (of / max(1, done) - 1.0)
            text += f", {left_s:.0f} s left" if left_s < 100 else f", {left_s / 60:.0f} min left"
        text += more
        sys.stderr.write(f"\r{text}\x1b[K" + ("\n" if done == of else "") if self._live else f"{text}\n")
        sys.stderr.flush()


def reading(name: str, *, quiet: bool = False) -> Callable[[int, int], None]:
    """Return what shows how much of a recording is read."""
    return (lambda _done, _of: None) if quiet else WorkProgress(f"reading {name}", "kB").take


@contextmanager
def named_wait(title: str, *, quiet: bool = False) -> Iterator[Callable[[], None]]:
    """Print the title of a step whose length is unknown when it has taken two seconds; yield what ends the wait before."""
    timer = threading.Timer(_SILENT_S, lambda: None if quiet else print_line(f"{title} ..."))
    try:
        timer.start()
        yield timer.cancel
    finally:
        timer.cancel()


@contextmanager
def writing(page: Path, *, quiet: bool) -> Iterator[Callable[[int, int], None]]:
    """Show that a report is written; yield what shows that it can be opened, and the encoding of its video."""
    progress = WorkProgress(f"{page} can be opened; encoding its video", "frames")
    with named_wait(f"writing {page}", quiet=quiet) as written:

        def take(done: int, of: int) -> None:
            written()
            if not quiet:
                progress.take(done, of)

        yield take
