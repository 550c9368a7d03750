"""Kill the daemon in flight, at each phase, and see what the drone does and whether a new daemon lands it.

python -m benches.dead_man --seeds 1 [--how kill|stop] [--phase NAME ...]

Everything is a process of its own: the simulated drone of `decklander demo`, the daemon, and the sender that the daemon starts.
The AT commands pass through this program, which so sees what is on the wire and when. `stop` is SIGSTOP instead of SIGKILL; the
daemon is killed after the three seconds in which the drone is watched.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from companion.observer import Decision, Silent
from companion.service import live, make_daemon, make_pilot
from companion.settings import load
from drivers.ardrone import at
from sitl.ardrone.truth_log import read as read_truth

ALONE_S = 3.0
"""The drone is watched this long before a new daemon is started."""
LAND_S = 45.0
"""Time that the new daemon has to land it."""
REACH_S = 60.0
COVERED = 'kind = "lens_covered"\nbelow_height_m = 2.4\n'
SETTINGS = """
[vehicle]
kind = "ardrone"
host = "127.0.0.1"
navdata_port = {navdata}
video_port = {video}
at_port = {at}
control_port = {control}
[camera]
file = "camera.toml"
[pad]
file = "thesis"
[vision]
colours = "simulator"
method = "registration"
[guidance]
start = "{start}"
[guidance.planner]
give_up_after_s = {give_up_s}
"""
CAMERA = """
# The simulator's camera at half its size, which costs a quarter: what is measured here is not vision.
width = 320
height = 180
fx = 187.335
fy = 187.335
cx = 159.5
cy = 89.5
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
p_body_cam_m = [0.15, 0.0, 0.0]
rpy_body_cam_deg = [0.0, 0.0, 90.0]
"""


@dataclass(frozen=True, slots=True)
class Case:
    """A phase, how to bring it about, and when in it the daemon is killed."""

    name: str
    phases: tuple[str, ...]
    below_m: float = math.inf
    after_s: float = 0.0
    where: str = "air"
    start: str = "automatic"
    covered: bool = False


CASES = (
    Case("before take-off", ("waiting for the vehicle",), after_s=2.0, where="pad"),
    Case("waiting for the start", ("waiting for the start",), after_s=1.0, start="signal"),
    Case("approach", ("approach",), after_s=1.0),
    Case("descend", ("descend",), below_m=1.3),
    Case("last half metre", ("descend", "land"), below_m=0.55),
    Case("landing ordered", ("land",), after_s=0.1),
    Case("lost", ("lost", "by dead reckoning"), after_s=0.3, covered=True),
    Case("climb", ("climb",), after_s=0.3, covered=True),
    Case("gave up", ("gave up",), after_s=0.5, covered=True),
    Case("after landing", ("landed",), after_s=0.5),
)


class Teller(Silent):
    """Prints phase and height of each guidance cycle for the program that kills us."""

    def on_decision(self, decision: Decision) -> None:
        height = math.inf if decision.belief is None else decision.belief.height_m
        sys.stdout.write(f"{decision.phase}|{height:.3f}\n")
        sys.stdout.flush()


def fly(config: str) -> None:
    """The daemon as `decklander run` has it, with an observer that tells what guidance is about."""
    settings = load(config)
    pilot = make_pilot(settings)
    asyncio.run(live(make_daemon(settings, pilot, observers=[Teller()]), pilot))


@dataclass
class Wire:
    """Passes AT datagrams on to the drone and keeps when it was told to move and when to hover."""

    port: int
    told: list[tuple[float, bool]] = field(default_factory=list)
    ended: bool = False

    def __post_init__(self) -> None:
        self._in = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._in.bind(("127.0.0.1", 0))
        self._in.settimeout(0.2)
        self.own_port = self._in.getsockname()[1]
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        with self._in, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            while not self.ended:
                try:
                    data = self._in.recv(2048)
                except TimeoutError:
                    continue
                now = time.monotonic()
                out.sendto(data, ("127.0.0.1", self.port))
                sticks = [c for c in at.decode(data) if isinstance(c, tuple) and isinstance(c[1], at.Pcmd)]
                if sticks:
                    self.told.append((now, bool(sticks[-1][1].flags)))

    def hover_after(self, instant: float) -> float:
        """Seconds from an instant until nothing but hover was on the wire (of the next second); 0 where it was so before."""
        moving = [t for t, moves in self.told if moves and instant <= t < instant + 1.0]
        if not moving:
            return 0.0
        return next((t - instant for t, moves in self.told if t > moving[-1] and not moves), math.inf)


@contextmanager
def drone(scenario: Path, seed: int, truth: Path) -> Iterator[dict[str, int]]:
    ports = [f"--{name}-port=0" for name in ("navdata", "video", "at", "control")]
    words = [sys.executable, "-m", "sitl.ardrone.serve", str(scenario), f"--seed={seed}", f"--truth={truth}", *ports]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        yield json.loads(child.stdout.readline())["ports"]
        assert child.stdin is not None
        child.stdin.close()
        child.wait(20)


class Daemon:
    """One daemon process and what it tells."""

    def __init__(self, config: Path) -> None:
        words = [sys.executable, "-m", "benches.dead_man", "--fly", str(config)]
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, bufsize=1)
        self.phase, self.height_m, self.since, self.first_moved = "", math.inf, time.monotonic(), math.inf
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            phase, _, height = line.strip().partition("|")
            if phase != self.phase:
                self.phase, self.since = phase, time.monotonic()
            self.height_m = float(height)

    def reach(self, case: Case) -> bool:
        """Wait until it is time to kill it."""
        deadline = time.monotonic() + REACH_S
        while time.monotonic() < deadline and self.process.poll() is None:
            if self.phase in case.phases and self.height_m <= case.below_m and time.monotonic() - self.since >= case.after_s:
                return True
            time.sleep(0.002)
        return False

    def wait_for(self, *phases: str, seconds: float) -> str:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and self.process.poll() is None and self.phase not in phases:
            time.sleep(0.02)
        return self.phase

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.terminate()
            try:
                self.process.wait(20)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()


def run(case: Case, seed: int, how: signal.Signals) -> dict[str, Any]:
    """One flight: up to the phase, killed, watched, taken over."""
    out: dict[str, Any] = {"phase": case.name, "seed": seed}
    with tempfile.TemporaryDirectory(prefix="decklander-") as name:
        folder = Path(name)
        scenario, truth = folder / "scenario.toml", folder / "truth.jsonl"
        place = 'where = "pad"\n' if case.where == "pad" else "height_m = 3.2\npad_right_m = 0.8\npad_forward_m = 0.5\n"
        fault = f"[[faults]]\n{COVERED}for_s = 14.0\n" if case.covered else ""
        camera = '[camera]\nfile = "camera.toml"\n'
        (folder / "camera.toml").write_text(CAMERA)
        scenario.write_text(f'base = "demo"\nduration_limit_s = 300.0\n{camera}[start]\n{place}{fault}')
        with drone(scenario, seed, truth) as ports:
            wire = Wire(ports["at"])
            ports_here = ports | {"at": wire.own_port}
            again, config = folder / "again.toml", folder / "first.toml"
            again.write_text(SETTINGS.format(**ports_here, start="automatic", give_up_s=20.0))
            config.write_text(SETTINGS.format(**ports_here, start=case.start, give_up_s=6.0 if case.covered else 20.0))
            first = second = Daemon(config)
            try:
                reached = first.reach(case)
                out["height_m"] = first.height_m
                killed = time.monotonic()
                first.process.send_signal(how)
                time.sleep(ALONE_S)
                first.process.kill()
                first.process.wait()
                back = time.monotonic()
                second = Daemon(again)
                flies = case.where == "air" and case.name != "after landing"
                if reached and flies:
                    ending = second.wait_for("landed", "landed by others", "gave up", "emergency", seconds=LAND_S)
                else:
                    ending = second.wait_for("waiting for the vehicle", seconds=10.0)
                moved = next((t - back for t, moves in wire.told if moves and t > back), None)
                time.sleep(0.3)
            finally:
                first.process.kill()
                first.process.wait()
                second.end()
                wire.ended = True
        records = read_truth(truth)
    out |= {"reached": reached, "hover_ms": 1e3 * wire.hover_after(killed), "took_over_s": moved, "ending": ending}
    return out | judged(records, killed, back, flies)


def judged(records: list[dict[str, Any]], killed: float, back: float, flies: bool) -> dict[str, Any]:
    """Measure in the truth how the drone moved while it was alone and how the flight ended."""
    at_kill = max((r for r in records if r["at_ns"] <= killed * 1e9), key=lambda r: r["at_ns"], default=records[0])
    alone = [r for r in records if killed * 1e9 <= r["at_ns"] <= back * 1e9]
    x0, y0, h0 = at_kill["d_body_pad_level_m"]
    turned = [_toward(r, at_kill) for r in alone]
    drift_m = max((math.hypot(x - x0, y - y0) for x, y, _ in turned), default=0.0)
    lowest_m = min((h - h0 for _, _, h in turned), default=0.0)
    contacts = [c for c in records[-1]["contacts"] if c["at"] > killed * 1e9]
    in_the_alone = [c for c in contacts if c["at"] <= back * 1e9]
    off_pad = [c for c in contacts if not c["on_pad"]]
    last = records[-1]
    landed = last["phase"] == "landed" and not off_pad
    safe = not off_pad and last["phase"] != "emergency" and (landed or not flies or last["phase"] in ("hovering", "flying"))
    lateral = contacts[-1]["lateral_m"] if contacts else None
    return {
        "drift_m": drift_m, "lowest_m": lowest_m, "true_height_m": h0, "contact_alone": bool(in_the_alone),
        "landed": landed, "lateral_m": lateral, "safe": safe,
    }  # fmt: skip


def _toward(record: dict[str, Any], first: dict[str, Any]) -> tuple[float, float, float]:
    """The pad as seen then, in the level axes of the first record."""
    turn = record["yaw_rad"] - first["yaw_rad"]
    x, y, z = record["d_body_pad_level_m"]
    return math.cos(turn) * x - math.sin(turn) * y, math.sin(turn) * x + math.cos(turn) * y, z


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=1, metavar="SEED")
    parser.add_argument("--how", choices=("kill", "stop"), default="kill")
    parser.add_argument("--phase", nargs="*", choices=[case.name for case in CASES], metavar="NAME")
    parser.add_argument("--fly", metavar="FILE", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.fly:
        fly(args.fly)
        return
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # through every finally: no process of ours stays
    os.environ.setdefault("MPLCONFIGDIR", tempfile.gettempdir())
    how = signal.SIGKILL if args.how == "kill" else signal.SIGSTOP
    print("phase                  seed  height m  hover ms  drift m  lowest m  contact  took over s  landed  off m  safe")
    rows = []
    for case in CASES:
        for seed in range(args.first, args.first + args.seeds):
            if args.phase and case.name not in args.phase:
                continue
            row = run(case, seed, how)
            rows.append(row)
            taken = "-" if row["took_over_s"] is None else f"{row['took_over_s']:.1f}"
            off = "-" if row["lateral_m"] is None else f"{row['lateral_m']:.2f}"
            print(
                f"{case.name:22} {seed:4}  {row['true_height_m']:8.2f}  {row['hover_ms']:8.0f}  {row['drift_m']:7.2f}  "
                f"{row['lowest_m']:8.2f}  {'yes' if row['contact_alone'] else 'no':>7}  {taken:>11}  "
                f"{'yes' if row['landed'] else 'no':>6}  {off:>5}  {'yes' if row['safe'] else 'NO'}"
                f"{'' if row['reached'] else '  (phase not reached)'}",
                flush=True,
            )
    moving = sorted(row["hover_ms"] for row in rows if row["hover_ms"] > 0.0)
    hover = f"p50 {moving[len(moving) // 2]:.0f} ms, max {moving[-1]:.0f} ms" if moving else "at once"
    drifts = sorted(row["drift_m"] for row in rows)
    print(
        f"hover on the wire: {hover} ({len(moving)} that were moving); "
        f"drift in {ALONE_S:.0f} s: p50 {drifts[len(drifts) // 2]:.2f} m, max {drifts[-1]:.2f} m; "
        f"unsafe: {sum(not row['safe'] for row in rows)} of {len(rows)}; not reached: {sum(not row['reached'] for row in rows)}"
    )


if __name__ == "__main__":
    main()
