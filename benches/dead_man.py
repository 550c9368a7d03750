"""Kill the daemon in flight, at each of ten phases, and see what the drone does and whether a new daemon lands it.

python -m benches.dead_man --seeds 1 [--how kill|stop] [--phase NAME ...]

Everything is a process of its own: the simulated drone over the demo's sea, the daemon, and the sender that the daemon starts.
The AT commands pass through this program, which so sees what is on the wire and when; it follows the drone's truth as it flies.
`stop` is SIGSTOP instead of SIGKILL; the daemon is killed after the three seconds in which the drone is watched.

A flight that does not reach its phase, or in which this machine was starved, is counted apart, and the next seed is flown
instead.
"""

import argparse
import asyncio
import json
import math
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from benches.options import described, failed, parsed
from companion.base.observer import Decision, NullObserver
from companion.guidance.pilot import make_pilot
from companion.service.assemble import live, make_daemon
from companion.settings.load import load
from drivers.ardrone import at
from sitl.emulators.ardrone.truth_log import LINE
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world import truth as world

_LOOK_S = 0.005
ALONE_S = 3.0
"""Time for which the drone is watched before a new daemon is started, seconds."""
LAND_S = 90.0
"""Time limit for the new daemon to land the drone, seconds."""
REACH_S = 75.0
"""Time limit for reaching the phase, seconds."""
STANDS_S = 1.0
"""Time for which a landed drone is watched with the new daemon, seconds."""
TRIES = 3
"""Largest number of flights for each requested one."""
LATE_MS = 150.0
SANK_M = 0.5
STARVED_S = 0.15
"""Delay of this program while the drone is alone from which a flight is no measurement, seconds."""
BEFORE_S = 4.0
"""Time before the kill in which a starved machine is looked for, seconds."""
SLOW_GUIDANCE_S = 0.4
"""Gap between two guidance cycles that shows a starved machine, seconds: twenty cycles."""
STOOD_STILL_S = 0.2
"""Gap in the simulated drone's physics that shows a starved machine, seconds."""
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
file = "camera.toml"
[pad]
file = "thesis"
[vision]
colours = "simulator"
method = "registration"
[guidance]
start = "{start}"
[guidance.tries]
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
PAD = 'where = "pad"\n'
HIGH = "height_m = 3.0\npad_right_m = 0.8\npad_forward_m = 0.5\n"
NEAR = "height_m = 2.3\npad_right_m = 0.3\npad_forward_m = 0.2\n"
FINAL = ("landed", "landed by others", "gave up", "refused", "emergency")


@dataclass(frozen=True, slots=True)
class Case:
    """A phase, the way to reach it, and the condition at which the daemon is killed."""

    name: str
    phases: tuple[str, ...]
    """Phases of guidance; the flight must reach one."""
    after_s: float = 0.0
    below_m: float = math.inf
    """True height of the body over the pad below which the daemon is killed, metres."""
    place: str = NEAR
    start: str = "automatic"
    covered_below_m: float | None = None
    """Height below which the lens is covered for `covered_s`, metres; None never covers it."""
    covered_s: float = 10.0
    give_up_s: float = 20.0


CASES = (
    Case("before take-off", ("waiting for the vehicle",), after_s=1.5, place=PAD),
    Case("waiting for the start", ("waiting for the start",), after_s=1.0, start="signal"),
    Case("intercept", ("intercept",), after_s=1.0, place=HIGH),
    Case("descend", ("descend",), below_m=1.3),
    Case("last half metre", ("descend",), below_m=0.5),
    Case("commit", ("commit", "press", "down"), after_s=0.1),
    Case("hold blind", ("hold blind",), after_s=0.3, covered_below_m=1.5),
    # The drone climbs 1.5 s after a loss below the safe height, so the lens stays covered for longer.
    Case("go around", ("go around",), after_s=0.3, covered_below_m=1.3),
    # The drone hovers after a loss above the safe height until it gives up.
    Case("gave up", ("gave up",), after_s=0.3, place=HIGH, covered_below_m=2.7, give_up_s=3.0),
    Case("after landing", ("landed",), after_s=0.5),
)


