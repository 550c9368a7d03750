"""The height against what is ordered: a drone that is ordered down and rises for two seconds flies by a wrong sensor.

An accelerometer that reads 30 % too much makes the filter estimate a deck that rises ever faster, and the law follows that deck
up while the machine says "descend". Time and sight do not show it; the height over the pad does, whatever the cause.
"""

from __future__ import annotations

from msgspec import Struct
from msgspec.structs import replace

from estimator.contracts.time import MonoNs, seconds_between

LASTS_S = 2.0
"""Time for which it goes the other way, s: longer than any vehicle answers."""
LEAST_M = 0.3
"""Least distance flown by then, m: ground effect and gusts make less."""
_ORDERED_M_S = 0.1
"""Rate against the deck that is an order to change the height, m/s."""


class HeldCourse(Struct, frozen=True):
    """The memory: the height that has come nearest to what is ordered, and when."""

    sign: int = 0
    """1 ordered down, -1 ordered up, 0 neither."""
    best_m: float = 0.0
    at: MonoNs | None = None

    def ordered(self, rate_m_s: float | None) -> HeldCourse:
        """Return the memory after the order of a cycle with sight, m/s against the deck, down positive; None holds a height."""
        sign = 0 if rate_m_s is None or abs(rate_m_s) < _ORDERED_M_S else 1 if rate_m_s > 0.0 else -1
        return self if sign == self.sign else HeldCourse(sign)

    def at_height(self, now: MonoNs, height_m: float, *, explained: bool) -> HeldCourse:
        """Return the memory after a height over the pad, m.

        Args:
            explained: whether the deck itself moves away faster than the drone can follow.
        """
        if self.sign == 0:
            return self
        if self.at is None or explained or self.sign * (height_m - self.best_m) < 0.0:
            return replace(self, best_m=height_m, at=now)
        return self

    def against_m(self, now: MonoNs, height_m: float) -> float | None:
        """Return how far it has gone against the order for `LASTS_S`, m; None if it has not."""
        if self.at is None or seconds_between(self.at, now) < LASTS_S:
            return None
        moved_m = self.sign * (height_m - self.best_m)
        return moved_m if moved_m >= LEAST_M else None
