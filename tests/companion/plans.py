"""Plans with some of their options changed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from msgspec import structs

from companion.guidance.options import GuidanceOptions, PlannerOptions
from companion.guidance.plan import Plan


def planned(**changes: Any) -> Plan:
    """Return the plan over the pad with these options of the planner."""
    return Plan.over_the_pad(GuidanceOptions(planner=PlannerOptions(**changes)))


def changed(plan: Plan, **changes: Any) -> Plan:
    """Return a plan with the same way points and these options of the planner."""
    planner = structs.replace(plan.options, **changes)
    return replace(plan, guidance=structs.replace(plan.guidance, planner=planner))