@dataclass
class Wire:
    """Forwards AT datagrams to the drone and records the times of its move and hover commands."""

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
                sticks = [c[1] for c in at.decode(data) if isinstance(c, tuple) and isinstance(c[1], at.Pcmd)]
                if sticks:
                    self.told.append((now, bool(sticks[-1].flags) and sticks[-1].gaz < 1.0))

    def hover_after(self, instant: float) -> float:
        """Return the seconds from an instant until only hover commands were sent, within the next second; 0 if none moved it."""
        moving = [t for t, moves in self.told if moves and instant <= t < instant + 1.0]
        if not moving:
            return 0.0
        return next((t - instant for t, moves in self.told if t > moving[-1] and not moves), math.inf)


@contextmanager
def drone(scenario: Path | str, seed: int = 0, truth: Path | None = None) -> Iterator[dict[str, int]]:
    """Run a simulated drone in its own process while the body runs; yield its ports."""
    ports = [f"--{name}-port=0" for name in ("navdata", "video", "at", "control")]
    log = [] if truth is None else [f"--truth={truth}"]
    words = [sys.executable, "-m", "sitl.emulators.ardrone.serve", str(scenario), f"--seed={seed}", *log, *ports]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdin is not None
        assert child.stdout is not None
        try:
            yield json.loads(child.stdout.readline())["ports"]
        finally:
            child.stdin.close()
            child.wait(20)


class Truth:
    """Follows the truth log of a simulated drone that flies, and how punctual this process is meanwhile."""

    def __init__(self, path: Path) -> None:
        self.records: list[world.Truth] = []
        self.late: list[tuple[float, float]] = []
        """Times at which this thread woke up more than 50 ms late, and by how many seconds."""
        self.ended = False
        self._path = path
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def phase(self) -> str:
        """The drone's phase; empty before the first record."""
        return self.records[-1].phase.name.lower() if self.records else ""

    @property
    def height_m(self) -> float:
        """True height of the body over the pad, metres."""
        return float(self.records[-1].d_body_pad_level[2]) if self.records else math.inf

    @property
    def contacts(self) -> Sequence[world.Touchdown]:
        """Return all contacts so far."""
        return self.records[-1].contacts if self.records else ()

    def slowest_s(self, since: float, until: float) -> float:
        """Return the longest time between two records, seconds; the drone's host had no time for it, and it does not catch up."""
        return _longest_s([1e-9 * r.at for r in self.records], since, until)

    def end(self) -> None:
        """Read what is left and stop following."""
        self.ended = True
        self._thread.join()

    def _run(self) -> None:
        with self._path.open(encoding="utf-8") as lines:
            rest, before = "", time.monotonic()
            while True:
                last = self.ended
                output = rest + lines.read()
                *whole, rest = output.split("\n")
                self.records += map(LINE.decode, whole)
                if last:
                    return
                time.sleep(_LOOK_S)
                before, slept = time.monotonic(), time.monotonic() - before
                if slept - _LOOK_S > 0.05:
                    self.late.append((before, slept - _LOOK_S))


class Daemon:
    """A daemon process that prints its phase in each guidance cycle, and the phase that it printed last."""

    def __init__(self, words: list[str]) -> None:
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, bufsize=1)
        self.phase, self.since = "", time.monotonic()
        self.cycles: list[float] = []
        """Time at which each cycle was printed."""
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                now = time.monotonic()
                if line.strip() != self.phase:
                    self.phase, self.since = line.strip(), now
                self.cycles.append(now)

    @property
    def alive(self) -> bool:
        return self.process.poll() is None

    def slowest_s(self, since: float, until: float) -> float:
        """Return the longest time between two guidance cycles, seconds."""
        return _longest_s(self.cycles, since, until)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def end(self) -> None:
        """End the daemon as an operator does."""
        if self.alive:
            self.process.send_signal(signal.SIGCONT)
            self.process.terminate()
            try:
                self.process.wait(20)
            except subprocess.TimeoutExpired:
                self.kill()


def _longest_s(instants: list[float], since: float, until: float) -> float:
    return max((b - a for a, b in pairwise(t for t in instants if since <= t <= until)), default=0.0)


