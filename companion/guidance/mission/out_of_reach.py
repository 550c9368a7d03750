"""Climb out of the deck's reach without sight of the pad, by what knows the height without the camera.

A deck in waves comes up to a drone that stays where it is, and feet that move along a deck catch and turn the vehicle over. So a
drone that is low, or does not know how high it is, climbs first and flies nowhere else meanwhile. One rule serves every state
(`low`); the states differ in the height that they want (`_WANTED`). The witnesses in order: the range sensor, not believed beyond
twice the safe height; the height that was last known, with what it has climbed and the deck has risen since; the one that is
reckoned out of sight, where a person flew it meanwhile; the time for which it has climbed, where the range sensor's silence says
nothing. A silent vehicle may not have climbed: its time counts by itself.
"""

import math
from collections.abc import Mapping

from msgspec.structs import replace

from companion.base.mission import FLOWN, State
from companion.guidance.mission.progress import STARVED_S, GuidanceCycle, Progress, fit_to_steer
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.time import seconds_between

NEAR_SAFE_M = 0.25
"""A height at most this far below the safe height counts as the safe height, metres."""
SILENT_S = 0.3
"""Time without a sample of the vehicle after which it counts as silent, seconds."""
_LIFT_M = 0.3
"""Height of the feet below which the drone climbs as fast as it can, m."""
_WANTED: Mapping[State, float] = {State.COMMIT: 0.0, State.REFUSED: 2.0, State.GAVE_UP: 2.0}
"""Known height below which a drone without sight is low, in safe heights; 1 in states that are not named.

A commit that must not end awaits its contact. A drone that refused may hover for long, over a deck out of sight.
"""
_BY_TIME = FLOWN | {State.REFUSED, State.GAVE_UP}
"""States that climb where nothing says how high the drone is. Where a person ordered it to hold, only a witness moves it."""
_WAITS_S = 3.0
"""Time for which a search that knows nothing of its height hovers first, s: the pad is about to be seen, wind moves a climb."""
_FELT_S = 20.0
"""Time after a contact for which a drone may still stand there while nothing says how high it is, s."""
_MOST = 2.0
"""Height beyond which no range sensor is believed against the climb so far, and the most that is climbed, in safe heights."""


def fastest_climb_m_s(s: GuidanceCycle, o: GuidanceOptions) -> float:
    """Return the fastest climb that the vehicle can make, m/s."""
    return max(o.tries.climb_m_s, s.knowledge.climb_max_m_s or 0.0)


def climbed(p: Progress, s: GuidanceCycle, since_last_s: float) -> Progress:
    """Charge a guidance cycle to the climb and the deck's rise; a vehicle that is silent, or left alone, may not have climbed."""
    if s.knowledge.deck is not None:
        p = replace(p, deck_rise_m=p.deck_rise_m - since_last_s * s.knowledge.deck.v_level.item(2))
    ordered_m = min(since_last_s, STARVED_S) * p.climbs_m_s
    if s.silent_s > SILENT_S:
        return replace(p, silent_m=(p.silent_m or 0.0) + ordered_m)
    return replace(p, climbed_m=p.climbed_m + ordered_m) if ordered_m else p


def flown_by_others(p: Progress) -> Progress:
    """Return the memory after a cycle whose command was another one: a climb that was ordered was not flown.

    Where a person flies a vehicle that waits, its height afterwards is not known, and its place is the new one.
    """
    p = replace(p, climbs_m_s=0.0)
    return p if p.state in FLOWN else replace(p, seen_height_m=math.inf, climbed_m=0.0, held=None)


def height_m(p: Progress, s: GuidanceCycle) -> float | None:
    """Return the least height over the deck by what was last known of it, m; None if nothing is."""
    if math.isfinite(p.seen_height_m) and p.silent_m is None:
        return p.seen_height_m + p.climbed_m - max(0.0, p.deck_rise_m)
    return _reckoned_m(p, s) if s.place is None else s.place.height_m


def _reckoned_m(p: Progress, s: GuidanceCycle) -> float | None:
    """Return the height that is reckoned out of sight, m; None where nothing is, or where a person ordered it to hold."""
    estimate = s.estimate
    if estimate is None or estimate.alerts or p.silent_m is not None or p.state not in _BY_TIME:
        return None
    return max(0.0, estimate.height_m)


def near(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether a range sensor finds the surface nearer than is safe, and may be believed."""
    # A drone that a person has flown meanwhile is not where it was seen.
    from_m = p.seen_height_m if p.state in FLOWN and math.isfinite(p.seen_height_m) and p.silent_m is None else 0.0
    safe_m = o.tries.safe_height_m
    return s.range_m is not None and s.range_m < safe_m - NEAR_SAFE_M and from_m + p.climbed_m < _MOST * safe_m


def low(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether a drone without sight of the pad may be within the reach of the deck."""
    safe_m, wanted = o.tries.safe_height_m, _WANTED.get(p.state, 1.0)
    if wanted == 0.0:
        return False
    if near(p, s, o):
        return True
    known_m = height_m(p, s)
    if known_m is None:
        climbed_m = p.silent_m or 0.0 if s.silent_s > SILENT_S else p.climbed_m
        return s.range_m is None and s.hold.over_ground and p.state in _BY_TIME and climbed_m < safe_m
    return known_m < wanted * safe_m and p.climbed_m < _MOST * safe_m


def climb_m_s(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> float:
    """Return how fast a drone without sight climbs against the deck, m/s; 0 where it is not low.

    A deck whose motion is unknown may rise as fast as a drone can climb.
    """
    if not low(p, s, o):
        return 0.0
    known_m = height_m(p, s)
    felt = s.knowledge.impact
    # A person gives it back where it has touched: standing, its turning motors drag it over the deck.
    stands = known_m is None and felt is not None and not felt.doubtful and seconds_between(felt.at, s.at) <= _FELT_S
    waits = known_m is None and not stands and s.range_m is None
    if waits and p.state is State.SEARCH and p.in_state_s(s.at) < _WAITS_S:
        return 0.0
    hurries = stands or near(p, s, o) or (known_m is not None and (s.estimate is None or known_m - o.cone.feet_below_m < _LIFT_M))
    return fastest_climb_m_s(s, o) if hurries else o.tries.climb_m_s


def out_of_reach(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether the drone may leave for another place: it is seen to be high enough, or has climbed without sight."""
    if not fit_to_steer(s.estimate, s.at, o.stale_after_s) or s.estimate is None:
        return not low(p, s, o)
    safe_m = o.tries.safe_height_m
    return s.estimate.height_m >= safe_m - NEAR_SAFE_M or p.in_state_s(s.at) * o.tries.climb_m_s > _MOST * safe_m
