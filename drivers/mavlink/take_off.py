"""Take a vehicle off from a deck, and average the velocity of the ship under it. No I/O."""

import math
from collections.abc import Callable
from typing import NamedTuple

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.vehicle import VELOCITY_MODE, Condition, Identity, Stack
from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between

CLIMB_M_S = 1.0
"""Rate of climb of a take-off."""
REST_S = 8.0
"""Time over which the velocity on deck is averaged, s: it keeps the ship's way and removes the waves."""
_RESET_M_S = 0.5
"""Step between two of the autopilot's velocities that is its filter's: what was averaged before was wrong."""
_LIFTED_M = 0.3  # climb from which the vehicle has left the deck
SHOWN_S = 0.5
"""Time from a request or an answer to a HEARTBEAT that surely is later, s."""


class Rested(NamedTuple):
    """Place, time and velocity of a vehicle that last stood."""

    at: MonoNs
    v_ned: F64
    """(3,) m/s, level: the mean velocity over the ground."""
    p_ned: F64
    """(3,) m from the origin of the autopilot's filter."""


class RestVelocity:
    """The mean velocity over the ground of a vehicle that stands: that of the deck under it."""

    def __init__(self) -> None:
        self._stood_s = 0.0
        self._last: F64 | None = None
        """The velocity before, (3,) m/s, level; None if it did not stand."""
        self.newest: Rested | None = None
        """None if it never stood."""

    def on_velocity(self, v_ned: F64, p_ned: F64, now: MonoNs, *, stands: bool) -> None:
        """Take the autopilot's velocity and place, (3,) m/s and m."""
        last, self._last = self._last, v_ned * (1.0, 1.0, 0.0) if stands else None
        if self._last is None:
            return
        mean = self._last
        if self.newest is not None and last is not None and math.dist(last, mean) < _RESET_M_S:
            since_s = max(seconds_between(self.newest.at, now), 0.0)
            self._stood_s += since_s
            mean = self.newest.v_ned + since_s / max(min(REST_S, self._stood_s), 1e-9) * (mean - self.newest.v_ned)
        else:
            self._stood_s = 0.0
        self.newest = Rested(now, mean, p_ned)


class TakingOff:
    """One take-off, from the order until the height is reached.

    Args:
        from_m: the position below the autopilot's origin at the order; None if it is not known.
        height_m: how far to climb.
    """

    def __init__(self, began: MonoNs, identity: Identity, from_m: float | None, height_m: float) -> None:
        self.began, self._id, self._from_m, self._height_m = began, identity, from_m, height_m
        self._asked: MonoNs | None = None
        self._arm_asked: MonoNs | None = None
        self._armed_at: MonoNs | None = None
        """Time of the answer that it is armed."""
        self._flew_at: MonoNs | None = None

    @property
    def flew(self) -> bool:
        """True once the vehicle has left the deck."""
        return self._flew_at is not None

    def on_flying(self, now: MonoNs) -> None:
        """Note that the vehicle flies."""
        self._flew_at = self._flew_at or now

    def on_position(self, down_m: float) -> None:
        """Take the position below the autopilot's origin where the one at the order was not known and it still stands, m."""
        if self._from_m is None and not self.flew:
            self._from_m = down_m

    @property
    def arms(self) -> bool:
        """True if arming was requested."""
        return self._arm_asked is not None

    def may_arm(self, now: MonoNs, within_s: float) -> bool:
        """Return whether arming was requested so lately that it may still follow."""
        return self._arm_asked is not None and seconds_between(self._arm_asked, now) <= within_s

    def on_armed(self, now: MonoNs) -> None:
        """Note the answer that it is armed."""
        self._armed_at = now

    def was_armed(self, now: MonoNs) -> bool:
        """Return whether it was armed by its answer, so long ago that a report shows it."""
        return self._armed_at is not None and seconds_between(self._armed_at, now) >= SHOWN_S

    def climbed_m(self, down_m: float | None) -> float:
        """Return how far it has climbed."""
        return 0.0 if down_m is None or self._from_m is None else self._from_m - down_m

    def done(self, now: MonoNs, down_m: float | None) -> bool:
        """Return whether the height is reached; where no height is known, whether it has flown for as long as that takes."""
        if self._flew_at is None:
            return False
        if down_m is None or self._from_m is None:
            return CLIMB_M_S * seconds_between(self._flew_at, now) >= self._height_m
        return self.climbed_m(down_m) >= self._height_m

    def steers(self, down_m: float | None, condition: Condition) -> bool:
        """Return whether setpoints are sent: ArduCopter's own take-off must have left the deck."""
        if self._id.stack is Stack.PX4:
            return True
        return condition.armed is True and bool(condition.flying) and self.climbed_m(down_m) >= _LIFTED_M

    def climb_m_s(self, condition: Condition) -> float:
        """Return the vertical speed of the setpoints, m/s down: none before the motors turn."""
        return -CLIMB_M_S if condition.armed else 0.0

    def requests(
        self, now: MonoNs, condition: Condition, period_s: float, ask: Callable[[str, MonoNs], list[Message]]
    ) -> list[Message]:
        """Return the request that is due: mode, arming, and ArduCopter's take-off.

        Args:
            period_s: time after which a request is repeated.
            ask: makes the request for a mode.
        """
        if self._asked is not None and seconds_between(self._asked, now) < period_s:
            return []
        mode = VELOCITY_MODE[self._id.stack]
        if condition.mode == mode and condition.armed and (not self._id.stack.is_ardupilot or condition.flying):
            return []
        self._asked = now
        if condition.mode != mode:
            return ask(mode, now)
        if not condition.armed:
            self._arm_asked = now
            return [self._command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)]
        return [self._command(mav.MAV_CMD_NAV_TAKEOFF, height_m=self._height_m)]

    def _command(self, number: int, param1: float = 0.0, *, height_m: float = 0.0) -> Message:
        return mav.MAVLink_command_long_message(*self._id.address, number, 0, param1, 0, 0, 0, 0, 0, height_m)
