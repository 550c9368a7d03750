"""INTERCEPT and DESCEND: fly over the pad at height, then down in the cone over it.

The nearer to the cone's axis, the faster the descent. Outside it by more than a gust the drone comes back over the pad
(INTERCEPT) before it descends further; at its lower end it is at the gate (GATE). Both share the time of one attempt over all
their visits. Without sight they hold still (HOLD_BLIND); a limit, or the time, ends the attempt with a go-around. A contact near
the pad's centre is the landing (PRESS), as at the gate, which a gust opens and shuts several times a second.
"""

import math
from collections.abc import Iterator

import numpy as np

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.controller import Target
from companion.guidance.mission import contact, limits, rules
from companion.guidance.mission.phase import STAYS, TRY, Phase, clear_m, not_lower, over_pad, waits_m
from companion.guidance.mission.progress import GuidanceCycle, Progress, unfit
from companion.guidance.mission.rules import Bar, ByEstimate, EventWithReason
from companion.settings.guidance import GuidanceOptions
from companion.settings.mission import ConeOptions
from estimator.contracts.commands import Command
from estimator.contracts.estimates import RelativeState

INSIDE = 1.2
"""The share of the descent rate on the axis, which is limited to 1: near the axis the rate does not depend on the error."""
_TAPER_1_S = 1.0
"""Rate per metre of height left over the gate."""
_AT_GATE_M = 0.08  # height over the gate's at which the descent ends


def inside(error_m: float, height_m: float, options: ConeOptions) -> bool:
    """Return whether the drone may descend at all."""
    return error_m < math.sqrt(INSIDE) * limits.radius_m(height_m, options)


def descent_rate_m_s(error_m: float, height_m: float, options: ConeOptions, ends_m: float, ends_m_s: float = 0.0) -> float:
    """Return the rate against the deck, m/s, down positive; it falls to zero at the least height and is negative below it.

    Args:
        error_m: distance from the axis.
        height_m: height over the deck.
        ends_m: the height at which the descent ends.
        ends_m_s: rate to which it falls on the way there, m/s.
    """
    share = INSIDE - (error_m / limits.radius_m(height_m, options)) ** 2
    rate = options.descent_rate_m_s * max(-1.0, min(1.0, share))
    tapered = _TAPER_1_S * (height_m - ends_m)
    return min(rate, max(ends_m_s, tapered) if tapered > 0.0 else tapered)


