"""The planner's numbers: way points, speeds, and the limits that end a try."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from estimator.contracts.geometry import F64
from estimator.contracts.samples import _vector


@dataclass(frozen=True, slots=True, eq=False)
class WayPoint:
    """A place against the pad, and how near is near enough."""

    d_body_pad_level: F64
    """(3,) m: (0, 0, 2) is two metres above the pad; (0.1, 0, 2) has the pad ten centimetres ahead of the nose."""
    reached_m: float
    """Horizontal distance of the drone."""
    reached_height_m: float
    dwell_s: float
    """It must stay that near for so long."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "d_body_pad_level", _vector("WayPoint.d_body_pad_level", self.d_body_pad_level, (3,)))
        if not (self.reached_m > 0.0 and self.reached_height_m > 0.0 and self.dwell_s >= 0.0):
            raise ValueError("reached_m and reached_height_m must be positive and dwell_s not negative")
        if not self.d_body_pad_level[2] > 0.0:
            raise ValueError(f"a way point must lie above the pad, got a height of {self.d_body_pad_level[2]} m")


@dataclass(frozen=True, slots=True)
class Plan:
    """Way points, speeds, and the budget of every try.

    Raises:
        ValueError: no way point, or a number out of its range.
    """

    way_points: tuple[WayPoint, ...]
    speed_m_s: float = 0.4
    slow_within_m: float = 1.0
    slow_least: float = 0.1
    """Smallest share of the speed, however near the way point."""
    lead_m: float = 0.8
    """The set point waits for a drone that is farther behind than this."""
    heading: Literal["keep", "align"] = "keep"
    """Turn until the nose points along the arrow, or leave the heading alone."""
    stale_after_s: float = 0.5
    """Age of the newest sighting beyond which the pad counts as lost."""
    blind_s: float = 4.0
    """Time after the last sight in which it flies on level to the way point by dead reckoning; 0 hovers at once."""
    blind_sigma_m: float = 1.0
    """Horizontal 1-sigma of the estimate above which it hovers instead."""
    climb_after_s: float = 1.5
    climb_m_s: float = 0.3
    safe_height_m: float = 2.0
    give_up_after_s: float = 20.0
    """Time without sight after which it gives up, summed up until sight has held for `SIGHT_HOLDS_S`."""
    touchdown_s: float = 0.6
    """The drone counts as near the last way point only if it will still be there after this at its present velocity."""
    sigma_land_m: float = 0.15
    """Horizontal 1-sigma of the estimate above which the drone does not land, however near it believes itself."""

    try_s: float = 120.0
    """A try, from the first sight to the deck, ends in a go-around after this long."""
    descend_s: float = 45.0
    """The same for its last leg alone."""
    losses_max: int = 8
    """Losses of sight that one try allows on its last leg."""
    blind_descent_max_m: float = 0.5
    """Height lost in one try between a last and a next sight, summed up."""
    go_arounds_max: int = 3
    land_timeout_s: float = 6.0
    """Time after the order to land within which the vehicle must report that it has landed."""
    another_pad: Literal["operator", "automatic"] = "operator"
    """Who decides when the pad is suddenly seen in a place that no motion explains: a person; or, once in a flight and only above
    the safe height, `another_pad_s` of unbroken sight of one pad alone."""
    another_pad_s: float = 5.0
    word_wait_s: float = 60.0
    """How long it waits for that person before it gives up."""

    def __post_init__(self) -> None:
        if not self.way_points:
            raise ValueError("a plan needs at least one way point")
        positive = (
            "speed_m_s", "slow_within_m", "slow_least", "lead_m", "stale_after_s", "climb_m_s", "sigma_land_m", "try_s",
            "descend_s", "blind_descent_max_m", "land_timeout_s", "another_pad_s", "word_wait_s",
        )  # fmt: skip
        for name in positive:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be positive, got {value}")
        if not (self.blind_s >= 0.0 and self.blind_sigma_m > 0.0 and self.touchdown_s >= 0.0):
            raise ValueError("blind_s and touchdown_s must not be negative, and blind_sigma_m must be positive")
        if self.losses_max < 0 or self.go_arounds_max < 0:
            raise ValueError("losses_max and go_arounds_max must not be negative")
        if not 0.0 < self.climb_after_s < self.give_up_after_s:
            raise ValueError("0 < climb_after_s < give_up_after_s must hold")

    @staticmethod
    def over_the_pad(via_height_m: float = 2.0, final_height_m: float = 0.3, pad_ahead_m: float = 0.0) -> Plan:
        """The thesis' way points, straight above the pad; or with the pad a little ahead, for a camera mounted at the nose."""
        return Plan(
            (
                WayPoint(np.array([pad_ahead_m, 0.0, via_height_m]), reached_m=0.25, reached_height_m=0.25, dwell_s=0.3),
                WayPoint(np.array([pad_ahead_m, 0.0, final_height_m]), reached_m=0.12, reached_height_m=0.12, dwell_s=0.2),
            )
        )
