"""Measure how long commands take to end after SIGTERM: `python -m benches.sigterm [--runs 20] [--load 4]`.

`run` with a simulated drone in flight, `simulate`, and `simulate --autopilot` with a program that ignores SIGTERM each get the
signal at a random moment between their start and some seconds of flight. Times are from the signal to the end of the process, on
this host's monotonic clock; the limit is 2 s.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from tests.support.processes import burners, decklander, started

LATEST_S = 12.0
ASKED_S = 2.0


def end_s(words: list[str], moment_s: float) -> tuple[float, int]:
    """Return the time from SIGTERM to the end, s, and the exit code."""
    with started(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        time.sleep(moment_s)
        process.send_signal(signal.SIGTERM)
        began = time.monotonic()
        code = process.wait(60.0)
        return time.monotonic() - began, code


def measured(command: str, runs: int, seed: int) -> list[tuple[float, int]]:
    """Return the time, s, and the exit code of each run."""
    rng = random.Random(f"{command} {seed}")
    out = []
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        if command == "run":
            ports = [f"--{name}-port=0" for name in ("navdata", "video", "at", "control")]
            serve = [sys.executable, "-m", "sitl.emulators.ardrone.serve", "demo", "--seed=1", "--repeat", *ports]
            sim = stack.enter_context(started(serve, stdin=subprocess.PIPE, lasting_s=3600.0))
            assert sim.stdout is not None
            found = json.loads(sim.stdout.readline())["ports"]
            rig = Path(folder) / "rig.toml"
            keys = "\n".join(f"{name}_port = {port}" for name, port in found.items())
            rig.write_text(
                f'[vehicle]\nkind = "ardrone"\nhost = "127.0.0.1"\n{keys}\n[camera]\nfile = "sim"\n[pad]\nfile = "thesis"\n'
                f'[vision]\ncolours = "simulator"\n[recorder]\nenabled = true\nfolder = "{folder}/recordings"\n'
            )
            words = decklander("run", "--config", str(rig))
        elif command == "simulate":
            words = decklander("simulate", "demo", "--json")
        else:
            program = Path(folder) / "program"
            program.write_text("#!/bin/sh\ntrap '' TERM\nwhile true; do sleep 1; done\n")
            program.chmod(0o755)
            words = decklander("simulate", "demo", "--autopilot", "arducopter", "--binary", str(program))
        for _ in range(runs):
            out.append(end_s(words, rng.uniform(0.1, LATEST_S)))
    return out


def main() -> int:
    """Print a line for each command, and return 1 if one took longer than the limit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--load", type=int, default=0, help="programs beside that only take CPU time")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--command", choices=("run", "simulate", "autopilot"), action="append")
    asked = parser.parse_args()
    worst_s = 0.0
    with ExitStack() as stack:
        stack.enter_context(burners(asked.load))
        for command in asked.command or ("run", "simulate", "autopilot"):
            times = sorted(measured(command, asked.runs, asked.seed))
            seconds = [s for s, _ in times]
            codes = sorted({code for _, code in times})
            worst_s = max(worst_s, seconds[-1])
            print(
                f"{command:<10} {asked.runs} runs, load {asked.load} of ours and {os.getloadavg()[0]:.1f} in all: median "
                f"{seconds[len(seconds) // 2]:.2f} s, most {seconds[-1]:.2f} s, exit codes {codes}",
                flush=True,
            )
    return 0 if worst_s < ASKED_S else 1


if __name__ == "__main__":
    sys.exit(main())
