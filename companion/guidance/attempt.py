"""The budget of one attempt to land: time, losses of sight, height lost without sight. A go-around or an order begins another."""

from __future__ import annotations

from msgspec import Struct
from msgspec.structs import replace

from companion.base.reason import Reason, ReasonCause
from companion.settings.mission import TryOptions
from estimator.contracts.time import MonoNs, seconds_between

SIGHT_HOLDS_S = 5.0
"""Unbroken sight for this long resets the time without sight, seconds."""
STARVED_S, _STARVED_MOST_S = 0.25, 2.0
"""Gap between two guidance cycles in which a vehicle has flown blindly on, and how much of it an attempt may have, seconds."""
_GAP_MAX_S = 1.0
"""Longest time that one guidance cycle adds, seconds, even if the machine was not called for longer."""


class Attempt(Struct, frozen=True):
    """Time and retries that a landing attempt has used so far."""

    began: MonoNs | None = None
    """Time of the first sight of the pad."""
    losses: int = 0
    """Number of losses of sight below the safe height."""
    blind_descent_m: float = 0.0
    without_sight_s: float = 0.0
    over_pad_s: float = 0.0
    """Time over the pad at height, all visits together."""
    in_descent_s: float = 0.0
    """Time in the descent, all visits together."""
    at_gate_s: float = 0.0
    """Time at the gate, all visits together."""
    with_sight_s: float = 0.0
    """Time of unbroken sight, seconds."""
    starved_s: float = 0.0
    """Time in gaps between guidance cycles, seconds: of a computer that is too slow, or that stood still."""

    def seen(self, now: MonoNs, since_last_s: float) -> Attempt:
        """Add one guidance cycle with sight of the pad."""
        held = self.with_sight_s + _counted_s(since_last_s)
        without = 0.0 if held >= SIGHT_HOLDS_S else self.without_sight_s
        return replace(self, began=now if self.began is None else self.began, with_sight_s=held, without_sight_s=without)

    def unseen(self, since_last_s: float) -> Attempt:
        """Add one guidance cycle without sight of the pad."""
        without = self.without_sight_s + _counted_s(since_last_s)
        return replace(self, with_sight_s=0.0, without_sight_s=without)

    def over_pad(self, since_last_s: float) -> Attempt:
        """Add one guidance cycle over the pad at height."""
        return replace(self, over_pad_s=self.over_pad_s + _counted_s(since_last_s))

    def in_descent(self, since_last_s: float) -> Attempt:
        """Add one guidance cycle in the descent."""
        return replace(self, in_descent_s=self.in_descent_s + _counted_s(since_last_s))

    def at_gate(self, since_last_s: float) -> Attempt:
        """Add one guidance cycle at the gate."""
        return replace(self, at_gate_s=self.at_gate_s + _counted_s(since_last_s))

    def cycle(self, since_last_s: float) -> Attempt:
        """Add one guidance cycle as late as it comes."""
        return self if since_last_s <= STARVED_S else replace(self, starved_s=self.starved_s + since_last_s)

    def lost(self) -> Attempt:
        """Add one loss of sight."""
        return replace(self, losses=self.losses + 1)

    def descended(self, metres: float) -> Attempt:
        """Add the height lost between two sights, metres; climbing gives nothing back."""
        return replace(self, blind_descent_m=self.blind_descent_m + max(0.0, metres))

    def again(self) -> Attempt:
        """Return the budget of the next attempt: the remaining time without sight carries over."""
        return Attempt(without_sight_s=self.without_sight_s)

    def used_up(self, options: TryOptions, now: MonoNs) -> Reason | None:
        """Return what is used up, or None while nothing is."""
        if self.began is not None and seconds_between(self.began, now) > options.try_s:
            return Reason(ReasonCause.TRY_TIME, seconds_between(self.began, now), options.try_s)
        if self.losses > options.losses_max:
            return Reason(ReasonCause.LOSSES, float(self.losses), float(options.losses_max))
        if self.starved_s > _STARVED_MOST_S:
            return Reason(ReasonCause.STARVED, self.starved_s, _STARVED_MOST_S)
        if self.blind_descent_m > options.blind_descent_max_m:
            return Reason(ReasonCause.BLIND_DESCENT, self.blind_descent_m, options.blind_descent_max_m)
        return None


def _counted_s(since_last_s: float) -> float:
    """Return the time that a guidance cycle adds, s."""
    return min(max(0.0, since_last_s), _GAP_MAX_S)
