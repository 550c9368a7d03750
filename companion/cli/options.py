"""Declare the options of commands, and do what several commands do alike: check folders, write files, print results."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from estimator.contracts.errors import BadInput, fault_of, unusable


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


def check_seed(args: argparse.Namespace) -> None:
    """Refuse a seed below 0.

    Raises:
        BadInput: it is.
    """
    if args.seed < 0:
        raise BadInput(f"--seed must be 0 or more, got {args.seed}")


def check_new(path: Path | None) -> None:
    """Refuse an `--out` that would overwrite a file.

    Raises:
        BadInput: there is a file of that name.
    """
    if path is not None and path.exists():
        raise BadInput(f"--out {path}: there is such a file already; name a new one")


@contextmanager
def file_errors(what: str) -> Iterator[None]:
    """Turn an error of the system about a file into one line.

    Args:
        what: the file, or the option that names it, which begins the line.

    Raises:
        BadInput: it cannot be read or written.
    """
    try:
        yield
    except OSError as why:
        raise unusable(what, why) from why


def print_result(args: argparse.Namespace, record: object, text: str) -> None:
    """Print a result as one line of JSON with `--json`, else as text."""
    sys.stdout.write((json.dumps(record) if args.json else text.removesuffix("\n")) + "\n")


def written(page: Path) -> str:
    """Return the line that says where the report is and how large."""
    return f"report: {page} ({page.stat().st_size / 1e6:.1f} MB, one file; open it in a browser)\n"


def prepare_folder(folder: Path | None) -> None:
    """Create the report's folder and check that files can be written into it; do nothing without a folder.

    Raises:
        BadInput: the folder cannot be created or written.
    """
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as why:
        raise BadInput(f"--report {folder}: {fault_of(why)}") from why


def require_drawing(option: str, instead: str = "") -> None:
    """Refuse an option that draws where matplotlib is not installed; `instead` says what the person can do without it.

    Raises:
        BadInput: matplotlib is not installed; the message says how to install it.
    """
    if find_spec("matplotlib") is None:
        raise BadInput(
            f"{option} draws with matplotlib, which is not installed: install requirements/report.txt, "
            f"or the extra decklander[report]{instead}"
        )
