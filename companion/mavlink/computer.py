"""ONBOARD_COMPUTER_STATUS: load, memory and temperature of this host, as Linux tells them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from drivers.mavlink.dialect import Message, mav
from estimator.contracts.time import MonoNs

_UNKNOWN_8, _UNKNOWN_16, _UNKNOWN_32 = 255, 32767, 0xFFFFFFFF
_NO_TEMPERATURE = 127


@dataclass(frozen=True, slots=True)
class Computer:
    """One reading; None where the host does not tell."""

    cores_percent: tuple[int, ...]
    memory_used_mib: int | None
    memory_total_mib: int | None
    temperature_c: int | None
    uptime_s: float | None


class ComputerReader:
    """Reads `/proc` and `/sys`; the load is that since the last reading."""

    def __init__(self, root: Path = Path("/")) -> None:
        self._root = root
        self._before: list[tuple[int, int]] = []

    def read(self) -> Computer:
        """The state now. Never raises: what cannot be read is None."""
        memory = self._memory()
        used = memory["MemTotal"] - memory["MemAvailable"] if {"MemTotal", "MemAvailable"} <= memory.keys() else None
        total = memory.get("MemTotal")
        uptime = self._text("proc/uptime").split()
        return Computer(
            cores_percent=self._load(),
            memory_used_mib=None if used is None else used // 1024,
            memory_total_mib=None if total is None else total // 1024,
            temperature_c=self._temperature(),
            uptime_s=float(uptime[0]) if uptime else None,
        )

    def _text(self, path: str) -> str:
        try:
            return (self._root / path).read_text()
        except (OSError, UnicodeDecodeError):
            return ""

    def _load(self) -> tuple[int, ...]:
        now: list[tuple[int, int]] = []
        for line in self._text("proc/stat").splitlines():
            name, *numbers = line.split()
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

    def _temperature(self) -> int | None:
        readings = []
        for zone in sorted((self._root / "sys/class/thermal").glob("thermal_zone*")):
            text = self._text(str(zone.relative_to(self._root) / "temp")).strip()
            if text.lstrip("-").isdigit():
                readings.append(round(int(text) / 1000))
        return max(readings) if readings else None


def computer_status(computer: Computer, now: MonoNs) -> Message:
    """The message for one reading."""
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
        _UNKNOWN_32 if computer.memory_used_mib is None else computer.memory_used_mib,
        _UNKNOWN_32 if computer.memory_total_mib is None else computer.memory_total_mib,
        [_UNKNOWN_32] * 4,
        [_UNKNOWN_32] * 4,
        [_UNKNOWN_32] * 4,
        [_UNKNOWN_32] * 6,
        [_UNKNOWN_32] * 6,
        [_UNKNOWN_32] * 6,
        [_UNKNOWN_32] * 6,
        [_UNKNOWN_32] * 6,
    )
