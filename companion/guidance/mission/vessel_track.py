"""The ship's place by her reports, beside the vehicle's own: checked, carried on to one instant, and subtracted.

A report is taken if it is not older than a limit, not older than the one before, and near the place to which the one before was
carried on. What is refused is counted by its reason. Between reports her place moves by her velocity; its standard deviation
grows with the report's age, by the velocity's own and by what she may have turned or slowed down since. Where she reports a rate
of turn, bow and velocity turn with it, and her place is carried round.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType

import numpy as np
from msgspec import Struct, field, structs

from companion.base.mission import Reason, ReasonCause
from companion.guidance.mission.progress import VesselPosition
from companion.settings.vessel import ReportLimits
from estimator.contracts.geometry import F64, ned_between, rotated
from estimator.contracts.samples import Attitude, GeoFix, VesselReport
from estimator.contracts.time import MonoNs, seconds_between

_SIGMAS = 3.0  # standard deviations that a place may be from the expected one
_VEHICLE_SPEED_MAX_M_S = 40.0  # speed that no multicopter's places may show
_VEHICLE_MAY_MOVE_M_S = 3.0
"""Standard deviation of the velocity of a vehicle that does not report it."""
_OWN_AGE_MAX_S = 2.0  # age up to which the vehicle's own place counts
_HEADING_AGE_MAX_S = 10.0  # age up to which the ship's heading counts
_YAW_AGE_MAX_S = 1.0  # age up to which the vehicle's heading counts
_TURN_AGE_MAX_S = 2.0  # age from which on a rate of turn says nothing any more, as a turn ends
_TURN_MAX_RAD_S = 0.2  # the fastest that a drone is flown round by
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


class VesselTrack(Struct, frozen=True, eq=False):
    """The newest reports that were taken, and the count of those that were not. Immutable."""

    limits: ReportLimits = field(default_factory=ReportLimits)
    vehicle: GeoFix | None = None
    vessel: GeoFix | None = None
    vessel_height_m: float | None = None
    """The newest height that the ship reported."""
    velocity: tuple[MonoNs, F64, float] | None = None
    """The ship's velocity: its instant, (2,) m/s north and east, standard deviation."""
    heading: tuple[MonoNs, float] | None = None
    turn: tuple[MonoNs, float] | None = None
    """The ship's rate of turn, clockwise seen from above, rad/s."""
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

    def on_sample(self, sample: GeoFix | VesselReport | Attitude) -> VesselTrack:
        """Return the track after a sample."""
        match sample:
            case Attitude():
                return structs.replace(self, yaw=(sample.stamp.measured_at, sample.R_ned_body.rpy_rad[2]))
            case VesselReport():
                return _reported(self, sample)
            case _:
                return _placed(self, sample)

    def restarted(self) -> VesselTrack:
        """Return the track without the ship's places, so that the next one is accepted alone: a person decided to go on."""
        return structs.replace(self, vessel=None, newest_refusal=None)

    def position(self, now: MonoNs) -> VesselPosition | Reason:
        """Return the pad's place by the newest reports, or why it is not known."""
        o, vehicle, vessel = self.limits, self.vehicle, self.vessel
        if vehicle is None or seconds_between(vehicle.stamp.measured_at, now) > _OWN_AGE_MAX_S:
            return Reason(ReasonCause.NO_OWN_PLACE)
        if self.yaw is None or seconds_between(self.yaw[0], now) > _YAW_AGE_MAX_S:
            return Reason(ReasonCause.NO_OWN_HEADING)
        if vessel is None:
            return _refusal(self, now) or Reason(ReasonCause.VESSEL_SILENT)
        age_s = seconds_between(vessel.stamp.measured_at, now)
        if age_s > o.age_max_s:
            return _refusal(self, now) or Reason(ReasonCause.VESSEL_OLD, age_s, o.age_max_s)
        v_vessel, sigma_v = _velocity(self, now)
        d = _to_vessel(self, vehicle, vessel, now)
        yaw, bow = self.yaw[1], _bow(self, now, v_vessel)
        sigma = math.hypot(vehicle.sigma_m, vessel.sigma_m, sigma_v * age_s, 0.5 * o.acceleration_m_s2 * age_s**2)
        if vehicle.v_ned is None:
            sigma = math.hypot(sigma, _VEHICLE_MAY_MOVE_M_S * seconds_between(vehicle.stamp.measured_at, now))
        if bow is None:
            sigma = math.hypot(sigma, o.pad_aside_m)
        else:
            arm = rotated(np.array([o.pad_forward_m, o.pad_right_m]), bow)
            d[:2] += arm
            v_vessel = v_vessel + _turn_rad_s(self, now) * np.array([-arm[1], arm[0]])
        if sigma > o.sigma_max_m:
            return Reason(ReasonCause.VESSEL_SIGMA, sigma, o.sigma_max_m)
        # Down from the vehicle to the ship's point, less what the pad is higher than that.
        height_m = None if vehicle.place.height_m is None else float(d[2]) - o.pad_up_m
        return VesselPosition(
            now,
            rotated(d[:2], -yaw),
            sigma,
            rotated(v_vessel, -yaw),
            axis_rad=(0.0 if bow is None else bow) - yaw,
            bow_known=bow is not None,
            height_m=height_m,
        )

    def velocity_ned(self, now: MonoNs) -> F64 | None:
        """Return the ship's reported velocity, (2,) m/s north and east; None if there is no fresh report of it."""
        if self.velocity is None or seconds_between(self.velocity[0], now) > self.limits.forget_s:
            return None
        return self.velocity[1]


