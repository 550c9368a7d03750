"""GO_AROUND: climb on the clear side, to begin again.

First it only climbs, at its place over the deck, for feet that are dragged turn the vehicle over; then aside in proportion to the
height, so that the pad stays in view. Without sight it climbs against the deck. High enough, by sight or by what it has climbed
since, it decides: another attempt (INTERCEPT) with limits of place and tilt that are a little wider; REFUSED, where wind or waves
will not pass or the attempts are used up by them; GAVE_UP, where they are used up by anything else. A climb that takes far longer
than it should gives up, and a contact near the centre in spite of it is the landing (PRESS).
"""

import math
from collections.abc import Iterator

import numpy as np
from msgspec.structs import replace

from companion.base.mission import CONDITIONS, Event, Reason, ReasonCause, State
from companion.guidance.controller import Target
from companion.guidance.mission import contact, limits, out_of_reach, rules
from companion.guidance.mission.out_of_reach import NEAR_SAFE_M
from companion.guidance.mission.phase import LANDING, Aimed, Phase, climbs, descending, not_lower, usable
from companion.guidance.mission.progress import GuidanceCycle, Progress, of_frames, with_deck_m_s
from companion.guidance.mission.rules import EventWithReason
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Command, Lean, Velocity
from estimator.contracts.estimates import IntegrityAlert
from estimator.contracts.motion import G_M_S2

_CLIMB_PATIENCE = 3.0  # a go-around that takes this many times the expected time and `_CLIMB_PATIENCE_S` is not climbing
_CLIMB_PATIENCE_S = 10.0  # time beyond the expected one
_TOUCHES_M = 0.04
"""Height of the feet up to which a push is the deck and not the climb's own thrust, m."""
_LIFT_M = 0.3
"""Height of the feet below which it only climbs, m."""
_BRAKES_M = 0.1  # height of the lowest foot from which on it leans further than it does
_LEAN_LEAST_RAD = math.radians(5.0)  # lean that it may always have