class Teller(NullObserver):
    """Prints the phase of each guidance cycle for the program that kills this daemon."""

    def on_decision(self, decision: Decision) -> None:
        sys.stdout.write(f"{decision.phase}\n")
        sys.stdout.flush()


def fly(config: str) -> None:
    """Run the daemon of `decklander run` with an observer that prints the phase of guidance."""
    settings = load(config)
    pilot = make_pilot(settings)
    asyncio.run(live(make_daemon(settings, pilot, observers=[Teller()]), pilot))


@dataclass
class Flight:
    """The result of one flight."""

    case: Case
    seed: int
    reached: bool
    height_m: float = math.nan
    """True height when the daemon was killed, metres."""
    hover_ms: float = 0.0
    drift_m: float = 0.0
    """Largest horizontal distance from the place of the kill within `ALONE_S`, metres."""
    lowest_m: float = 0.0
    """Smallest height relative to that of the kill within `ALONE_S`, metres."""
    took_over_s: float | None = None
    """Time from the new daemon's start to its first command to move, seconds."""
    outcome: str = ""
    lateral_m: float | None = None
    unsafe: tuple[str, ...] = ()
    starved: tuple[str, ...] = ()

    def line(self) -> str:
        measured_at = "-" if self.took_over_s is None else f"{self.took_over_s:.1f}"
        off = "-" if self.lateral_m is None else f"{self.lateral_m:.2f}"
        safe = "NO" if self.unsafe else "yes" if self.reached else "-"
        remarks = [*self.unsafe, *(f"starved: {why}" for why in self.starved), *([] if self.reached else ["phase not reached"])]
        return (
            f"{self.case.name:22} {self.seed:4}  {self.height_m:8.2f}  {self.hover_ms:8.0f}  {self.drift_m:7.2f}  "
            f"{self.lowest_m:8.2f}  {measured_at:>11}  {self.outcome:14}  {off:>5}  {safe:4}  {'; '.join(remarks)}"
        ).rstrip()


HEADER = "phase                  seed  height m  hover ms  drift m  lowest m  took over s  outcome         off m  safe  remarks"


def run(case: Case, seed: int, how: signal.Signals) -> Flight:
    """Fly once: reach the phase, kill the daemon, watch the drone, and let a new daemon take over."""
    with tempfile.TemporaryDirectory(prefix="decklander-") as name:
        folder = Path(name)
        scenario, log = folder / "scenario.toml", folder / "truth.jsonl"
        fault = ""
        if case.covered_below_m is not None:
            fault = f'[[faults]]\nkind = "lens_covered"\nbelow_height_m = {case.covered_below_m}\nfor_s = {case.covered_s}\n'
        (folder / "camera.toml").write_text(CAMERA)
        camera = '[camera]\nfile = "camera.toml"\n'
        scenario.write_text(f'base = "demo"\nduration_limit_s = 600.0\n{camera}[start]\n{case.place}{fault}')
        with drone(scenario, seed, log) as ports:
            truth, wire = Truth(log), Wire(ports["at"])
            try:
                return _flown(case, seed, how, folder, ports | {"at": wire.own_port}, truth, wire)
            finally:
                wire.ended = True
                truth.end()


def _daemon(config: Path) -> Daemon:
    return Daemon([sys.executable, "-m", "benches.dead_man", "--fly", str(config)])


def _flown(case: Case, seed: int, how: signal.Signals, folder: Path, ports: dict[str, int], truth: Truth, wire: Wire) -> Flight:
    first_config, second_config = folder / "first.toml", folder / "second.toml"
    first_config.write_text(SETTINGS.format(**ports, start=case.start, give_up_s=case.give_up_s))
    second_config.write_text(SETTINGS.format(**ports, start="automatic", give_up_s=20.0))
    first = second = _daemon(first_config)
    try:
        if not _reach(case, first, truth):
            return _missed(case, seed, truth)
        killed = time.monotonic()
        first.process.send_signal(how)
        time.sleep(ALONE_S)
        first.kill()
        back = time.monotonic()
        second = _daemon(second_config)
        _taken_over(second, truth)
        moved = next((t - back for t, moves in wire.told if moves and t > back), None)
    finally:
        first.kill()
        second.end()
    flight = Flight(case, seed, True, hover_ms=1e3 * wire.hover_after(killed), took_over_s=moved)
    _judge(flight, truth, killed, back)
    flight.starved = _starved(first, truth, killed, back)
    return flight


