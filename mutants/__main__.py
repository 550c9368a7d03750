"""Mutate, run the tests that meet the changed line, count who noticed: `python -m mutants`, or `make mutants SHARE=0.1`.

Ends with 1 when fewer mutants than `--goal` are killed in any file. A mutant that never ends is killed: the tests hang.
"""

import argparse
import gc
import importlib
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from mutants.interpreted import judge_interpreted
from mutants.native import judge_native
from mutants.page import write_table
from mutants.table import TARGETS
from mutants.tally import Tally

ROOT = Path(__file__).parents[1]
LIBRARIES = (
    "numpy", "scipy.linalg", "filterpy.kalman", "hypothesis", "pymavlink.dialects.v20.common", "msgspec",
    "pytest_asyncio", "pytest_timeout",
)  # fmt: skip
"""Imported once, before the forks."""


def judge(path: str, tests: Sequence[str], share: float, seed: int, *, root: Path = ROOT) -> Tally:
    """Test every mutant of one file, or a sample.

    Raises:
        SystemExit: the tests fail on the original file.
    """
    return (judge_native if path.endswith(".c") else judge_interpreted)(path, tests, share, seed, root=root)


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m mutants", description="Mutation tests of what decides.")
    parser.add_argument("--share", type=float, default=1.0, help="of the mutants, drawn by the seed")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--goal", type=float, default=95.0, help="percent killed, each file")
    parser.add_argument("--only", nargs="+", choices=sorted(TARGETS), metavar="FILE", help=f"of {', '.join(TARGETS)}")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the counts into the table of this Markdown page")
    args = parser.parse_args()
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # a fork does not inherit the threads that numpy would start
    for library in LIBRARIES:
        importlib.import_module(library)
    gc.freeze()  # what was imported here is not collected in any child
    began = time.monotonic()
    tallies = [judge(path, TARGETS[path], args.share, args.seed) for path in args.only or TARGETS]
    print(f"\n{'file':<40} {'killed':>6} {'of':>5}        equivalent")
    for tally in tallies:
        alike = tally.compiled_alike + tally.named
        print(f"{tally.path:<40} {tally.killed:>6} {tally.tried:>5} {100 * tally.share:>5.1f} % {alike:>10}")
    killed, tried = sum(t.killed for t in tallies), sum(t.tried for t in tallies)
    print(
        f"{killed} of {tried} killed ({100 * killed / max(1, tried):.1f} %) in {time.monotonic() - began:.0f} s, seed {args.seed}"
    )
    if args.page:
        write_table(args.page, tallies, args.share)
    return 0 if all(100 * tally.share >= args.goal for tally in tallies) else 1


if __name__ == "__main__":
    sys.exit(main())
