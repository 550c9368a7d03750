"""Measure the resources of this process over hours, and decide whether they grow. Reads /proc, so it needs Linux."""

import gc
import os
import resource
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from companion.base import memory
from estimator.contracts.errors import SetupImpossible

GROWTH_MAX = 0.01
"""Share by which memory may grow after warm-up."""
_PAGE = resource.getpagesize()


@dataclass(frozen=True, slots=True)
class Reading:
    """The resources of this process at one instant."""

    at_s: float
    """Wall time since the start, seconds."""
    flights: int
    memory_mib: float
    """Resident memory, MiB. In virtual time it is read when what is free has been given back; see `give_back`."""
    descriptors: int
    threads: int
    tasks: int | None
    """Number of asyncio tasks; None without a loop."""
    cpu_s: float
    """CPU time so far, user and system, all threads, seconds."""
    before_mib: float | None = None
    """Resident memory before what is free was given back, MiB; None where it was not."""


def give_back() -> float:
    """Collect what nothing refers to and give free memory back to the system; return the resident memory before that, MiB.

    Without this a reading says where the heap happened to be cut: the C library keeps free pages between blocks that are in use
    (some 25 MiB here), and now and then a frame's buffer that fits into none of the gaps makes the heap longer. That looks like
    a leak of some megabytes, and would hide a small one.

    Raises:
        SetupImpossible: there is no /proc.
    """
    before_mib = _resident_mib()
    gc.collect()
    memory.give_back()
    return before_mib


def _resident_mib() -> float:
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE / 2**20
    except OSError as why:
        raise SetupImpossible(f"a soak reads /proc, which is not there: {why.strerror}") from why


def read(at_s: float, flights: int, tasks: int | None, before_mib: float | None = None) -> Reading:
    """Take a reading now.

    Args:
        before_mib: what `give_back` returned just before; None where it was not called.

    Raises:
        SetupImpossible: there is no /proc.
    """
    memory_mib = _resident_mib()
    try:
        descriptors = len(os.listdir("/proc/self/fd")) - 1
        threads = len(os.listdir("/proc/self/task"))
    except OSError as why:
        raise SetupImpossible(f"a soak reads /proc, which is not there: {why.strerror}") from why
    spent = resource.getrusage(resource.RUSAGE_SELF)
    return Reading(at_s, flights, memory_mib, descriptors, threads, tasks, spent.ru_utime + spent.ru_stime, before_mib)


@dataclass(frozen=True, slots=True)
class Trend:
    """One quantity after warm-up: the medians of the first and the last quarter of its readings."""

    first: float
    last: float
    most: float
    per_hour: float
    """Slope of a straight line through all of them."""

    @property
    def growth(self) -> float:
        """Return the growth from `first` to `last` as a share of `first`; negative if it shrank."""
        return self.last / self.first - 1.0 if self.first else 0.0


@dataclass(frozen=True, slots=True)
class Findings:
    """Trends of the readings after warm-up."""

    duration_s: float
    warm_up_s: float
    flights: int
    readings: int
    """Number of readings after warm-up."""
    memory_mib: Trend
    descriptors: Trend
    threads: Trend
    tasks: Trend | None
    cpu_share: float
    """CPU load after warm-up, in shares of one core."""

    @property
    def faults(self) -> list[str]:
        """Return what grew and must not, in words."""
        output = []
        if self.memory_mib.growth >= GROWTH_MAX:
            first, last = self.memory_mib.first, self.memory_mib.last
            output.append(f"memory grew by {self.memory_mib.growth:.1%} ({first:.1f} to {last:.1f} MiB)")
        counted = {"descriptors": self.descriptors, "threads": self.threads, "tasks": self.tasks}
        for name, trend in counted.items():
            if trend is not None and trend.last > trend.first:
                output.append(f"{name} grew from {trend.first:g} to {trend.last:g}")
        return output

    def as_json(self) -> dict[str, Any]:
        return {**asdict(self), "memory_growth": self.memory_mib.growth, "faults": self.faults}


def findings(readings: Sequence[Reading], warm_up_s: float) -> Findings | None:
    """Return the trends; None while fewer than eight readings are past the warm-up."""
    after = [r for r in readings if r.at_s >= warm_up_s]
    if len(after) < 8:
        return None
    tasks = [r.tasks for r in after if r.tasks is not None]
    wall_s = after[-1].at_s - after[0].at_s
    return Findings(
        duration_s=readings[-1].at_s,
        warm_up_s=warm_up_s,
        flights=readings[-1].flights,
        readings=len(after),
        memory_mib=_trend(after, lambda r: r.memory_mib),
        descriptors=_trend(after, lambda r: r.descriptors),
        threads=_trend(after, lambda r: r.threads),
        tasks=_trend(after, lambda r: r.tasks or 0) if len(tasks) == len(after) else None,
        cpu_share=(after[-1].cpu_s - after[0].cpu_s) / wall_s if wall_s > 0 else 0.0,
    )


def _trend(readings: Sequence[Reading], of: Callable[[Reading], float]) -> Trend:
    values = [float(of(r)) for r in readings]
    hours = np.array([r.at_s for r in readings]) / 3600.0
    slope = float(np.polyfit(hours - hours[0], values, 1)[0]) if hours[-1] > hours[0] else 0.0
    quarter = max(1, len(values) // 4)
    return Trend(median(values[:quarter]), median(values[-quarter:]), max(values), slope)
