"""Measure the start-up time of the command line against that of the bare interpreter: `python -m benches.startup`.

Also the daemon's: from the command to the log line of its first guidance cycle, with no drone at the other end. The modules'
bytecode is there, as pip leaves it when it installs; the last line is of a checkout that has none and may keep none.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benches.daemon_memory import SETTINGS, cpu_s, rss_mb

RUNS = 15
FIRST_CYCLE = "waiting for the vehicle"


def environment(bytecode: Path | None) -> dict[str, str]:
    """Return an environment in which Python keeps the modules' bytecode in a folder; with None it keeps none."""
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONDONTWRITEBYTECODE", "PYTHONPYCACHEPREFIX")}
    if bytecode is not None:
        return kept | {"PYTHONPYCACHEPREFIX": str(bytecode)}
    return kept | {"PYTHONDONTWRITEBYTECODE": "1"}


def median_ms(env: dict[str, str], *words: str) -> float:
    """Return the median wall time of one process over `RUNS` runs, ms, after one that is not measured."""
    took = []
    for _ in range(RUNS + 1):
        began = time.perf_counter()
        subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL, env=env)
        took.append((time.perf_counter() - began) * 1e3)
    return statistics.median(took[1:])


def first_cycle(env: dict[str, str] | None = None) -> tuple[float, float, float]:
    """Start the daemon; return the wall time until its first guidance cycle and its CPU time then, s, and its memory, MB."""
    with tempfile.TemporaryDirectory() as folder:
        rig = Path(folder) / "rig.toml"
        rig.write_text(SETTINGS.format(navdata=45554, video=45555, at=45556, control=45559))
        began = time.perf_counter()
        run = [sys.executable, "-m", "companion.cli.main", "run", "--config", str(rig)]
        with subprocess.Popen(run, stderr=subprocess.PIPE, text=True, env=env) as daemon:
            assert daemon.stderr is not None
            next(line for line in daemon.stderr if FIRST_CYCLE in line)
            found = time.perf_counter() - began, cpu_s(daemon.pid), rss_mb(daemon.pid)
            daemon.kill()
            daemon.stderr.close()
    return found


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        env = environment(Path(folder))
        floor = median_ms(env, "-c", "pass")
        print(f"start-up, median of {RUNS}: the bare interpreter takes {floor:.0f} ms")
        for words in (["--help"], ["config", "--help"], ["config", "check", "sim"]):
            took = median_ms(env, "-m", "companion.cli.main", *words)
            print(f"  decklander {' '.join(words):<18} {took:5.0f} ms  {took / floor:4.1f} x")
        first_cycle(env)
        for name, one in (("run, first guidance cycle", env), ("the same without bytecode", environment(None))):
            starts = [first_cycle(one) for _ in range(RUNS)]
            wall, cpu, rss = (statistics.median(column) for column in zip(*starts, strict=True))
            least = min(start[0] for start in starts)
            print(
                f"  {name}     {1e3 * wall:5.0f} ms  {1e3 * wall / floor:4.1f} x, the least {1e3 * least:.0f} ms, "
                f"{1e3 * cpu:.0f} ms of CPU, {rss:.0f} MB"
            )


if __name__ == "__main__":
    main()
