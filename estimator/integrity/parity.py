"""Compare the IMU with independent ways to the same motion, over windows of a second or two.

The gyro is integrated between two of the vehicle's own attitudes; the accelerometer, levelled by them, is integrated twice. What
a barometer, the pad's sightings and a measured velocity say less that integral has a curvature (a velocity: a slope): the true
acceleration less the measured one. The least squares of the window give it with its variance, from the residuals themselves.

Tell a frozen half of an IMU, gyro or accelerometer, and put what else is known in its place.

Compare the measured velocity with the accelerometer's integral, and with the pad's sightings where there are any.

A velocity that lies is dangerous where a loop is closed on it: one of the wrong sign is flown away from at full tilt. So what is
compared are changes within two seconds, as a vehicle that begins to fly away makes them: the velocity and the integral, each
less its mean and less the difference of both that has been there (`Steady`). A surface that moves below a flow sensor makes
neither a large difference nor a wrong sign: in clean flights up to weather_5 the difference is 0.5 m/s, a root mean square, at
most. A leap of the velocity alone begins the comparison again: below the vehicle the deck has ended and the water begun.

In sight of the pad its sightings decide who of both is right, and for 10 s after them that holds, unless the difference grows
beyond what an attitude that errs makes. Later nobody decides, and the velocity is not flown by.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from estimator.contracts.geometry import F64, fixed_vector
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu

_LONGEST = 3.0  # Factor on the time limit for a sensor of coarse steps that repeated itself in flight
_MOST_S = 1.0  # Longest time limit of a sensor
_TURN_S = 0.02  # Least time between the two attitudes whose difference is a rate
_OLD_S = 0.1  # Age of an attitude from which it says nothing of the present turn
_BIN_S = 0.1  # Length of a bin
_GAP_S = 0.3  # Longest time between two samples of a bin
_SAMPLES_MIN = 3  # Fewest samples of a bin
_KEPT = 25  # Number of bins that are kept: the longest window, and the time by which a sighting is late
_UNMEASURED_VAR = 1e3  # Variance above which a component was not measured
_SMALL_TURN_TRACE = 1.0 + 2.0 * math.cos(1.0)  # Trace of a rotation by a radian
_PICTURES = 4  # Fewest pictures that show a turn
_SHOWN = 0.6  # Least share of the turn that has to show in them
_SHOWN_RAD = math.radians(0.8)  # Least difference, a root mean square, that images resolve: at 7 m they err by half a degree
_WINDOW_NS = 2_000_000_000  # Window in which velocity and integral are compared
_POINTS = 8  # Fewest points in it
_LEAP_M_S = 0.8  # Step of the velocity that is a leap
_APART_M_S = 0.6  # Difference of velocity and integral that is a lie, a root mean square
_SHARE = 0.25  # Largest share of the integral's swing that the velocity has then
_SWINGS_M_S = 0.25  # Least swing that shows it
_FAR_APART_M_S = 0.9
"""Difference that is wrong whatever the share: of a velocity that comes half a second late the share is of the right sign."""
_AGAINST_M_S = 0.45  # Difference where the velocity swings against the integral
_AGAINST_SHARE = -0.4  # Largest share of the swing then
_AGAINST_SWINGS_M_S = 0.2  # Least swing then
_WELL_M_S = 0.35  # Difference below which the velocity agrees again
_WELL_SHARE = 0.5  # Share of the swing above which it does
_STEADY_M_S2 = 1.2  # Largest difference that is no lie: an attitude that errs by 6 degrees makes it
_STEADY_WEIGHT = 0.02  # Weight of a bin in its mean, of 5 s
_SEEN_M = 0.08  # Least way against the pad that shows something, a root mean square
_SEEN_SHARE = 0.4  # Share of it from which the velocity is right


class Half(Struct, frozen=True):
    """Repetition of one half of a sample: unchanged values."""

    since: int = -1
    """Instant at which the value was first read that it repeats, ns; -1 while it changes."""
    longest_s: float = 0.0
    """The longest time for which it has repeated itself in flight and then gone on."""
    frozen: bool = False


def read_half(half: Half, before: int | None, t: int, frozen_s: float, flying: bool) -> Half:
    """Process one reading.

    Args:
        before: instant of the reading before, ns, if this one is the same to the bit; None if it differs.
        t: instant of this one, ns.
    """
    since, longest_s = half.since, half.longest_s
    if before is None:
        if since < 0:
            return half
        return half if t < since else Half(-1, longest_s if half.frozen or not flying else max(longest_s, (t - since) * 1e-9))
    since = before if since < 0 else since
    after_s = max(frozen_s, min(_LONGEST * longest_s, _MOST_S))
    return Half(since, longest_s, flying and (t - since) * 1e-9 > after_s)


class TurnByAttitude(Struct, frozen=True):
    """The two newest attitudes that are at least `_TURN_S` apart."""

    before: Attitude | None = None
    now: Attitude | None = None

    def after(self, attitude: Attitude) -> "TurnByAttitude":
        """Return it with one attitude more."""
        now = self.now
        if now is not None and attitude.stamp.measured_at - now.stamp.measured_at < _TURN_S * 1e9:
            return self
        return TurnByAttitude(now, attitude)

    def rate(self, at: int) -> F64 | None:
        """Return the body's rate, rad/s, about an instant, ns; None if the attitudes do not say."""
        a, b = self.before, self.now
        if a is None or b is None:
            return None
        dt = (b.stamp.measured_at - a.stamp.measured_at) * 1e-9
        if not 0.0 < dt <= 2.0 * _OLD_S or abs(at - b.stamp.measured_at) > _OLD_S * 1e9:
            return None
        return fixed_vector(*(x / dt for x in turn_between(a, b)))


