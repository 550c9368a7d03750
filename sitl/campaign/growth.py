"""Measure the resources of this process over hours, and decide whether they grow. Reads /proc, so it needs Linux."""

import gc
import os
import resource
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from msgspec import Struct, to_builtins

from companion.base import memory
from estimator.contracts.errors import SetupImpossible

GROWTH_MAX = 0.01
"""Share by which memory may grow after warm-up."""
WARM_UP_SHARE, WARM_UP_MOST_S = 0.2, 900.0
"""Warm-up as a share of the run, and its limit: textures, caches and the allocator's arenas are filled by then."""
WARM_UP_FLIGHTS = 30
"""Number of flights after which the faults have gone most ways through the code once, and its caches and arenas are full."""
_READINGS_MIN = 8
"""Number of readings after warm-up that show a trend."""
_PAGE = resource.getpagesize()


class Reading(Struct, frozen=True):
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
    before_mib = read(0.0, 0, None).memory_mib
    gc.collect()
    memory.give_back()
    return before_mib


def read(at_s: float, flights: int, tasks: int | None, before_mib: float | None = None) -> Reading:
    """Take a reading now.

    Args:
        before_mib: what `give_back` returned just before; None where it was not called.

    Raises:
        SetupImpossible: there is no /proc.
    """
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        descriptors, threads = len(os.listdir("/proc/self/fd")) - 1, len(os.listdir("/proc/self/task"))
    except OSError as why:
        raise SetupImpossible(f"a soak reads /proc, which is not there: {why.strerror}") from why
    spent = resource.getrusage(resource.RUSAGE_SELF)
    cpu_s = spent.ru_utime + spent.ru_stime
    return Reading(at_s, flights, pages * _PAGE / 2**20, descriptors, threads, tasks, cpu_s, before_mib)


class Trend(Struct, frozen=True):
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


class Findings(Struct, frozen=True):
    """Trends of the readings after warm-up."""

    duration_s: float
    warm_up_s: float
    flights: int
    readings: int
    """Number of readings after warm-up."""
    cpu_share: float
    """CPU load after warm-up, in shares of one core."""
    memory_mib: Trend
    counted: dict[str, Trend | None]
    """Trends of descriptors, threads and tasks; None for tasks without a loop."""

    @property
    def faults(self) -> list[str]:
        """Return what grew and must not, in words."""
        output, m = [], self.memory_mib
        if m.growth >= GROWTH_MAX:
            output.append(f"memory grew by {m.growth:.1%} ({m.first:.1f} to {m.last:.1f} MiB)")
        for name, trend in self.counted.items():
            if trend is not None and trend.last > trend.first:
                output.append(f"{name} grew from {trend.first:g} to {trend.last:g}")
        return output

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        values: dict[str, Any] = to_builtins(self)
        return {**values, **values.pop("counted"), "memory_growth": self.memory_mib.growth, "faults": self.faults}

    def in_words(self, virtual: bool) -> list[str]:
        """Return a line for each quantity."""
        m = self.memory_mib
        lines = [
            f"memory     {m.first:.1f} to {m.last:.1f} MiB ({m.growth:+.2%}, most {m.most:.1f}) after {self.warm_up_s:.0f} s"
        ]
        for name, trend in self.counted.items():
            if trend is not None:
                lines.append(f"{name:<10} {trend.first:g} to {trend.last:g} (most {trend.most:g})")
        return [*lines, f"CPU        {self.cpu_share:.0%} of a core" + (", as fast as it goes" if virtual else "")]


def findings(readings: Sequence[Reading], warm_up_s: float) -> Findings | None:
    """Return the trends; None while fewer than eight readings are past the warm-up."""
    after = [r for r in readings if r.at_s >= warm_up_s]
    if len(after) < _READINGS_MIN:
        return None
    hours = (np.array([r.at_s for r in after]) - after[0].at_s) / 3600.0

    def trend(name: str) -> Trend | None:
        values = [getattr(r, name) for r in after]
        if None in values:
            return None
        slope = float(np.polyfit(hours, values, 1)[0]) if hours[-1] > 0.0 else 0.0
        quarter = len(values) // 4
        return Trend(float(median(values[:quarter])), float(median(values[-quarter:])), float(max(values)), slope)

    wall_s = after[-1].at_s - after[0].at_s
    memory_mib = trend("memory_mib")
    assert memory_mib is not None
    return Findings(
        duration_s=readings[-1].at_s,
        warm_up_s=warm_up_s,
        flights=readings[-1].flights,
        readings=len(after),
        cpu_share=(after[-1].cpu_s - after[0].cpu_s) / wall_s if wall_s > 0 else 0.0,
        memory_mib=memory_mib,
        counted={name: trend(name) for name in ("descriptors", "threads", "tasks")},
    )


def warm_up_s(readings: Sequence[Reading]) -> float:
    """Return the length of the warm-up: a share of the run, and in a long one at least its first `WARM_UP_FLIGHTS` flights."""
    usual_s = min(WARM_UP_MOST_S, WARM_UP_SHARE * readings[-1].at_s)
    if readings[-1].flights < 2 * WARM_UP_FLIGHTS:
        return usual_s
    return max(usual_s, next(reading.at_s for reading in readings if reading.flights >= WARM_UP_FLIGHTS))
