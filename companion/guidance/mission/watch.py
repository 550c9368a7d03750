"""Find what happens in a guidance cycle: the events of the machine with their reasons, in the order in which they are taken."""

import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from msgspec.structs import replace

from companion.base.mission import FLOWN, Event, State
from companion.base.reason import CONDITIONS, Reason, ReasonCause
from companion.guidance.controller import Impact
from companion.guidance.law.response_watch import DELAY_MAX_S
from companion.guidance.mission import cone, contact, limits, out_of_reach, rendezvous
from companion.guidance.mission.clearance import SWELL_MEAN_S
from companion.guidance.mission.contact import HELD_S
from companion.guidance.mission.cycle import GuidanceCycle, of_frames, unfit
from companion.guidance.mission.held_course import LASTS_S, HeldCourse
from companion.guidance.mission.limits import ends
from companion.guidance.mission.out_of_reach import NEAR_SAFE_M
from companion.guidance.mission.progress import Attempt, Progress, follow_arrow
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.estimates import IntegrityAlert, RelativeState
from estimator.contracts.time import after, seconds_between

EventWithReason = tuple[Event, Reason]

_PRESS_IN_WIND = 0.5
"""Share of the time for which it presses on that is left in wind."""
_RISES_M_S = 0.1
"""Speed from the deck at which a drone has left it, m/s; one that stands is estimated to move by half of that."""
_TOUCH_S = 0.3
"""Time for which the push of one foot counts, s."""
_CLIMB_PATIENCE, _CLIMB_PATIENCE_S = 3.0, 10.0
"""A go-around that takes this many times the expected time plus this many seconds is not climbing."""
_AT_GATE_M = 0.08
_OVER_GATE_M = 0.3
_AGREE = 0.2
"""Difference of an estimate out of sight from the range, of that, up to which two witnesses say the same height."""
_RISEN_M = 0.4
_ASIDE_M = 0.3
_BELOW_DECK_M = 0.6
"""A drone on deck without sight may be estimated some decimetres away from it."""
_HELD_UP_BELOW = 0.75
"""Share of the gate's height below which being held up is a contact."""
_BLIND_MARGIN_M = 0.1
_OFF_DECK_M, _OFF_DECK_SIGMAS = 0.1, 2.0
"""A height this far over the gate's, by this many standard deviations, is too high for a vehicle that stands on the deck."""
_FRESH_S = 0.2
"""Age of a sighting up to which it shows that the drone has left the deck, s."""
_STAY = frozenset({IntegrityAlert.UNFELT, IntegrityAlert.ATTITUDE})
"""Alerts that stay for seconds at least: nothing is won by waiting low over the deck."""
_TURNS_S = 1.0
"""Time that a drone takes until an order to climb has ended its way down, and a rising deck's way up to it, s."""
_ENDS_S, _SANK_M = 0.4, 0.1
"""Time that it takes at a height that is kept, and the least that it has sunk below that."""
_DEVIATES_MOST = 0.12
"""Standard deviation of a height, m, or its rate, m/s, that counts at most: a path without the IMU hardly knows them."""
_TELLING = frozenset({ReasonCause.ALERT, ReasonCause.INCONSISTENT})
"""Causes of a hold without sight that say more than its length."""
BOUNCES_MOST = 2
"""Number of bounces after which it stays down: it lands by the vehicle's own landing, off the deck again or not."""
_TOUCHES_MOST = 4
"""Number of bounces after which a contact in a go-around no longer makes it press on."""
_MAY_STAY = (State.GO_AROUND, State.GATE, State.HOLD_BLIND)
"""States that no contact belongs to, in which one near the pad's centre is taken as the landing all the same."""
_AT_DECK_M = 0.1
"""Height of the feet up to which it is better to press on than to climb, once the commit's sight is too old, m."""
_TOUCHES_M = 0.04
"""Height of the feet up to which a push in a go-around is the deck and not the climb's own thrust, m."""
_TILTS_FAR = 3.0
"""Tilt of the deck over the gate's limit beyond which the attempts end with the present one."""
_FASTEST_M_S = 1.0
"""Vertical speed of a vehicle whose law does not say, m/s."""
_REASON_STANDS_S = 2.0
"""Time for which a cause of the shut gate stands before the operator, s."""
_LEAN_SETTLES_S = 10.0
"""Time after the way to the ship in which the mean lean still holds that of the drone's own speed: twice the mean's time."""
_SPENT_WAIT_S = 8.0
"""Time for which it waits out of sight where the lean takes all of the tilt, s: the gust may pass, but the drone is blown off."""
_LOOKS_S = 10.0
"""Time for which it looks for the pad with a charge too low to begin, s: that may be the nearest place to land."""
_ENDS_AFTER_S = 2.0
"""Time after a refusal before a battery that ends is a reason to try again, s."""
_WIND_DWELL_S = 2.0
"""Time for which the wind must be too strong before anything is done about it, s."""