def _turn_rad_s(track: VesselTrack, now: MonoNs) -> float:
    """Return the ship's rate of turn; zero if she does not report it."""
    if track.turn is None or seconds_between(track.turn[0], now) > _TURN_AGE_MAX_S:
        return 0.0
    return max(-_TURN_MAX_RAD_S, min(_TURN_MAX_RAD_S, track.turn[1]))


def _to_vessel(track: VesselTrack, vehicle: GeoFix, vessel: GeoFix, now: MonoNs) -> F64:
    """Return the vector from vehicle to ship at an instant, (3,) m in ned; a ship without a height is at sea level."""
    height_m = 0.0 if track.vessel_height_m is None else track.vessel_height_m
    d = ned_between(vehicle.place, structs.replace(vessel.place, height_m=height_m))
    age_s = seconds_between(vessel.stamp.measured_at, now)
    # On an arc the way has the direction of its middle.
    d[:2] += rotated(_velocity(track, now)[0], -0.5 * _turn_rad_s(track, now) * age_s) * age_s
    if vehicle.v_ned is not None:
        d -= vehicle.v_ned * seconds_between(vehicle.stamp.measured_at, now)
    return d


def _velocity(track: VesselTrack, now: MonoNs) -> tuple[F64, float]:
    """Return the ship's velocity, (2,) m/s in ned, and its standard deviation; zero if she does not report it."""
    if track.velocity is None or seconds_between(track.velocity[0], now) > track.limits.forget_s:
        return np.zeros(2), _VELOCITY_SIGMA_M_S
    turned_rad = _turn_rad_s(track, now) * seconds_between(track.velocity[0], now)
    return rotated(track.velocity[1], turned_rad), track.velocity[2]


def _bow(track: VesselTrack, now: MonoNs, v_vessel: F64) -> float | None:
    """Return the direction of the bow, rad clockwise from north: by her compass, else by her course; None if neither says."""
    if track.heading is not None and seconds_between(track.heading[0], now) <= _HEADING_AGE_MAX_S:
        return track.heading[1] + _turn_rad_s(track, now) * seconds_between(track.heading[0], now)
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
            track = structs.replace(track, velocity=(at, v, math.sqrt(variance)))
    if report.heading_rad is not None and (track.heading is None or at >= track.heading[0]):
        track = structs.replace(track, heading=(at, report.heading_rad))
    if report.turn_rad_s is not None and (track.turn is None or at >= track.turn[0]):
        track = structs.replace(track, turn=(at, report.turn_rad_s))
    return track


def _placed(track: VesselTrack, fix: GeoFix) -> VesselTrack:
    """Take or refuse a place."""
    if fix.whose == "vehicle":
        refusal = _unfit(track, fix, track.vehicle, _VEHICLE_SPEED_MAX_M_S, np.zeros(2), _VEHICLE_SPEED_MAX_M_S)
        return _refused(track, "vehicle", refusal) if refusal is not None else structs.replace(track, vehicle=fix)
    v, sigma_v = _velocity(track, fix.stamp.measured_at)
    refusal = _unfit(track, fix, track.vessel, track.limits.speed_max_m_s, v, sigma_v)
    if refusal is not None:
        track = _refused(track, "vessel", refusal)
        return structs.replace(track, newest_refusal=(fix.stamp.received_at, refusal))
    height_m = track.vessel_height_m if fix.place.height_m is None else fix.place.height_m
    return structs.replace(track, vessel=fix, vessel_height_m=height_m, taken=track.taken + 1, newest_refusal=None)


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
    return structs.replace(track, refused=MappingProxyType({**track.refused, name: track.refused.get(name, 0) + 1}))
