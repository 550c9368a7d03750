"""ONBOARD_COMPUTER_STATUS: the load, memory and temperature of this host, as Linux reports them."""

import math
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

from msgspec import Struct

from drivers.mavlink.dialect import Message, mav
from estimator.contracts.time import MonoNs

_UNKNOWN_8, _UNKNOWN_16, _UNKNOWN_32 = 255, 32767, 0xFFFFFFFF
_NO_TEMPERATURE = 127
_LONGEST = 1 << 20
"""The most characters that are read from one file."""
T = TypeVar("T")


class Computer(Struct, frozen=True):
    """One reading; a field is None if the host does not report it."""

    cores_percent: tuple[int, ...]
    memory_used_mib: int | None
    memory_total_mib: int | None
    temperature_c: int | None
    uptime_s: float | None


class ComputerReader:
    """Reads `/proc` and `/sys`; the load is the mean since the previous reading."""

    def __init__(self, root: Path = Path("/")) -> None:
        self._root = root
        self._before: list[tuple[int, int]] = []

    def read(self) -> Computer:
        """Return the current state. It never raises: a value that cannot be read or parsed is None."""
        memory = _tried(self._memory) or {}
        used = memory["MemTotal"] - memory["MemAvailable"] if {"MemTotal", "MemAvailable"} <= memory.keys() else None
        total = memory.get("MemTotal")
        return Computer(
            cores_percent=_tried(self._load) or (),
            memory_used_mib=None if used is None else used // 1024,
            memory_total_mib=None if total is None else total // 1024,
            temperature_c=_tried(self._temperature),
            uptime_s=_tried(self._uptime_s),
        )

    def _text(self, path: str) -> str:
        with (self._root / path).open() as file:
            return file.read(_LONGEST)

    def _load(self) -> tuple[int, ...]:
        now: list[tuple[int, int]] = []
        for line in self._text("proc/stat").splitlines():
            name, *numbers = line.split() or [""]
            if name.startswith("cpu") and name != "cpu" and len(numbers) >= 5:
                ticks = [int(n) for n in numbers]
                now.append((sum(ticks) - ticks[3] - ticks[4], sum(ticks)))
        before, self._before = self._before, now
        if len(before) != len(now):
            return ()
        spans = [(busy - b, total - t) for (busy, total), (b, t) in zip(now, before, strict=True)]
        return tuple(min(max(round(100 * busy / total), 0), 100) if total > 0 else 0 for busy, total in spans)

    def _memory(self) -> dict[str, int]:
        pairs = (line.split() for line in self._text("proc/meminfo").splitlines())
        return {p[0].rstrip(":"): int(p[1]) for p in pairs if len(p) >= 2 and p[1].isdigit()}

    def _uptime_s(self) -> float | None:
        uptime_s = float(self._text("proc/uptime").split()[0])
        return uptime_s if math.isfinite(uptime_s) else None

    def _temperature(self) -> int | None:
        readings = []
        for entry in os.listdir(self._root / "sys/class/thermal"):
            if entry.startswith("thermal_zone"):
                # Reading a zone whose sensor does not answer raises an error; the other zones are still worth reading.
                path = f"sys/class/thermal/{entry}/temp"
                readings.append(_tried(partial(self._celsius, path)))
        known = [reading for reading in readings if reading is not None]
        return max(known) if known else None

    def _celsius(self, path: str) -> int:
        return round(int(self._text(path)) / 1000)


def _tried(read: Callable[[], T]) -> T | None:
    """Return what `read` returns, or None if the host does not report it or reports something other than a number.

    Every reading goes through here, so that one that fails (no descriptors left, a sensor gone) costs only itself.
    """
    try:
        return read()
    except (OSError, ValueError, IndexError):
        return None


def computer_status(computer: Computer, now: MonoNs) -> Message:
    """Return the message for one reading."""
    cores = list(computer.cores_percent[:8])
    combined = round(sum(cores) / len(cores)) if cores else _UNKNOWN_8
    temperature = _NO_TEMPERATURE if computer.temperature_c is None else min(max(computer.temperature_c, -126), 126)
    uptime_ms = 0 if computer.uptime_s is None else round(1000 * computer.uptime_s) & 0xFFFFFFFF
    return mav.MAVLink_onboard_computer_status_message(
        now // 1000,
        uptime_ms,
        0,
        cores + [_UNKNOWN_8] * (8 - len(cores)),
        [combined] + [_UNKNOWN_8] * 9,
        [_UNKNOWN_8] * 4,
        [_UNKNOWN_8] * 10,
        temperature,
        [temperature] + [_NO_TEMPERATURE] * 7,
        [_UNKNOWN_16] * 4,
        _memory_field(computer.memory_used_mib),
        _memory_field(computer.memory_total_mib),
        *([_UNKNOWN_32] * n for n in (4, 4, 4, 6, 6, 6, 6, 6)),
    )


def _memory_field(mib: int | None) -> int:
    return _UNKNOWN_32 if mib is None else min(max(mib, 0), _UNKNOWN_32 - 1)
