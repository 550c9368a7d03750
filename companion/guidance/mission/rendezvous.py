"""Fly to the ship by her reports: round her to the hold-off point, then an expanding square over the pad's reported place.

All of it is level or upward. Points are written in the ship's own axes (forward, starboard of the pad), so the pattern moves
and turns with her.

Her place and the vehicle's are checked, carried on to one instant, and subtracted. A report is taken if it is not older than a
limit, not older than the one before, and near the place to which the one before was carried on. What is refused is counted by its
reason. Between reports her place moves by her velocity; its standard deviation grows with the report's age, by the velocity's own
and by what she may have turned or slowed down since.

Source: IAMSAR Manual, volume II, section 5.6: expanding square search, whose tracks lengthen by one spacing at every second turn.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType

import numpy as np

from companion.base.reason import Reason, ReasonCause
from companion.guidance.mission.cycle import VesselPosition
from companion.settings.rendezvous import RendezvousOptions, ReportLimits
from estimator.contracts.commands import Velocity
from estimator.contracts.geodesy import ned_between
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.samples import Attitude, GeoFix, VesselReport
from estimator.contracts.time import MonoNs, seconds_between

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


_SIGMAS = 3.0
_VEHICLE_SPEED_MAX_M_S = 40.0
_VEHICLE_MAY_MOVE_M_S = 3.0
"""Standard deviation of the velocity of a vehicle that does not report it."""
_OWN_AGE_MAX_S = 2.0
_HEADING_AGE_MAX_S = 10.0
_YAW_AGE_MAX_S = 1.0
_COURSE_FROM_M_S = 0.7
"""Speed over the ground from which the course counts as the heading, if no compass reports."""
_VELOCITY_SIGMA_M_S = 2.0
"""Standard deviation of the velocity of a ship that does not report it."""


class ReportRefusal(Enum):
    """Reason for the refusal of a report; the value is the name of its counter."""

    STALE = "stale"
    OUT_OF_ORDER = "out_of_order"
    TOO_FAST = "too_fast"
    JUMP = "jump"


@dataclass(frozen=True, slots=True, eq=False)
class VesselTrack:
    """The newest reports that were taken, and the count of those that were not. Immutable."""

    limits: ReportLimits = field(default_factory=ReportLimits)
    vehicle: GeoFix | None = None
    vessel: GeoFix | None = None
    vessel_height_m: float | None = None
    """The newest height that the ship reported."""
    velocity: tuple[MonoNs, F64, float] | None = None
    """The ship's velocity: its instant, (2,) m/s north and east, standard deviation."""
    heading: tuple[MonoNs, float] | None = None
    yaw: tuple[MonoNs, float] | None = None
    """The vehicle's own heading."""
    taken: int = 0
    refused: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    """The number of refused reports by whose and why, such as `vessel_jump`."""
    newest_refusal: tuple[MonoNs, ReportRefusal] | None = None
    """The newest refused place of the ship."""

    def counted(self) -> dict[str, float]:
        """Return the counters for health."""
        return {"taken": self.taken, **self.refused}


def on_sample(track: VesselTrack, sample: GeoFix | VesselReport | Attitude) -> VesselTrack:
    """Return the track after a sample."""
    match sample:
        case Attitude():
            return replace(track, yaw=(sample.stamp.measured_at, sample.R_ned_body.rpy_rad[2]))
        case VesselReport():
            return _reported(track, sample)
        case _:
            return _placed(track, sample)


def restarted(track: VesselTrack) -> VesselTrack:
    """Return the track without the ship's places, so that the next one is accepted alone: a person decided to go on."""
    return replace(track, vessel=None, newest_refusal=None)


