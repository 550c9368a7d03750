"""GATE: follow the deck just above it until every limit holds for a while.

The gate is the last place to wait. What keeps it shut stands before the operator for some seconds, `blocked` may change with
every cycle. The drone waits higher before waves that it could not climb away from in time. It commits when all limits of
`limits.gate` have held for the dwell (COMMIT), goes back up the cone when a gust takes it out (DESCEND), and around when its
time is over. A contact here, near the centre, is the landing (PRESS): nothing is won by a climb from a deck that came up to it.
"""

from collections.abc import Iterator

import numpy as np
from msgspec import Struct, structs

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.controller import Target
from companion.guidance.mission import contact, limits, rules
from companion.guidance.mission.phase import STAYS, TRY, Phase, lower_if_agreed, over_pad, waits_m
from companion.guidance.mission.progress import GuidanceCycle, Progress
from companion.guidance.mission.rules import Bar, ByEstimate, EventWithReason
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.estimates import RelativeState
from estimator.contracts.time import MonoNs, seconds_between

_OVER_GATE_M = 0.3  # height over the gate's at which the gate is left again
_TILTS_FAR = 3.0
"""Tilt of the deck over the gate's limit beyond which the attempts end with the present one."""
_REASON_STANDS_S = 2.0
"""Time for which a cause of the shut gate stands before the operator, s."""
_AWAY_M_S = 5.0
"""Largest rate against the deck with which the drone goes up before a deck that will rise faster than it can climb: no limit."""


class Gate(Struct, frozen=True):
    """The memory of a visit to the gate."""

    good_since: MonoNs | None = None
    """Time since which every limit has held without a break."""
    blocked: Reason | None = None
    """Reason that keeps the gate shut in the newest cycle."""
    waits_for: Reason | None = None
    """Blocking reason that is shown to the operator. It is held for some time."""
    waits_since: MonoNs | None = None
    """Time since which the reason has been the same."""


def gate_of(p: Progress) -> Gate:
    """Return what this visit to the gate remembers."""
    return p.kept if isinstance(p.kept, Gate) else Gate()


def note(p: Progress, s: GuidanceCycle, o: GuidanceOptions, bars: Bar = rules.bars_commit) -> Progress:
    """Note what bars the way through the gate, and since when nothing does."""
    p, gate, shut = rules.spend(p, s, o), gate_of(p), bars(p, s, o)
    if shut is None:
        return structs.replace(
            p, kept=structs.replace(gate, blocked=None, good_since=s.at if gate.good_since is None else gate.good_since)
        )
    if gate.waits_since is None or seconds_between(gate.waits_since, s.at) >= _REASON_STANDS_S:
        gate = structs.replace(gate, waits_for=shut, waits_since=s.at)
    tilts = shut.measured if shut.cause is ReasonCause.DECK_TILT else None
    # A deck that tilts this far in its swing is not still for as long as a commit takes: one wait for it is enough.
    refusing = p.refusing or (tilts is not None and tilts > _TILTS_FAR * o.limits.deck_tilt_gate_deg)
    return structs.replace(p, kept=structs.replace(gate, blocked=shut, good_since=None), refusing=refusing)


def _leaves(p: Progress, s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> Iterator[EventWithReason]:
    height_m, error_m = estimate.height_m, limits.beside_m(estimate, s.knowledge)
    if limits.outside(error_m, height_m, o.cone) or height_m > o.cone.gate_m + _OVER_GATE_M:
        yield Event.OUT_OF_CONE, Reason(ReasonCause.OUT_OF_CONE, error_m, limits.radius_m(height_m, o.cone))


def events(
    p: Progress, s: GuidanceCycle, o: GuidanceOptions, leaves: ByEstimate, dwell_s: float
) -> Iterator[rules.EventWithReason]:
    """Yield what happens at the gate, by what finds that the drone has left it, and the time for which all must be good."""
    yield from rules.other_pad(p, s, o)
    yield from contact.stays(p, s, o)
    yield from rules.try_ends(p, s, o)
    if (limit := rules.try_over(p, s, o) or rules.windy(p, s) or s.thing) is not None:
        yield Event.LIMIT, limit
    gate = gate_of(p)
    yield from rules.time_over(p.attempt.spent_s.get(p.state, 0.0), o.cone.gate_s, gate.blocked)
    if (estimate := rules.fit_estimate(p, s, o)) is None:
        yield from rules.sight_lost(p, s, o)
        return
    yield from leaves(p, s, o, estimate)
    if gate.good_since is not None and seconds_between(gate.good_since, s.at) >= dwell_s:
        yield Event.GATE_OPEN, Reason(ReasonCause.ALL_LIMITS_HOLD)


def _target(p: Progress, s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> Target:
    least_m = waits_m(s, o)
    rate_max = o.tries.climb_m_s if least_m == o.cone.gate_m or estimate.height_m > least_m else _AWAY_M_S
    return Target(np.array([*s.knowledge.aim_level, least_m]), vertical_rate_max_m_s=rate_max)


PHASES = {
    State.GATE: Phase(
        "Following the deck just above it until every limit holds.",
        {**TRY, **STAYS, Event.CONTACT: State.PRESS, Event.OUT_OF_CONE: State.DESCEND, Event.GATE_OPEN: State.COMMIT},
        lambda p, s, o: events(p, s, o, _leaves, o.cone.gate_dwell_s),
        over_pad(_target),
        note,
        lower_if_agreed,
    ),
}