def turn_between(a: Attitude, b: Attitude) -> tuple[float, float, float]:
    """Return the rotation vector, rad in `body`, that takes one attitude to another less than half a turn away."""
    (a0, a1, a2), (a3, a4, a5), (a6, a7, a8) = a.R_ned_body.matrix.tolist()
    (b0, b1, b2), (b3, b4, b5), (b6, b7, b8) = b.R_ned_body.matrix.tolist()
    x = (a2 * b1 + a5 * b4 + a8 * b7) - (a1 * b2 + a4 * b5 + a7 * b8)
    y = (a0 * b2 + a3 * b5 + a6 * b8) - (a2 * b0 + a5 * b3 + a8 * b6)
    z = (a1 * b0 + a4 * b3 + a7 * b6) - (a0 * b1 + a3 * b4 + a6 * b7)
    twice_sine = math.sqrt(x * x + y * y + z * z)
    trace = a0 * b0 + a3 * b3 + a6 * b6 + a1 * b1 + a4 * b4 + a7 * b7 + a2 * b2 + a5 * b5 + a8 * b8
    k = 0.5 if twice_sine < 1e-9 else math.atan2(twice_sine, trace - 1.0) / twice_sine
    return k * x, k * y, k * z


def replace_halves(imu: Imu, gyro_lost_s: float, accel_lost_s: float, turn: TurnByAttitude) -> Imu | None:
    """Return a sample without its lost halves; None if nothing else says how the body turns.

    Args:
        gyro_lost_s: time up to this sample in which the gyro was lost; 0 if it measures.
        accel_lost_s: the same for the accelerometer.
    """
    w = imu.w_body
    if gyro_lost_s > 0.0:
        rate = turn.rate(imu.stamp.measured_at)
        if rate is None:
            return None
        w = rate
    return replace(imu, w_body=w, gyro_lost_s=gyro_lost_s, accel_lost_s=accel_lost_s)


Vec3 = tuple[float, float, float]
Point = tuple[int, Vec3]
"""An instant, ns, and a witness's value less what the accelerometer makes of it; NaN where an axis is not measured."""