def _starved(first: Daemon, truth: Truth, killed: float, back: float) -> tuple[str, ...]:
    """Return why this machine was too slow in the seconds before the kill and while the drone was alone."""
    why, began = [], killed - BEFORE_S
    if (slow_s := first.slowest_s(began, killed)) > SLOW_GUIDANCE_S:
        why.append(f"{slow_s:.2f} s between two guidance cycles")
    if (late_s := max((late for t, late in truth.late if killed - 0.5 <= t <= back), default=0.0)) > STARVED_S:
        why.append(f"this program was {late_s:.2f} s late")
    if (stood_s := truth.slowest_s(began, back)) > STOOD_STILL_S:
        why.append(f"the simulated drone stood still for {stood_s:.2f} s")
    return tuple(why)


def _missed(case: Case, seed: int, truth: Truth) -> Flight:
    """Return the result of a flight whose daemon was not killed; it may have failed all the same."""
    why = tuple(f"touched {c.lateral_m:.2f} m off, not on the pad" for c in truth.contacts if not c.on_pad)
    if truth.phase == "emergency":
        why += ("its motors were cut",)
    return Flight(case, seed, False, truth.height_m, outcome=truth.phase, unsafe=why)


def _reach(case: Case, daemon: Daemon, truth: Truth) -> bool:
    """Wait until it is time to kill the daemon; give up if that can no longer come."""
    deadline = time.monotonic() + REACH_S
    while time.monotonic() < deadline and daemon.alive:
        if daemon.phase in case.phases and truth.height_m <= case.below_m and time.monotonic() - daemon.since >= case.after_s:
            return True
        if daemon.phase in FINAL and daemon.phase not in case.phases:
            return False
        time.sleep(0.002)
    return False


def _taken_over(daemon: Daemon, truth: Truth) -> None:
    """Wait until the drone has landed and the new daemon leaves it there, or decides otherwise, or the time is up."""
    deadline, stands_since = time.monotonic() + LAND_S, math.inf
    while time.monotonic() < deadline and daemon.alive:
        now = time.monotonic()
        stands = truth.phase in ("landed", "emergency") and daemon.phase != ""
        stands_since = min(stands_since, now) if stands else math.inf
        if now - stands_since > STANDS_S or (not stands and daemon.phase in FINAL and now - daemon.since > STANDS_S):
            return
        time.sleep(0.02)


def _judge(flight: Flight, truth: Truth, killed: float, back: float) -> None:
    """Measure from the truth log how the drone moved while it was alone, and how the flight ended."""
    records = truth.records[:]
    start = max((r for r in records if r.at <= killed * 1e9), key=lambda r: r.at, default=records[0])
    alone = [r for r in records if killed * 1e9 <= r.at <= back * 1e9]
    moved = np.array([r.p_body_ned - start.p_body_ned for r in alone]).reshape(-1, 3)
    flight.height_m = float(start.d_body_pad_level[2])
    flight.drift_m = float(np.hypot(moved[:, 0], moved[:, 1]).max(initial=0.0))
    flight.lowest_m = float(-moved[:, 2].max()) if alone else 0.0
    contacts, landing = records[-1].contacts, start.phase is VehiclePhase.LANDING
    by_itself = [r for r in alone if r.phase is VehiclePhase.LANDING and not landing]
    why = [f"touched {c.lateral_m:.2f} m off, not on the pad" for c in contacts if not c.on_pad]
    if truth.phase == "emergency":
        why.append("its motors were cut")
    if by_itself:
        why.append(f"began to land by itself at {by_itself[0].d_body_pad_level[2]:.2f} m")
    if flight.lowest_m < -SANK_M and not landing:
        why.append(f"sank {-flight.lowest_m:.2f} m while alone")
    flight.unsafe = tuple(why)
    flight.lateral_m = contacts[-1].lateral_m if contacts else None
    ends = {"landed": "on the pad" if contacts else "never flew", "hovering": "hovers", "flying": "still flies"}
    flight.outcome = ends.get(truth.phase, truth.phase)


