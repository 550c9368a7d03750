"""Mutants of Python modules.

Where a change is within functions, their code is replaced in a fork of a process that has imported everything. Where it is
outside of them, a constant or a default, the module and the tests are imported again.
"""

import ast
import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from mutants import child
from mutants.forks import Forks, in_server
from mutants.functions import changed_functions, living_functions
from mutants.operators import Mutant, mutants
from mutants.tally import Tally, chosen

_PATIENCE, _PATIENCE_S = 6.0, 20.0
"""Times as long as the tests take on the module as it is, and some seconds, until a mutant imported again counts as hanging."""


class _Interpreted(Forks):
    def __init__(self, file: Path, tally: Tally, drawn: Sequence[Mutant], folder: Path) -> None:
        super().__init__(tally)
        self._file, self._drawn, self._folder = file, drawn, folder
        self._plain = ast.unparse(ast.parse(file.read_text()))
        self._lines: set[int] = set()
        self.outside: list[int] = []
        """Indices of the drawn mutants that are to be imported again."""

    def on_original(self, k: int) -> Callable[[], None]:
        def trace(frame: FrameType, event: str, argument: object) -> Any:
            if frame.f_code.co_filename != str(self._file):
                return None
            self._lines.add(frame.f_lineno)
            return trace

        def prepare() -> None:
            report = self._folder / f"{k}.json"
            self.after_tests = lambda: report.write_text(json.dumps(sorted(self._lines)))
            sys.settrace(trace)

        return prepare

    def judge(self) -> None:
        met = [set(json.loads((self._folder / f"{k}.json").read_text())) for k in range(len(self.items))]
        alive = living_functions(self._file)
        for place, mutant in enumerate(self._drawn):
            bodies = changed_functions(self._plain, mutant.source, self._file)
            if bodies is None or not bodies.keys() <= alive.keys():
                self.outside.append(place)
                continue
            if not bodies:
                self.tally.compiled_alike += 1
                continue

            def prepare(bodies: dict[Any, Any] = bodies) -> None:
                for name, code in bodies.items():
                    alive[name].__code__ = code

            tests = [k for k in range(len(self.items)) if mutant.line in met[k]]
            self.tally.count(mutant, killed=bool(tests) and self.is_killed(prepare, tests))


def judge_interpreted(path: str, tests: Sequence[str], share: float, seed: int, *, root: Path) -> Tally:
    """Test every mutant of one module, or a sample.

    Raises:
        SystemExit: the tests fail on the original module.
    """
    file, ids = root / path, [str(root / test) for test in tests]
    drawn = [m for m in mutants(file.read_text()) if chosen(path, m, share, seed)]
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder, "report")

        def serve() -> str:
            tally = Tally(path, out=child.quiet())
            sys.path.insert(0, str(root))
            judge = _Interpreted(file, tally, drawn, Path(folder))
            wrong = judge.run(ids)
            report.write_text(json.dumps([tally.dumped(), judge.outside, sum(judge.seconds)]))
            return wrong

        in_server(path, tests, report, serve)
        counts, outside, took_s = json.loads(report.read_text())
    tally = Tally.loaded(counts)
    name = path.removesuffix(".py").replace("/", ".")
    for place in outside:
        mutant = drawn[place]
        code = child.in_child(
            lambda m=mutant: child.on_mutant(name, file, m.source, ids),  # type: ignore[misc]
            _PATIENCE_S + _PATIENCE * took_s,
        )
        tally.count(mutant, killed=code != 0)
    return tally
