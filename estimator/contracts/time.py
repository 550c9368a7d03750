"""Instants of this host's monotonic clock, how well a sample's instant is known, and the clock."""

from __future__ import annotations

import math
from typing import Literal, NewType, Protocol

from msgspec import Struct

MonoNs = NewType("MonoNs", int)
"""An instant of this host's CLOCK_MONOTONIC in nanoseconds; never wall time."""

NS_PER_S = 1_000_000_000  # Nanoseconds of a second

StampSource = Literal["hw", "kernel", "synced", "arrival", "sim"]


def seconds_between(earlier: MonoNs, later: MonoNs) -> float:
    """Return the time from `earlier` to `later`, s; it is negative if `later` is before `earlier`."""
    return (later - earlier) / NS_PER_S


def after(instant: MonoNs, seconds: float) -> MonoNs:
    """Return the instant `seconds` after `instant` (before it if negative)."""
    return MonoNs(instant + round(seconds * NS_PER_S))


class Stamp(Struct, frozen=True):
    """The time of measurement, the time of reception, and the uncertainty of the former.

    Raises:
        ValueError: sigma is negative or absurd (1 s or more), or the measurement is later than the reception by over 5 sigma.
    """

    measured_at: MonoNs
    """Mid-exposure or sampling instant."""
    received_at: MonoNs
    """Instant at which the first byte reached this process."""
    sigma_s: float
    """One standard deviation of `measured_at`, seconds."""
    source: StampSource

    def __post_init__(self) -> None:
        if not 0.0 <= self.sigma_s < 1.0:
            raise ValueError(f"a stamp's sigma must lie in [0, 1) s, got {self.sigma_s}")
        ahead_ns = self.measured_at - self.received_at
        if ahead_ns > 0 and ahead_ns > round(5 * NS_PER_S * self.sigma_s):
            raise ValueError(f"a sample cannot arrive before it is measured: {self}")

    @staticmethod
    def from_seconds(
        measured_s: float, received_s: float | None = None, *, sigma_s: float = 0.0, source: StampSource = "hw"
    ) -> Stamp:
        """Return the stamp of instants given in seconds of the monotonic clock; without `received_s` the sample has no delay.

        Raises:
            ValueError: as for the class; nan or an infinite number of seconds.
        """
        received_s = measured_s if received_s is None else received_s
        if not (math.isfinite(measured_s) and math.isfinite(received_s)):
            raise ValueError(f"a stamp needs finite seconds, got {measured_s!r} and {received_s!r}")
        return Stamp(MonoNs(round(measured_s * NS_PER_S)), MonoNs(round(received_s * NS_PER_S)), sigma_s, source)

    @property
    def delay_s(self) -> float:
        """Time from measurement to reception, s."""
        return seconds_between(self.measured_at, self.received_at)


class Clock(Protocol):
    """The only source of time in the service; replay and simulation pass another one."""

    def now(self) -> MonoNs: ...

    async def sleep(self, seconds: float) -> None: ...
