"""Judge mutants in forks of one process that has imported the tests and the code under test.

A mutant costs its own making and the tests up to the first that fails. Those that killed most in the least time run first.
"""

import os
import resource
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from mutants import child
from mutants.tally import Tally

_ELSEWHERE = 255
"""Exit code of a fork that failed elsewhere than in a test."""
_PATIENCE, _PATIENCE_S = 3.0, 5.0
"""CPU time after which a mutant counts as hanging: this many times the time of the tests on the original, and some seconds."""


class Forks(ABC):
    """A plugin: when the tests are collected, `judge` is called, which runs them in forks."""

    def __init__(self, tally: Tally) -> None:
        self.tally = tally
        self.failed_on_original: list[str] = []
        self.after_tests: Callable[[], object] = lambda: None
        """Action of a fork when no test failed."""
        self._ended_by = "no tests"

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run each test by itself on the original, then judge every mutant."""
        self.session, self.items = session, session.items
        self.seconds, self._kills = [0.0] * len(self.items), [1] * len(self.items)
        self._caches = caches()
        if session.testsfailed:
            self.failed_on_original.append("collection")
            return True
        for k, item in enumerate(self.items):
            since = time.monotonic()
            if self._first_failure([item], self.on_original(k), 900.0) is not None:
                self.failed_on_original.append(item.nodeid)
            self.seconds[k] = time.monotonic() - since
        if not self.failed_on_original:
            print(f"{self.tally.path}: {len(self.items)} tests took {sum(self.seconds):.0f} s", file=self.tally.out)
            self._ended_by = "an error while judging"
            self.judge()
            self._ended_by = ""
        return True

    def on_original(self, k: int) -> Callable[[], None]:
        """Return what a fork does before it runs the k-th test on the original."""
        return lambda: None

    @abstractmethod
    def judge(self) -> None:
        """Judge every mutant."""

    def is_killed(self, prepare: Callable[[], None], tests: Sequence[int] | None = None) -> bool:
        """Return whether a test fails in a fork after `prepare`, of all or of those with these numbers."""
        numbers = range(len(self.items)) if tests is None else tests
        order = sorted(numbers, key=lambda k: self.seconds[k] / self._kills[k])
        patience_s = _PATIENCE_S + _PATIENCE * sum(self.seconds[k] for k in order)
        killer = self._first_failure([self.items[k] for k in order], prepare, patience_s)
        if killer is not None and killer < len(order):
            self._kills[order[killer]] += 1
        return killer is not None

    def _first_failure(self, items: Sequence[pytest.Item], prepare: Callable[[], None], patience_s: float) -> int | None:
        """Return the place of the first test that fails in a fork; None if none fails."""
        pid = os.fork()
        if pid == 0:
            try:
                child.silence()
                limit = int(patience_s) + 1
                resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
                resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
                for cache in self._caches:
                    cache.cache_clear()
                prepare()
                for k, item in enumerate(items):
                    item.config.hook.pytest_runtest_protocol(item=item, nextitem=items[k + 1] if k + 1 < len(items) else None)
                    if self.session.testsfailed:
                        os._exit(min(k + 1, _ELSEWHERE))
                sys.settrace(None)
                self.after_tests()
                os._exit(0)
            except BaseException:
                os._exit(_ELSEWHERE)
        deadline = time.monotonic() + 20.0 * (patience_s + 1.0)  # a test that waits uses no CPU time
        while True:
            done, status = os.waitpid(pid, os.WNOHANG)
            if done:
                break
            if time.monotonic() > deadline:
                os.kill(pid, 9)
            time.sleep(0.002)
        code = os.waitstatus_to_exitcode(status)
        return None if code == 0 else code - 1 if 0 < code < _ELSEWHERE else _ELSEWHERE

    def run(self, tests: Sequence[str]) -> str:
        """Run in this process; return what failed on the original, or nothing."""
        pytest.main([*child.QUIET, *tests], plugins=[self, child.Profile()])
        return ", ".join(self.failed_on_original) or self._ended_by


def caches() -> list[Any]:
    """Return the caches of our modules: a mutant must be called again."""
    modules = [module for name, module in sys.modules.items() if name.partition(".")[0] in child.OURS]
    return [value for module in modules for value in vars(module).values() if hasattr(value, "cache_clear")]


def in_server(path: str, tests: Sequence[str], report: Path, serve: Callable[[], str]) -> None:
    """Call `serve` in a fork, which writes a report and returns what went wrong.

    Raises:
        SystemExit: it is not empty.
    """
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            os.setpgid(0, 0)
            wrong = serve()
            code = int(bool(wrong))
            report.with_suffix(".wrong").write_text(wrong)
        except BaseException as why:
            report.with_suffix(".wrong").write_text(repr(why))
        finally:
            os._exit(code)
    _, status = os.waitpid(pid, 0)
    if status != 0:
        wrong_file = report.with_suffix(".wrong")
        sys.exit(f"{path}: its tests do not pass as it is ({wrong_file.read_text() if wrong_file.exists() else status}): {tests}")
