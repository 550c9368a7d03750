"""Events that can end more than one state, each with its reason. Every state's file names those that hold in it."""

import math
from collections.abc import Callable, Iterator, Mapping

from msgspec.structs import replace

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.law.response_watch import DELAY_MAX_S
from companion.guidance.mission import charge, limits
from companion.guidance.mission.clearance import SWELL_MEAN_S
from companion.guidance.mission.held_course import LASTS_S
from companion.guidance.mission.progress import GuidanceCycle, Progress, unfit
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.estimates import IntegrityAlert, RelativeState
from estimator.contracts.time import seconds_between

EventWithReason = tuple[Event, Reason]
Events = Callable[[Progress, GuidanceCycle, GuidanceOptions], Iterator[EventWithReason]]
"""A function that yields what happens in a guidance cycle, the most important first."""
ByEstimate = Callable[[Progress, GuidanceCycle, GuidanceOptions, RelativeState], Iterator[EventWithReason]]
"""The same by an estimate that is fit to land by."""
Bar = Callable[[Progress, GuidanceCycle, GuidanceOptions], Reason | None]
"""A function that returns what bars a way, or None."""
Row = Mapping[Event, State]
"""The states that events lead to; an event that is not named leaves the state as it is."""

_SPENT_WAIT_S = 8.0
"""Time for which it waits out of sight where the lean takes all of the tilt, s: the gust may pass, but the drone is blown off."""
_NEAR_DECK_S = 110.0
"""Time near the deck that a landing may have, all tries together, s: sound flights waited there for up to 109 s for a quiet deck
(`weather_4`, seed 896010)."""
_SWEEPS_ALL_MOST = 15
"""Sweeps out of the cone near the deck that a landing may have: three tries of them, the last in the widest cone."""
_WIND_DWELL_S = 2.0
"""Time for which the wind must be too strong before anything is done about it, s."""
_ENDS_S = 0.4  # time that a way down takes to end at a height that is kept
_SANK_M = 0.1  # least that the drone has sunk below that height
_DEVIATES_MOST = 0.12
"""Standard deviation of a height, m, or its rate, m/s, that counts at most: a path without the IMU hardly knows them."""


