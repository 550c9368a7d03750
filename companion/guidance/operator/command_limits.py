"""The limits of every command to the vehicle: geofence, heights and battery. Pure functions; none makes the vehicle descend."""

import math
from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np
from msgspec import Struct, structs

from companion.guidance.operator.fence import Corners, within
from companion.settings.operator import LimitOptions
from estimator.contracts.commands import Command, Hover, Lean, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, GeoPoint, ned_between, rotated, rotated_xy
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, GeoFix, Range, Sample, VehicleStatus
from estimator.contracts.time import MonoNs, seconds_between

_GAP_S = 0.5
"""The longest gap between two velocities that the position is integrated over."""
_RANGE_S = 0.5  # age up to which a range counts
_BARO_S = 2.5  # age up to which a barometric height counts: an autopilot sends one a second
_FIX_AGE_S = 2.0
"""Age up to which a position counts, s."""
_SIGMA_MAX_M = 5.0
"""The standard deviation of the pad's position above which the fence of a ship does not know where it is."""
_SEEN_GAIN_1_S = 1.5
"""Acceleration for each m/s that the velocity differs from the wanted one by sight, 1/s."""
_CLIMB_S = 1.0
"""The rate of climb is at most the height that is left over this time."""


class Limit(Enum):
    """A limit that changed a command."""

    FENCE = "the geofence"
    HEIGHT_MAX = "the greatest height"
    HEIGHT_MIN = "the least height of manual flight"
    RETURN = "a low battery: no farther away"


class Fixed(NamedTuple):
    """The vehicle's newest position."""

    origin: GeoPoint
    """The first one of the flight."""
    from_ned: tuple[float, float]
    """Its place from the start, m."""
    at: MonoNs
    p_ned: tuple[float, float]
    """The newest one from the start, m."""
    way_ned: tuple[float, float]
    """Integral of the measured velocity at that time, m."""


class PlaceMemory(Struct, frozen=True, eq=False):
    """Position of the vehicle from its start, by its own positions or else by its own velocity, and its height."""

    p_start_ned: tuple[float, float] = (0.0, 0.0)
    """m north and east of the place where it was first seen to fly."""
    velocity: BodyVelocity | None = None
    attitude: Attitude | None = None
    flying: bool = False
    baro: Baro | None = None
    ground_baro_m: float | None = None
    """The barometer's height on the ground, or where the vehicle was first seen to fly."""
    range: Range | None = None
    charge: float | None = None
    """The battery's charge, 0 to 1."""
    trusted: bool = True
    """False while nothing is flown by the measured velocity: the place stays where it was then."""
    way_ned: tuple[float, float] = (0.0, 0.0)
    """Integral of the measured velocity, trusted or not, m."""
    spread_m: float = 0.0
    """Distance from there at which it may be: what the velocity may have been off by, integrated."""
    fixed: Fixed | None = None

    def fix_at(self, now: MonoNs) -> Fixed | None:
        """Return the newest position; None without a fresh one."""
        return None if self.fixed is None or seconds_between(self.fixed.at, now) > _FIX_AGE_S else self.fixed

    def velocity_at(self, now: MonoNs) -> BodyVelocity | None:
        """Return the newest velocity; None without a fresh one."""
        v = self.velocity
        return None if v is None or seconds_between(v.stamp.measured_at, now) > _GAP_S else v


def place_step(
    memory: PlaceMemory, samples: Sequence[Sample], *, trusts_velocity: bool = True, error_m_s: float = 0.0
) -> PlaceMemory:
    """Process samples of the vehicle, in the order in which they were received.

    Args:
        trusts_velocity: integrity guard and monitor do not refuse the velocities among them.
        error_m_s: rate at which the place becomes uncertain.
    """
    p_start_ned, velocity, attitude, flying = memory.p_start_ned, memory.velocity, memory.attitude, memory.flying
    baro, ground_baro_m, newest_range, charge = memory.baro, memory.ground_baro_m, memory.range, memory.charge
    way_ned, spread_m, fixed = memory.way_ned, memory.spread_m, memory.fixed
    for sample in samples:
        # By the type itself: hundreds of samples a second, and a match checks one class after the other.
        if type(sample) is Attitude:
            attitude = sample
        elif type(sample) is BodyVelocity:
            if velocity is not None and attitude is not None and flying:
                dt_s = seconds_between(velocity.stamp.measured_at, sample.stamp.measured_at)
                if 0.0 < dt_s <= _GAP_S:
                    v_north, v_east = rotated_xy(sample.v_level, attitude.R_ned_body.rpy_rad[2])
                    way_ned = way_ned[0] + v_north * dt_s, way_ned[1] + v_east * dt_s
                    spread_m += error_m_s * dt_s
                    if trusts_velocity:
                        p_start_ned = p_start_ned[0] + v_north * dt_s, p_start_ned[1] + v_east * dt_s
            velocity = sample
        elif type(sample) is Baro:
            baro = sample
            ground_baro_m = baro.height_m if ground_baro_m is None else ground_baro_m
        elif type(sample) is Range:
            newest_range = sample
        elif type(sample) is GeoFix and sample.whose == "vehicle" and flying:
            origin, from_ned = (sample.place, p_start_ned) if fixed is None else (fixed.origin, fixed.from_ned)
            north, east, _ = ned_between(origin, sample.place).tolist()
            p_start_ned, spread_m = (from_ned[0] + north, from_ned[1] + east), sample.sigma_m
            fixed = Fixed(origin, from_ned, sample.stamp.received_at, p_start_ned, way_ned)
        elif type(sample) is VehicleStatus:
            flying, charge = sample.flying is True, sample.battery_fraction
            if not flying:
                p_start_ned, ground_baro_m = (0.0, 0.0), None if baro is None else baro.height_m
                spread_m, fixed = 0.0, None
    return PlaceMemory(
        p_start_ned, velocity, attitude, flying, baro, ground_baro_m, newest_range, charge, trusts_velocity, way_ned, spread_m,
        fixed,
    )  # fmt: skip


