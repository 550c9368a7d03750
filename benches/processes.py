"""Run and watch a simulated drone, the datagrams to it, its truth log, and a daemon that prints its phase."""

import json
import math
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from drivers.ardrone import at

_LOOK_S = 0.005
_KEPT = ("at_ns", "phase", "d_body_pad_level_m", "p_body_ned_m", "contacts")
"""Fields of a truth record that are kept."""


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
        self.records: list[dict[str, Any]] = []
        self.late: list[tuple[float, float]] = []
        """Times at which this thread woke up more than 50 ms late, and by how many seconds."""
        self.ended = False
        self._path = path
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def phase(self) -> str:
        """The drone's phase; empty before the first record."""
        return str(self.records[-1]["phase"]) if self.records else ""

    @property
    def height_m(self) -> float:
        """True height of the body over the pad, metres."""
        return float(self.records[-1]["d_body_pad_level_m"][2]) if self.records else math.inf

    @property
    def contacts(self) -> list[dict[str, Any]]:
        """Return all contacts so far."""
        return list(self.records[-1]["contacts"]) if self.records else []

    def slowest_s(self, since: float, until: float) -> float:
        """Return the longest time between two records, seconds; the drone's host had no time for it, and it does not catch up."""
        return _longest_s([1e-9 * r["at_ns"] for r in self.records], since, until)

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
                self.records += [{name: value for name, value in json.loads(line).items() if name in _KEPT} for line in whole]
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
        for line in self.process.stdout:
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
