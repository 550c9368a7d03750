"""Run tests in a forked process: on the original module, recording which test runs which line, or on a mutant of it.

The parent has imported pytest and the libraries but nothing of ours, so a child starts in a tenth of a second and finds the
module changed without a file being written. Nobody reads what a failing test says, so nothing is spent on it: asserts are not
rewritten, Hypothesis draws the same examples each time and does not shrink the one that fails.
"""

from __future__ import annotations

import importlib.abc
import importlib.util
import json
import os
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import Any

import pytest
from hypothesis import Phase, settings

IMPORTING = ""
"""Stands for a test's name where a line runs when the module is imported."""


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


class _Lines:
    """A plugin that records the lines of one file that each test runs, and the test's duration."""

    def __init__(self, path: Path) -> None:
        self._path = str(path)
        self.test = IMPORTING
        self.met: dict[str, set[int]] = defaultdict(set)
        self.seconds: dict[str, float] = {}

    def trace(self, frame: FrameType, event: str, argument: object) -> Any:
        if frame.f_code.co_filename != self._path:
            return None
        self.met[self.test].add(frame.f_lineno)
        return self.trace

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Any:
        self.test = item.nodeid
        began = time.perf_counter()
        sys.settrace(self.trace)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            self.seconds[item.nodeid] = time.perf_counter() - began
            self.test = IMPORTING


def baseline(path: Path, tests: Sequence[str], report: Path) -> int:
    """Run the tests on the original module and write the lines that each runs; return the exit code of pytest."""
    _no_shrinking()
    lines = _Lines(path)
    sys.settrace(lines.trace)
    code = int(pytest.main([*_QUIET, *tests], plugins=[lines]))
    sys.settrace(None)
    report.write_text(json.dumps({"met": {test: sorted(met) for test, met in lines.met.items()}, "seconds": lines.seconds}))
    return code


def on_mutant(name: str, path: Path, source: str, tests: Sequence[str]) -> int:
    """Run tests on the changed module up to the first failure; return 0 if none fails."""
    try:
        _no_shrinking()
        sys.meta_path.insert(0, _Changed(name, path, source))
        return int(pytest.main([*_QUIET, "-x", *tests]))
    except BaseException:
        return 1


def _no_shrinking() -> None:
    settings.register_profile("mutants", derandomize=True, database=None, phases=(Phase.explicit, Phase.generate))
    settings.load_profile("mutants")


_QUIET = (
    "-q", "--no-header", "--no-summary", "--tb=no", "--assert=plain", "-W", "ignore",
    "-p", "no:randomly", "-p", "no:unraisableexception", "-p", "no:threadexception",
)  # fmt: skip
"""The two plugins collect garbage for a warning that is ignored here."""


def silence() -> None:
    """Discard what tests print."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