def position(track: VesselTrack, now: MonoNs) -> VesselPosition | Reason:
    """Return the pad's place by the newest reports, or why it is not known."""
    o, vehicle, vessel = track.limits, track.vehicle, track.vessel
    if vehicle is None or seconds_between(vehicle.stamp.measured_at, now) > _OWN_AGE_MAX_S:
        return Reason(ReasonCause.NO_OWN_PLACE)
    if track.yaw is None or seconds_between(track.yaw[0], now) > _YAW_AGE_MAX_S:
        return Reason(ReasonCause.NO_OWN_HEADING)
    if vessel is None:
        return _refusal(track, now) or Reason(ReasonCause.VESSEL_SILENT)
    age_s = seconds_between(vessel.stamp.measured_at, now)
    if age_s > o.age_max_s:
        return _refusal(track, now) or Reason(ReasonCause.VESSEL_OLD, age_s, o.age_max_s)
    v_vessel, sigma_v = _velocity(track, now)
    d = _to_vessel(track, vehicle, vessel, now, v_vessel)
    yaw, bow = track.yaw[1], _bow(track, now, v_vessel)
    sigma = math.hypot(vehicle.sigma_m, vessel.sigma_m, sigma_v * age_s, 0.5 * o.acceleration_m_s2 * age_s**2)
    if vehicle.v_ned is None:
        sigma = math.hypot(sigma, _VEHICLE_MAY_MOVE_M_S * seconds_between(vehicle.stamp.measured_at, now))
    if bow is None:
        sigma = math.hypot(sigma, o.pad_aside_m)
    else:
        d[:2] += _turned(np.array([o.pad_forward_m, o.pad_right_m]), bow)
    if sigma > o.sigma_max_m:
        return Reason(ReasonCause.VESSEL_SIGMA, sigma, o.sigma_max_m)
    # Down from the vehicle to the ship's point, less what the pad is higher than that.
    height_m = None if vehicle.place.height_m is None else float(d[2]) - o.pad_up_m
    return VesselPosition(
        now,
        _turned(d[:2], -yaw),
        sigma,
        _turned(v_vessel, -yaw),
        axis_rad=(0.0 if bow is None else bow) - yaw,
        bow_known=bow is not None,
        height_m=height_m,
    )


def velocity_ned(track: VesselTrack, now: MonoNs) -> F64 | None:
    """Return the ship's reported velocity, (2,) m/s north and east; None if there is no fresh report of it."""
    if track.velocity is None or seconds_between(track.velocity[0], now) > track.limits.forget_s:
        return None
    return track.velocity[1]


def _to_vessel(track: VesselTrack, vehicle: GeoFix, vessel: GeoFix, now: MonoNs, v_vessel: F64) -> F64:
    """Return the vector from vehicle to ship at an instant, (3,) m in ned; a ship without a height is at sea level."""
    height_m = 0.0 if track.vessel_height_m is None else track.vessel_height_m
    d = ned_between(vehicle.place, replace(vessel.place, height_m=height_m))
    d[:2] += v_vessel * seconds_between(vessel.stamp.measured_at, now)
    if vehicle.v_ned is not None:
        d -= vehicle.v_ned * seconds_between(vehicle.stamp.measured_at, now)
    return d


def _velocity(track: VesselTrack, now: MonoNs) -> tuple[F64, float]:
    """Return the ship's velocity, (2,) m/s in ned, and its standard deviation; zero if she does not report it."""
    if track.velocity is None or seconds_between(track.velocity[0], now) > track.limits.forget_s:
        return np.zeros(2), _VELOCITY_SIGMA_M_S
    return track.velocity[1], track.velocity[2]


def _bow(track: VesselTrack, now: MonoNs, v_vessel: F64) -> float | None:
    """Return the direction of the bow, rad clockwise from north: by her compass, else by her course; None if neither says."""
    if track.heading is not None and seconds_between(track.heading[0], now) <= _HEADING_AGE_MAX_S:
        return track.heading[1]
    if math.hypot(*v_vessel) >= _COURSE_FROM_M_S:
        return math.atan2(float(v_vessel[1]), float(v_vessel[0]))
    return None


