"""HOLD_BLIND: still against the deck without sight of the pad.

A sight so short ago comes back as likely, so the drone waits over the pad's last place, then where it is, and in wind looks
upwind. Nothing here goes lower: where it is low, or a witness of the height says that the deck comes, the attempt ends with a
climb (GO_AROUND). Sight brings it back over the pad (INTERCEPT). The time without sight is counted over all attempts, and when it
is over the drone gives up.
"""

import math
from collections.abc import Iterator

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.mission import contact, out_of_reach, rules
from companion.guidance.mission.out_of_reach import NEAR_SAFE_M
from companion.guidance.mission.phase import LANDING, Phase, descending, looks_upwind, still
from companion.guidance.mission.progress import GuidanceCycle, Progress, of_frames
from companion.guidance.mission.rules import EventWithReason
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Command, Lean, Velocity
from estimator.contracts.estimates import IntegrityAlert
from estimator.contracts.time import seconds_between

_STAY = frozenset({IntegrityAlert.UNFELT, IntegrityAlert.ATTITUDE})
"""Alerts that stay for seconds at least: nothing is won by waiting low over the deck."""
_TURNS_S = 1.0
"""Time that a drone takes until an order to climb has ended its way down, and a rising deck's way up to it, s."""
_TELLING = frozenset({ReasonCause.ALERT, ReasonCause.INCONSISTENT})
"""Causes of a hold without sight that say more than its length."""
_SURELY = 0.5
"""Standard deviations of its vertical speed by which a drone may sink without being kept up: errors lift it by 3 cm/s."""


def _lost_low(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return that it is too low to wait for the sight any longer, or None. A deck that comes up fast makes any height low."""
    if p.seen is None:
        return None
    lies = s.estimate is not None and not _STAY.isdisjoint(s.estimate.alerts)
    nearer = s.range_m is not None and s.range_m < p.seen_height_m - NEAR_SAFE_M and out_of_reach.near(p, s, o)
    over = seconds_between(p.seen, s.at) > o.tries.climb_after_s
    is_low = p.seen_height_m < o.tries.safe_height_m - NEAR_SAFE_M and (over or lies or nearer)
    return Reason(ReasonCause.LOST_LOW, p.seen_height_m) if is_low or rules.reaches_deck(s.estimate, s, o, _TURNS_S) else None


def _events(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    yield from rules.other_pad(p, s, o)
    yield from contact.stays(p, s, o)
    yield from rules.too_windy(p, s, o)
    yield from rules.unlandable(p, s, o)
    if (limit := rules.try_over(p, s, o) or _lost_low(p, s, o)) is not None:
        yield Event.LIMIT, limit
    spent_s, limit_s = p.attempt.without_sight_s, o.tries.give_up_after_s
    if spent_s > limit_s:
        why = p.reason if p.reason is not None and p.reason.cause in _TELLING else None
        yield Event.TIMEOUT, s.unconfirmed or of_frames(s.frames) or why or Reason(ReasonCause.NOT_FOUND_AGAIN, spent_s, limit_s)
    yield from rules.pad_seen(p, s, o)


def keep_up(aim: Command | None, p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Command | None:
    """Return the command with a climb against what the drone sinks over the ground beyond its order, in a hold without sight.

    Commands that arrive changed sink a drone that is to hold its height, and a height without sight is too uncertain to fly by.
    The gain is 1: with that a loop stands commands that come however late. An autopilot keeps its own height.
    """
    estimate, deck = s.estimate, s.knowledge.deck
    if p.state is not State.HOLD_BLIND or not isinstance(aim, Velocity | Lean) or estimate is None or deck is None:
        return aim
    # Without a velocity a climb is flown by the tilt against the wind, which the wrong velocity has falsified.
    if s.hold.over_ground or not s.knowledge.trusts_velocity or estimate.alerts or estimate.age_s(s.at) <= o.stale_after_s:
        return aim
    down_m_s = aim.v_level.item(2)
    # Out of sight the errors of the speeds of drone and deck over the ground are the same.
    over_ground_m_s = deck.v_level.item(2) - estimate.v_pad_level.item(2)
    sinks_m_s = over_ground_m_s - _SURELY * math.sqrt(deck.cov_level.item(2, 2)) - max(0.0, down_m_s)
    return descending(aim, down_m_s - max(0.0, sinks_m_s))


PHASES = {
    State.HOLD_BLIND: Phase(
        "Still against the deck without sight of the pad.",
        {
            **LANDING,
            Event.OTHER_PAD: State.ANOTHER_PAD,
            Event.CONTACT: State.PRESS,
            Event.NO_CONDITIONS: State.GO_AROUND,
            Event.LIMIT: State.GO_AROUND,
            Event.TIMEOUT: State.GAVE_UP,
            Event.SIGHT: State.INTERCEPT,
        },
        _events,
        lambda p, s, o: still(p, s, o, looks_upwind(p, s, o)),
    ),
}