@dataclass
class Count:
    """The flights of one phase."""

    case: Case
    flights: list[Flight] = field(default_factory=list)

    @property
    def kills(self) -> list[Flight]:
        """The flights that count."""
        return [f for f in self.flights if f.reached and not f.starved]

    def line(self) -> str:
        starved = [f for f in self.flights if f.reached and f.starved]
        unsafe_starved = _unsafe(starved)
        moving = sorted(f.hover_ms for f in self.kills if f.hover_ms > 0.0)
        drift = sorted(f.drift_m for f in self.kills)
        hover = f"{moving[len(moving) // 2]:4.0f} {moving[-1]:4.0f}" if moving else "   -    -"
        drifted = f"{drift[len(drift) // 2]:4.2f} {drift[-1]:4.2f}" if drift else "   -    -"
        ends = ", ".join(f"{n} {outcome}" for outcome, n in Counter(f.outcome for f in self.kills).most_common())
        aside = f"{len(starved)}" + (f" ({unsafe_starved} unsafe)" if unsafe_starved else "")
        return (
            f"{self.case.name:22} {len(self.kills):5}  {sum(not f.reached for f in self.flights):11}  {aside:>12}  "
            f"{_unsafe(self.kills):6}  {sum(ms > LATE_MS for ms in moving):4}  {hover}  {drifted}  {ends}"
        )


def fly_case(case: Case, args: argparse.Namespace) -> Count:
    """Fly a phase until it has its number of kills that count."""
    count, how = Count(case), signal.SIGKILL if args.how == "kill" else signal.SIGSTOP
    for seed in range(args.first, args.first + TRIES * args.seeds):
        if len(count.kills) >= args.seeds:
            break
        try:
            flight = run(case, seed, how)
        except (OSError, ValueError, IndexError, subprocess.SubprocessError) as why:
            flight = Flight(case, seed, False, outcome=f"broke: {type(why).__name__}")
        count.flights.append(flight)
        print(flight.line(), flush=True)
    return count


def summarize(counts: list[Count]) -> None:
    """Print the table and its sums."""
    print("\nphase                  kills  not reached  (starved)     unsafe  late  hover p50/most  drift  outcomes")
    for count in counts:
        print(count.line())
    kills = [f for c in counts for f in c.kills]
    every = [f for c in counts for f in c.flights]
    missed = [f for f in every if not f.reached]
    starved = [f for f in every if f.reached and f.starved]
    print(
        f"{len(kills)} kills, {_unsafe(kills)} unsafe. Hover on the wire in ms, of the flights that were moving; late is "
        f"over {LATE_MS:.0f} ms; drift in {ALONE_S:.0f} s in m.\n{len(every)} flights: {len(missed)} did not reach their "
        f"phase ({_unsafe(missed)} unsafe), in {len(starved)} this machine was starved ({_unsafe(starved)} unsafe).",
        flush=True,
    )


def _unsafe(flights: list[Flight]) -> int:
    return sum(bool(f.unsafe) for f in flights)


def main() -> None:
    parser = described(__doc__)
    parser.add_argument("--seeds", type=int, default=1, help="flights for each phase")
    parser.add_argument("--first", type=int, default=1, metavar="SEED")
    parser.add_argument("--how", choices=("kill", "stop"), default="kill")
    parser.add_argument("--phase", nargs="*", choices=[case.name for case in CASES], metavar="NAME")
    parser.add_argument("--fly", metavar="FILE", help=argparse.SUPPRESS)
    args = parsed(parser, "--phase descend")
    if args.fly:
        fly(args.fly)
        return
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # this runs every finally block, so that no child process remains
    print(HEADER, flush=True)
    counts: list[Count] = []
    try:
        counts.extend(fly_case(case, args) for case in CASES if not args.phase or case.name in args.phase)
    finally:
        summarize(counts)
    if not any(flight.reached for count in counts for flight in count.flights):
        failed("no flight reached its phase")


if __name__ == "__main__":
    main()