def unfit_here(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return why the estimate is not fit to steer by in the present state, or None; in the commit the sighting may be older."""
    stale_s = max(o.stale_after_s, o.limits.commit_sighting_age_s) if p.state is State.COMMIT else o.stale_after_s
    return unfit(s.estimate, s.at, stale_s)


def fit_estimate(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> RelativeState | None:
    """Return the estimate if it is fit to steer by in the present state."""
    return s.estimate if unfit_here(p, s, o) is None else None


def other_pad(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield that the estimate is of another pad than the one that this attempt flies to."""
    if s.estimate is not None and p.track is not None and s.estimate.track != p.track:
        yield Event.OTHER_PAD, Reason(ReasonCause.ANOTHER_PAD)


def pad_seen(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield that there is an estimate to fly by."""
    if (estimate := fit_estimate(p, s, o)) is not None:
        yield Event.SIGHT, Reason(ReasonCause.PAD_SEEN, estimate.height_m)


def sight_lost(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield that there is none."""
    if (lost := unfit_here(p, s, o)) is not None:
        yield Event.SIGHT_LOST, lost


def time_over(spent_s: float, limit_s: float, reason: Reason | None = None) -> Iterator[EventWithReason]:
    """Yield that a state's time is over, for a better reason than that if there is one."""
    if spent_s > limit_s:
        yield Event.TIMEOUT, reason or Reason(ReasonCause.STATE_TIME, spent_s, limit_s)


def landing_over(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return what used up the whole landing: a thing that bars the pad, else its time, its time near the deck, or its sweeps.

    None while nothing is used up. With the last charge the time alone counts.
    """
    spent_s = 0.0 if p.landing_began is None else seconds_between(p.landing_began, s.at)
    if spent_s > o.tries.landing_s:
        return s.thing or Reason(ReasonCause.LANDING_TIME, spent_s, o.tries.landing_s)
    if charge.battery_ends(s.battery, o):
        return None
    if p.low_s > _NEAR_DECK_S:
        return s.thing or Reason(ReasonCause.LOW_TIME, p.low_s, _NEAR_DECK_S)
    return Reason(ReasonCause.SWEPT, float(p.sweeps), float(_SWEEPS_ALL_MOST)) if p.sweeps > _SWEEPS_ALL_MOST else None


def against_order(p: Progress, s: GuidanceCycle) -> Reason | None:
    """Return the reason if the height moves against the order, or None."""
    if not p.in_sight or s.estimate is None or (against_m := p.course.against_m(s.at, s.estimate.height_m)) is None:
        return None
    return Reason(ReasonCause.ROSE_AGAINST if p.course.sign > 0 else ReasonCause.SANK_AGAINST, against_m, LASTS_S)


def try_over(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return what ends an attempt in each state of its way to the gate, or None."""
    if o.tries.heading == "align" and p.turned is not None:
        return p.turned
    return landing_over(p, s, o) or p.attempt.used_up(o.tries, s.at) or s.off_orders or against_order(p, s)


def reaches_deck(estimate: RelativeState | None, s: GuidanceCycle, o: GuidanceOptions, within_s: float) -> bool:
    """Return whether a drone may be at the deck before a climb begins. Whose deck it is does not matter then."""
    if estimate is None:
        return False
    height_m = estimate.height_m - min(_DEVIATES_MOST, math.sqrt(estimate.cov.item(2, 2)))
    rises_m_s = min(_DEVIATES_MOST, math.sqrt(estimate.cov.item(5, 5))) - estimate.v_pad_level.item(2)
    return min(height_m, math.inf if s.range_m is None else s.range_m) - o.cone.feet_below_m < rises_m_s * within_s


def sank(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return that a drone which keeps its height sinks onto the deck; None while it does not."""
    if p.since is None or s.estimate is None or not reaches_deck(s.estimate, s, o, _ENDS_S):
        return None
    sank_m = p.entered_height_m - s.estimate.height_m
    return Reason(ReasonCause.SANK_AGAINST, sank_m, round(seconds_between(p.since, s.at), 1)) if sank_m >= _SANK_M else None


def windy_s(p: Progress, s: GuidanceCycle) -> float:
    """Return the time for which the wind has been beyond what the vehicle can fly, s."""
    return 0.0 if p.windy_since is None else seconds_between(p.windy_since, s.at)


def windy(p: Progress, s: GuidanceCycle) -> Reason | None:
    """Return that the wind is too strong, once that has stood for longer than a gust."""
    if s.wind is None or windy_s(p, s) < _WIND_DWELL_S:
        return None
    detail = f"by its drag, gusts of {s.wind.gust_m_s:.1f}, {math.degrees(s.wind.lean_rad):.0f} degrees of lean"
    return Reason(ReasonCause.WIND, s.wind.speed_m_s, s.wind.limit_m_s, detail)


def bars_descent(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return the wind that bars the way down to the gate: near the deck one that takes the whole tilt, higher up none.

    The wind grows with the height. A drone that holds in the cone finds less of it below, and one that does not leaves the cone.
    The room for gusts is the gate's matter.
    """
    low = p.seen_height_m < o.tries.safe_height_m
    return windy(p, s) if low and s.wind is not None and s.wind.spent else None


def bars_commit(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return the first limit of the cone's gate that does not hold, or None."""
    if (lost := unfit(s.estimate, s.at, o.stale_after_s)) is not None or s.estimate is None:
        return lost
    aligned = o.tries.heading == "align"
    return limits.gate(s.at, s.estimate, s.knowledge, s.quality, o.limits, o.cone, aligned=aligned) or s.unseen


def conditions_count(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether wind and waves can end the tries: with a battery that ends, a pad in sight is the nearest way down."""
    return not charge.battery_ends(s.battery, o) or unfit_here(p, s, o) is not None


def too_windy(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield that the wind will not pass within this flight."""
    if s.wind is None or not conditions_count(p, s, o):
        return
    if s.wind.forbids:
        yield Event.NO_CONDITIONS, Reason(ReasonCause.WIND, s.wind.speed_m_s, s.wind.limit_m_s, "by the ship's anemometer")
    if (wind := windy(p, s)) is None:
        return
    waited_s = windy_s(p, s)
    blind_s = 0.0 if p.in_sight else waited_s if p.seen is None else min(waited_s, seconds_between(p.seen, s.at))
    if waited_s > o.limits.wind_wait_s or (s.wind.spent and blind_s > _SPENT_WAIT_S):
        yield Event.NO_CONDITIONS, wind


def outrun(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield that a drone would wait for this swell as high as it goes around. One large wave alone is no such swell."""
    outrun_m = s.knowledge.outrun_m
    watched = s.knowledge.swell_watched_s >= SWELL_MEAN_S
    if watched and conditions_count(p, s, o) and o.cone.gate_m + outrun_m > o.tries.safe_height_m:
        yield Event.NO_CONDITIONS, Reason(ReasonCause.DECK_RISE, outrun_m, o.tries.safe_height_m - o.cone.gate_m)


def lens_elsewhere(s: GuidanceCycle) -> Reason | None:
    """Return that the lens is not where the camera's file has it, so that the landing would be as far off; else None."""
    off_m = None if s.estimate is None else s.estimate.lens_off_m
    if off_m is None:
        return None
    forward_m, right_m = off_m
    return Reason(ReasonCause.LENS, 100.0 * math.hypot(*off_m), detail=f"{forward_m:+.2f} m forward, {right_m:+.2f} m right")


def unlandable(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield that the vehicle answers too late to be flown, its own samples come too late to land by, or its lens is elsewhere."""
    if s.late_s is not None:
        yield Event.NO_CONDITIONS, Reason(ReasonCause.ANSWERS_LATE, s.late_s, DELAY_MAX_S)
    if s.estimate is not None and IntegrityAlert.IMU_LATE in s.estimate.alerts:
        yield Event.NO_CONDITIONS, Reason(ReasonCause.ALERT, detail=IntegrityAlert.IMU_LATE)
    if (elsewhere := lens_elsewhere(s)) is not None and conditions_count(p, s, o):
        yield Event.NO_CONDITIONS, elsewhere


def try_ends(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield the conditions that end an attempt on its way down."""
    yield from too_windy(p, s, o)
    yield from outrun(p, s, o)
    yield from unlandable(p, s, o)


def unconfirmed(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield that there is no velocity to look for the pad by."""
    if s.unconfirmed is not None and unfit_here(p, s, o) is not None:
        yield Event.NO_CONDITIONS, s.unconfirmed


def spend(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    """Charge a guidance cycle to the time that all visits of the state share."""
    return replace(p, attempt=p.attempt.spend(p.state, p.since_last_s))