def fit_in(state: State, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return why the estimate is not fit to steer by in a state, or None; in the commit the sighting may be older."""
    stale_s = max(o.stale_after_s, o.limits.commit_sighting_age_s) if state is State.COMMIT else o.stale_after_s
    return unfit(s.estimate, s.at, stale_s)


def account(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    """Charge the guidance cycle to the attempt, and note what was seen."""
    since_last_s = 0.0 if p.last is None else max(0.0, seconds_between(p.last, s.at))
    p = replace(p, last=s.at, since_last_s=since_last_s, since=s.at if p.since is None else p.since)
    p = out_of_reach.climbed(p, s, since_last_s)
    if p.state not in FLOWN:
        return _seen_from(p, s, o)
    if p.state is State.RENDEZVOUS:
        p = replace(p, on_way=s.at)
    p = replace(p, attempt=p.attempt.cycle(since_last_s))
    if p.state in _CHARGED:
        p = replace(p, attempt=_CHARGED[p.state](p.attempt, since_last_s))
    if s.place is not None:
        p = replace(p, place_known=s.at)
        if p.state is State.SEARCH:
            p = replace(p, search_leg=rendezvous.next_leg(p.search_leg, s.place, o.rendezvous))
    p = _in_wind(p, s)
    if p.state is State.PRESS:
        p = replace(p, way_s=_way_s(p, s, o))
    if p.state is State.ANOTHER_PAD:
        return _asked(p, s, o)
    estimate, attempt = s.estimate, p.attempt
    other = estimate is not None and p.track is not None and estimate.track != p.track
    if estimate is None or other or unfit(estimate, s.at, o.stale_after_s) is not None:
        if p.in_sight and p.seen_height_m < o.tries.safe_height_m - NEAR_SAFE_M and p.state is not State.COMMIT:
            attempt = attempt.lost()
        if p.seen is not None:
            attempt = attempt.unseen(since_last_s)
        return _judged(replace(p, attempt=attempt, in_sight=False), s, o)
    if not p.in_sight and p.seen is not None and p.state is not State.GO_AROUND:
        attempt = attempt.descended(p.seen_height_m - estimate.height_m)
    attempt = attempt.seen(s.at, since_last_s)
    if p.state is State.COMMIT:
        low = estimate.height_m <= limits.no_return_m(s.knowledge, o.cone)
        p = replace(p, no_return_until=after(s.at, o.cone.no_return_s) if low else None)
    p = replace(p, course=_course(p, s, estimate))
    turning, turned = follow_arrow(p.heading, estimate)
    return _judged(
        replace(
            p, attempt=attempt, landing_began=s.at if p.landing_began is None else p.landing_began,
            in_sight=True, seen=s.at, was_silent=False, deck_rise_m=0.0, climbed_m=0.0,
            seen_height_m=estimate.height_m, track=estimate.track,
            heading=turning, turned=turned or p.turned,
        ),
        s,
        o,
    )  # fmt: skip


def _seen_from(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    """Note the height that is seen while no landing is flown, or found by a range that the estimate agrees with."""
    if s.estimate is None:
        return p
    height_m, range_m = s.estimate.height_m, s.range_m
    if unfit(s.estimate, s.at, o.stale_after_s) is not None:
        if range_m is None or s.estimate.alerts or abs(range_m - height_m) >= _AGREE * range_m:
            return p
        height_m = min(height_m, range_m)
    return replace(p, seen_height_m=height_m, was_silent=False, deck_rise_m=0.0, climbed_m=0.0)


def _in_wind(p: Progress, s: GuidanceCycle) -> Progress:
    """Note since when the wind has been beyond what the vehicle can fly; its own speed on the way to the ship is no wind."""
    slow = p.on_way is None or seconds_between(p.on_way, s.at) > _LEAN_SETTLES_S
    if s.wind is None or not slow or not s.wind.too_strong:
        return p if p.windy_since is None else replace(p, windy_since=None)
    return p if p.windy_since is not None else replace(p, windy_since=s.at)


def _windy_s(p: Progress, s: GuidanceCycle) -> float:
    return 0.0 if p.windy_since is None else seconds_between(p.windy_since, s.at)


def _windy(p: Progress, s: GuidanceCycle) -> Reason | None:
    """Return that the wind is too strong, once that has stood for longer than a gust."""
    if s.wind is None or _windy_s(p, s) < _WIND_DWELL_S:
        return None
    told = f"gusts of {s.wind.gust_m_s:.1f}, {math.degrees(s.wind.lean_rad):.0f} degrees of lean"
    return Reason(ReasonCause.WIND, s.wind.speed_m_s, s.wind.limit_m_s, told)


def _bars_descent(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return the wind that bars the way down to the gate: near the deck one that takes the whole tilt, higher up none.

    The wind grows with the height. A drone that holds in the cone finds less of it below, and one that does not leaves the cone.
    The room for gusts is the gate's matter.
    """
    low = p.seen_height_m < o.tries.safe_height_m
    return _windy(p, s) if low and s.wind is not None and s.wind.spent else None


def _came_nearer(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether a range sensor finds the deck out of sight nearer than it was in sight, and than is safe."""
    return s.range_m is not None and s.range_m < p.seen_height_m - NEAR_SAFE_M and out_of_reach.near(p, s, o)


def _course(p: Progress, s: GuidanceCycle, estimate: RelativeState) -> HeldCourse:
    """Return the height against what was ordered, after a cycle with sight."""
    if p.course.sign < 0 and not p.in_sight:
        return HeldCourse(p.course.sign).at_height(s.at, estimate.height_m, explained=False)
    deck, fastest = s.knowledge.deck, s.knowledge.climb_max_m_s or _FASTEST_M_S
    away = deck is not None and p.course.sign * deck.v_level.item(2) > fastest
    return p.course.at_height(s.at, estimate.height_m, explained=away)


def events(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield what happens in the present state, the most important first."""
    state, estimate = p.state, s.estimate
    if state in (State.REFUSED, State.GAVE_UP) and (ends := _battery_ends(p, s, o)) is not None:
        yield Event.BATTERY_ENDS, ends
    if state not in FLOWN:
        return
    if estimate is not None and p.track is not None and estimate.track != p.track:
        yield Event.OTHER_PAD, Reason(ReasonCause.ANOTHER_PAD)
    if state is State.ANOTHER_PAD:
        yield from _question(p, s, o)
        return
    in_state_s = p.in_state_s(s.at)
    yield from _contact(p, s, o, in_state_s)
    yield from _conditions(p, s, o)
    if (reason := _limit(p, s, o)) is not None:
        yield Event.LIMIT, reason
    yield from _time_over(p, s, o, in_state_s)
    lost = fit_in(state, s, o)
    if lost is not None:
        if p.no_return_until is None or s.at > p.no_return_until:
            yield Event.SIGHT_LOST, lost
    elif estimate is not None:
        yield Event.SIGHT, Reason(ReasonCause.PAD_SEEN, estimate.height_m)
    if s.place is not None:
        if rendezvous.far(s.place, o.rendezvous):
            yield Event.VESSEL_FAR, Reason(ReasonCause.VESSEL_FAR, s.place.distance_m)
        elif rendezvous.arrived(s.place, o.rendezvous):
            yield Event.ARRIVED, Reason(ReasonCause.VESSEL_NEAR, s.place.distance_m)
    if state is State.GO_AROUND and clear(p, s, o):
        yield Event.CLEAR, Reason(ReasonCause.HIGH_ENOUGH, _height_m(p, s, o), o.tries.safe_height_m)
    if lost is None and estimate is not None:
        yield from _way_down(p, s, o, estimate)


def clear(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether a go-around is high enough: by sight, or by the time that it has climbed since the newest sight."""
    if p.in_sight:
        return p.seen_height_m >= o.tries.safe_height_m - NEAR_SAFE_M
    return _height_m(p, s, o) >= o.tries.safe_height_m


def _height_m(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> float:
    """Return the height over the pad: the one that is seen, or the least that the climb since the newest sight has made."""
    if p.in_sight:
        return p.seen_height_m
    known = not p.was_silent and math.isfinite(p.seen_height_m)
    from_m = min(p.seen_height_m, o.tries.safe_height_m) if known else 0.0
    reckoned_m = from_m + p.climbed_m - p.deck_rise_m
    if s.range_m is not None and out_of_reach.near(p, s, o):
        return min(reckoned_m, s.range_m)
    estimate = s.estimate
    if estimate is None or estimate.alerts != (IntegrityAlert.UNFELT,) or estimate.age_s(s.at) > o.stale_after_s:
        return reckoned_m
    # The height is seen all the same.
    return min(reckoned_m, estimate.height_m)


def _contact(p: Progress, s: GuidanceCycle, o: GuidanceOptions, in_state_s: float) -> Iterator[EventWithReason]:
    felt = s.knowledge.impact
    if felt is not None and (p.since is None or felt.at < p.since or not _at_the_deck(felt, s, o)):
        felt = None
    feet_m = contact.feet_m(s, o.cone)
    if p.state is State.COMMIT and p.since is not None:
        if felt is None and s.touch is not None and p.since <= s.touch.at and seconds_between(s.touch.at, s.at) <= _TOUCH_S:
            felt = s.touch
        votes = contact.votes(s, felt, o, in_state_s) + (0.5 if p.bounces >= BOUNCES_MOST else 0.0)
        if votes >= contact.ENOUGH or (felt is None and _over_blind(s, o, feet_m)):
            yield Event.CONTACT, Reason(ReasonCause.REACHED, feet_m) if felt is None else _of_contact(felt)
    steers = s.estimate is not None and s.estimate.steers
    climbs = p.state is State.GO_AROUND and (feet_m is None or feet_m > _TOUCHES_M or steers or _own_thrust(felt, s))
    may_stay = p.state in _MAY_STAY and not climbs
    if may_stay and felt is not None and p.bounces < _TOUCHES_MOST and _stands_on_pad(s, o, feet_m):
        yield Event.CONTACT, _of_contact(felt)
    # Wind drags a vehicle over the deck for as long as its rotors carry a part of the weight.
    press_s = o.cone.press_s * (_PRESS_IN_WIND if s.wind is not None and s.wind.drags else 1.0)
    press_s = max(o.cone.press_s + press_s if _rises(s) else press_s, p.way_s or 0.0)
    if p.state is State.PRESS and in_state_s >= press_s and not contact.descends(s, o):
        yield Event.PRESSED, Reason(ReasonCause.PRESSED, in_state_s, press_s)


def _way_s(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> float:
    """Return the time from the contact after which the feet are at the deck by what contradicts it, s."""
    if p.way_s is None:
        return contact.way_s(s, o)
    estimate, since = s.estimate, p.since
    # What no frame shows any more is reckoned with an accelerometer that the contact may have shaken.
    seen_since = estimate is not None and since is not None and estimate.sighted > since and estimate.age_s(s.at) <= _FRESH_S
    left_s = contact.way_s(s, o, contact.NEAR_M) if seen_since else 0.0
    return max(p.way_s, p.in_state_s(s.at) + left_s) if left_s > 0.0 else p.way_s


def _rises(s: GuidanceCycle) -> bool:
    """Return whether the drone goes up from the deck: its own landing would have to begin in the air."""
    estimate = s.estimate
    return estimate is not None and not estimate.alerts and estimate.v_pad_level.item(2) > _RISES_M_S


def _over_blind(s: GuidanceCycle, o: GuidanceOptions, feet_m: float | None) -> bool:
    """Return whether the commit has come to the deck when its sight is too old, or its driver lets it hover there.

    A climb from there is worse than to press on, and a deck drags a vehicle that hovers on it.
    """
    too_old = s.estimate is not None and s.estimate.age_s(s.at) > o.limits.commit_sighting_age_s
    return (too_old or s.unflown) and feet_m is not None and feet_m <= _AT_DECK_M and _stands_on_pad(s, o, feet_m)


def _stands_on_pad(s: GuidanceCycle, o: GuidanceOptions, feet_m: float | None) -> bool:
    """Return whether a vehicle whose feet touch the deck now comes to stand on the pad."""
    if s.estimate is None or feet_m is None or feet_m > contact.NEAR_M:
        return False
    return limits.stop_m(s.estimate) <= limits.ON_PAD * o.limits.commit_error_m


def _at_the_deck(felt: Impact, s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether it is a contact: an updraft holds up too, which counts near the deck alone and while it lasts."""
    if felt.by != "velocity":
        return True
    low = s.estimate is None or s.estimate.height_m < o.cone.feet_below_m + _HELD_UP_BELOW * o.cone.gate_height_m
    return low and seconds_between(felt.at, s.at) <= HELD_S


def _own_thrust(felt: Impact | None, s: GuidanceCycle) -> bool:
    """Return whether a push in a go-around is no more than what its own climb needs to begin, beyond the least of a contact."""
    climb, fastest = s.knowledge.climb, s.knowledge.climb_max_m_s
    if felt is None or felt.by != "accelerometer" or climb is None or fastest is None:
        return False
    return felt.size_m_s2 <= contact.LEAST_M_S2 + fastest / climb.lag_s


def _of_contact(felt: Impact) -> Reason:
    if felt.by == "accelerometer":
        return Reason(ReasonCause.FELT, felt.size_m_s2)
    return Reason(ReasonCause.HELD_UP, felt.held_m_s) if felt.by == "velocity" else Reason(ReasonCause.REPORTED)


def _conditions(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield what ends the flight's tries: wind and late answers at once, the battery before it begins, the rest between tries."""
    if p.state is State.GO_AROUND and not clear(p, s, o):
        return
    low = ends(s.battery, o)
    lost = fit_in(p.state, s, o) is not None
    # The pad in sight is the nearest way down then, whatever wind and waves: the gate still waits for its limits.
    stays = not low or lost
    if stays and s.wind is not None and (windy := _windy(p, s)) is not None:
        waited_s = _windy_s(p, s)
        blind_s = 0.0 if p.in_sight else waited_s if p.seen is None else min(waited_s, seconds_between(p.seen, s.at))
        if waited_s > o.limits.wind_wait_s or (s.wind.spent and blind_s > _SPENT_WAIT_S):
            yield Event.NO_CONDITIONS, windy
    outrun_m = s.knowledge.outrun_m
    waits = p.state in (State.INTERCEPT, State.DESCEND, State.GATE) and s.knowledge.swell_watched_s >= SWELL_MEAN_S
    if stays and waits and o.cone.gate_m + outrun_m > o.tries.safe_height_m:
        # It would wait as high as it goes around. One large wave alone is no such swell.
        yield Event.NO_CONDITIONS, Reason(ReasonCause.DECK_RISE, outrun_m, o.tries.safe_height_m - o.cone.gate_m)
    if s.late_s is not None:
        yield Event.NO_CONDITIONS, Reason(ReasonCause.ANSWERS_LATE, s.late_s, DELAY_MAX_S)
    if p.state is State.GO_AROUND and s.off_orders is not None:
        yield Event.NO_CONDITIONS, s.off_orders
    if s.estimate is not None and IntegrityAlert.IMU_LATE in s.estimate.alerts:
        yield Event.NO_CONDITIONS, Reason(ReasonCause.ALERT, detail=IntegrityAlert.IMU_LATE)
    if p.state in (State.SEARCH, State.RENDEZVOUS) and isinstance(s.vessel, Reason) and lost:
        known = max((at for at in (p.since, p.place_known) if at is not None), default=s.at)
        if seconds_between(known, s.at) > o.rendezvous.lost_s:
            yield Event.NO_CONDITIONS, s.vessel
    # A landing that has begun is the nearest way down: after a go-around a low battery is one reason more to try again.
    begins = p.state in (State.SEARCH, State.RENDEZVOUS) and lost
    if low and s.battery is not None and begins and p.in_state_s(s.at) > _LOOKS_S:
        yield Event.NO_CONDITIONS, Reason(ReasonCause.BATTERY, 100.0 * s.battery, 100.0 * o.limits.battery)
    if p.state is State.GO_AROUND and p.fault is not None:
        used_up = p.go_arounds > o.tries.go_arounds_max or _landing_over(p, s, o) is not None
        if (p.refusing and stays) or (used_up and p.fault.cause in CONDITIONS):
            yield Event.NO_CONDITIONS, p.fault
        if used_up:
            yield Event.HOPELESS, (None if p.in_sight else of_frames(s.frames)) or p.fault


def _battery_ends(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return that the battery of a drone that refused will not last while the pad is in sight; what stands does not take off."""
    if (
        p.stood
        or p.in_state_s(s.at) < _ENDS_AFTER_S
        or s.battery is None
        or not o.last_charge < s.battery < o.limits.battery
        or fit_in(p.state, s, o) is not None
    ):
        return None
    return Reason(ReasonCause.BATTERY_ENDS, 100.0 * s.battery, 100.0 * o.last_charge)


def _limit(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    estimate = s.estimate
    match p.state:
        case State.COMMIT:
            ends = (
                None
                if estimate is None
                else limits.commit(s.at, estimate, s.knowledge, limits.of_try(o.limits, p.go_arounds), o.cone)
            )
            turns = estimate is not None and estimate.height_m > limits.no_return_m(s.knowledge, o.cone)
            return ends or (s.thing if turns else None) or _against(p, s)
        case State.DOWN if o.mission == "thesis":
            return _lease(p, s, o)
        case State.PRESS | State.DOWN:
            return _past_deck(s) or (None if p.bounces >= BOUNCES_MOST else off_deck(p, s, o))
        case State.INTERCEPT | State.DESCEND | State.GATE | State.HOLD_BLIND:
            if o.tries.heading == "align" and p.turned is not None:
                return p.turned
            ends = _landing_over(p, s, o) or p.attempt.used_up(o.tries, s.at) or s.off_orders or _against(p, s)
            if ends is not None:
                return ends
            wind = _windy(p, s) if p.state is State.GATE else _bars_descent(p, s, o)
            if p.state in (State.DESCEND, State.GATE) and (bars := wind or s.thing) is not None:
                return bars
            if p.state is State.INTERCEPT and o.mission != "thesis" and _reaches_deck(estimate, s, o, _ENDS_S):
                return _sank(p, s)
            low = p.seen_height_m < o.tries.safe_height_m - NEAR_SAFE_M
            if p.state is State.HOLD_BLIND and low and p.seen is not None:
                lost_s = seconds_between(p.seen, s.at)
                lies = estimate is not None and not _STAY.isdisjoint(estimate.alerts)
                if lost_s > o.tries.climb_after_s or lies or _came_nearer(p, s, o) or _reaches_deck(estimate, s, o, _TURNS_S):
                    return Reason(ReasonCause.LOST_LOW, p.seen_height_m)
    return None


def _sank(p: Progress, s: GuidanceCycle) -> Reason | None:
    """Return that a drone which keeps its height has sunk; None while it has not."""
    if p.since is None or s.estimate is None or (sank_m := p.entered_height_m - s.estimate.height_m) < _SANK_M:
        return None
    return Reason(ReasonCause.SANK_AGAINST, sank_m, round(seconds_between(p.since, s.at), 1))


def _reaches_deck(estimate: RelativeState | None, s: GuidanceCycle, o: GuidanceOptions, within_s: float) -> bool:
    """Return whether a drone may be at the deck before a climb begins. Whose deck it is does not matter then."""
    if estimate is None:
        return False
    height_m = estimate.height_m - min(_DEVIATES_MOST, math.sqrt(estimate.cov.item(2, 2)))
    rises_m_s = min(_DEVIATES_MOST, math.sqrt(estimate.cov.item(5, 5))) - estimate.v_pad_level.item(2)
    return min(height_m, math.inf if s.range_m is None else s.range_m) - o.cone.feet_below_m < rises_m_s * within_s


def _landing_over(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return that the time of the whole landing is used up, or None while it is not."""
    spent_s = 0.0 if p.landing_began is None else seconds_between(p.landing_began, s.at)
    return Reason(ReasonCause.LANDING_TIME, spent_s, o.tries.landing_s) if spent_s > o.tries.landing_s else None


def _against(p: Progress, s: GuidanceCycle) -> Reason | None:
    """Return the reason if the height moves against the order, or None."""
    if not p.in_sight or s.estimate is None or (against_m := p.course.against_m(s.at, s.estimate.height_m)) is None:
        return None
    return Reason(ReasonCause.ROSE_AGAINST if p.course.sign > 0 else ReasonCause.SANK_AGAINST, against_m, LASTS_S)


def _search_over(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return that the pad was not seen within the time since the order, all ways to the ship and searches together."""
    if p.asked_at is None or p.landing_began is not None:
        return None
    limit_s = o.tries.search_s + (o.rendezvous.time_s if o.rendezvous.enabled else 0.0)
    spent_s = seconds_between(p.asked_at, s.at)
    return Reason(ReasonCause.NOT_FOUND, spent_s, limit_s) if spent_s > limit_s else None


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


def _past_deck(s: GuidanceCycle) -> Reason | None:
    """Return that the drone is below the deck: it was swept off the pad, and would go down into the water."""
    past_m = 0.0 if s.estimate is None else -s.estimate.height_m
    return Reason(ReasonCause.PAST_DECK, past_m) if past_m > _BELOW_DECK_M else None


def _lease(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return what ends a landing that the vehicle makes by itself from the last way point, its time apart.

    From the height of the last way point down the pad leaves the camera's view, so there only the time ends it.
    """
    estimate, final = s.estimate, o.thesis
    if (past := _past_deck(s)) is not None:
        return past
    if estimate is not None and unfit(estimate, s.at, o.stale_after_s) is None:
        risen_m = estimate.height_m - p.entered_height_m
        if risen_m > _RISEN_M:
            return Reason(ReasonCause.ROSE, risen_m)
        aside_m = final.final_reached_m + _ASIDE_M + final.pad_ahead_m
        return Reason(ReasonCause.DRIFTED, estimate.lateral_m, aside_m) if estimate.lateral_m > aside_m else None
    blind_below_m = final.final_height_m + final.final_reached_m + _BLIND_MARGIN_M
    lost = p.seen is not None and seconds_between(p.seen, s.at) > o.stale_after_s
    return Reason(ReasonCause.LOST_LOW, p.seen_height_m) if lost and p.seen_height_m > blind_below_m else None


def _time_over(p: Progress, s: GuidanceCycle, o: GuidanceOptions, in_state_s: float) -> Iterator[EventWithReason]:
    tries = o.tries
    if p.state in (State.SEARCH, State.RENDEZVOUS) and (over := _landing_over(p, s, o) or _search_over(p, s, o)) is not None:
        yield Event.TIMEOUT, over
    if p.state in (State.HOLD_BLIND, State.SEARCH):
        limit_s, cause = (
            (tries.give_up_after_s, ReasonCause.NOT_FOUND_AGAIN)
            if p.state is State.HOLD_BLIND
            else (tries.search_s, ReasonCause.NOT_FOUND)
        )
        spent_s = p.attempt.without_sight_s if p.state is State.HOLD_BLIND else in_state_s
        if spent_s > limit_s:
            yield Event.TIMEOUT, of_frames(s.frames) or _why_blind(p) or Reason(cause, spent_s, limit_s)
        return
    if p.state is State.GO_AROUND:
        to_climb_m = max(0.0, tries.safe_height_m - p.entered_height_m)
        limit_s = _CLIMB_PATIENCE * to_climb_m / tries.climb_m_s + _CLIMB_PATIENCE_S
        cause = ReasonCause.NOT_CLIMBING
        if (sinks := _against(p, s)) is not None:
            yield Event.TIMEOUT, sinks
    else:
        limit_s, cause = _TIME_OF[p.state](o)
    spent_s = _SPENT[p.state](p.attempt) if p.state in _SPENT else in_state_s
    if spent_s > limit_s:
        yield Event.TIMEOUT, p.blocked or (s.thing if p.state is State.INTERCEPT else None) or Reason(cause, spent_s, limit_s)


_TIME_OF: Mapping[State, Callable[[GuidanceOptions], tuple[float, ReasonCause]]] = {
    State.RENDEZVOUS: lambda o: (o.rendezvous.time_s, ReasonCause.STATE_TIME),
    State.INTERCEPT: lambda o: (o.tries.leg_s, ReasonCause.STATE_TIME),
    State.DESCEND: lambda o: (o.tries.leg_s, ReasonCause.STATE_TIME),
    State.GATE: lambda o: (o.cone.gate_s, ReasonCause.STATE_TIME),
    State.COMMIT: lambda o: (o.cone.commit_s, ReasonCause.NO_CONTACT),
    State.PRESS: lambda o: (o.cone.press_s + o.cone.commit_s, ReasonCause.STATE_TIME),
    State.DOWN: lambda o: (o.land_timeout_s, ReasonCause.NO_LANDING),
}

# A gust that takes the drone out of the gate or the cone, and a loss of sight, do not give it another time there.
_CHARGED: Mapping[State, Callable[[Attempt, float], Attempt]] = {
    State.INTERCEPT: Attempt.over_pad,
    State.DESCEND: Attempt.in_descent,
    State.GATE: Attempt.at_gate,
}
"""Functions that charge a guidance cycle to the attempt, for states whose visits share one time budget."""
_SPENT: Mapping[State, Callable[[Attempt], float]] = {
    State.INTERCEPT: lambda attempt: attempt.over_pad_s,
    State.DESCEND: lambda attempt: attempt.in_descent_s,
    State.GATE: lambda attempt: attempt.at_gate_s,
}
"""The time that they have shared so far, s."""


def _why_blind(p: Progress) -> Reason | None:
    """Return why the sight ended where that says more than that the pad is out of sight; None if it does not."""
    return p.reason if p.state is State.HOLD_BLIND and p.reason is not None and p.reason.cause in _TELLING else None


def _way_down(p: Progress, s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> Iterator[EventWithReason]:
    if o.mission == "thesis":
        yield from _way_points(p, s, o, estimate)
        return
    height_m, error_m = estimate.height_m, limits.beside_m(estimate, s.knowledge)
    radius_m = cone.radius_m(height_m, o.cone)
    if p.state is State.INTERCEPT and cone.inside(error_m, height_m, o.cone) and (_bars_descent(p, s, o) or s.thing) is None:
        yield Event.IN_CONE, Reason(ReasonCause.ARRIVED, error_m, radius_m)
    high = height_m > o.cone.gate_m + _OVER_GATE_M
    if cone.outside(error_m, height_m, o.cone) or (p.state is State.GATE and high):
        yield Event.OUT_OF_CONE, Reason(ReasonCause.OUT_OF_CONE, error_m, radius_m)
    if p.state is State.DESCEND and height_m <= o.cone.gate_m + _AT_GATE_M:
        yield Event.AT_GATE, Reason(ReasonCause.LOW_ENOUGH, height_m, o.cone.gate_m)
    if p.state is State.GATE and p.good_since is not None and seconds_between(p.good_since, s.at) >= o.cone.gate_dwell_s:
        yield Event.GATE_OPEN, Reason(ReasonCause.ALL_LIMITS_HOLD)


def _way_points(p: Progress, s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> Iterator[EventWithReason]:
    way = o.thesis
    over = near(estimate, way.pad_ahead_m, way.approach_height_m, way.approach_reached_m)
    if p.state is State.INTERCEPT and over and s.thing is None:
        yield Event.IN_CONE, Reason(ReasonCause.ARRIVED, estimate.lateral_m, way.approach_reached_m)
    if p.state is State.DESCEND and near(estimate, way.pad_ahead_m, way.final_height_m, way.final_reached_m):
        yield Event.AT_GATE, Reason(ReasonCause.LOW_ENOUGH, estimate.height_m, way.final_height_m)
    if p.state is State.GATE:
        if not near(estimate, way.pad_ahead_m, way.final_height_m, 2.0 * way.final_reached_m):
            yield Event.OUT_OF_CONE, Reason(ReasonCause.OUT_OF_CONE, estimate.lateral_m, way.final_reached_m)
        if p.good_since is not None and seconds_between(p.good_since, s.at) >= way.final_dwell_s:
            yield Event.GATE_OPEN, Reason(ReasonCause.ALL_LIMITS_HOLD)


def near(estimate: RelativeState, ahead_m: float, height_m: float, reached_m: float) -> bool:
    """Return whether the drone is within `reached_m` of a way point, aside and in height."""
    x, y, z = estimate.d_body_pad_level.tolist()
    return math.hypot(x - ahead_m, y) <= reached_m and abs(z - height_m) <= reached_m


def _judged(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    """Note what keeps the gate shut, and since when nothing does."""
    if p.state is not State.GATE:
        return p
    blocked = unfit(s.estimate, s.at, o.stale_after_s)
    if blocked is None and s.estimate is not None:
        blocked = (
            _thesis_gate(s.estimate, o)
            if o.mission == "thesis"
            else limits.gate(
                s.at,
                s.estimate,
                s.knowledge,
                s.quality,
                limits.of_try(o.limits, p.go_arounds),
                o.cone,
                aligned=o.tries.heading == "align",
            )
        )
    blocked = blocked or s.unseen
    if blocked is not None:
        if p.waits_since is None or seconds_between(p.waits_since, s.at) >= _REASON_STANDS_S:
            p = replace(p, waits_for=blocked, waits_since=s.at)
        tilts = blocked.measured if blocked.cause is ReasonCause.DECK_TILT else None
        # A deck that tilts this far in its swing is not still for as long as a commit takes: one wait for it is enough.
        refusing = p.refusing or (tilts is not None and tilts > _TILTS_FAR * o.limits.deck_tilt_gate_deg)
        return replace(p, blocked=blocked, good_since=None, refusing=refusing)
    return replace(p, blocked=None, good_since=s.at if p.good_since is None else p.good_since)


def _thesis_gate(estimate: RelativeState, o: GuidanceOptions) -> Reason | None:
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


def _asked(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    """Note for how long one other pad alone has been in unbroken sight."""
    estimate = s.estimate
    if estimate is None or unfit(estimate, s.at, o.stale_after_s) is not None:
        return replace(p, good_since=None)
    steady = p.good_since if estimate.track == p.newest_track else None
    return replace(p, newest_track=estimate.track, good_since=s.at if steady is None else steady)


def _question(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    waited_s = p.in_state_s(s.at)
    if waited_s > o.tries.operator_wait_s:
        yield Event.TIMEOUT, Reason(ReasonCause.NOBODY_DECIDED, waited_s, o.tries.operator_wait_s)
    if o.tries.another_pad != "automatic" or p.questions > 1 or p.good_since is None or s.estimate is None:
        return
    safe_m = o.tries.safe_height_m - NEAR_SAFE_M
    held_s = seconds_between(p.good_since, s.at)
    if min(p.entered_height_m, s.estimate.height_m) >= safe_m and held_s >= o.tries.another_pad_s:
        yield Event.BEGIN, Reason(ReasonCause.AUTOMATIC)