class Bin(NamedTuple):
    """A tenth of a second, from one attitude to another."""

    t: int
    """Instant of its begin, ns."""
    span_s: float
    v: Vec3
    """The accelerometer's integral at its begin, m/s in `ned`."""
    s: Vec3
    """The integral of that, m."""
    dv: Vec3
    off: Vec3
    """Rate of the gyro less that of the attitude, rad/s in `body`; of the first two without what is about the vertical."""
    w: Vec3
    """Mean rate of the gyro, rad/s in `body`."""
    f: Vec3
    """Mean specific force in `body`, m/s^2."""
    up: Vec3
    """The vertical in body axes at its end."""
    heading: tuple[float, float]
    """Cosine and sine of the heading at its end."""

    def at(self, t: int) -> tuple[Vec3, Vec3]:
        """Return both integrals at an instant within it, ns."""
        h = (t - self.t) * 1e-9
        k = h / self.span_s
        (vx, vy, vz), (sx, sy, sz), (ax, ay, az) = self.v, self.s, self.dv
        half = 0.5 * k * h
        return (vx + k * ax, vy + k * ay, vz + k * az), (
            sx + vx * h + half * ax,
            sy + vy * h + half * ay,
            sz + vz * h + half * az,
        )


class PadTurn(NamedTuple):
    """The turn of the pad against what the vehicle calls level, between two frames: none if its attitude is right."""

    since: int
    until: int
    """Instants of the frames, ns."""
    turn: Vec3
    """rad in `body`, the first two without what is about the vertical. A vessel's own is a small part of what a body turns."""


class Parity(Struct, frozen=True):
    """The bins, and each witness' values in them."""

    attitudes: tuple[Attitude, ...] = ()
    """Attitudes since the newest bin; the first one ends it."""
    bins: tuple[Bin, ...] = ()
    heights: tuple[float, ...] = ()
    """Heights by the barometer since the newest bin, m."""
    velocity: BodyVelocity | None = None
    """The first velocity since the newest bin."""
    baro: tuple[Point, ...] = ()
    flow: tuple[Point, ...] = ()
    sight: tuple[Point, ...] = ()
    yaw: tuple[tuple[int, float], ...] = ()
    """Instants, ns, and headings against the pad's arrow, rad."""
    pad: tuple[PadTurn, ...] = ()
    newest_pad: tuple[int, F64, float] | None = None
    """Instant, ns, the pad's rotation in `ned` by picture and attitude, (3, 3), and the correction of its heading, rad."""


class Slope(NamedTuple):
    """Difference between a witness and the accelerometer along one axis."""

    value: float
    """True less measured acceleration, m/s^2."""
    var: float


def weighed(p: Parity, event: Baro) -> Parity:
    """Add a height."""
    return replace(p, heights=(*p.heights[-63:], event.height_m))


def moved(p: Parity, event: BodyVelocity) -> Parity:
    """Add a velocity; the first of a bin counts."""
    return p if p.velocity is not None or not p.attitudes else replace(p, velocity=event)


def levelled(p: Parity, attitude: Attitude, imus: tuple[Imu, ...]) -> tuple[Parity, bool]:
    """Add an attitude; return whether it ended a bin.

    Args:
        imus: the IMU samples since the newest bin.
    """
    if not p.attitudes:
        return replace(p, attitudes=(attitude,)), False
    span_s = (attitude.stamp.measured_at - p.attitudes[0].stamp.measured_at) * 1e-9
    newest_s = (attitude.stamp.measured_at - p.attitudes[-1].stamp.measured_at) * 1e-9
    if newest_s <= 0.0:
        return p, False
    if span_s < _BIN_S:
        return replace(p, attitudes=(*p.attitudes, attitude)), False
    since = p.attitudes[0].stamp.measured_at
    within = [imu for imu in imus if imu.stamp.measured_at > since]
    if span_s > _GAP_S or len(within) < _SAMPLES_MIN:
        return Parity(attitudes=(attitude,)), False
    return _binned(p, attitude, within, span_s), True


