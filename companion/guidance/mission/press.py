"""PRESS and DOWN: press on level after the contact, then order the vehicle to stop its motors, in every cycle.

The press gives a witness that contradicts the contact its time: the drone presses on for as long as the rest of the way would
take, and for as long as the descent goes on. In wind it presses on for less, with its lean, for wind drags a vehicle over the
deck while its rotors carry a part of the weight. Motors stop by force only where the deck was felt and another witness finds it
there; otherwise the vehicle's own landing does it. An autopilot's works over the ground, and a deck under way slides from under
it: an autopilot presses on with the deck until it feels it, or goes around. A vehicle that is in the air again, or below the
deck, goes around, but no more often than `BOUNCES_MOST` times: then it stays down.
A landing where it is never goes around: it goes down again (LAND_HERE). Without sight it takes a second instrument that felt it,
or that it stays held up where the deck may be. To an autopilot's own landing it is left only while it is held up, or at last.
"""

import math
from collections.abc import Iterator

import numpy as np
from msgspec import Struct, structs

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.controller import Target
from companion.guidance.mission import contact, held_up, limits, rules
from companion.guidance.mission.land_here import felt_by, sees_heave, trusted
from companion.guidance.mission.phase import AROUND, CALLED_OFF, LANDING, Aimed, Phase, descending
from companion.guidance.mission.progress import BOUNCES_MOST, GuidanceCycle, Progress, unfit
from companion.guidance.mission.rules import Bar, Events, EventWithReason
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Command, Land, Lean, Velocity
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.time import seconds_between

_PRESS_IN_WIND = 0.5
"""Share of the time for which it presses on that is left in wind."""
_FELT_M_S = 1.0
"""Rate against the deck that an autopilot is ordered on a deck that is felt, so that the feet soon carry the weight, m/s."""
_TURN_1_S = 6.0  # rate of the turn back to the arrow there for each radian that is left, 1/s
_TURN_MOST_RAD = 0.25  # turn that counts at most
_RISES_M_S = 0.1
"""Speed from the deck at which a drone has left it, m/s; one that stands is estimated to move by half of that."""
_BELOW_DECK_M = 0.6
"""A drone on deck without sight may be estimated some decimetres away from it."""
_CONFIRMED_S = 3.0
"""Time for which a landing where it is presses until it is felt; then the autopilot's own is better where it is held up."""
_AT_LAST_S = 60.0  # time from its order after which that is better in any case
_STAYS_HELD_S = 1.0
"""Time for which it stays held up after the contact that an updraft does not last, s."""
_OFF_DECK_M = 0.1  # height over the gate's that is too high for a vehicle that stands on the deck (docs/decisions/contact.md)
_OFF_DECK_SIGMAS = 2.0  # standard deviations by which it has to be (docs/decisions/contact.md)
_FRESH_S = 0.2
"""Age of a sighting up to which it shows that the drone has left the deck, s."""


class Press(Struct, frozen=True):
    """The memory of a press."""

    way_s: float
    """Time from the contact after which the feet are at the deck by what contradicts it, s."""


