"""Mutate, run the tests that meet the changed line, count who noticed: `python -m mutants`, or `make mutants SHARE=0.1`.

Ends with 1 when fewer mutants than `--goal` are killed in any file. A mutant that never ends is killed: the tests hang.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import importlib
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mutants import child
from mutants.c_operators import c_mutants
from mutants.operators import Mutant, mutants
from mutants.table import TARGETS
from supply import core

ROOT = Path(__file__).parents[1]
LIBRARIES = (
    "numpy", "scipy.linalg", "filterpy.kalman", "hypothesis", "pymavlink.dialects.v20.common", "msgspec",
    "pytest_asyncio", "pytest_timeout",
)  # fmt: skip
"""Imported once, before the forks."""
_PATIENCE = 6.0
"""Times as long as the tests take on the module as it is, and some seconds, until a mutant counts as hanging."""
_PATIENCE_S = 20.0


@dataclass(slots=True)
class Tally:
    """The results of one file's mutants."""

    path: str
    killed: int = 0
    survivors: list[Mutant] = field(default_factory=list)

    @property
    def total(self) -> int:
        """The number of mutants tried."""
        return self.killed + len(self.survivors)

    @property
    def share(self) -> float:
        """The share of killed mutants among those tried."""
        return self.killed / self.total if self.total else 1.0


def in_child(work: Callable[[], int], timeout_s: float) -> int | None:
    """Return the exit code of `work` in a fork; None if it does not end in time."""
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        try:
            os.setpgid(0, 0)
            child.silence()
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


def chosen(path: str, mutant: Mutant, share: float, seed: int) -> bool:
    """Return whether a mutant is in the sample; it depends on the seed, not on other changes in the file."""
    digest = hashlib.sha256(f"{seed} {path} {mutant.change}".encode()).digest()
    return int.from_bytes(digest[:6], "big") < share * 2**48


def judge(path: str, tests: Sequence[str], share: float, seed: int, *, root: Path = ROOT) -> Tally:
    """Test every mutant of one file, or a sample.

    Raises:
        SystemExit: the tests fail on the original file.
    """
    if path.endswith(".c"):
        return judge_native(path, tests, share, seed, root=root)
    file = root / path
    source = file.read_text()
    name = path.removesuffix(".py").replace("/", ".")
    tally = Tally(path)
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "lines.json"
        began = time.monotonic()
        code = in_child(lambda: child.baseline(file, [str(root / test) for test in tests], report), 900.0)
        if code != 0:
            sys.exit(f"{path}: its tests do not pass as it is (exit code {code}): {' '.join(tests)}")
        found = json.loads(report.read_text())
    print(f"{path}: tests took {time.monotonic() - began:.0f} s", flush=True)
    seconds: dict[str, float] = found["seconds"]
    met = {test: set(lines) for test, lines in found["met"].items()}
    for mutant in mutants(source):
        if not chosen(path, mutant, share, seed):
            continue
        touched = [test for test in seconds if mutant.line in met.get(test, ())]
        if mutant.line in met.get(child.IMPORTING, ()):
            touched = list(seconds)
        touched.sort(key=lambda test: seconds[test])
        patience_s = _PATIENCE_S + _PATIENCE * sum(seconds[test] for test in touched)
        code = 0
        if touched:
            ids = [str(root / test) for test in touched]
            code_or_none = in_child(lambda m=mutant, t=ids: child.on_mutant(name, file, m.source, t), patience_s)  # type: ignore[misc]
            code = -1 if code_or_none is None else code_or_none
        if code == 0:
            tally.survivors.append(mutant)
            print(f"  survives, line {mutant.line}: {mutant.change}", flush=True)
        else:
            tally.killed += 1
    return tally


def judge_native(path: str, tests: Sequence[str], share: float, seed: int, *, root: Path = ROOT) -> Tally:
    """Test every mutant of one C file of the core, or a sample. The tests load a library that is built with it.

    Raises:
        SystemExit: the tests fail on the original file.
    """
    door = root / "estimator/core/library.py"
    ids = [str(root / test) for test in tests]
    tally = Tally(path)
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, core.LIBRARY.name)
        sources = Path(folder, "core")
        shutil.copytree(root / "estimator/core", sources, ignore=shutil.ignore_patterns("*.so.*", "__pycache__"))
        loading = f"{door.read_text()}".replace("CORE = load()", f"CORE = load({str(library)!r})")

        def run() -> int | None:
            return in_child(lambda: child.on_mutant("estimator.core.library", door, loading, ids), patience_s)

        began, patience_s = time.monotonic(), 900.0
        core.build(library, ["-O1"], sources)
        if (code := run()) != 0:
            sys.exit(f"{path}: its tests do not pass as it is (exit code {code}): {' '.join(tests)}")
        patience_s = _PATIENCE_S + _PATIENCE * (time.monotonic() - began)
        print(f"{path}: tests took {time.monotonic() - began:.0f} s", flush=True)
        changed = sources / Path(path).name
        for mutant in c_mutants(changed.read_text()):
            if not chosen(path, mutant, share, seed):
                continue
            changed.write_text(mutant.source)
            try:
                core.build(library, ["-O1"], sources)
            except core.BuildError:
                continue
            if run() == 0:
                tally.survivors.append(mutant)
                print(f"  survives, line {mutant.line}: {mutant.change}", flush=True)
            else:
                tally.killed += 1
    return tally


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m mutants", description="Mutation tests of what decides.")
    parser.add_argument("--share", type=float, default=1.0, help="of the mutants, drawn by the seed")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--goal", type=float, default=95.0, help="percent killed, each file")
    parser.add_argument("--only", nargs="+", choices=sorted(TARGETS), metavar="FILE", help=f"of {', '.join(TARGETS)}")
    args = parser.parse_args()
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # a fork does not inherit the threads that numpy would start
    for library in LIBRARIES:
        importlib.import_module(library)
    gc.freeze()  # what was imported here is not collected in any child
    began = time.monotonic()
    tallies = [judge(path, TARGETS[path], args.share, args.seed) for path in args.only or TARGETS]
    print(f"\n{'file':<34} {'killed':>6} {'of':>5}")
    for tally in tallies:
        print(f"{tally.path:<34} {tally.killed:>6} {tally.total:>5}  {100 * tally.share:.0f} %")
    killed, total = sum(t.killed for t in tallies), sum(t.total for t in tallies)
    print(
        f"{killed} of {total} killed ({100 * killed / max(1, total):.1f} %) in {time.monotonic() - began:.0f} s, seed {args.seed}"
    )
    return 0 if all(100 * tally.share >= args.goal for tally in tallies) else 1


if __name__ == "__main__":
    sys.exit(main())
