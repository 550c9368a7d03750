"""Mutate, run the tests that are near, count who noticed: `python -m mutants`, or `make mutants SHARE=0.1`.

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

from mutants.judge import Tally, judge
from mutants.table import TARGETS

ROOT = Path(__file__).parents[1]
HEAD = ("| file | tried | killed | alike | drawn |", "|---|---|---|---|---|")
"""The head of the table in docs/mutants.md."""
LIBRARIES = (
    "numpy", "scipy.linalg", "filterpy.kalman", "hypothesis", "pymavlink.dialects.v20.common", "msgspec",
    "pytest_asyncio", "pytest_timeout",
)  # fmt: skip
"""Imported once, before the forks."""


def write_table(page: Path, tallies: Sequence[Tally], share: float) -> None:
    """Put the rows of some files into the page's table, in the order of `mutants.table`; rows of other files stay.

    Raises:
        ValueError: the page has no such table.
    """
    lines = page.read_text().splitlines()
    if HEAD[0] not in lines:
        raise ValueError(f"{page} has no table headed {HEAD[0]!r}")
    start = lines.index(HEAD[0]) + len(HEAD)
    end = next((k for k in range(start, len(lines)) if not lines[k].startswith("|")), len(lines))
    rows = {line.split("|")[1].strip(" `"): line for line in lines[start:end]}
    rows |= {t.path: f"| `{t.path}` | {t.tried} | {t.killed} | {t.alike} | {100 * share:.3g} % |" for t in tallies}
    page.write_text("\n".join([*lines[:start], *(rows[path] for path in TARGETS if path in rows), *lines[end:]]) + "\n")


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m mutants", description="Mutation tests of what decides.")
    parser.add_argument("--share", type=float, default=1.0, help="of the mutants, drawn by the seed")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--goal", type=float, default=90.0, help="percent killed, each file")
    parser.add_argument("--only", nargs="+", choices=sorted(TARGETS), metavar="FILE", help=f"of {', '.join(TARGETS)}")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the counts into the table of this Markdown page")
    args = parser.parse_args()
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # a fork does not inherit the threads that numpy would start
    for library in LIBRARIES:
        importlib.import_module(library)
    gc.freeze()  # what was imported here is not collected in any child
    began = time.monotonic()
    tallies = [judge(path, TARGETS[path], args.share, args.seed, root=ROOT) for path in args.only or TARGETS]
    print(f"\n{'file':<52} killed    of  alike")
    for tally in tallies:
        print(f"{tally.path:<52} {tally.killed:>6} {tally.tried:>5} {tally.alike:>6} {100 * tally.share:>5.1f} %")
    killed, tried = sum(t.killed for t in tallies), sum(t.tried for t in tallies)
    took_s = time.monotonic() - began
    print(f"{killed} of {tried} killed ({100 * killed / max(1, tried):.1f} %) in {took_s:.0f} s, seed {args.seed}")
    if args.page:
        write_table(args.page, tallies, args.share)
    return 0 if all(100 * tally.share >= args.goal for tally in tallies) else 1


if __name__ == "__main__":
    sys.exit(main())