def _in_cone(p: Progress, s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> Iterator[EventWithReason]:
    height_m, error_m = estimate.height_m, limits.beside_m(estimate, s.knowledge)
    if inside(error_m, height_m, o.cone) and (rules.bars_descent(p, s, o) or s.thing) is None:
        yield Event.IN_CONE, Reason(ReasonCause.ARRIVED, error_m, limits.radius_m(height_m, o.cone))


def over(
    p: Progress, s: GuidanceCycle, o: GuidanceOptions, arrives: ByEstimate = _in_cone, lost_height: Bar = rules.sank
) -> Iterator[rules.EventWithReason]:
    """Yield what happens over the pad, by what finds that it has arrived, and that it lost height."""
    yield from rules.other_pad(p, s, o)
    yield from contact.stays(p, s, o)
    yield from rules.try_ends(p, s, o)
    if (limit := rules.try_over(p, s, o) or lost_height(p, s, o)) is not None:
        yield Event.LIMIT, limit
    yield from rules.time_over(p.attempt.spent_s.get(p.state, 0.0), o.tries.leg_s, s.thing)
    if (estimate := rules.fit_estimate(p, s, o)) is None:
        yield from rules.sight_lost(p, s, o)
    elif p.stays:
        error_m = limits.beside_m(estimate, s.knowledge)
        if inside(error_m, estimate.height_m, o.cone):
            yield Event.ARRIVED, Reason(ReasonCause.ARRIVED, error_m, limits.radius_m(estimate.height_m, o.cone))
    else:
        yield from arrives(p, s, o, estimate)


def _at_gate(p: Progress, s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> Iterator[EventWithReason]:
    height_m, error_m = estimate.height_m, limits.beside_m(estimate, s.knowledge)
    if limits.outside(error_m, height_m, o.cone):
        yield Event.OUT_OF_CONE, Reason(ReasonCause.OUT_OF_CONE, error_m, limits.radius_m(height_m, o.cone))
    if height_m <= o.cone.gate_m + _AT_GATE_M:
        yield Event.AT_GATE, Reason(ReasonCause.LOW_ENOUGH, height_m, o.cone.gate_m)


def down(p: Progress, s: GuidanceCycle, o: GuidanceOptions, arrives: ByEstimate = _at_gate) -> Iterator[rules.EventWithReason]:
    """Yield what happens on the way down, by what finds its end."""
    yield from rules.other_pad(p, s, o)
    yield from contact.stays(p, s, o)
    yield from rules.try_ends(p, s, o)
    if (limit := rules.try_over(p, s, o) or rules.bars_descent(p, s, o) or s.thing) is not None:
        yield Event.LIMIT, limit
    yield from rules.time_over(p.attempt.spent_s.get(p.state, 0.0), o.tries.leg_s)
    if (estimate := rules.fit_estimate(p, s, o)) is None:
        yield from rules.sight_lost(p, s, o)
    else:
        yield from arrives(p, s, o, estimate)


def _target_over(p: Progress, s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> Target:
    # A cone that is wide enough for the error is higher up; and higher up the pad stays in view.
    wide_m = min(o.tries.safe_height_m, limits.beside_m(estimate, s.knowledge) / o.cone.slope)
    stays_m = o.stay_height_m if p.stays else 0.0
    over = np.array([*s.knowledge.aim_level, max(min(estimate.height_m, p.entered_height_m), wide_m, waits_m(s, o), stays_m)])
    return Target(over, vertical_rate_max_m_s=o.tries.climb_m_s, speed_max_m_s=o.cone.intercept_speed_m_s)


def _target_down(p: Progress, s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> Target:
    least_m = waits_m(s, o)
    # Where two witnesses of the deck find the gate open already, and surely so, it is passed at the commit's rate.
    falls_m_s = limits.fall_m_s(s.knowledge, limits.to_contact_s(estimate, s.knowledge, o.cone), o.cone, limits.SIGMAS_AHEAD)
    surely = s.knowledge.confirmed and least_m == o.cone.gate_m and (falls_m_s or 0.0) <= o.limits.deck_fall_m_s
    ends_m_s = o.cone.commit_rate_m_s if surely and rules.bars_commit(p, s, o) is None else 0.0
    rate = descent_rate_m_s(limits.beside_m(estimate, s.knowledge), estimate.height_m, o.cone, least_m, ends_m_s)
    over = np.array([*s.knowledge.aim_level, least_m])
    return Target(over, descent_rate_m_s=rate, speed_max_m_s=o.cone.intercept_speed_m_s)


def _keeps_height(command: Command, p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Command:
    return not_lower(command, p, s, o, clear_m(s, o))


def lower_in_sight(command: Command, p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Command:
    """Return the controller's command while the pad is in sight, else as `not_lower` allows it."""
    return command if unfit(s.estimate, s.at, o.stale_after_s) is None else not_lower(command, p, s, o)


PHASES = {
    State.INTERCEPT: Phase(
        "Flying over the pad at height.",
        {**TRY, Event.CONTACT: State.PRESS, Event.IN_CONE: State.DESCEND, Event.ARRIVED: State.STAY},
        over,
        over_pad(_target_over),
        rules.spend,
        _keeps_height,
    ),
    State.DESCEND: Phase(
        "Descending in the cone over the pad.",
        {**TRY, **STAYS, Event.CONTACT: State.PRESS, Event.OUT_OF_CONE: State.INTERCEPT, Event.AT_GATE: State.GATE},
        down,
        over_pad(_target_down),
        rules.spend,
        lower_in_sight,
    ),
}
