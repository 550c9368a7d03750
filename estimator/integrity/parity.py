"""Compare the IMU with independent ways to the same motion, over windows of a second or two.

The gyro is integrated between two of the vehicle's own attitudes; the accelerometer, levelled by them, is integrated twice. What
a barometer, the pad's sightings and a measured velocity say less that integral has a curvature (a velocity: a slope): the true
acceleration less the measured one. The least squares of the window give it with its variance, from the residuals themselves.
"""

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from estimator.contracts.geometry import F64
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu
from estimator.integrity.halves import turn_between

_BIN_S = 0.1
_GAP_S = 0.3
_SAMPLES_MIN = 3
_KEPT = 25
"""Number of bins that are kept: the longest window, and the time by which a sighting is late."""
_UNMEASURED_VAR = 1e3
_SMALL_TURN_TRACE = 1.0 + 2.0 * math.cos(1.0)
"""Trace of a rotation by a radian."""
_PICTURES, _SHOWN = 4, 0.6
_SHOWN_RAD = math.radians(0.8)
"""Least difference, a root mean square, that images resolve: at 7 m they err by half a degree."""

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


def curvature(points: tuple[Point, ...], axis: int, since: int, least: int) -> Slope | None:
    """Return the acceleration that a place says along an axis, since an instant, ns; None with fewer points than `least`."""
    return _fit(points, axis, since, least, 2)


def slope(points: tuple[Point, ...], axis: int, since: int, least: int) -> Slope | None:
    """Return the acceleration from a velocity; otherwise as `curvature`."""
    return _fit(points, axis, since, least, 1)


def _fit(points: tuple[Point, ...], axis: int, since: int, least: int, order: int) -> Slope | None:
    taken = [(t - since, value[axis]) for t, value in points if t >= since]
    if len(taken) < least:
        return None
    both = np.array(taken)
    x, y = both[:, 0] * 1e-9, both[:, 1]
    n = len(taken)
    x = x - np.add.reduce(x) / n
    y = y - np.add.reduce(y) / n
    m2, xy = float(x.dot(x)), float(x.dot(y))
    if not math.isfinite(xy) or m2 <= 0.0:
        return None
    rest = float(y.dot(y)) - xy * xy / m2
    if order == 1:
        return Slope(xy / m2, max(0.0, rest) / (n - 2) / m2)
    squares = x * x
    q = squares - float(squares.dot(x)) / m2 * x - m2 / n
    qq = float(q.dot(q))
    if qq <= 0.0:
        return None
    c = float(q.dot(y)) / qq
    return Slope(2.0 * c, 4.0 * max(0.0, rest - c * c * qq) / (n - 3) / qq)


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
