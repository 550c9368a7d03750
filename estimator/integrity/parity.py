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
    """Rate of the gyro less that of the attitude, rad/s in `body`."""
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


class Parity(Struct, frozen=True):
    """The bins, and what each witness said in them."""

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


class Slope(NamedTuple):
    """What a witness has over the accelerometer along one axis."""

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


def curvature(points: tuple[Point, ...], axis: int, since: int, least: int) -> Slope | None:
    """Return the acceleration that a place says along an axis, since an instant, ns; None with fewer points than `least`."""
    return _fit(points, axis, since, least, 2)


def slope(points: tuple[Point, ...], axis: int, since: int, least: int) -> Slope | None:
    """Return the acceleration that a velocity says; as `curvature`."""
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
    off = wx - rx / span_s, wy - ry / span_s, wz - rz / span_s
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
    return Parity((end,), (*kept[1 - _KEPT :], made), (), None, baro, flow, p.sight, p.yaw)


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