def sighted(p: Parity, t: int, d_ned: Vec3, yaw_rad: float | None) -> Parity:
    """Add a sighting of the pad, in axes of fixed heading, at an instant of the past, ns."""
    if p.sight and t - p.sight[-1][0] < 0.8 * _BIN_S * 1e9:
        return p
    found = next((b for b in reversed(p.bins) if b.t <= t), None)
    if found is None or t - found.t > 2e9 * found.span_s:
        return p
    (_, (x, y, z)), (dx, dy, dz) = found.at(t), d_ned
    yaw = p.yaw if yaw_rad is None else (*p.yaw[1 - _KEPT :], (t, yaw_rad))
    return replace(p, sight=(*p.sight[1 - _KEPT :], (t, (-dx - x, -dy - y, -dz - z))), yaw=yaw)


def pictured(p: Parity, t: int, R_ned_body: F64, R_ned_pad: F64, off_rad: float = 0.0) -> Parity:
    """Add a picture's rotation of the pad at an instant of the past, ns, as the attitude levels it, (3, 3).

    Args:
        off_rad: how much the reported heading is more than that of this attitude: gyro and reported attitude are compared.
    """
    before = p.newest_pad
    since_s = math.inf if before is None else (t - before[0]) * 1e-9
    if 0.0 <= since_s < 0.8 * _BIN_S:
        return p
    newest = (t, R_ned_pad, off_rad)
    if before is None or not 0.0 < since_s <= _GAP_S:
        return replace(p, newest_pad=newest, pad=())
    D = R_ned_pad.dot(before[1].T)
    if float(np.trace(D)) < _SMALL_TURN_TRACE:
        # Half a turn is an arrow that was mistaken.
        return replace(p, newest_pad=newest)
    turn = R_ned_body.T.dot((0.5 * (D[2, 1] - D[1, 2]), 0.5 * (D[0, 2] - D[2, 0]), 0.5 * (D[1, 0] - D[0, 1])))
    x, y, z = _tilts(turn, R_ned_body[2])
    z += math.remainder(off_rad - before[2], math.tau) * R_ned_body.item(2, 2)
    return replace(p, newest_pad=newest, pad=(*p.pad[1 - _KEPT :], PadTurn(before[0], t, (x, y, z))))


def attitude_share(p: Parity, axis: int, since: int, *, swings: bool) -> float | None:
    """Return the share of the difference of gyro and attitude about an axis that is the attitude's, by the pad's pictures.

    It is 1 where the pad turns with the attitude's error, and 0 where it stays level, up to the vessel's own turn.

    Args:
        since: instant from which they are compared, ns.
        swings: compare what goes back and forth, without a steady turn, which may be the vessel's.

    Returns:
        The share; None if the pictures show too little of the difference.
    """
    end = p.bins[-1].t + round(p.bins[-1].span_s * 1e9) if p.bins else 0
    seen = [each for each in p.pad if since <= each.since and each.until <= end]
    if len(seen) < _PICTURES or _shown(p.bins, axis, since, seen[-1].until) < _SHOWN:
        return None
    t = np.array([seen[0].since, *(each.until for each in seen)], dtype=np.float64) * 1e-9
    off = np.cumsum([0.0, *(_off_between(p.bins, axis, each.since, each.until) for each in seen)])
    turned = -np.cumsum([0.0, *(each.turn[axis] for each in seen)])
    if swings:
        x = t - t.mean()
        off, turned = (y - y.mean() - x * (x.dot(y) / x.dot(x)) for y in (off, turned))
    square = float(off.dot(off))
    return float(off.dot(turned)) / square if square > len(t) * _SHOWN_RAD**2 else None


def _shown(bins: tuple[Bin, ...], axis: int, since: int, until: int) -> float:
    """Return the part of the difference since an instant that came before another one."""
    each = [(b.t, b.off[axis] ** 2) for b in bins if b.t >= since]
    whole = math.fsum(square for _, square in each)
    # A heading leaps at an instant of its bin, and so beside the picture that shows it: some more have to follow.
    after_s = 3.5 * _BIN_S if axis == 2 else 0.5 * _BIN_S
    return math.fsum(square for t, square in each if t + 1e9 * after_s < until) / whole if whole > 0.0 else 0.0


