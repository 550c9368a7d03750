"""The thesis' way (`guidance.mission = "thesis"`): two way points, and from the last one the vehicle's own landing.

It ends at a height from which the vehicle lands by itself, still in the air: the gate leads to DOWN, there is no COMMIT and no
contact, and from there only the time, a climb or a drift ends it. All else is as in the other mission.
"""

import math
from collections.abc import Iterator, Mapping

import numpy as np

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.controller import Target
from companion.guidance.mission import descend, gate, limits, press, stay
from companion.guidance.mission.phase import Phase, over_pad
from companion.guidance.mission.progress import GuidanceCycle, Progress, unfit
from companion.guidance.mission.rules import EventWithReason, Row
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Land
from estimator.contracts.estimates import RelativeState
from estimator.contracts.time import seconds_between

_RISEN_M = 0.4  # rise that ends the vehicle's own landing
_ASIDE_M = 0.3  # distance beside the pad, over that of the last way point, that ends it
_BLIND_MARGIN_M = 0.1  # margin of the height below which the pad leaves the view


def _near(estimate: RelativeState, ahead_m: float, height_m: float, reached_m: float) -> bool:
    """Return whether the drone is within `reached_m` of a way point, aside and in height."""
    x, y, z = estimate.d_body_pad_level.tolist()
    return math.hypot(x - ahead_m, y) <= reached_m and abs(z - height_m) <= reached_m


def _over(p: Progress, s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> Iterator[EventWithReason]:
    """Yield that the first way point is reached (INTERCEPT)."""
    way = o.thesis
    if _near(estimate, way.pad_ahead_m, way.approach_height_m, way.approach_reached_m) and s.thing is None:
        yield Event.IN_CONE, Reason(ReasonCause.ARRIVED, estimate.lateral_m, way.approach_reached_m)


def _down(p: Progress, s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> Iterator[EventWithReason]:
    """Yield that the last way point is reached (DESCEND)."""
    way = o.thesis
    if _near(estimate, way.pad_ahead_m, way.final_height_m, way.final_reached_m):
        yield Event.AT_GATE, Reason(ReasonCause.LOW_ENOUGH, estimate.height_m, way.final_height_m)


def _leaves(p: Progress, s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> Iterator[EventWithReason]:
    """Yield that the drone has left the last way point (GATE)."""
    way = o.thesis
    if not _near(estimate, way.pad_ahead_m, way.final_height_m, 2.0 * way.final_reached_m):
        yield Event.OUT_OF_CONE, Reason(ReasonCause.OUT_OF_CONE, estimate.lateral_m, way.final_reached_m)


def _bars(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return what keeps the drone at the last way point, or None."""
    estimate, way, lost = s.estimate, o.thesis, unfit(s.estimate, s.at, o.stale_after_s)
    if estimate is None or lost is not None:
        return lost
    off = np.array(estimate.d_body_pad_level[:2])
    off[0] -= way.pad_ahead_m
    then = off + way.touchdown_s * estimate.v_pad_level[:2]
    sigma = limits.sigma_m(estimate)
    if sigma > o.limits.sigma_m:
        return Reason(ReasonCause.SIGMA, sigma, o.limits.sigma_m)
    if not _near(estimate, way.pad_ahead_m, way.final_height_m, way.final_reached_m):
        return Reason(ReasonCause.ERROR, float(np.hypot(*off)), way.final_reached_m)
    error = float(np.hypot(*then))
    return Reason(ReasonCause.ERROR_AHEAD, error, way.final_reached_m) if error > way.final_reached_m else s.unseen


def _ends(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return what ends a landing that the vehicle makes by itself from the last way point, its time apart (DOWN).

    From the height of the last way point down the pad leaves the camera's view, so there only the time ends it.
    """
    if (past := press.past_deck(p, s)) is not None:
        return past
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


def _way_point(o: GuidanceOptions, height_m: float) -> Target:
    over, speed = np.array([o.thesis.pad_ahead_m, 0.0, height_m]), o.thesis.speed_m_s
    return Target(over, vertical_rate_max_m_s=speed, speed_max_m_s=speed)


def phases(cone: Mapping[State, Phase]) -> Mapping[State, Phase]:
    """Return the phases of the thesis' mission, by those of the one in the cone."""
    rows: dict[State, Row] = {state: phase.ways for state, phase in cone.items()}
    for state in cone.keys() - {State.COMMIT, State.LAND_HERE}:
        rows[state] = {event: to for event, to in rows[state].items() if event is not Event.CONTACT}
    rows[State.GATE] = {**rows[State.GATE], Event.GATE_OPEN: State.DOWN}
    rows[State.DOWN] = {**rows[State.DOWN], Event.OTHER_PAD: State.ANOTHER_PAD}
    own = {state: phase._replace(ways=rows[state]) for state, phase in cone.items()}
    first = over_pad(lambda p, s, o, estimate: _way_point(o, o.thesis.approach_height_m))
    at_last = over_pad(lambda p, s, o, estimate: _way_point(o, o.thesis.final_height_m))
    return {
        **own,
        # It flies to a height of its own, so that sinking is no fault, and an intercept may go lower.
        State.INTERCEPT: own[State.INTERCEPT]._replace(
            events=lambda p, s, o: descend.over(p, s, o, _over, lambda *_: None), aim=first, allows=descend.lower_in_sight
        ),
        State.STAY: own[State.STAY]._replace(
            events=lambda p, s, o: stay.events(p, s, o, lambda *_: None),
            aim=over_pad(lambda p, s, o, estimate: _way_point(o, stay.height_m(s, o))),
        ),
        State.DESCEND: own[State.DESCEND]._replace(events=lambda p, s, o: descend.down(p, s, o, _down), aim=at_last),
        State.GATE: own[State.GATE]._replace(
            events=lambda p, s, o: gate.events(p, s, o, _leaves, o.thesis.final_dwell_s),
            aim=at_last,
            note=lambda p, s, o: gate.note(p, s, o, _bars),
        ),
        # Only a landing where it is comes down with a contact, as in the cone.
        State.DOWN: own[State.DOWN]._replace(
            events=lambda p, s, o: press.stops(p, s, o, _ends) if p.here is None else cone[State.DOWN].events(p, s, o),
            aim=lambda p, s, o: (p, Land(on_deck=press.tipped(p, s))) if p.here is None else cone[State.DOWN].aim(p, s, o),
        ),
    }
