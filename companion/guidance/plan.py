"""The planner's way points and the options of guidance."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.guidance.options import GuidanceOptions, PlannerOptions
from estimator.contracts.geometry import F64
from estimator.contracts.samples import _vector


@dataclass(frozen=True, slots=True, eq=False)
class WayPoint:
    """A position relative to the pad, with the tolerances for reaching it."""

    d_body_pad_level: F64
    """(3,) m: (0, 0, 2) is two metres above the pad; (0.1, 0, 2) has the pad ten centimetres ahead of the nose."""
    reached_m: float
    """Horizontal distance within which the drone counts as there, metres."""
    reached_height_m: float
    dwell_s: float
    """Time that the drone must stay that near, seconds."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "d_body_pad_level", _vector("WayPoint.d_body_pad_level", self.d_body_pad_level, (3,)))
        if not (self.reached_m > 0.0 and self.reached_height_m > 0.0 and self.dwell_s >= 0.0):
            raise ValueError("reached_m and reached_height_m must be positive and dwell_s not negative")
        if not self.d_body_pad_level[2] > 0.0:
            raise ValueError(f"a way point must lie above the pad, got a height of {self.d_body_pad_level[2]} m")


@dataclass(frozen=True, slots=True)
class Plan:
    """The way points and the options of guidance.

    Raises:
        ValueError: there is no way point.
    """

    way_points: tuple[WayPoint, ...]
    guidance: GuidanceOptions = field(default_factory=GuidanceOptions)

    def __post_init__(self) -> None:
        if not self.way_points:
            raise ValueError("a plan needs at least one way point")

    @property
    def options(self) -> PlannerOptions:
        """The planner's own options."""
        return self.guidance.planner

    @staticmethod
    def over_the_pad(guidance: GuidanceOptions | None = None) -> Plan:
        """Return the plan of the thesis: two way points straight above the pad, or with the pad ahead as the options say."""
        guidance = guidance or GuidanceOptions()
        o = guidance.planner
        approach = np.array([o.pad_ahead_m, 0.0, o.approach_height_m])
        final = np.array([o.pad_ahead_m, 0.0, o.final_height_m])
        return Plan(
            (
                WayPoint(approach, o.approach_reached_m, o.approach_reached_height_m, o.approach_dwell_s),
                WayPoint(final, o.final_reached_m, o.final_reached_height_m, o.final_dwell_s),
            ),
            guidance,
        )
