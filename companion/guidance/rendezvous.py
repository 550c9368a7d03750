"""Fly to the ship by her reports: round her to the hold-off point, then an expanding square over the pad's reported place.

All of it is level or upward. Points are written in the ship's own axes (forward, starboard of the pad), so the pattern moves
and turns with her.

Source: IAMSAR Manual, volume II, section 5.6: expanding square search, whose tracks lengthen by one spacing at every second turn.
"""

import math

import numpy as np

from companion.guidance.situation import VesselPosition
from companion.settings.rendezvous import RendezvousOptions
from estimator.contracts.commands import Velocity
from estimator.contracts.geometry import F64, wrap_pi

_GAIN_1_S = 0.4
_CORNER_REACHED_M = 0.7
_LOW_M = 0.5
"""A height that is at most this far below the wanted one counts as reached, metres."""
_ROUND_RAD = math.radians(50.0)
"""Turn about the ship of the next point on the way round her."""
_LEGS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
_ROUND_RATIO = 1.3
"""Radius of that way over that of the hold-off point."""


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


def to_hold_off(place: VesselPosition, o: RendezvousOptions, climb_m_s: float, *, over_ground: bool) -> Velocity:
    """Fly towards the hold-off point, round the ship where she lies between.

    Args:
        climb_m_s: rate upward while it is below the height of the hold-off point.
        over_ground: whether the driver adds the ship's velocity by itself.
    """
    return _towards(_round(place, o), o.speed_m_s, place, o, climb_m_s, over_ground=over_ground)


def along_pattern(leg: int, place: VesselPosition, o: RendezvousOptions, climb_m_s: float, *, over_ground: bool) -> Velocity:
    """Fly towards a corner of the search pattern; the arguments are those of `to_hold_off`."""
    corner = _corner(leg, place, o)
    return _towards(corner, o.search_speed_m_s, place, o, climb_m_s, over_ground=over_ground)


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


def _towards(
    d: F64, speed_m_s: float, place: VesselPosition, o: RendezvousOptions, climb_m_s: float, *, over_ground: bool
) -> Velocity:
    """Return the velocity towards a point that moves with the ship; upward while the drone is low, never downward."""
    distance_m = math.hypot(*d)
    v = np.zeros(3)
    v[:2] = d / max(distance_m, 1e-9) * min(speed_m_s, _GAIN_1_S * distance_m)
    if not over_ground:
        v[:2] += place.v_level
    v[2] = -climb_m_s if _low(place, o) else 0.0
    return Velocity(v, 0.0)


def _low(place: VesselPosition, o: RendezvousOptions) -> bool:
    return place.height_m is not None and place.height_m < o.height_m - _LOW_M


def _bearing_of_body(place: VesselPosition) -> float:
    """Return the direction from the pad to the body in `level`, rad clockwise from forward."""
    return math.atan2(-float(place.d_body_pad_level[1]), -float(place.d_body_pad_level[0]))


def _direction(angle_rad: float) -> F64:
    return np.array([math.cos(angle_rad), math.sin(angle_rad)])