def clear(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether it is high enough: by sight, or by the time that it has climbed since the newest sight."""
    if p.in_sight:
        return p.seen_height_m >= o.tries.safe_height_m - NEAR_SAFE_M
    return _height_m(p, s, o) >= o.tries.safe_height_m


def _height_m(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> float:
    """Return the height over the pad: the one that is seen, or the least that the climb since the newest sight has made."""
    if p.in_sight:
        return p.seen_height_m
    known = p.silent_m is None and math.isfinite(p.seen_height_m)
    from_m = min(p.seen_height_m, o.tries.safe_height_m) if known else 0.0
    reckoned_m = from_m + p.climbed_m - p.deck_rise_m
    if s.range_m is not None and out_of_reach.near(p, s, o):
        return min(reckoned_m, s.range_m)
    estimate = s.estimate
    if estimate is None or estimate.alerts != (IntegrityAlert.UNFELT,) or estimate.age_s(s.at) > o.stale_after_s:
        return reckoned_m
    # The height is seen all the same.
    return min(reckoned_m, estimate.height_m)


def _touches(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield a contact that is not the climb's own thrust."""
    feet_m, felt = contact.feet_m(s, o.cone), contact.felt(p, s, o)
    steers = s.estimate is not None and (s.estimate.steers or s.estimate.jolted)
    if feet_m is not None and feet_m <= _TOUCHES_M and not steers and not contact.is_own_thrust(felt, s):
        yield from contact.stays(p, s, o)


def _tries_over(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield what leaves no other attempt, once it is high enough for one."""
    yield from rules.too_windy(p, s, o)
    yield from rules.unlandable(p, s, o)
    if s.off_orders is not None:
        yield Event.NO_CONDITIONS, s.off_orders
    if (feet := contact.feet_elsewhere(p)) is not None:
        yield Event.NO_CONDITIONS, feet
    if p.fault is None:
        return
    used_up = p.go_arounds > o.tries.go_arounds_max or rules.landing_over(p, s, o) is not None
    if (p.refusing and rules.conditions_count(p, s, o)) or (used_up and p.fault.cause in CONDITIONS):
        yield Event.NO_CONDITIONS, p.fault
    if used_up:
        yield Event.HOPELESS, (None if p.in_sight else of_frames(s.frames)) or p.fault


def _events(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    yield from rules.other_pad(p, s, o)
    yield from _touches(p, s, o)
    high = clear(p, s, o)
    if high:
        yield from _tries_over(p, s, o)
    to_climb_m = max(0.0, o.tries.safe_height_m - p.entered_height_m)
    spent_s, limit_s = p.in_state_s(s.at), _CLIMB_PATIENCE * to_climb_m / o.tries.climb_m_s + _CLIMB_PATIENCE_S
    if (sinks := rules.against_order(p, s)) is not None:
        yield Event.TIMEOUT, sinks
    if spent_s > limit_s:
        yield Event.TIMEOUT, Reason(ReasonCause.NOT_CLIMBING, spent_s, limit_s)
    if high:
        yield Event.CLEAR, Reason(ReasonCause.HIGH_ENOUGH, _height_m(p, s, o), o.tries.safe_height_m)


def _aim(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Aimed:
    estimate = usable(s, o)
    # Where the pad was swung aside it comes back to a drone that goes on as the ship did.
    flown_s = o.tries.blind_s if estimate is not None and estimate.adrift else o.tries.climb_after_s
    old = estimate is not None and estimate.age_s(s.at) > flown_s
    if estimate is None or old or (p.track is not None and estimate.track != p.track):
        return climbs(p, s, max(o.tries.climb_m_s, out_of_reach.climb_m_s(p, s, o)))
    p = replace(p, climbs_m_s=with_deck_m_s(o.tries.climb_m_s, s.knowledge))
    if estimate.height_m - o.cone.feet_below_m < _LIFT_M:
        # It climbs at its place and moves with the deck: feet that are dragged before they leave the deck turn the vehicle over.
        here = np.array([*estimate.d_body_pad_level[:2], o.tries.safe_height_m])
        # A speed that it took off with is braked higher up: leaning further lowers a foot by more than it has climbed.
        body, most_rad = s.knowledge.body, None
        if body is not None and estimate.height_m - o.cone.feet_below_m - limits.lower_foot_m(s.knowledge, o.cone) < _BRAKES_M:
            most_rad = max(_LEAN_LEAST_RAD, math.atan(math.hypot(*body.lean_m_s2) / G_M_S2))
        fastest, speed = out_of_reach.fastest_climb_m_s(s, o), o.cone.intercept_speed_m_s
        return p, Target(here, descent_rate_m_s=-fastest, speed_max_m_s=speed, lean_max_rad=most_rad)
    # Aside in proportion to the height, so that the pad stays in view.
    aside_m = o.tries.clear_side_m * min(1.0, max(0.0, estimate.height_m) / o.tries.safe_height_m)
    d = np.array([0.0, 0.0, o.tries.safe_height_m])
    if estimate.yaw_rad is not None:
        bearing = math.radians(o.tries.clear_side_deg) - estimate.yaw_rad
        d[:2] = -aside_m * np.array([math.cos(bearing), math.sin(bearing)])
    return p, Target(d, descent_rate_m_s=-o.tries.climb_m_s, speed_max_m_s=o.cone.intercept_speed_m_s)


def _allows(command: Command, p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Command:
    """Return the command with a climb, at least, without sight: an estimate that has risen by itself requests none."""
    if p.in_sight:
        return not_lower(command, p, s, o)
    if not isinstance(command, Velocity | Lean) or command.v_level[2] <= -o.tries.climb_m_s:
        return command
    return descending(command, -o.tries.climb_m_s)


PHASES = {
    State.GO_AROUND: Phase(
        "Climbing on the clear side, to begin again.",
        {
            **LANDING,
            Event.OTHER_PAD: State.ANOTHER_PAD,
            Event.CONTACT: State.PRESS,
            Event.NO_CONDITIONS: State.REFUSED,
            Event.HOPELESS: State.GAVE_UP,
            Event.TIMEOUT: State.GAVE_UP,
            Event.CLEAR: State.INTERCEPT,
        },
        _events,
        _aim,
        allows=_allows,
    ),
}
