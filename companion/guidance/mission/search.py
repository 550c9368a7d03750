"""SEARCH and RENDEZVOUS: look for the pad where it may be, and fly to the ship by her reports where she is far.

The drone goes round the ship to the hold-off point, then flies an expanding square over the pad's reported place. All of it is
level or upward. Points are written in the ship's own axes (forward, starboard of the pad), so the pattern moves and turns with
her. Without reports it hovers, in wind it looks upwind. Either state ends with the pad in sight (INTERCEPT), refuses where
no landing is possible, and gives up when the time of the search is over. A pad that another attempt has lost is not looked
for here: see HOLD_BLIND.

Source: IAMSAR Manual, volume II, section 5.6: expanding square search, whose tracks lengthen by one spacing at every second turn.
"""

import math
from collections.abc import Iterator

import numpy as np
from msgspec import Struct, structs

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.mission import out_of_reach, rules
from companion.guidance.mission.charge import battery_ends
from companion.guidance.mission.phase import LANDING, Aimed, Phase, climbs, looks_upwind, still
from companion.guidance.mission.progress import GuidanceCycle, Progress, VehicleHold, VesselPosition, of_frames
from companion.guidance.mission.rules import EventWithReason
from companion.settings.guidance import GuidanceOptions
from companion.settings.vessel import RendezvousOptions
from estimator.contracts.commands import Velocity
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.time import MonoNs, seconds_between

_LOOKS_S = 10.0
"""Time for which it looks for the pad with a charge too low to begin, s: that may be the nearest place to land."""
_GAIN_1_S = 0.4  # speed toward a corner for each metre that is left, 1/s
_CORNER_REACHED_M = 0.7  # distance from a corner at which it is reached
_LOW_M = 0.5
"""A height that is at most this far below the wanted one counts as reached, metres."""
_ROUND_RAD = math.radians(50.0)
"""Turn about the ship of the next point on the way round her."""
_LEGS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
_ROUND_RATIO = 1.3
"""Radius of that way over that of the hold-off point."""


class Search(Struct, frozen=True):
    """The memory of a search."""

    place_known: MonoNs | None = None
    """Time of the newest cycle in which the ship's place was known by reports."""
    leg: int = 0
    """Number of the corner of the search pattern that the drone flies to."""


def _search(p: Progress) -> Search:
    return p.kept if isinstance(p.kept, Search) else Search()


