"""Run tests in a forked process, quietly, on a module with another source or on a core with another library.

The parent has imported pytest and the libraries but nothing of ours, so a child starts in a tenth of a second and finds the
module changed without a file being written. Nobody reads the report of a failing test, so nothing is spent on it: asserts are not
rewritten, Hypothesis draws the same examples each time and does not shrink the one that fails.
"""

import importlib
import importlib.abc
import importlib.util
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import Phase, settings

_QUIET = (
    "-q", "-x", "--no-header", "--no-summary", "--tb=no", "--assert=plain", "-W", "ignore",
    "-p", "no:randomly", "-p", "no:unraisableexception", "-p", "no:threadexception", "-p", "no:cacheprovider",
)  # fmt: skip
"""Two of the plugins collect garbage for a warning that is ignored here."""


class _Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds one module with another source."""

    def __init__(self, name: str, path: Path, source: str) -> None:
        self._name, self._path, self._source = name, path, source

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        return importlib.util.spec_from_loader(fullname, self) if fullname == self._name else None

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = str(self._path)
        exec(compile(self._source, str(self._path), "exec"), module.__dict__)


class _Profile:
    """A plugin that sets Hypothesis's profile after the project's own `conftest.py` has set its."""

    def pytest_sessionstart(self) -> None:
        phases = (Phase.explicit, Phase.generate)
        settings.register_profile("mutants", derandomize=True, database=None, deadline=None, phases=phases)
        settings.load_profile("mutants")


def change_module(root: Path, path: str, source: str) -> None:
    """Give a module that nothing has imported yet another source."""
    name = path.removesuffix(".py").replace("/", ".")
    sys.meta_path.insert(0, _Changed(name, root / path, source))


def load_core(library: Path) -> None:
    """Load a library in place of the core's own."""
    importlib.import_module("estimator.core.library").CORE.load(str(library))


def passes(prepare: Callable[[], None], root: Path, tests: Sequence[str], timeout_s: float) -> bool:
    """Return whether tests pass in a fork after `prepare`; tests that do not end in time do not pass."""
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        try:
            os.setpgid(0, 0)
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 1)
            os.dup2(null, 2)
            sys.path.insert(0, str(root))
            os.environ["DECKLANDER_MUTANT"] = "1"  # its flights are none to keep
            prepare()
            os._exit(int(pytest.main([*_QUIET, *(str(root / test) for test in tests)], plugins=[_Profile()])) & 0xFF)
        except BaseException:
            os._exit(1)
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status) == 0
        time.sleep(0.01)
    os.killpg(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return False
