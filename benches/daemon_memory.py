"""Measure the daemon's memory and processor time over some minutes while a simulated drone hovers over the pad.

python -m benches.daemon_memory --minutes 10

Where there are several cores, the daemon has one to itself: the simulated drone, which no vehicle carries, renders and encodes on
the others, and would empty the daemon's caches.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benches.processes import drone

SETTINGS = """
[vehicle]
kind = "ardrone"
host = "127.0.0.1"
[expert.vehicle]
navdata_port = {navdata}
video_port = {video}
at_port = {at}
control_port = {control}

[camera]
file = "sim"

[pad]
file = "thesis"

[vision]
colours = "simulator"

[guidance]
start = "signal"
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--scenario", default="calm")
    args = parser.parse_args()
    own, *others = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, others or [own])
    with tempfile.TemporaryDirectory() as folder, drone(args.scenario) as ports:
        rig = Path(folder) / "rig.toml"
        rig.write_text(SETTINGS.format(**ports))
        run = [sys.executable, "-m", "companion.cli.main", "run", "--config", str(rig)]
        alone = ["taskset", "--cpu-list", str(own), *run]
        with subprocess.Popen(alone, stderr=subprocess.PIPE, text=True) as daemon:
            watch(daemon.pid, args.minutes)
            daemon.terminate()
            output = daemon.communicate()[1].strip().splitlines()
        print("the daemon's last word:", output[-1] if output else "none")


def watch(pid: int, minutes: float) -> None:
    """Print resident memory and the processor load in parts of a core, ten times."""
    print(f"{'minute':>7} {'RSS, MB':>8} {'core, %':>8} {'descriptors':>12}")
    pause_s = max(5.0, 6.0 * minutes)
    before = cpu_s(pid)
    for i in range(1, 11):
        time.sleep(pause_s)
        now = cpu_s(pid)
        fds = len(os.listdir(f"/proc/{pid}/fd"))
        print(f"{i * pause_s / 60:7.1f} {rss_mb(pid):8.1f} {100 * (now - before) / pause_s:8.0f} {fds:12d}", flush=True)
        before = now


def rss_mb(pid: int) -> float:
    line = next(line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


def cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    main()