def _note(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    if s.place is None:
        return p
    leg = next_leg(_search(p).leg, s.place, o.rendezvous) if p.state is State.SEARCH else 0
    return structs.replace(p, kept=Search(s.at, leg))


def _refuses(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield what lets no landing begin."""
    yield from rules.too_windy(p, s, o)
    yield from rules.unlandable(p, s, o)
    yield from rules.unconfirmed(p, s, o)
    if rules.unfit_here(p, s, o) is None:
        return
    if isinstance(s.vessel, Reason):
        known = max((at for at in (p.since, _search(p).place_known) if at is not None), default=s.at)
        if seconds_between(known, s.at) > o.rendezvous.lost_s:
            yield Event.NO_CONDITIONS, s.vessel
    # A landing that has begun is the nearest way down: after a go-around a low battery is one reason more to try again.
    if s.battery is not None and battery_ends(s.battery, o) and p.in_state_s(s.at) > _LOOKS_S:
        yield Event.NO_CONDITIONS, Reason(ReasonCause.BATTERY, 100.0 * s.battery, 100.0 * o.limits.battery)


def _search_over(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return that the pad was not seen within the time since the order, all ways to the ship and searches together."""
    if p.asked_at is None or p.landing_began is not None:
        return None
    limit_s = o.tries.search_s + (o.rendezvous.time_s if o.rendezvous.enabled else 0.0)
    spent_s = seconds_between(p.asked_at, s.at)
    return Reason(ReasonCause.NOT_FOUND, spent_s, limit_s) if spent_s > limit_s else None


def _events(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    yield from _refuses(p, s, o)
    if (over := rules.landing_over(p, s, o) or _search_over(p, s, o)) is not None:
        yield Event.TIMEOUT, over
    spent_s = p.in_state_s(s.at)
    if p.state is State.RENDEZVOUS:
        yield from rules.time_over(spent_s, o.rendezvous.time_s)
    elif spent_s > o.tries.search_s:
        yield Event.TIMEOUT, of_frames(s.frames) or Reason(ReasonCause.NOT_FOUND, spent_s, o.tries.search_s)
    yield from rules.pad_seen(p, s, o)
    if s.place is not None:
        if far(s.place, o.rendezvous):
            yield Event.VESSEL_FAR, Reason(ReasonCause.VESSEL_FAR, s.place.distance_m)
        elif arrived(s.place, o.rendezvous):
            yield Event.ARRIVED, Reason(ReasonCause.VESSEL_NEAR, s.place.distance_m)


def _aim(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Aimed:
    if out_of_reach.low(p, s, o):
        return climbs(p, s, out_of_reach.climb_m_s(p, s, o))
    if s.place is None:
        return still(p, s, o, looks_upwind(p, s, o) if p.state is State.SEARCH else None)
    if p.state is State.RENDEZVOUS:
        return p, to_hold_off(s.place, o.rendezvous, o.tries.climb_m_s, s.hold)
    return p, along_pattern(_search(p).leg, s.place, o.rendezvous, o.tries.climb_m_s, s.hold)


def hold_off(place: VesselPosition, o: RendezvousOptions) -> F64:
    """Return the vector from the body to the hold-off point, (2,) m in `level`; on the drone's own side if no bow is known."""
    bearing = place.axis_rad + math.radians(o.bearing_deg) if place.bow_known else _bearing_of_body(place)
    return place.d_body_pad_level + o.range_m * _direction(bearing)


def far(place: VesselPosition, o: RendezvousOptions) -> bool:
    """Return whether the ship is farther away than both the hold-off point and the search pattern reach."""
    return place.distance_m > max(o.range_m, o.extent_m) + 2.0 * o.reached_m + place.sigma_m


def arrived(place: VesselPosition, o: RendezvousOptions) -> bool:
    """Return whether the drone is at the hold-off point, and not below its height as far as that is known."""
    return math.hypot(*hold_off(place, o)) <= o.reached_m and not _low(place, o)


def to_hold_off(place: VesselPosition, o: RendezvousOptions, climb_m_s: float, hold: VehicleHold) -> Velocity:
    """Fly towards the hold-off point, round the ship where she lies between.

    Args:
        climb_m_s: rate upward while it is below the height of the hold-off point.
    """
    return hold.with_ship(_towards(_round(place, o), o.speed_m_s, place, o, climb_m_s), place.v_level)


def along_pattern(leg: int, place: VesselPosition, o: RendezvousOptions, climb_m_s: float, hold: VehicleHold) -> Velocity:
    """Fly towards a corner of the search pattern; the arguments are those of `to_hold_off`."""
    return hold.with_ship(_towards(_corner(leg, place, o), o.search_speed_m_s, place, o, climb_m_s), place.v_level)


def next_leg(leg: int, place: VesselPosition, o: RendezvousOptions) -> int:
    """Return the number of the corner to fly to: the next one when this one is reached, the first one after the last."""
    if math.hypot(*_corner(leg, place, o)) > _CORNER_REACHED_M:
        return leg
    following = expanding_square(leg + 1) * o.spacing_m
    return 0 if math.hypot(*following) > o.extent_m * math.sqrt(2.0) else leg + 1


def expanding_square(corner: int) -> F64:
    """Return a corner of the square in units of its spacing, (2,) forward and right of its centre; corner 0 is the centre."""
    forward = right = 0.0
    for leg in range(corner):
        length, (ahead, aside) = leg // 2 + 1, _LEGS[leg % 4]
        forward, right = forward + length * ahead, right + length * aside
    return np.array([forward, right])


def _corner(leg: int, place: VesselPosition, o: RendezvousOptions) -> F64:
    forward, right = expanding_square(leg) * o.spacing_m
    bow = _direction(place.axis_rad)
    return np.asarray(place.d_body_pad_level + forward * bow + right * np.array([-bow[1], bow[0]]))


def _round(place: VesselPosition, o: RendezvousOptions) -> F64:
    """Return the vector to the next point on the way to the hold-off point that does not cross the ship."""
    goal = hold_off(place, o)
    pad = place.d_body_pad_level
    way_m = math.hypot(*goal)
    along = float(pad @ goal) / max(way_m, 1e-9)
    # The way crosses the ship where it comes nearer to the pad than the hold-off point is, on this side of that point.
    nearest_m = math.sqrt(max(0.0, float(pad @ pad) - along**2))
    if not 0.0 < along < way_m or nearest_m >= 0.8 * o.range_m:
        return goal
    body = _bearing_of_body(place)
    turn = wrap_pi(math.atan2(*(goal - pad)[::-1]) - body)
    if abs(turn) <= _ROUND_RAD:
        return goal
    return pad + _ROUND_RATIO * o.range_m * _direction(body + math.copysign(_ROUND_RAD, turn))


def _towards(d: F64, speed_m_s: float, place: VesselPosition, o: RendezvousOptions, climb_m_s: float) -> F64:
    """Return the velocity to the ship towards a point that moves with her; upward while the drone is low, never downward."""
    distance_m = math.hypot(*d)
    v = np.zeros(3)
    v[:2] = d / max(distance_m, 1e-9) * min(speed_m_s, _GAIN_1_S * distance_m)
    v[2] = -climb_m_s if _low(place, o) else 0.0
    return v


def _low(place: VesselPosition, o: RendezvousOptions) -> bool:
    return place.height_m is not None and place.height_m < o.height_m - _LOW_M


def _bearing_of_body(place: VesselPosition) -> float:
    """Return the direction from the pad to the body in `level`, rad clockwise from forward."""
    return math.atan2(-float(place.d_body_pad_level[1]), -float(place.d_body_pad_level[0]))


def _direction(angle_rad: float) -> F64:
    return np.array([math.cos(angle_rad), math.sin(angle_rad)])


_WAYS = {**LANDING, Event.NO_CONDITIONS: State.REFUSED, Event.TIMEOUT: State.GAVE_UP, Event.SIGHT: State.INTERCEPT}
PHASES = {
    State.RENDEZVOUS: Phase(
        "Flying to the place that the vessel reports.", {**_WAYS, Event.ARRIVED: State.SEARCH}, _events, _aim, _note
    ),
    State.SEARCH: Phase(
        "Waiting for the first sight of the pad.", {**_WAYS, Event.VESSEL_FAR: State.RENDEZVOUS}, _events, _aim, _note
    ),
}