def _off_between(bins: tuple[Bin, ...], axis: int, since: int, until: int) -> float:
    """Return the angle by which the gyro turned more than the attitude between two instants, rad."""
    total = 0.0
    for b in bins:
        within = min(until, b.t + round(b.span_s * 1e9)) - max(since, b.t)
        if within > 0:
            total += b.off[axis] * within * 1e-9
    return total


def accelerations(points: tuple[Point, ...], axes: tuple[int, ...], since: int, least: int, order: int) -> list[Slope | None]:
    """Return the acceleration that places (`order` 2) or velocities (1) say along each axis, since an instant, ns.

    None with fewer points than `least`, and along an axis that is not measured.
    """
    taken = [(t - since, *value) for t, value in points if t >= since]
    if len(taken) < least:
        return [None] * len(axes)
    both, n = np.array(taken), len(taken)
    x = both[:, 0] * 1e-9
    x = x - np.add.reduce(x) / n
    m2, squares = float(x.dot(x)), x * x
    q = squares - float(squares.dot(x)) / m2 * x - m2 / n if order == 2 and m2 > 0.0 else x
    qq = float(q.dot(q))
    found: list[Slope | None] = []
    for axis in axes:
        y = both[:, 1 + axis]
        y = y - np.add.reduce(y) / n
        xy = float(x.dot(y))
        if not math.isfinite(xy) or m2 <= 0.0 or qq <= 0.0:
            found.append(None)
            continue
        rest, c = float(y.dot(y)) - xy * xy / m2, float(q.dot(y)) / qq
        of_place = Slope(2.0 * c, 4.0 * max(0.0, rest - c * c * qq) / (n - 3) / qq)
        found.append(of_place if order == 2 else Slope(xy / m2, max(0.0, rest) / (n - 2) / m2))
    return found


def _binned(p: Parity, end: Attitude, imus: list[Imu], span_s: float) -> Parity:
    first = p.attitudes[0]
    t0, t1 = first.stamp.measured_at, end.stamp.measured_at
    both = np.array([(imu.w_body, imu.f_body) for imu in imus])
    times = np.array([imu.stamp.measured_at for imu in imus])
    turns = np.array([a.R_ned_body.matrix for a in p.attitudes])
    which = np.searchsorted(np.array([a.stamp.measured_at for a in p.attitudes]), times, side="right") - 1
    f: F64 = np.add.reduce(np.matmul(turns[np.maximum(which, 0)], both[:, 1, :, None]), axis=0)[:, 0] / len(times)
    (wx, wy, wz), (f0, f1, f2) = (np.add.reduce(both) / len(times)).tolist()
    rx, ry, rz = turn_between(first, end)
    fx, fy, fz = f.tolist()
    dv = fx * span_s, fy * span_s, (fz + G_M_S2) * span_s
    last = p.bins[-1] if p.bins and p.bins[-1].t + round(p.bins[-1].span_s * 1e9) == t0 else None
    kept = p.bins if last is not None else ()
    (v, s) = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)) if last is None else last.at(t0)
    off = _tilts((wx - rx / span_s, wy - ry / span_s, wz - rz / span_s), end.R_ned_body.matrix[2])
    (c, _, _), (q, _, _), (x, y, z) = end.R_ned_body.matrix.tolist()
    n = max(1e-9, math.hypot(c, q))
    made = Bin(t0, span_s, v, s, dv, off, (wx, wy, wz), (f0, f1, f2), (x, y, z), (c / n, q / n))
    middle = (t0 + t1) // 2
    baro = p.baro
    if p.heights:
        _, (_, _, sz) = made.at(middle)
        # The height is positive up, and the integral down.
        mean = math.fsum(p.heights) / len(p.heights)
        baro = (*baro[1 - _KEPT :], (middle, (math.nan, math.nan, -mean - sz)))
    flow = p.flow if p.velocity is None else (*p.flow[1 - _KEPT :], _flow(p.velocity, made, first))
    return Parity((end,), (*kept[1 - _KEPT :], made), (), None, baro, flow, p.sight, p.yaw, p.pad, p.newest_pad)


