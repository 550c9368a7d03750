"""Measure the daemon's processor time with a GStreamer camera beside one of raw frames, each process by itself.

python -m benches.gstreamer_cpu --seconds 20

The raw frames are YUYV from a file, as a USB camera gives them, decoded in the daemon. Both cameras show GStreamer's test picture
in 640x360 px, which holds no pad, so vision searches each frame, within its budget. A simulated AR.Drone gives attitudes.
"""

import argparse
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from benches.daemon_memory import SETTINGS, cpu_s, rss_mb
from benches.processes import drone

RATES_HZ = (30, 60)
SIZE = "width=640,height=360"
_SETTLED_S = 8.0
_FILE_S = 2.0


def main() -> int:
    """Print a table; exit code 2 if there is no GStreamer."""
    parser = argparse.ArgumentParser(description="Measure the processor time of GStreamer and raw cameras.")
    parser.add_argument("--seconds", type=float, default=20.0, help="how long each is measured")
    args = parser.parse_args()
    print(f"{'frames/s':>8} {'camera':>10} {'process':>18} {'core, %':>8} {'RSS, MB':>8} {'looked at/s':>11}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for rate_hz in RATES_HZ:
            raw = folder / f"raw{rate_hz}.avi"
            try:
                record_raw(raw, rate_hz)
            except (OSError, subprocess.CalledProcessError) as why:
                sys.stderr.write(f"error: gst-launch-1.0 wrote no raw video ({why}): install gstreamer1.0-plugins-good\n")
                return 2
            live = f"videotestsrc is-live=true ! video/x-raw,format=YUY2,{SIZE},framerate={rate_hz}/1"
            cameras = {
                "gstreamer": f'source = "gstreamer"\ndevice = "{live}"',
                "raw": f'source = "stream"\ndevice = "{raw}"\nrepeat = true',
            }
            for camera, lines in cameras.items():
                for r in measured(folder, f"{lines}\nrate_hz = {rate_hz}.0", args.seconds):
                    taken = f"{100 * r.cores:8.1f} {r.memory_mb:8.0f} {r.looked_at_hz:11.1f}"
                    print(f"{rate_hz:8d} {camera:>10} {r.process:>18} {taken}", flush=True)
    return 0


def record_raw(path: Path, rate_hz: int) -> None:
    """Write the test picture as raw YUYV."""
    words = f"videotestsrc num-buffers={round(_FILE_S * rate_hz)} ! video/x-raw,format=YUY2,{SIZE},framerate={rate_hz}/1"
    subprocess.run(
        ["gst-launch-1.0", "-q", *words.split(), "!", "avimux", "!", "filesink", f"location={path}"],
        check=True,
        capture_output=True,
    )


class Reading(NamedTuple):
    """Resource usage of one process."""

    process: str
    cores: float
    memory_mb: float
    looked_at_hz: float
    """Rate of the frames that vision looked at, the others being skipped within its share of the processor."""


def measured(folder: Path, camera: str, seconds: float) -> Iterator[Reading]:
    """Run the daemon with a camera; yield what each of its processes takes."""
    with drone("calm") as ports:
        rig = folder / "rig.toml"
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        settings = SETTINGS.format(**ports).replace('file = "sim"', f'file = "sim"\n{camera}', 1)
        rig.write_text(f'{settings}\n[metrics]\nendpoint = "http"\nport = {port}\n')
        run = [sys.executable, "-m", "companion.cli.main", "run", "--config", str(rig)]
        with subprocess.Popen(run, stderr=subprocess.DEVNULL) as daemon:
            time.sleep(_SETTLED_S)
            if daemon.poll() is not None:
                raise SystemExit(f"error: the daemon ended with {daemon.returncode}: run it with --config {rig}")
            frames = looked_at(port)
            before = {pid: cpu_s(pid) for pid in (daemon.pid, *children(daemon.pid))}
            began = time.monotonic()
            time.sleep(seconds)
            wall_s = time.monotonic() - began
            rate_hz = (looked_at(port) - frames) / wall_s
            for pid, was in before.items():
                yield Reading(named(pid, daemon.pid), (cpu_s(pid) - was) / wall_s, rss_mb(pid), rate_hz)
            daemon.terminate()


def looked_at(port: int) -> float:
    """Return the number of frames that vision has looked at."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=5) as answer:
        lines = answer.read().decode().splitlines()
    counted = [line for line in lines if line.startswith("decklander_frames_total")]
    return sum(float(line.rpartition(" ")[2]) for line in counted if '"skipped"' not in line)


def children(pid: int) -> list[int]:
    """Return the processes whose parent is this one."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
            if parent == pid:
                found.append(int(entry.name))
    return found


def named(pid: int, daemon: int) -> str:
    """Return "daemon", or the program that a child runs."""
    if pid == daemon:
        return "daemon"
    words = Path(f"/proc/{pid}/cmdline").read_bytes().decode()
    return next((name for name in ("gstreamer_program", "sender") if name in words), words.split("\0")[0])


if __name__ == "__main__":
    sys.exit(main())
