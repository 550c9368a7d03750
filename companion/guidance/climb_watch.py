"""The height against what was ordered: a vehicle that goes on flying another course takes its orders from somebody else.

A trim that drifts, a second sender of commands or a load that it cannot lift change the vertical speed and leave the sensors
right, so no test of sensors names them, and the law asks for more until it asks for all there is. Two heights witness it: the
barometer's, which a gust changes, and the one over the pad, which waves change. What is ordered then says nothing of what the
vehicle will do; its own hover takes no orders.
"""

import math

from msgspec import Struct

from companion.settings.response import ClimbResponse

OFF_M = 1.2
"""Difference from the ordered course that two heights in agreement do not have in flights as ordered, m."""
_ALONE = 2.5
"""Factor on it for a barometer alone."""
_FORGETS_S = 5.0
"""Time constant with which a difference is forgotten, s: it goes by the last seconds, and no swell or weather adds up."""
_BARO_S = 0.5
"""Time constant of the barometer's mean, s: its noise is half a metre."""


class HeightCourse(Struct, frozen=True):
    """A height against the ordered course."""

    height_m: float | None = None
    """The newest; None while it is not known."""
    off_m: float = 0.0
    """Height over the ordered course of the last seconds, m."""

    def to(self, height_m: float | None, ordered_m: float, keeps: float) -> "HeightCourse":
        """Return the course at the next height, after so much of an ordered climb, m; a gap tells nothing."""
        if height_m is None or self.height_m is None:
            return HeightCourse(height_m, keeps * self.off_m)
        return HeightCourse(height_m, keeps * self.off_m + height_m - self.height_m - ordered_m)


class ClimbWatch(Struct, frozen=True):
    """The memory."""

    climbs_m_s: float | None = None
    """Rate of climb by the orders; None where nothing was ordered in the cycle before."""
    baro: HeightCourse = HeightCourse()
    pad: HeightCourse = HeightCourse()

    def flown(
        self, ordered_m_s: float | None, baro_m: float | None, pad_m: float | None, climb: ClimbResponse, since_last_s: float
    ) -> "ClimbWatch":
        """Return the memory after a cycle; without an order it keeps what it knows, for a hover says nothing of orders.

        Args:
            ordered_m_s: ordered rate of climb over the ground, m/s; None if none was.
            baro_m: height by the barometer, m; None if it is not known.
            pad_m: height over the pad, m; None while it is not seen.
            climb: the vehicle's response.
            since_last_s: time since the cycle before, s.
        """
        if ordered_m_s is None:
            return ClimbWatch(None, HeightCourse(None, self.baro.off_m), HeightCourse(None, self.pad.off_m))
        if baro_m is not None and self.baro.height_m is not None:
            baro_m = self.baro.height_m - math.expm1(-since_last_s / _BARO_S) * (baro_m - self.baro.height_m)
        before_m_s = ordered_m_s if self.climbs_m_s is None else self.climbs_m_s
        answered = -math.expm1(-since_last_s / (climb.delay_s + climb.lag_s))
        climbs_m_s = before_m_s + answered * (ordered_m_s - before_m_s)
        keeps = math.exp(-since_last_s / _FORGETS_S)
        by_orders_m = climbs_m_s * since_last_s
        return ClimbWatch(climbs_m_s, self.baro.to(baro_m, by_orders_m, keeps), self.pad.to(pad_m, by_orders_m, keeps))

    @property
    def off_m(self) -> float | None:
        """Height over the ordered course, m, negative below it; None while the vehicle flies as ordered."""
        baro_m, pad_m = self.baro.off_m, self.pad.off_m
        agree = math.copysign(min(abs(baro_m), abs(pad_m)), baro_m) if baro_m * pad_m > 0.0 else 0.0
        if abs(baro_m) >= _ALONE * OFF_M:
            return baro_m
        return agree if abs(agree) >= OFF_M else None
