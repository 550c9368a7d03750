"""Run tests in a forked process, quietly, or on a module with another source.

The parent has imported pytest and the libraries but nothing of ours, so a child starts in a tenth of a second and finds the
module changed without a file being written. Nobody reads what a failing test says, so nothing is spent on it: asserts are not
rewritten, Hypothesis draws the same examples each time and does not shrink the one that fails.
"""

import importlib.abc
import importlib.util
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import CodeType, ModuleType
from typing import TextIO

import pytest
from hypothesis import Phase, settings

OURS = ("companion", "drivers", "estimator", "sitl", "tests")
"""The packages under test."""


class _Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds one module with another source."""

    def __init__(self, name: str, path: Path, source: str) -> None:
        self._name, self._path, self._source = name, path, source

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        return importlib.util.spec_from_loader(fullname, self) if fullname == self._name else None

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = str(self._path)
        code: CodeType = compile(self._source, str(self._path), "exec")
        exec(code, module.__dict__)


def in_child(work: Callable[[], int], timeout_s: float) -> int | None:
    """Return the exit code of `work` in a fork; None if it does not end in time."""
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        try:
            os.setpgid(0, 0)
            silence()
            os._exit(work() & 0xFF)
        except BaseException:
            os._exit(1)
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.killpg(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return None


def on_mutant(name: str, path: Path, source: str, tests: Sequence[str]) -> int:
    """Run tests on the changed module up to the first failure; return 0 if none fails."""
    try:
        sys.meta_path.insert(0, _Changed(name, path, source))
        return int(pytest.main([*QUIET, "-x", *tests], plugins=[Profile()]))
    except BaseException:
        return 1


class Profile:
    """A plugin that sets Hypothesis's profile after the project's own `conftest.py` has set its."""

    def pytest_sessionstart(self) -> None:
        """Draw the same examples each time, and do not shrink."""
        phases = (Phase.explicit, Phase.generate)
        settings.register_profile("mutants", derandomize=True, database=None, deadline=None, phases=phases)
        settings.load_profile("mutants")


QUIET = (
    "-q", "--no-header", "--no-summary", "--tb=no", "--assert=plain", "-W", "ignore",
    "-p", "no:randomly", "-p", "no:unraisableexception", "-p", "no:threadexception",
)  # fmt: skip
"""The two plugins collect garbage for a warning that is ignored here."""


def quiet() -> TextIO:
    """Discard what is printed from now on, except to the stream that is returned."""
    out = os.fdopen(os.dup(1), "w", buffering=1)
    silence()
    return out


def silence() -> None:
    """Discard what tests print."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
