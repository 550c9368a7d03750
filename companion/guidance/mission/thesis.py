"""The thesis' way (`guidance.mission = "thesis"`): two way points, and from the last one the vehicle's own landing.

It ends at a height from which the vehicle lands by itself, still in the air: the gate leads to DOWN, there is no COMMIT and no
contact, and from there only the time, a climb or a drift ends it. All else is as in the other mission.
"""

import math
from collections.abc import Iterator, Mapping

import numpy as np

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.mission import limits
from companion.guidance.mission.progress import GuidanceCycle, Progress, unfit
from companion.guidance.mission.rules import EventWithReason, Row
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.estimates import RelativeState
from estimator.contracts.time import seconds_between

_RISEN_M = 0.4  # rise that ends the vehicle's own landing
_ASIDE_M = 0.3  # distance beside the pad, over that of the last way point, that ends it
_BLIND_MARGIN_M = 0.1  # margin of the height below which the pad leaves the view


def ways(cone: Mapping[State, Row]) -> Mapping[State, Row]:
    """Return the rows of the thesis' mission, by those of the other one."""
    rows: dict[State, Row] = {}
    for state, row in cone.items():
        touches = state in (State.COMMIT, State.LAND_HERE)
        rows[state] = row if touches else {event: to for event, to in row.items() if event is not Event.CONTACT}
    rows[State.GATE] = {**rows[State.GATE], Event.GATE_OPEN: State.DOWN}
    rows[State.DOWN] = {**rows[State.DOWN], Event.OTHER_PAD: State.ANOTHER_PAD}
    return rows


def near(estimate: RelativeState, ahead_m: float, height_m: float, reached_m: float) -> bool:
    """Return whether the drone is within `reached_m` of a way point, aside and in height."""
    x, y, z = estimate.d_body_pad_level.tolist()
    return math.hypot(x - ahead_m, y) <= reached_m and abs(z - height_m) <= reached_m


def over_pad(s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> Iterator[EventWithReason]:
    """Yield that the first way point is reached (INTERCEPT)."""
    way = o.thesis
    if near(estimate, way.pad_ahead_m, way.approach_height_m, way.approach_reached_m) and s.thing is None:
        yield Event.IN_CONE, Reason(ReasonCause.ARRIVED, estimate.lateral_m, way.approach_reached_m)


def down(s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> Iterator[EventWithReason]:
    """Yield that the last way point is reached (DESCEND)."""
    way = o.thesis
    if near(estimate, way.pad_ahead_m, way.final_height_m, way.final_reached_m):
        yield Event.AT_GATE, Reason(ReasonCause.LOW_ENOUGH, estimate.height_m, way.final_height_m)


def left_gate(estimate: RelativeState, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield that the drone has left the last way point (GATE)."""
    way = o.thesis
    if not near(estimate, way.pad_ahead_m, way.final_height_m, 2.0 * way.final_reached_m):
        yield Event.OUT_OF_CONE, Reason(ReasonCause.OUT_OF_CONE, estimate.lateral_m, way.final_reached_m)


def bars_gate(estimate: RelativeState, o: GuidanceOptions) -> Reason | None:
    """Return what keeps the drone at the last way point, or None."""
    way = o.thesis
    off = np.array(estimate.d_body_pad_level[:2])
    off[0] -= way.pad_ahead_m
    then = off + way.touchdown_s * estimate.v_pad_level[:2]
    sigma = limits.sigma_m(estimate)
    if sigma > o.limits.sigma_m:
        return Reason(ReasonCause.SIGMA, sigma, o.limits.sigma_m)
    if not near(estimate, way.pad_ahead_m, way.final_height_m, way.final_reached_m):
        return Reason(ReasonCause.ERROR, float(np.hypot(*off)), way.final_reached_m)
    error = float(np.hypot(*then))
    return Reason(ReasonCause.ERROR_AHEAD, error, way.final_reached_m) if error > way.final_reached_m else None


def ends_landing(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return what ends a landing that the vehicle makes by itself from the last way point, its time apart (DOWN).

    From the height of the last way point down the pad leaves the camera's view, so there only the time ends it.
    """
    estimate, final = s.estimate, o.thesis
    if estimate is not None and unfit(estimate, s.at, o.stale_after_s) is None:
        risen_m = estimate.height_m - p.entered_height_m
        if risen_m > _RISEN_M:
            return Reason(ReasonCause.ROSE, risen_m)
        aside_m = final.final_reached_m + _ASIDE_M + final.pad_ahead_m
        return Reason(ReasonCause.DRIFTED, estimate.lateral_m, aside_m) if estimate.lateral_m > aside_m else None
    blind_below_m = final.final_height_m + final.final_reached_m + _BLIND_MARGIN_M
    lost = p.seen is not None and seconds_between(p.seen, s.at) > o.stale_after_s
    return Reason(ReasonCause.LOST_LOW, p.seen_height_m) if lost and p.seen_height_m > blind_below_m else None
