"""COMMIT: go down from the gate to the deck under full control, in some half a second to a second.

Three things end it. A contact, by the vote of all witnesses, is the landing (PRESS). A limit of `limits.commit`, a thing on the
pad, a height against the order, or the time ends it with a go-around. Lost sight does as well, for half a second from the deck
the drone goes up without sight, it does not wait. Below the height of no return a climb would come too late: there the contact
is awaited for a moment whatever becomes of the estimate, and without going lower. Wind and waves have no say here: nothing but
a limit of its own ends it.
"""

from collections.abc import Iterator

import numpy as np
from msgspec import Struct, structs

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.controller import Target
from companion.guidance.mission import contact, limits, rules
from companion.guidance.mission.phase import AROUND, CALLED_OFF, LANDING, Aimed, Phase, not_lower, still, turn_rad
from companion.guidance.mission.progress import GuidanceCycle, Progress, unfit
from companion.guidance.mission.rules import EventWithReason
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Command
from estimator.contracts.time import MonoNs, after

_AT_DECK_M = 0.1
"""Height of the feet up to which it is better to press on than to climb, once the commit's sight is too old, m."""


class Commit(Struct, frozen=True):
    """The memory of a commit."""

    no_return_until: MonoNs | None = None
    """Time until which the contact is awaited whatever becomes of the estimate; None while a climb can avoid it."""


def _note(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    p = contact.touched(p, s, o)
    if not p.in_sight or s.estimate is None:
        return p
    low = s.estimate.height_m <= limits.no_return_m(s.knowledge, o.cone)
    return structs.replace(p, kept=Commit(after(s.at, o.cone.no_return_s) if low else None))


def _meets_deck(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    if p.since is None:
        return
    (votes, felt), feet_m = contact.meets_deck(p, s, o, p.in_state_s(s.at)), contact.feet_m(s, o.cone)
    if votes >= contact.ENOUGH or (felt is None and _over_blind(s, o, feet_m)):
        yield Event.CONTACT, Reason(ReasonCause.REACHED, feet_m) if felt is None else contact.reason_of(felt)


def _over_blind(s: GuidanceCycle, o: GuidanceOptions, feet_m: float | None) -> bool:
    """Return whether it has come to the deck when its sight is too old, or its driver lets it hover there.

    A climb from there is worse than to press on, and a deck drags a vehicle that hovers on it.
    """
    too_old = s.estimate is not None and s.estimate.age_s(s.at) > o.limits.commit_sighting_age_s
    return (too_old or s.unflown) and feet_m is not None and feet_m <= _AT_DECK_M and contact.stands_on_pad(s, o)


def _limit(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    estimate = s.estimate
    if estimate is None:
        return rules.against_order(p, s)
    ends = limits.commit(s.at, estimate, s.knowledge, o.limits, o.cone)
    turns = estimate.height_m > limits.no_return_m(s.knowledge, o.cone)
    return (
        contact.feet_elsewhere(p) or ends or (s.thing or rules.lens_elsewhere(s) if turns else None) or rules.against_order(p, s)
    )


def _events(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    yield from rules.other_pad(p, s, o)
    yield from _meets_deck(p, s, o)
    if (limit := _limit(p, s, o)) is not None:
        yield Event.LIMIT, limit
    if (spent_s := p.in_state_s(s.at)) > o.cone.commit_s:
        yield Event.TIMEOUT, Reason(ReasonCause.NO_CONTACT, spent_s, o.cone.commit_s)
    awaited_until = p.kept.no_return_until if isinstance(p.kept, Commit) else None
    if awaited_until is None or s.at > awaited_until:
        yield from rules.sight_lost(p, s, o)


def _may_go_lower(s: GuidanceCycle, o: GuidanceOptions) -> bool:
    return unfit(s.estimate, s.at, o.limits.commit_sighting_age_s) is None


def _aim(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Aimed:
    if s.estimate is None or not _may_go_lower(s, o):
        # So low that a climb would come too late: it awaits the contact without going lower.
        return still(p, s, o)
    deck = np.array([*s.knowledge.aim_level, 0.0])
    return p, Target(deck, descent_rate_m_s=o.cone.commit_rate_m_s, yaw_rad=turn_rad(s, o, s.estimate))


def _allows(command: Command, p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Command:
    return command if _may_go_lower(s, o) else not_lower(command, p, s, o)


PHASES = {
    State.COMMIT: Phase(
        "Going down to the deck under full control.",
        {
            **LANDING,
            **AROUND,
            **CALLED_OFF,
            Event.OTHER_PAD: State.ANOTHER_PAD,
            Event.SIGHT_LOST: State.GO_AROUND,
            Event.CONTACT: State.PRESS,
        },
        _events,
        _aim,
        _note,
        _allows,
    ),
}
