"""Measure the start-up time of the command line against that of the bare interpreter: `python -m benches.startup`.

Also the daemon's: from the command to the log line of its first guidance cycle, with no drone at the other end.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benches.daemon_memory import SETTINGS, cpu_s, rss_mb

RUNS = 15
FIRST_CYCLE = "waiting for the vehicle"


def median_ms(*words: str) -> float:
    """Return the median wall time of one process over `RUNS` runs, ms."""
    took = []
    for _ in range(RUNS):
        began = time.perf_counter()
        subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL)
        took.append((time.perf_counter() - began) * 1e3)
    return statistics.median(took)


def first_cycle() -> tuple[float, float, float]:
    """Start the daemon; return the wall time until its first guidance cycle and its CPU time then, s, and its memory, MB."""
    with tempfile.TemporaryDirectory() as folder:
        rig = Path(folder) / "rig.toml"
        rig.write_text(SETTINGS.format(navdata=45554, video=45555, at=45556, control=45559))
        began = time.perf_counter()
        run = [sys.executable, "-m", "companion.cli.main", "run", "--config", str(rig)]
        with subprocess.Popen(run, stderr=subprocess.PIPE, text=True) as daemon:
            assert daemon.stderr is not None
            next(line for line in daemon.stderr if FIRST_CYCLE in line)
            found = time.perf_counter() - began, cpu_s(daemon.pid), rss_mb(daemon.pid)
            daemon.kill()
            daemon.stderr.close()
    return found


def main() -> None:
    floor = median_ms("-c", "pass")
    print(f"start-up, median of {RUNS}: the bare interpreter takes {floor:.0f} ms")
    for words in (["--help"], ["config", "--help"], ["config", "check", "sim"]):
        took = median_ms("-m", "companion.cli.main", *words)
        print(f"  decklander {' '.join(words):<18} {took:5.0f} ms  {took / floor:4.1f} x")
    wall, cpu, rss = (statistics.median(column) for column in zip(*[first_cycle() for _ in range(RUNS)], strict=True))
    took = 1e3 * wall
    print(f"  run, first guidance cycle     {took:5.0f} ms  {took / floor:4.1f} x, {1e3 * cpu:.0f} ms of CPU, {rss:.0f} MB")


if __name__ == "__main__":
    main()