def _refusal(track: VesselTrack, now: MonoNs) -> Reason | None:
    """Return the reason if reports arrive and are refused."""
    if track.newest_refusal is None or seconds_between(track.newest_refusal[0], now) > track.limits.age_max_s:
        return None
    causes = {
        ReportRefusal.STALE: ReasonCause.VESSEL_LATE,
        ReportRefusal.OUT_OF_ORDER: ReasonCause.VESSEL_LATE,
        ReportRefusal.TOO_FAST: ReasonCause.VESSEL_TOO_FAST,
        ReportRefusal.JUMP: ReasonCause.VESSEL_JUMPED,
    }
    return Reason(causes[track.newest_refusal[1]])


def _reported(track: VesselTrack, report: VesselReport) -> VesselTrack:
    """Take what a report says of velocity and heading."""
    at, o = report.stamp.measured_at, track.limits
    if report.stamp.delay_s > o.age_max_s:
        return _refused(track, "vessel", ReportRefusal.STALE)
    if report.v_vessel_ned is not None and report.cov_v_ned is not None:
        v = report.v_vessel_ned[:2]
        if math.hypot(*v) > o.speed_max_m_s:
            return _refused(track, "vessel", ReportRefusal.TOO_FAST)
        if track.velocity is None or at >= track.velocity[0]:
            variance = float(max(report.cov_v_ned[0, 0], report.cov_v_ned[1, 1]))
            track = replace(track, velocity=(at, v, math.sqrt(variance)))
    if report.heading_rad is not None and (track.heading is None or at >= track.heading[0]):
        track = replace(track, heading=(at, report.heading_rad))
    return track


def _placed(track: VesselTrack, fix: GeoFix) -> VesselTrack:
    """Take or refuse a place."""
    if fix.whose == "vehicle":
        refusal = _unfit(track, fix, track.vehicle, _VEHICLE_SPEED_MAX_M_S, np.zeros(2), _VEHICLE_SPEED_MAX_M_S)
        return _refused(track, "vehicle", refusal) if refusal is not None else replace(track, vehicle=fix)
    v, sigma_v = _velocity(track, fix.stamp.measured_at)
    refusal = _unfit(track, fix, track.vessel, track.limits.speed_max_m_s, v, sigma_v)
    if refusal is not None:
        track = _refused(track, "vessel", refusal)
        return replace(track, newest_refusal=(fix.stamp.received_at, refusal))
    height_m = track.vessel_height_m if fix.place.height_m is None else fix.place.height_m
    return replace(track, vessel=fix, vessel_height_m=height_m, taken=track.taken + 1, newest_refusal=None)


def _unfit(
    track: VesselTrack, fix: GeoFix, before: GeoFix | None, speed_max_m_s: float, v: F64, sigma_v_m_s: float
) -> ReportRefusal | None:
    """Return why a place is not taken after the one before it; None if it is."""
    o = track.limits
    if fix.stamp.delay_s > o.age_max_s:
        return ReportRefusal.STALE
    if fix.v_ned is not None and math.hypot(*fix.v_ned.tolist()) > speed_max_m_s:
        return ReportRefusal.TOO_FAST
    if before is None:
        return None
    since_s = seconds_between(before.stamp.measured_at, fix.stamp.measured_at)
    if since_s < 0.0:
        return ReportRefusal.OUT_OF_ORDER
    if since_s > o.forget_s:
        return None
    step = ned_between(before.place, fix.place)[:2] - v * since_s
    may_m = o.jump_m + _SIGMAS * math.hypot(before.sigma_m, fix.sigma_m, sigma_v_m_s * since_s)
    may_m += 0.5 * o.acceleration_m_s2 * since_s**2
    return ReportRefusal.JUMP if math.hypot(*step) > may_m else None


def _refused(track: VesselTrack, whose: str, why: ReportRefusal) -> VesselTrack:
    name = f"{whose}_{why.value}"
    return replace(track, refused=MappingProxyType({**track.refused, name: track.refused.get(name, 0) + 1}))


def _turned(v: F64, angle_rad: float) -> F64:
    """Return a horizontal vector turned clockwise seen from above by an angle."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([c * v[0] - s * v[1], s * v[0] + c * v[1]])
