"""STAY: wait over the pad's centre at a height and follow the ship, until a person begins the landing.

It is entered from over the pad (INTERCEPT) where the order was to stay (`Progress.stays`), and leads down to no state: only an
order to begin does, by the search. The height is the setting's, or more before waves that the drone could not climb away from. A
gust that takes it out of the cone brings it back over the pad (INTERCEPT), and a lost sight is a hold (HOLD_BLIND). The limits of
an attempt end it as on a way down, but no time and no loss in sight of the pad is charged to the attempt. When its own time is
over it holds (PAUSED). A battery that will not last refuses (REFUSED), from where the last landing is made as after any refusal.
"""

from collections.abc import Iterator

import numpy as np
from msgspec.structs import replace

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.controller import Target
from companion.guidance.mission import charge, limits, rules
from companion.guidance.mission.phase import TRY, Phase, lower_if_agreed, over_pad, waits_m
from companion.guidance.mission.progress import SIGHT_HOLDS_S, GuidanceCycle, Progress
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.estimates import RelativeState


def _note(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    p = rules.spend(p, s, o)
    if p.attempt.with_sight_s < SIGHT_HOLDS_S:
        return p
    return replace(p, attempt=p.attempt.stayed(s.at), landing_began=s.at)


def events(
    p: Progress, s: GuidanceCycle, o: GuidanceOptions, lost_height: rules.Bar = rules.sank
) -> Iterator[rules.EventWithReason]:
    """Yield what happens during the wait, by what finds that the drone lost height."""
    yield from rules.other_pad(p, s, o)
    yield from rules.try_ends(p, s, o)
    if s.battery is not None and charge.battery_ends(s.battery, o):
        yield Event.HOPELESS, Reason(ReasonCause.BATTERY, 100.0 * s.battery, 100.0 * o.limits.battery)
    if (limit := rules.try_over(p, s, o) or lost_height(p, s, o)) is not None:
        yield Event.LIMIT, limit
    stayed_s = p.attempt.spent_s.get(State.STAY, 0.0)
    yield from rules.time_over(stayed_s, o.stay_s, Reason(ReasonCause.STAYED, stayed_s, o.stay_s))
    if (estimate := rules.fit_estimate(p, s, o)) is None:
        yield from rules.sight_lost(p, s, o)
        return
    error_m = limits.beside_m(estimate, s.knowledge)
    if limits.outside(error_m, estimate.height_m, o.cone):
        yield Event.OUT_OF_CONE, Reason(ReasonCause.OUT_OF_CONE, error_m, limits.radius_m(estimate.height_m, o.cone))


def height_m(s: GuidanceCycle, o: GuidanceOptions) -> float:
    """Return the height over the deck at which it waits, m."""
    return max(o.stay_height_m, waits_m(s, o))


def _target(p: Progress, s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> Target:
    over = np.array([*s.knowledge.aim_level, height_m(s, o)])
    return Target(over, vertical_rate_max_m_s=o.tries.climb_m_s, speed_max_m_s=o.cone.intercept_speed_m_s)


PHASES = {
    State.STAY: Phase(
        "Waiting over the pad at a height, until a person begins the landing.",
        {
            **TRY,
            Event.BEGIN: State.SEARCH,
            Event.HOPELESS: State.REFUSED,
            Event.TIMEOUT: State.PAUSED,
            Event.OUT_OF_CONE: State.INTERCEPT,
        },
        events,
        over_pad(_target),
        _note,
        lower_if_agreed,
    ),
}
