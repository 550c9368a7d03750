"""Watch the event loop, how late it is and what holds it.

A task sleeps for `PERIOD_S` and notes how late it is. A thread looks on: while the loop is away it notes where the
loop's own thread is, so that a long hold has a name. Time in which the computer was suspended counts, which the monotonic clock
leaves out; after `STOOD_S` without the loop in flight the vehicle is commanded to hold, since all data about it is old.
"""

from __future__ import annotations

import asyncio
import logging
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FrameType

from companion.base.health import Delays, Health

log = logging.getLogger(__name__)


PERIOD_S = 0.02
"""Time between two looks of the task: that of a guidance cycle."""
HELD_S = 0.2
"""A hold above this is reported: a command every 0.04 s has been left out five times."""
_SUSPECT_S = 0.08  # time without the loop after which the thread looks at what the loop runs
STOOD_S = 2.0
"""Time without the loop after which a flying vehicle is commanded to hold; it has held by itself since about the first second."""
_SET_S = 1.0
"""Smallest step of the wall clock that is reported, s: a time server's own steps are smaller once it has the time."""
_ENDLESS_S = 1.0
"""Time without the loop after which the thread reports it itself: it may never come back."""


log = logging.getLogger(__name__)


STAGE = "loop_lag"
"""The stage of health that has each lag."""
LAG_EDGES_S = tuple(1e-4 * 1.05**n for n in range(260))
"""Upper edges of the buckets, s, from 0.1 ms to half a minute: a quantile is known to 5 %."""
_OURS = ("companion", "drivers", "estimator", "sitl")


def in_words(counts: Mapping[str, float]) -> str:
    """Return what `LoopWatch.counts` says of a flight, in words."""
    return (
        f"late by at most {1e3 * counts['lag_worst_s']:.0f} ms, 99.9 % within {1e3 * counts['lag_p999_s']:.1f} ms, "
        f"held longer than {HELD_S:g} s {counts['held']:.0f} times"
    )


class LoopWatch:
    """Measures the loop that runs it.

    Args:
        flying: returns whether the vehicle flew by its newest status. Each flight has its own worst and quantile.
        hold: called after `STOOD_S` in flight without the loop.
    """

    def __init__(self, health: Health, flying: Callable[[], bool], hold: Callable[[], object]) -> None:
        self._health = health
        self._flying = flying
        self._hold = hold
        self._flew = False
        self._beat_s = time.monotonic()
        self._where = ""
        """Cause of the loop's standstill, as the thread saw it; empty while the loop runs."""
        self._told = False
        self._thread_beat_s = self._beat_s
        self._worked_s = 0.0
        self._stopped = threading.Event()
        self.lags = Delays(LAG_EDGES_S)
        self.held = 0
        """The number of holds above `HELD_S`."""
        self.stood_s = 0.0
        """The time of all standstills above `STOOD_S`, s."""
        health.counters("loop", self.counts)

    def counts(self) -> Mapping[str, float]:
        """Return the counters for health, of this flight (or the last) and of the service."""
        return {
            "lag_worst_s": round(self.lags.worst_s, 5), "lag_p999_s": round(self.lags.quantile(0.999), 5),
            "held": self.held, "stood_s": round(self.stood_s, 1),
        }  # fmt: skip

    async def run(self) -> None:
        """Watch until cancelled."""
        self._stopped.clear()
        of_loop = threading.get_ident()
        threading.Thread(target=self._look, args=(of_loop,), name="loop watch", daemon=True).start()
        try:
            awake_s = time.clock_gettime(time.CLOCK_BOOTTIME)
            wall_s = time.time() - awake_s
            while True:
                self._where, self._told, self._worked_s = "", False, time.process_time()
                asked_s = self._beat_s = time.monotonic()
                await asyncio.sleep(PERIOD_S)
                late_s = time.monotonic() - asked_s - PERIOD_S
                now_s = time.clock_gettime(time.CLOCK_BOOTTIME)
                self._note(max(0.0, late_s), now_s - awake_s)
                awake_s, before_s, wall_s = now_s, wall_s, time.time() - now_s
                if abs(wall_s - before_s) > _SET_S:
                    log.warning("the wall clock was set by %+.1f s: the flight does not go by it", wall_s - before_s)
        finally:
            self._stopped.set()

    def _note(self, late_s: float, away_s: float) -> None:
        """Take a lag by the monotonic clock, and how long the loop was away in all, suspended time included."""
        flying = self._flying()
        if flying and not self._flew:
            self.lags = Delays(LAG_EDGES_S)
        self._flew = flying
        self.lags.add(late_s)
        self._health.delay(STAGE, late_s)
        if away_s >= STOOD_S:
            self.stood_s += away_s
            suspended = away_s - late_s > 1.0
            what = "this computer was suspended" if suspended else f"the service stood still ({self._what(late_s)})"
            log.error("%s for %.1f s%s", what, away_s, ": the drone is commanded to hold" if flying else "")
            if flying:
                self._hold()
        elif late_s >= HELD_S:
            self.held += 1
            log.warning("the event loop was held for %.2f s: %s", late_s, self._what(late_s))

    def _what(self, late_s: float) -> str:
        """Return what held the loop, in words."""
        if self._where:
            return self._where
        if time.process_time() - self._worked_s < 0.5 * late_s:
            return "stopped, or without processor time"
        return "a library kept the interpreter"

    def _look(self, of_loop: int) -> None:
        """Note where the loop's thread is while it is away; runs on a thread."""
        while not self._stopped.wait(_SUSPECT_S / 2):
            now_s = time.monotonic()
            on_time, self._thread_beat_s = now_s - self._thread_beat_s < _SUSPECT_S, now_s
            away_s = now_s - self._beat_s - PERIOD_S
            if away_s >= _SUSPECT_S and on_time and not self._where:
                self._where = calls(sys._current_frames()[of_loop])
            if away_s >= _ENDLESS_S and on_time and not self._told:
                self._told = True
                log.error("the event loop is held since %.1f s: %s", away_s, self._where)


def calls(frame: FrameType) -> str:
    """Return the call that a thread is in, and the one of ours that made it."""
    newest = outer = frame
    while outer.f_back is not None and not _is_ours(outer):
        outer = outer.f_back
    if newest.f_code.co_name == "select":
        return "it waited for the interpreter, which another thread kept"
    words = [_place(newest)] + ([f"called by {_place(outer)}"] if outer is not newest and outer.f_back is not None else [])
    return ", ".join(words)


def _is_ours(frame: FrameType) -> bool:
    name = str(frame.f_globals.get("__name__", ""))
    return name.startswith(_OURS) and not name.endswith("event_loop")


def _place(frame: FrameType) -> str:
    code = frame.f_code
    return f"{code.co_qualname} ({Path(code.co_filename).name}:{frame.f_lineno})"
