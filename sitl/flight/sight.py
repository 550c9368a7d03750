"""Watch how far a vehicle comes down without true sight of the pad."""

import math
from collections import Counter
from dataclasses import dataclass

from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs, seconds_between
from sitl.flight.hands import MOTORS_TURN, descent_m
from sitl.world.truth import Truth

BLIND_AFTER_S = 1.0
"""Time after the newest true sight that still counts as sight; the last 0.3 m of a landing, without the pad, take less."""
MET_AFTER_S = 0.5
"""Time after a command at which the vehicle has the speed that it requests, and meets the deck's."""
STAMP_ERROR_MAX_S = 0.5
"""Error of a frame's stamp beyond which the frame says nothing about the pad's present position."""


@dataclass(frozen=True, slots=True)
class BlindDescent:
    """The deepest descent without true sight of the pad."""

    descent_m: float
    """Descent from the height at which sight was lost: the smaller of those against the deck and over the ground."""
    lowest_m: float
    """Lowest height over the deck meanwhile."""
    blind_s: float
    """Time since the newest true sight, at that height."""


class SightWatch:
    """Watches how far the vehicle comes down without true sight of the pad.

    A descent while nothing reaches the vehicle is kept apart: no order ends it, whatever the service does.
    """

    def __init__(self, start: MonoNs) -> None:
        self.worst = BlindDescent(0.0, math.inf, 0.0)
        self.unreached_m = 0.0
        """Deepest descent during one time in which nothing reached the vehicle, metres."""
        self.deck_fell_m_s = 0.0
        """Fastest fall of the deck at the beginning of such a time, where the last command was meant to meet it."""
        self.since_sight: Counter[Verdict] = Counter()
        """Number of frames by verdict since the newest true sight."""
        self._seen_at = start
        self._lost_at_m: tuple[float, float] | None = None
        self._unreached_at_m: tuple[float, float] | None = None
        self._unreached_since = start

    def frame(self, exposed_at: MonoNs, verdict: Verdict, *, true_view: bool, stamp_error_s: float) -> None:
        """Note a frame and the service's verdict on it."""
        if verdict is Verdict.FUSED and true_view and abs(stamp_error_s) <= STAMP_ERROR_MAX_S:
            self._seen_at = max(self._seen_at, exposed_at)
            self.since_sight.clear()
        else:
            self.since_sight[verdict] += 1

    def step(self, truth: Truth, *, reached: bool, ours: bool) -> None:
        """Note the true state at an instant; call it in order of time.

        Args:
            reached: whether the service's commands reach the vehicle.
            ours: whether the service flies; a person who lands it where it is needs no sight of the pad.
        """
        at_m = float(truth.d_body_pad_level[2]), -float(truth.p_body_ned[2])
        if not reached:
            if self._unreached_at_m is None:
                self._unreached_at_m, self._unreached_since = at_m, truth.at
            if seconds_between(self._unreached_since, truth.at) <= MET_AFTER_S:
                self.deck_fell_m_s = max(self.deck_fell_m_s, float(truth.v_pad_ned[2]))
            if truth.phase in MOTORS_TURN:
                self.unreached_m = max(self.unreached_m, descent_m(self._unreached_at_m, at_m))
            return
        if self._unreached_at_m is not None:
            if self._lost_at_m is not None:
                height_m, altitude_m = (now - was for now, was in zip(at_m, self._unreached_at_m, strict=True))
                self._lost_at_m = self._lost_at_m[0] + height_m, self._lost_at_m[1] + altitude_m
            self._unreached_at_m = None
        blind_s = seconds_between(self._seen_at, truth.at)
        if not ours or blind_s <= BLIND_AFTER_S or truth.phase not in MOTORS_TURN:
            self._lost_at_m = None
            return
        if self._lost_at_m is None:
            self._lost_at_m = at_m
        came_down_m = descent_m(self._lost_at_m, at_m)
        if came_down_m > self.worst.descent_m:
            self.worst = BlindDescent(came_down_m, at_m[0], blind_s)