def limited(
    command: Command,
    options: LimitOptions,
    place: PlaceMemory,
    belief: RelativeState | None,
    now: MonoNs,
    *,
    manual: bool,
    unseen_m: float = 0.0,
) -> tuple[Command, tuple[Limit, ...]]:
    """Return the command within the limits, and the limits that changed it.

    Only velocities and tilts are changed. A tilt that would cross the fence becomes a velocity, and a vehicle that may not move
    along the deck for its place is not sure holds by itself.

    Args:
        belief: the steering estimate of the pad, None while there is none.
        unseen_m: way that may have been flown since the newest sight without the estimate following it.
        manual: a person flies by hand; the least height and the battery's rule hold for manual flight alone.
    """
    if not isinstance(command, Velocity | Lean):
        return command, ()
    if options.fence == "off" and not manual:
        v_down = command.v_level.tolist()[2]
        if not _vertical(v_down, options, place, belief, now, manual=False)[1]:
            return command, ()
    v, hit = np.array(command.v_level), list[Limit]()
    for limit, frame, radius_m, corners in _fences(options, place, belief, unseen_m, manual=manual):
        kept = frame.centre_v_level + rotated(
            within(frame.into(v[:2]), frame.p, radius_m, corners, options.fence_brake_s, frame.spread_m), -frame.yaw_rad
        )
        change = _braking(v[:2], kept - v[:2])
        if float(np.hypot(*change)) > 1e-9:
            v[:2] += change
            hit.append(limit)
    across = bool(hit)
    if across and v[2] == 0.0 and place.spread_m + unseen_m > 0.0 and not v[:2].any():
        # A velocity of nought is flown by the sensor that may lie.
        return Hover(), tuple(hit)
    down, vertical = _vertical(float(v[2]), options, place, belief, now, manual=manual)
    v[2] = down
    hit += vertical
    if not hit:
        return command, ()
    if isinstance(command, Lean) and not across:
        return structs.replace(command, v_level=v), tuple(hit)
    return Velocity(v, command.yaw_rate_rad_s), tuple(hit)


def _braking(v: F64, change: F64) -> F64:
    """Return as much of a change as only takes speed away: a fence that sails away does not make the vehicle follow it."""
    size_2 = float(change @ change)
    return change * min(1.0, max(0.0, -float(v @ change) / size_2)) if size_2 > 0.0 else change


class _Frame(Struct, frozen=True, eq=False):
    """Position of the vehicle from a fence's centre."""

    p: F64
    """(2,) m in the fence's axes."""
    spread_m: float
    """Distance from there at which it may be."""
    yaw_rad: float
    """Heading of the body in the fence's axes."""
    centre_v_level: F64
    """(2,) m/s, velocity of the centre over the ground, in `level`."""

    def into(self, v_level: F64) -> F64:
        """Return a velocity over the ground as one relative to the centre, in the fence's axes."""
        return rotated(v_level - self.centre_v_level, self.yaw_rad)


def _fences(
    options: LimitOptions, place: PlaceMemory, belief: RelativeState | None, unseen_m: float, *, manual: bool
) -> list[tuple[Limit, _Frame, float, Corners]]:
    """Return the fences whose centre is known."""
    corners, found = options.corners(), list[tuple[Limit, _Frame, float, Corners]]()
    if options.fence != "off":
        frame = _start(place) if options.fence == "start" else _pad(place, belief, axes=bool(corners), spread_m=unseen_m)
        if frame is not None:
            found.append((Limit.FENCE, frame, options.fence_radius_m, corners))
    if manual and place.charge is not None and place.charge < options.return_charge:
        frame = _pad(place, belief, axes=False) or _start(place)
        if frame is not None:
            found.append((Limit.RETURN, frame, 0.0, ()))
    return found