def _tilts(turn: F64 | Vec3, down: F64) -> Vec3:
    """Return a turn in `body` whose first two components are without its part about the vertical.

    A reported heading that leaps, beside steel, turns a tilted body about all of its axes, and the pad in `ned` as well. That
    says nothing of roll and pitch.

    Args:
        down: the vertical in body axes.
    """
    (x, y, z), (i, j, k) = turn, down.tolist()
    about = x * i + y * j + z * k
    return x - about * i, y - about * j, z


def _flow(event: BodyVelocity, within: Bin, level: Attitude) -> Point:
    """Return what a velocity says, turned to `ned` by an attitude."""
    t = event.stamp.measured_at
    (c, _, _), (s, _, _), _ = level.R_ned_body.matrix.tolist()
    n = max(1e-9, math.hypot(c, s))
    (x, y, z), cov = event.v_level.tolist(), event.cov_level.diagonal().tolist()
    (vx, vy, vz), _ = within.at(t)
    if max(cov[:2]) > _UNMEASURED_VAR:
        x = y = math.nan
    return t, ((c * x - s * y) / n - vx, (s * x + c * y) / n - vy, (math.nan if cov[2] > _UNMEASURED_VAR else z) - vz)


class Steady(NamedTuple):
    """The acceleration by the velocity less that of the levelled accelerometer that has been there, m/s^2.

    A bias makes it, and an attitude that errs; it turns with the body.
    """

    bins: int = 0
    ahead: float = 0.0
    aside: float = 0.0

    def after(self, rate: tuple[float, float], heading: tuple[float, float]) -> "Steady":
        """Return it after one bin more.

        Args:
            rate: the difference's, m/s^2 north and east.
            heading: its cosine and sine.
        """
        k, (c, s), (x, y) = max(1.0 / (self.bins + 1), _STEADY_WEIGHT), heading, rate
        ahead, aside = self.ahead + k * (c * x + s * y - self.ahead), self.aside + k * (c * y - s * x - self.aside)
        within = min(1.0, _STEADY_M_S2 / max(1e-9, math.hypot(ahead, aside)))
        return Steady(self.bins + 1, within * ahead, within * aside)

    def ned(self, heading: tuple[float, float]) -> tuple[float, float]:
        """Return it north and east."""
        c, s = heading
        return c * self.ahead - s * self.aside, s * self.ahead + c * self.aside


class Compared(NamedTuple):
    """The velocity's change against the accelerometer's within the window."""

    rate: tuple[float, float]
    """Rate of their difference, m/s^2 north and east."""
    apart_m_s: float
    swings_m_s: float
    share: float
    """Part of the integral's swing that the velocity has, 1 where both agree."""

    @property
    def far(self) -> bool:
        """True if one of both is wrong by more than an attitude that errs makes."""
        return self.apart_m_s > _FAR_APART_M_S

    @property
    def contradicts(self) -> bool:
        """True if one of both is wrong."""
        apart = self.apart_m_s > _APART_M_S and self.share < _SHARE and self.swings_m_s > _SWINGS_M_S
        swings = self.swings_m_s > _AGAINST_SWINGS_M_S
        return self.far or apart or (self.apart_m_s > _AGAINST_M_S and self.share < _AGAINST_SHARE and swings)

    @property
    def agrees(self) -> bool:
        """True if both move, and alike."""
        return self.swings_m_s > _AGAINST_SWINGS_M_S and self.apart_m_s < _WELL_M_S and self.share > _WELL_SHARE


