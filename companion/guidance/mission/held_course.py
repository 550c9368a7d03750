"""The height against what is ordered, over the pad and over the ground.

A drone that is ordered down and rises for two seconds flies by a wrong sensor (`HeldCourse`): an accelerometer that reads 30 %
too much makes the filter estimate a deck that rises ever faster, and the law follows that deck up while the machine says
"descend". Time and sight do not show it; the height over the pad does, whatever the cause.

A vehicle that flies another course than ordered takes its orders from somebody else (`ClimbWatch`). A trim that drifts, a second
sender of commands or a load that it cannot lift change the vertical speed and leave the sensors right. No test of sensors names
them, and the law asks for more until it asks for all there is. Two heights witness it: the barometer's, which a gust changes, and
the one over the pad, which waves change. What is ordered then says nothing of what the vehicle will do; its own hover takes no
orders.
"""

from __future__ import annotations

import math

from msgspec import Struct, structs

from companion.settings.guidance import ClimbResponse
from estimator.contracts.samples import Baro
from estimator.contracts.time import MonoNs, seconds_between

LASTS_S = 2.0
"""Time for which it goes the other way, s: longer than any vehicle answers."""
LEAST_M = 0.3
"""Least distance flown by then, m: ground effect and gusts make less."""
_ORDERED_M_S = 0.1
"""Rate against the deck that is an order to change the height, m/s."""
OFF_M = 1.2
"""Difference from the ordered course that two heights in agreement do not have in flights as ordered, m."""
_ALONE = 2.5
"""Factor on it for a barometer alone, out of sight of the pad."""
_FORGETS_S = 5.0
"""Time constant with which a difference is forgotten, s: it goes by the last seconds, and no swell or weather adds up."""
_BARO_S = 0.5
"""Time constant of the barometer's mean, s: its noise is half a metre."""
_SETTLES_S = 1.5
"""Time of orders since a gap before which nothing is counted: the barometer's mean begins with one reading, which errs by a
metre, and the estimate with half of that (docs/decisions/integrity.md)."""
_LEAST_S = 3.0  # time of all orders before which nothing is concluded
_FASTEST_M_S = 2.0  # largest difference from the ordered rate that counts
_JUMP_M = 4.0  # step of a height that no vehicle flies within a cycle: it is the sensor's


class HeldCourse(Struct, frozen=True):
    """The height over the pad against the order: the height that has come nearest to what is ordered, and when."""

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
            return structs.replace(self, best_m=height_m, at=now)
        return self

    def against_m(self, now: MonoNs, height_m: float) -> float | None:
        """Return how far it has gone against the order for `LASTS_S`, m; None if it has not."""
        if self.at is None or seconds_between(self.at, now) < LASTS_S:
            return None
        moved_m = self.sign * (height_m - self.best_m)
        return moved_m if moved_m >= LEAST_M else None


class HeightCourse(Struct, frozen=True):
    """A height against the ordered course."""

    height_m: float | None = None
    """Height where orders and readings put it, None while it is not known: a mean of readings would lag a vehicle that moves."""
    off_m: float = 0.0
    """Height over the ordered course of the last seconds, m."""

    def to(self, read_m: float | None, ordered_m: float, since_last_s: float, since_read_s: float, share: float) -> HeightCourse:
        """Return the course after so much of an ordered climb, m; a gap and a jump tell nothing.

        Args:
            read_m: the newest reading, m; None if there is none that is fresh.
            since_read_s: time from the reading before to this one, s; 0 if it is the same one.
            share: weight of a new reading against the height that is expected.
        """
        off_m = math.exp(-since_last_s / _FORGETS_S) * self.off_m
        if read_m is None or self.height_m is None:
            return HeightCourse(read_m, off_m)
        expected_m = self.height_m + ordered_m
        beyond_m = read_m - expected_m if since_read_s > 0.0 else 0.0
        if abs(beyond_m) > _JUMP_M:
            return HeightCourse(read_m, off_m)
        most_m = _FASTEST_M_S * since_read_s
        return HeightCourse(expected_m + share * beyond_m, off_m + min(most_m, max(-most_m, share * beyond_m)))


class ClimbWatch(Struct, frozen=True):
    """Barometer and pad against the ordered climb."""

    climbs_m_s: float | None = None
    """Rate of climb by the orders; None where nothing was ordered in the cycle before."""
    baro: HeightCourse = HeightCourse()
    baro_at: MonoNs | None = None
    """Time of the newest reading."""
    pad: HeightCourse = HeightCourse()
    ordered_s: float = 0.0
    """Time for which orders were given, s."""
    since_gap_s: float = 0.0
    """Time for which they were given since the last gap, s."""

    def flown(
        self, ordered_m_s: float | None, baro: Baro | None, pad_m: float | None, climb: ClimbResponse, since_last_s: float
    ) -> ClimbWatch:
        """Return the memory after a cycle; without an order it keeps what it knows, for a hover says nothing of orders.

        Args:
            ordered_m_s: ordered rate of climb over the ground, m/s; None if none was.
            baro: the newest reading, which may be some cycles old; None if there is none that is fresh.
            pad_m: height over the pad, m; None while it is not seen.
            climb: the vehicle's response.
            since_last_s: time since the cycle before, s.
        """
        if ordered_m_s is None:
            return ClimbWatch(None, HeightCourse(None, self.baro.off_m), None, HeightCourse(None, self.pad.off_m), self.ordered_s)
        before_m_s = ordered_m_s if self.climbs_m_s is None else self.climbs_m_s
        answered = -math.expm1(-since_last_s / (climb.delay_s + climb.lag_s))
        climbs_m_s = before_m_s + answered * (ordered_m_s - before_m_s)
        by_orders_m = climbs_m_s * since_last_s
        at, baro_m = (None, None) if baro is None else (baro.stamp.measured_at, baro.height_m)
        since_read_s = 0.0 if at is None or self.baro_at is None else seconds_between(self.baro_at, at)
        course = self.baro.to(baro_m, by_orders_m, since_last_s, since_read_s, -math.expm1(-max(0.0, since_read_s) / _BARO_S))
        pad = self.pad.to(pad_m, by_orders_m, since_last_s, since_last_s, 1.0)
        if self.since_gap_s < _SETTLES_S:
            course, pad = structs.replace(course, off_m=self.baro.off_m), structs.replace(pad, off_m=self.pad.off_m)
        return ClimbWatch(climbs_m_s, course, at, pad, self.ordered_s + since_last_s, self.since_gap_s + since_last_s)

    @property
    def off_m(self) -> float | None:
        """Height over the ordered course, m, negative below it; None while the vehicle flies as ordered."""
        if self.ordered_s < _LEAST_S:
            return None
        baro_m, pad_m = self.baro.off_m, self.pad.off_m
        if self.pad.height_m is None and abs(baro_m) >= _ALONE * OFF_M:
            return baro_m
        least_m = min(abs(baro_m), abs(pad_m))
        return math.copysign(least_m, baro_m) if baro_m * pad_m > 0.0 and least_m >= OFF_M else None
