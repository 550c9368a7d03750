"""Measure the start-up time of the command line against that of the bare interpreter: `python -m benches.startup`."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time

RUNS = 15


def median_ms(*words: str) -> float:
    """Return the median wall time of one process over `RUNS` runs, ms."""
    took = []
    for _ in range(RUNS):
        began = time.perf_counter()
        subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL)
        took.append((time.perf_counter() - began) * 1e3)
    return statistics.median(took)


def main() -> None:
    floor = median_ms("-c", "pass")
    print(f"start-up, median of {RUNS}: the bare interpreter takes {floor:.0f} ms")
    for words in (["--help"], ["config", "--help"], ["config", "check", "sim"]):
        took = median_ms("-m", "companion.cli.main", *words)
        print(f"  decklander {' '.join(words):<18} {took:5.0f} ms  {took / floor:4.1f} x")


if __name__ == "__main__":
    main()
