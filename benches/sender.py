"""Measure how soon an AR.Drone hovers when the service or its sender falls silent, and how far it drifts.

python -m benches.sender --runs 5

Processes and sockets are real; there is no vision. A service without vision flies the simulated drone ahead at 0.5 m/s while it
descends at 0.2 m/s. Then service or sender are killed, stopped or blocked.
"""

import argparse
import asyncio
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benches.processes import Wire, drone
from drivers.ardrone.link import open_ardrone
from drivers.ardrone.options import ArDroneOptions
from drivers.clock import SystemClock
from estimator.contracts.commands import Velocity
from sitl.emulators.ardrone.truth_log import read as read_truth

WATCH_S = 3.0
SCENARIO = 'base = "demo"\nduration_limit_s = 300.0\n[start]\nheight_m = 5.0\n'
FAULTS: dict[str, Callable[[int, int], None]] = {
    "service killed": lambda service, sender: os.kill(service, signal.SIGKILL),
    "service stopped (SIGSTOP)": lambda service, sender: os.kill(service, signal.SIGSTOP),
    "service's loop blocked": lambda service, sender: os.kill(service, signal.SIGUSR1),
    "guidance silent": lambda service, sender: os.kill(service, signal.SIGUSR2),
    "sender killed": lambda service, sender: os.kill(sender, signal.SIGKILL),
    "sender stopped (SIGSTOP)": lambda service, sender: os.kill(sender, signal.SIGSTOP),
}


async def fly(ports: dict[str, int]) -> None:
    """Run the service: print when it steers and which process sends for it. Nothing listens on the video port."""
    silent = False
    loop = asyncio.get_running_loop()
    signal.signal(signal.SIGUSR1, lambda *_: time.sleep(WATCH_S + 1.0))

    def fall_silent() -> None:
        nonlocal silent
        silent = True

    loop.add_signal_handler(signal.SIGUSR2, fall_silent)
    names: dict[str, Any] = {f"{name}_port": port for name, port in ports.items()} | {"video_port": 1}
    async with open_ardrone(ArDroneOptions(host="127.0.0.1", **names), SystemClock()) as link:
        while not link.ready:  # noqa: ASYNC110 - it waits for the drone's answer
            await asyncio.sleep(0.02)
        print(link.sender_pid, flush=True)
        while True:
            if not silent:
                link.command(Velocity(np.array([0.5, 0.0, 0.2]), 0.0))
            await asyncio.sleep(0.02)


def run(name: str, seed: int) -> tuple[float, float, float]:
    """Return the time until a hover command is on the wire, ms, and the drift and the loss of height in three seconds, m."""
    with tempfile.TemporaryDirectory(prefix="decklander-") as folder:
        scenario, truth = Path(folder) / "scenario.toml", Path(folder) / "truth.jsonl"
        scenario.write_text(SCENARIO)
        with drone(scenario, seed, truth) as ports:
            wire = Wire(ports["at"])
            words = [sys.executable, "-m", "benches.sender", "--fly", json.dumps(ports | {"at": wire.own_port})]
            with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as service:
                assert service.stdout is not None
                sender = int(service.stdout.readline())
                deadline = time.monotonic() + 10.0
                while sum(moves for _, moves in wire.told[-30:]) < 25 and time.monotonic() < deadline:
                    time.sleep(0.02)
                began = time.monotonic()
                FAULTS[name](service.pid, sender)
                time.sleep(WATCH_S)
                service.kill()
            wire.ended = True
        records = read_truth(truth)
    alone = [r for r in records if began * 1e9 <= r["at_ns"] <= (began + WATCH_S) * 1e9]
    p0 = alone[0]["p_body_ned_m"]
    drift = max(math.hypot(r["p_body_ned_m"][0] - p0[0], r["p_body_ned_m"][1] - p0[1]) for r in alone)
    lost = max(r["p_body_ned_m"][2] - p0[2] for r in alone)
    if name.startswith("sender"):  # the service steers again as soon as it has another sender: only the gap counts
        hovered = next((t for t, moves in wire.told if t > began and not moves), math.inf)
        return 1e3 * (hovered - began), math.nan, math.nan
    return 1e3 * wire.hover_after(began), drift, lost


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--fly", metavar="PORTS", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.fly:
        asyncio.run(fly(json.loads(args.fly)))
        return
    print("what ends                    runs  hover ms p50    max  drift m p50   max  height lost m max")
    for name in FAULTS:
        rows = [run(name, seed) for seed in range(1, args.runs + 1)]
        hover, drift, lost = (sorted(column) for column in zip(*rows, strict=True))
        middle = len(rows) // 2
        moved = f"{drift[middle]:11.2f} {drift[-1]:5.2f}  {lost[-1]:17.2f}" if math.isfinite(drift[0]) else ""
        print(f"{name:28} {len(rows):4}  {hover[middle]:12.0f} {hover[-1]:6.0f}  {moved}", flush=True)


if __name__ == "__main__":
    main()
