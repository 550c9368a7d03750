"""Parse a bench's options with its smallest run, and end a bench in words where something is missing or died."""

import argparse
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn


def described(doc: str | None) -> argparse.ArgumentParser:
    """Return the parser of a bench, whose help is its module's."""
    return argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)


def parsed(parser: argparse.ArgumentParser, smoke: str, argv: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the options of a bench; with --smoke those of its smallest run, which measures something within seconds.

    Args:
        smoke: options of that run. Those that are given beside --smoke come after these, so they win.
    """
    parser.add_argument("--smoke", action="store_true", help=f"the smallest run, as a test runs it: {smoke or 'the whole'}")
    argv = sys.argv[1:] if argv is None else argv
    return parser.parse_args([*shlex.split(smoke), *argv] if "--smoke" in argv else argv)


@contextmanager
def mapping(workers: int) -> Iterator[Callable[..., Iterator[Any]]]:
    """Yield what maps a function over items in their order: by so many processes, or in this one where it is one."""
    if workers == 1:
        yield map
    else:
        with ProcessPoolExecutor(workers) as pool:
            yield pool.map


def program(name: str, package: str) -> str:
    """Return the path of a program that a bench needs; end with what to install where it is missing."""
    path = shutil.which(name) or shutil.which(name, path="/usr/sbin:/usr/local/sbin")
    return path or failed(f"{name} is missing: apt install {package}")


def alive(child: subprocess.Popen[str], name: str, words: Path) -> None:
    """End with the words of a child that has died."""
    if child.poll() is not None:
        failed(f"{name} ended with {child.returncode}: {words.read_text(errors='replace').strip()[-2000:] or 'without a word'}")


def failed(why: str) -> NoReturn:
    """End a bench that measured nothing."""
    sys.exit(f"{Path(sys.argv[0]).stem}: {why}")