def compared(p: Parity, steady: Steady) -> Compared | None:
    """Return the comparison over the newest window; None with too few velocities in it."""
    t, flow, felt = _window(p)
    if len(t) < _POINTS:
        return None
    flow, felt = flow - flow.mean(axis=0), felt - felt.mean(axis=0)
    apart, x = flow - felt, (t - t.mean()) * 1e-9
    north, east = (x @ apart / (x @ x)).tolist()
    there = np.outer(x, steady.ned(p.bins[-1].heading))
    apart, felt = apart - there, felt + there
    square = float((felt * felt).sum())
    return Compared(
        (north, east),
        math.sqrt(float((apart * apart).sum()) / len(t)),
        math.sqrt(square / len(t)),
        float((flow * felt).sum()) / square if square > 0.0 else 1.0,
    )


def seen_right(p: Parity) -> bool | None:
    """Return whether the velocity leads along the way that the pad's sightings show; None where they show too little.

    Where they show no way, it is right that shows none either, if the accelerometer shows one.
    """
    t, flow, felt = _window(p)
    if len(t) < _POINTS:
        return None
    seen = [(at, value[:2]) for at, value in p.sight if t[0] <= at <= t[-1]]
    places = [(at, place) for at, value in seen if (place := _place(p, at, value)) is not None]
    if len(places) < _POINTS:
        return None
    at = np.array([instant for instant, _ in places], dtype=np.float64)
    x = at - at.mean()

    def swings(y: F64) -> F64:
        # Over the ground a ship's own way is a steady difference.
        swung: F64 = y - y.mean(axis=0) - np.outer(x, x @ (y - y.mean(axis=0)) / (x @ x))
        return swung

    def way_of(v: F64) -> F64:
        steps = 0.5 * (v[1:] + v[:-1]) * (np.diff(t) * 1e-9)[:, None]
        by_v = np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0)))
        return swings(np.column_stack([np.interp(at, t, by_v[:, axis]) for axis in range(2)]))

    way, flown, least = swings(np.array([place for _, place in places])), way_of(flow), len(places) * _SEEN_M**2
    square = float((way * way).sum())
    if square < least:
        return True if float((flown * flown).sum()) < least < 0.5 * float((way_of(felt) ** 2).sum()) else None
    return float((way * flown).sum()) > _SEEN_SHARE * square


def leaps(p: Parity, since: int) -> tuple[float, float]:
    """Return the sum of the velocity's leaps after an instant, ns, that the accelerometer did not feel, m/s north and east."""
    north = east = 0.0
    for (_, before), (t, now) in pairwise(p.flow):
        if t > since and math.hypot(x := now[0] - before[0], y := now[1] - before[1]) > _LEAP_M_S:
            north, east = north + x, east + y
    return north, east


def _window(p: Parity) -> tuple[F64, F64, F64]:
    """Return the instants, (N,) ns, the velocities and the accelerometer's integrals, (N, 2) m/s each in `ned`."""
    end = p.flow[-1][0] if p.flow else 0
    rows = []
    for t, off in p.flow:
        if t > end - _WINDOW_NS and (within := next((b for b in reversed(p.bins) if b.t <= t), None)) is not None:
            (x, y, _), _ = within.at(t)
            rows.append((t, off[0] + x, off[1] + y, x, y))
    both = np.array([row for row in rows if not math.isnan(row[1])], dtype=np.float64).reshape(-1, 5)
    off = np.hypot(*(np.diff(both[:, 1:3], axis=0) - np.diff(both[:, 3:5], axis=0)).T)
    leaps = np.nonzero(off > _LEAP_M_S)[0]
    both = both[leaps[-1] + 1 :] if len(leaps) else both
    return both[:, 0], both[:, 1:3], both[:, 3:5]


def _place(p: Parity, at: int, value: tuple[float, ...]) -> tuple[float, float] | None:
    """Return the body's place against the pad at a sighting, m north and east, from one less the accelerometer's way."""
    within = next((b for b in reversed(p.bins) if b.t <= at), None)
    if within is None:
        return None
    _, (x, y, _) = within.at(at)
    return value[0] + x, value[1] + y
