"""The budget of one try to land: time, losses of sight, height lost without sight. Only a new try resets it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from companion.guidance.plan import Plan
from estimator.contracts.time import MonoNs, seconds_between

SIGHT_HOLDS_S = 5.0
"""Unbroken sight for this long resets the time without sight, seconds."""
_GAP_MAX_S = 1.0
"""Longest time that one guidance cycle adds, seconds, even if the planner was not called for longer."""


@dataclass(frozen=True, slots=True)
class Spent:
    """The part of the budget that a try has used so far."""

    began: MonoNs | None = None
    """Time of the first sight of the pad."""
    descending: MonoNs | None = None
    """Time at which the last leg began."""
    losses: int = 0
    """Number of losses of sight on the last leg or below the safe height."""
    blind_descent_m: float = 0.0
    without_sight_s: float = 0.0
    with_sight_s: float = 0.0
    """Time of unbroken sight, seconds."""

    def seen(self, now: MonoNs, since_last_s: float) -> Spent:
        """Add one guidance cycle with sight of the pad."""
        held = self.with_sight_s + min(max(0.0, since_last_s), _GAP_MAX_S)
        without = 0.0 if held >= SIGHT_HOLDS_S else self.without_sight_s
        return replace(self, began=now if self.began is None else self.began, with_sight_s=held, without_sight_s=without)

    def unseen(self, since_last_s: float) -> Spent:
        """Add one guidance cycle without sight of the pad."""
        without = self.without_sight_s + min(max(0.0, since_last_s), _GAP_MAX_S)
        return replace(self, with_sight_s=0.0, without_sight_s=without)

    def lost(self) -> Spent:
        """Add one loss of sight in the descent."""
        return replace(self, losses=self.losses + 1)

    def descended(self, metres: float) -> Spent:
        """Add the height lost between two sights, metres; climbing gives nothing back."""
        return replace(self, blind_descent_m=self.blind_descent_m + max(0.0, metres))

    def descends(self, now: MonoNs) -> Spent:
        """Note that the last leg has begun."""
        return self if self.descending is not None else replace(self, descending=now)

    def exhausted(self, plan: Plan, now: MonoNs) -> str | None:
        """Return what is used up, as text for the operator, or None while nothing is."""
        if self.began is not None and seconds_between(self.began, now) > plan.options.try_s:
            return f"no landing within {plan.options.try_s:g} s"
        if self.descending is not None and seconds_between(self.descending, now) > plan.options.descend_s:
            return f"no landing within {plan.options.descend_s:g} s of descent"
        if self.losses > plan.options.losses_max:
            return f"the pad was lost {self.losses} times in one descent"
        if self.blind_descent_m > plan.options.blind_descent_max_m:
            return f"{self.blind_descent_m:.2f} m lower without sight of the pad"
        return None