def _note(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    if p.here is not None:
        stays = frozenset({"height"}) if _stays_held(p, s, o) else frozenset[str]()
        p = structs.replace(p, here=structs.replace(p.here, felt=felt_by(p, s, o, p.here) | stays))
    if not isinstance(p.kept, Press):
        return structs.replace(p, kept=Press(contact.way_s(s, o)))
    estimate, since = s.estimate, p.since
    # What no frame shows any more is reckoned with an accelerometer that the contact may have shaken.
    seen_since = estimate is not None and since is not None and estimate.sighted > since and estimate.age_s(s.at) <= _FRESH_S
    left_s = contact.way_s(s, o, contact.NEAR_M) if seen_since else 0.0
    return p if left_s <= 0.0 else structs.replace(p, kept=Press(max(p.kept.way_s, p.in_state_s(s.at) + left_s)))


def _is_held(s: GuidanceCycle) -> bool:
    impact = s.knowledge.impact
    return impact is not None and impact.by == "velocity" and seconds_between(impact.at, s.at) <= held_up.HELD_S


def _stays_held(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether it stays held up at a height that may be the deck's: an autopilot's own lowest height does so as well."""
    estimate = trusted(s, o)
    if estimate is None or p.in_state_s(s.at) < _STAYS_HELD_S or not _is_held(s):
        return False
    least_m = estimate.height_m - _OFF_DECK_SIGMAS * math.sqrt(max(0.0, estimate.cov.item(2, 2)))
    return least_m - o.cone.feet_below_m <= contact.NEAR_M


def _rises(s: GuidanceCycle) -> bool:
    """Return whether the drone goes up from the deck: its own landing would have to begin in the air."""
    estimate = s.estimate
    return estimate is not None and not estimate.alerts and estimate.v_pad_level.item(2) > _RISES_M_S


def off_deck(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return the reason if it is in the air again after the contact; only a fresh sight of the pad shows it."""
    estimate, most_m = s.estimate, o.cone.gate_m + _OFF_DECK_M
    if estimate is None or estimate.track != p.track or unfit(estimate, s.at, _FRESH_S) is not None:
        return None
    surely_m = estimate.height_m - _OFF_DECK_SIGMAS * math.sqrt(max(0.0, estimate.cov.item(2, 2)))
    if surely_m - o.cone.feet_below_m > contact.NEAR_M:
        # Lower it may be left to come down again, where it comes down on the pad.
        x, y, _ = estimate.d_body_pad_level.tolist()
        vx, vy, _ = estimate.v_pad_level.tolist()
        falls_s = (estimate.height_m - o.cone.feet_below_m) / o.cone.commit_rate_m_s
        if math.hypot(x + falls_s * vx, y + falls_s * vy) > limits.ON_PAD * o.limits.commit_error_m:
            most_m = min(most_m, o.cone.feet_below_m + contact.NEAR_M)
    return Reason(ReasonCause.OFF_DECK, estimate.height_m, most_m) if surely_m > most_m else None


def past_deck(p: Progress, s: GuidanceCycle) -> Reason | None:
    """Return that it is below the deck: it was swept off the pad, and would go down into the water."""
    past_m = 0.0 if s.estimate is None else -s.estimate.height_m
    return Reason(ReasonCause.PAST_DECK, past_m) if past_m > _BELOW_DECK_M and p.here is None else None


def _limit(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    return past_deck(p, s) or (None if p.bounces >= BOUNCES_MOST else off_deck(p, s, o))


def _presses(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    in_state_s, way_s = p.in_state_s(s.at), p.kept.way_s if isinstance(p.kept, Press) else 0.0
    press_s = o.cone.press_s * (_PRESS_IN_WIND if s.wind is not None and s.wind.drags else 1.0)
    press_s = max(o.cone.press_s + press_s if _rises(s) else press_s, way_s)
    # The own landing of a vehicle that holds over the ground is none for a deck under way.
    sure = not s.hold.over_ground or _felt(p, s, o)
    if p.here is not None and in_state_s >= _CONFIRMED_S and p.asked_at is not None:
        sure = sure or _is_held(s) or seconds_between(p.asked_at, s.at) > _AT_LAST_S
    if in_state_s >= press_s and sure and not contact.descends(s, o):
        yield Event.PRESSED, Reason(ReasonCause.PRESSED, in_state_s, press_s)
    if (limit := _limit(p, s, o)) is not None:
        yield Event.LIMIT, limit
    yield from rules.time_over(in_state_s, o.cone.press_s + o.cone.commit_s)


def tipped(p: Progress, s: GuidanceCycle) -> bool:
    """Return whether it lies there: it neither goes around nor asks whose deck it is."""
    return s.tipped is not None or (p.reason is not None and p.reason.cause is ReasonCause.TIPPED)


def stops(p: Progress, s: GuidanceCycle, o: GuidanceOptions, bars: Bar = _limit) -> Iterator[EventWithReason]:
    """Yield what happens while it is to stop its motors, by what finds that it must not."""
    if tipped(p, s):
        return
    yield from rules.other_pad(p, s, o)
    if (limit := bars(p, s, o)) is not None:
        yield Event.LIMIT, limit
    if (spent_s := p.in_state_s(s.at)) > o.land_timeout_s:
        yield Event.TIMEOUT, Reason(ReasonCause.NO_LANDING, spent_s, o.land_timeout_s)


def _goes_down(events: Events) -> Events:
    """Return the events of a state, where those that end a landing lead one that is made where it is down again."""

    def of(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
        for event, reason in events(p, s, o):
            if p.here is None or event is Event.PRESSED:
                yield event, reason
            elif event is not Event.OTHER_PAD:
                yield Event.LAND, reason

    return of


def _press(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Aimed:
    estimate = s.estimate
    if p.here is not None and s.hold.over_ground and not sees_heave(s, o):
        # Nothing is known so well that a foot which holds should be leant against, and a wrong heave would press on nothing.
        return p, Velocity(np.array([0.0, 0.0, o.cone.commit_rate_m_s]), 0.0)
    # Sightings of the last decimetre are wrong often, and what was known before them still holds for so short a time.
    if estimate is None or estimate.alerts or s.unflown:
        # A vehicle of which nothing fit is known is not held on a deck that falls: it lands by itself, and no motor is stopped by
        # force before it has pressed.
        felt = estimate is None and _felt(p, s, o)
        if not felt and s.hold.over_ground:
            return p, Velocity(np.array([0.0, 0.0, o.cone.commit_rate_m_s]), 0.0)
        return p, Land(on_deck=felt)
    level = np.array(estimate.d_body_pad_level)
    if s.hold.over_ground and _felt(p, s, o):
        # Leaning on one foot, it is turned about that by the wind; level with weight on all feet, it neither turns nor slides.
        return p, Target(level, descent_rate_m_s=_FELT_M_S, lean_max_rad=0.0)
    # Level in wind, it would be dragged to lee for as long as its rotors carry a part of the weight.
    level_off = None if s.wind is not None and s.wind.drags else 0.0
    return p, Target(level, descent_rate_m_s=o.cone.commit_rate_m_s, lean_max_rad=level_off)


def _down(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Aimed:
    felt = tipped(p, s) or _felt(p, s, o)
    presses = not felt and p.here is None and s.hold.over_ground
    return _press(p, s, o) if presses else (p, Land(on_deck=felt))


def _felt(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether the deck was felt and another witness finds it there: only then do the motors stop by force.

    That is a range, the newest height by sight less the way that the commit has made since, or on a way down without sight the
    reckoned height where it is still known, or the second instrument that felt it. Without one the vehicle lands by itself, and
    finds the deck with its own sensors.
    """
    felt = s.knowledge.impact
    if (p.reckoned is not None and (felt is None or felt.at < p.reckoned)) or off_deck(p, s, o) is not None:
        return False
    if s.range_m is not None and s.range_m - o.cone.feet_below_m <= contact.NEAR_M:
        return True
    if p.here is not None:
        feet = contact.feet_m(s, o.cone)
        if len(p.here.felt) > 1 or (feet is not None and feet <= contact.NEAR_M):
            return True
    if p.seen is None:
        return False
    way_m = o.cone.commit_rate_m_s * min(o.limits.commit_sighting_age_s, seconds_between(p.seen, s.at))
    return p.seen_height_m - way_m - o.cone.feet_below_m <= contact.NEAR_M


def _pressing(command: Command, p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Command:
    """Return the command with at least the commit's rate: an estimate that sinks into the deck is no reason to press less."""
    if not isinstance(command, Lean):
        return command
    deck_m_s = 0.0 if s.knowledge.deck is None else s.knowledge.deck.v_level.item(2)
    yaw_rad = None if s.estimate is None or o.tries.heading != "align" else s.estimate.yaw_rad
    if s.hold.over_ground and _felt(p, s, o):
        # A foot that is held turns it faster than the law's gain for the air turns it back.
        turn_rad = 0.0 if yaw_rad is None else max(-_TURN_MOST_RAD, min(_TURN_MOST_RAD, -wrap_pi(yaw_rad)))
        command = structs.replace(command, yaw_rate_rad_s=_TURN_1_S * turn_rad, on_deck_turn_rad=turn_rad)
    return descending(command, max(command.v_level.item(2), o.cone.commit_rate_m_s + deck_m_s))


_DOWN = {event: to for event, to in {**LANDING, **AROUND, **CALLED_OFF}.items() if to is not State.DOWN}
PHASES = {
    State.PRESS: Phase(
        "Pressing on level after the contact.",
        {**LANDING, **AROUND, **CALLED_OFF, Event.PRESSED: State.DOWN},
        _goes_down(_presses),
        _press,
        _note,
        _pressing,
    ),
    State.DOWN: Phase(
        "Ordering the vehicle to stop its motors, in every cycle.",
        _DOWN,
        _goes_down(stops),
        _down,
        allows=_pressing,
    ),
}