def _start(place: PlaceMemory) -> _Frame | None:
    if place.attitude is None or (place.velocity is None and place.fixed is None):
        return None
    return _Frame(np.array(place.p_start_ned), place.spread_m, place.attitude.R_ned_body.rpy_rad[2], np.zeros(2))


def _pad(place: PlaceMemory, belief: RelativeState | None, *, axes: bool, spread_m: float = 0.0) -> _Frame | None:
    """Return the frame around the pad; with `axes` only if the heading against the arrow is known."""
    if belief is None or math.sqrt(max(float(belief.cov[0, 0]), float(belief.cov[1, 1]))) > _SIGMA_MAX_M:
        return None
    if axes and belief.yaw_rad is None:
        return None
    yaw_rad = belief.yaw_rad or 0.0
    body_v = np.zeros(2) if place.velocity is None or not place.trusted else place.velocity.v_level[:2]
    p = rotated(-belief.d_body_pad_level[:2], yaw_rad)
    return _Frame(p, spread_m, yaw_rad, belief.v_pad_level[:2] + body_v)


def _heights_m(place: PlaceMemory, now: MonoNs) -> tuple[float | None, float | None]:
    """Return the range below, and the height above the start: one that is not reported any more would bar a climb for good."""
    range_m = above_start_m = None
    if place.range is not None and seconds_between(place.range.stamp.measured_at, now) <= _RANGE_S:
        range_m = place.range.range_m
    baro = place.baro
    if baro is not None and place.ground_baro_m is not None and seconds_between(baro.stamp.measured_at, now) <= _BARO_S:
        above_start_m = baro.height_m - place.ground_baro_m
    return range_m, above_start_m


def _vertical(
    down: float, options: LimitOptions, place: PlaceMemory, belief: RelativeState | None, now: MonoNs, *, manual: bool
) -> tuple[float, list[Limit]]:
    """Return the vertical velocity within the limits, m/s down: each limit only moves it towards zero."""
    range_m, above_start_m = _heights_m(place, now)
    above_pad_m = None if belief is None else belief.height_m
    known = sorted(height_m for height_m in (above_start_m, range_m, above_pad_m) if height_m is not None)
    if down < 0.0 and known:
        # Of three the middle one is no lie. Of two, one that lies high would keep a drone low over a deck that comes up to it; a
        # hand that flies sees the deck, and one that lies low would lift its limit.
        height_m = known[1] if len(known) == 3 else known[-1 if manual else 0]
        climb = min(-down, max(0.0, (options.height_max_m - height_m) / _CLIMB_S))
        return -climb, [Limit.HEIGHT_MAX] if climb < -down else []
    above_m = range_m if range_m is not None else above_pad_m
    if manual and down > 0.0 and above_m is not None:
        descent = min(down, max(0.0, (above_m - options.manual_height_min_m) / _CLIMB_S))
        return descent, [Limit.HEIGHT_MIN] if descent < down else []
    return down, []


class Unmeasured(Struct, frozen=True, eq=False):
    """Tilt and turn that are flown while the measured velocity is refused."""

    trim_level: F64
    """Acceleration that holds against the wind, (2,) m/s^2 forward and right."""
    drag_1_s: float
    """The vehicle's deceleration for each m/s."""
    v_seen: F64 | None
    """Velocity against the deck by the sight of the pad, (3,) m/s in `level`; None out of sight."""
    over_ground: bool
    """True if the vehicle closes the loop by itself, and its driver adds the deck's velocity to a velocity."""


def without_velocity(command: Command, by: Unmeasured, *, guided: bool) -> Command:
    """Return what is flown in place of a velocity, so that no loop is closed on what the integrity guard refuses.

    In sight of the pad the loop is closed on the estimate. Out of sight guidance flies nowhere along the deck: it climbs, or
    hovers by the vehicle's own means; a person's velocity becomes the tilt that drives the vehicle as fast against its drag.

    Args:
        guided: guidance requests it, and no person who sees where the vehicle flies.
    """
    if not isinstance(command, Velocity) or (by.over_ground and (by.v_seen is not None or not guided)):
        return command
    v = np.array(command.v_level)
    a_level = by.drag_1_s * v[:2]
    if by.v_seen is not None:
        a_level = a_level + _SEEN_GAIN_1_S * (v[:2] - by.v_seen[:2])
    elif guided:
        v[:2], a_level = 0.0, np.zeros(2)
        if v[2] >= 0.0:
            return Hover()
    if by.over_ground:
        return Velocity(v, command.yaw_rate_rad_s)
    return Lean(a_level, by.trim_level, v, command.yaw_rate_rad_s)
