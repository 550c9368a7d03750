"""The motion that faults of the vessel add to hers: another course and speed, a roll, the wake of another ship.

The vessel's pose is her own, then rolled and lifted in her own axes, then turned about her origin and carried along the course
that she really takes. Every part has its exact rate, so that deck and contact stay consistent.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64
from sitl.faults.fault import Fault
from sitl.faults.kinds import DeckRoll, FerryWake, ShipFault, ShipSpeed, ShipTurn
from sitl.vessel.seakeeping import encounter_rad_s, heel_rad, responses, smooth_step, speed_in_turn_m_s
from sitl.vessel.vessel import Mounted, Vessel

_APART_S = 1e-3
"""Distance of the velocities whose difference is the acceleration."""


class _Course(NamedTuple):
    """Speed and heading at times (T,), against those of the course before."""

    speed_m_s: F64
    yaw_rad: F64
    yaw_rate_rad_s: F64


class Manoeuvre:
    """The added motion of one vessel.

    Args:
        vessel: a batch of one.
        course_m_s: her speed through the water without a fault.
        seconds: instant of the world at which this begins.
    """

    def __init__(self, vessel: Vessel, course_m_s: float, seconds: float) -> None:
        self._vessel, self._before_m_s = vessel, course_m_s
        self._begun: list[tuple[ShipFault, float]] = []
        self._at_s = seconds
        self._d_ne: F64 = np.zeros(2)
        self._newest: tuple[F64, F64] = (np.array([seconds]), np.zeros((1, 2)))
        """The times of the newest call, and how far from her course before the vessel was at them."""

    def begin(self, fault: Fault, at_s: float) -> bool:
        """Take note of a fault that begins at an instant; return whether it is one of the vessel.

        Earlier results of `pad` for later times become invalid.
        """
        if not isinstance(fault, ShipFault):
            return False
        if self._begun:
            times, d_ne = self._newest
            i = max(0, int(np.searchsorted(times, at_s + 1e-9)) - 1)
            self._at_s, self._d_ne = float(times[i]), d_ne[i]
        else:
            self._at_s, self._newest = at_s, (np.array([at_s]), np.zeros((1, 2)))
        self._begun.append((fault, at_s))
        return True

    def __bool__(self) -> bool:
        """Return whether there is anything to add."""
        return bool(self._begun)

    def pad(self, t_s: F64) -> Mounted:
        """Return the pad at the next times (T,), in order and close to each other, with the leading shape (1, T).

        The acceleration is a central difference of the velocity, right to 1e-4 m/s^2.
        """
        d_ne = self._carried(t_s, self._at_s, self._d_ne)
        self._at_s, self._d_ne, self._newest = float(t_s[-1]), d_ne[-1], (t_s, d_ne)
        return self._at(t_s, d_ne)

    def pad_ahead(self, now_s: float, t_s: F64) -> Mounted:
        """Return the pad at later times (T,), ascending from an instant of the newest call of `pad`; nothing changes."""
        times, d_ne = self._newest
        i = max(0, int(np.searchsorted(times, now_s + 1e-9)) - 1)
        return self._at(t_s, self._carried(t_s, float(times[i]), d_ne[i]))

    def _at(self, t_s: F64, d_ne: F64) -> Mounted:
        now, before, after = (self._moved(t) for t in (t_s, t_s - _APART_S, t_s + _APART_S))
        p = now.p_ned.copy()
        p[0, :, :2] += d_ne
        return Mounted(p, now.v_ned, (after.v_ned - before.v_ned) / (2.0 * _APART_S), now.R_ned, now.w)

    def _moved(self, t_s: F64) -> Mounted:
        """Return the pad as `pad` does, at any times, except for the way along the other course; the acceleration is left out."""
        ship = self._vessel.mounted(t_s, np.zeros(3))
        course = self._course(t_s)
        heading = float(self._vessel.heading_rad[0])
        v_ne = self._off(heading, course)
        eta, rate = self._added(t_s)
        c, s = np.cos(course.yaw_rad), np.sin(course.yaw_rad)
        zero, one = np.zeros_like(c), np.ones_like(c)
        turn = np.stack([np.stack([c, -s, zero], -1), np.stack([s, c, zero], -1), np.stack([zero, zero, one], -1)], -2)
        R = turn @ ship.R_ned[0]
        tilt, w_tilt = _tilted(eta, rate)
        p = ship.p_ned[0].copy()
        v = ship.v_ned[0] + np.concatenate([v_ne, zero[:, None]], axis=1)
        # Surge, sway and heave in the axes of the turned course.
        ahead = heading + course.yaw_rad
        axes = np.stack([np.stack([np.cos(ahead), np.sin(ahead)], -1), np.stack([-np.sin(ahead), np.cos(ahead)], -1)], -1)
        p[:, :2] += (axes @ eta[:, :2, None])[..., 0]
        turned = np.stack([axes[..., 1], -axes[..., 0]], axis=-1)
        v[:, :2] += (axes @ rate[:, :2, None] + course.yaw_rate_rad_s[:, None, None] * (turned @ eta[:, :2, None]))[..., 0]
        p[:, 2] += eta[:, 2]
        v[:, 2] += rate[:, 2]
        w_ned = (R @ (ship.w[0] + w_tilt)[..., None])[..., 0]
        w_ned[:, 2] += course.yaw_rate_rad_s
        R_vessel = R @ tilt
        arm = R_vessel @ self._vessel.d_vessel_pad
        R_pad = R_vessel @ self._vessel.R_vessel_pad.matrix
        w_pad = (np.swapaxes(R_pad, -1, -2) @ w_ned[..., None])[..., 0]
        p, v = p + arm, v + np.cross(w_ned, arm)
        return Mounted(p[None], v[None], np.full_like(v, np.nan)[None], R_pad[None], w_pad[None])

    def _course(self, t_s: F64) -> _Course:
        speed = np.full_like(t_s, self._before_m_s)
        yaw, rate = np.zeros_like(t_s), np.zeros_like(t_s)
        for fault, at_s in self._begun:
            x = t_s - at_s
            if isinstance(fault, ShipSpeed):
                share, _, _ = _share(x, fault.over_s, fault.for_s)
                speed += share * (fault.to_m_s - speed)
            elif isinstance(fault, ShipTurn):
                share, _, integral = _share(x, fault.over_s, fault.for_s)
                turning = math.radians(fault.rate_deg_s)
                rate += turning * share
                yaw += turning * integral
                after = speed_in_turn_m_s(self._before_m_s, turning, self._vessel.hull.length_m)
                speed *= 1.0 + share * (after / max(1e-9, self._before_m_s) - 1.0)
        return _Course(speed, yaw, rate)

    def _carried(self, t_s: F64, from_s: float, d_ne: F64) -> F64:
        """Return how far from her course before the vessel is, (T, 2) m north and east, by Simpson's rule.

        Args:
            from_s: an instant at which she was `d_ne` (2,) m off.
        """
        heading = float(self._vessel.heading_rad[0])
        before = np.concatenate([[from_s], t_s[:-1]])
        starts, middles, ends = (self._off(heading, self._course(t)) for t in (before, 0.5 * (before + t_s), t_s))
        steps = (t_s - before)[:, None] / 6.0 * (starts + 4.0 * middles + ends)
        return np.asarray(d_ne + np.cumsum(steps, axis=0))

    def _off(self, heading: float, course: _Course) -> F64:
        ahead = heading + course.yaw_rad
        now = course.speed_m_s[:, None] * np.stack([np.cos(ahead), np.sin(ahead)], axis=-1)
        return np.asarray(now - self._before_m_s * np.array([math.cos(heading), math.sin(heading)]))

    def _added(self, t_s: F64) -> tuple[F64, F64]:
        """Return [surge, sway, heave, roll, pitch, yaw] about the course, (T, 6) m and rad, and its rate."""
        eta, rate = np.zeros((t_s.size, 6)), np.zeros((t_s.size, 6))
        for fault, at_s in self._begun:
            x = t_s - at_s
            if isinstance(fault, DeckRoll):
                w = math.tau / fault.period_s
                share, slope, _ = _share(x, fault.period_s, None if fault.for_s is None else fault.for_s - fault.period_s)
                size = math.radians(fault.roll_deg)
                eta[:, 3] += size * share * np.sin(w * x)
                rate[:, 3] += size * (slope * np.sin(w * x) + w * share * np.cos(w * x))
            elif isinstance(fault, FerryWake):
                for out, value in zip((eta, rate), self._wake(fault, x), strict=True):
                    out += value
            elif isinstance(fault, ShipTurn):
                share, slope, _ = _share(x, fault.over_s, fault.for_s)
                turning = math.radians(fault.rate_deg_s)
                speed = speed_in_turn_m_s(self._before_m_s, turning, self._vessel.hull.length_m)
                heel = float(heel_rad(self._vessel.hull, np.asarray(speed), np.asarray(turning)))
                eta[:, 3] += heel * share
                rate[:, 3] += heel * slope
        return eta, rate

    def _wake(self, fault: FerryWake, x: F64) -> tuple[F64, F64]:
        """Return the motion in a train of waves that grows and dies as a squared sine, and its rate, (T, 6).

        The envelope is slow against the waves, so that the response is that to a steady wave under it.
        """
        beta = np.array(math.radians(fault.from_deg) + math.pi)
        w = math.tau / fault.period_s
        gain = responses(self._vessel.hull, np.array(w), beta, self._before_m_s)
        seen = float(encounter_rad_s(np.array(w), beta, self._before_m_s))
        lasts_s = fault.waves * fault.period_s
        angle = math.pi * np.clip(x / lasts_s, 0.0, 1.0)
        share, slope = np.sin(angle) ** 2, math.pi / lasts_s * np.sin(2.0 * angle)
        carrier = 0.5 * fault.height_m * np.exp(-1j * seen * x)
        eta = (share * carrier)[:, None] * gain
        rate = ((slope - 1j * seen * share) * carrier)[:, None] * gain
        return eta.real, rate.real


def _share(x: F64, over_s: float, for_s: float | None) -> tuple[F64, F64, F64]:
    """Return how far something has developed x s after its beginning, 0 to 1, its rate and its integral from the beginning.

    It develops over `over_s` and, after `for_s`, goes back in the same time.
    """
    up, slope, _ = smooth_step(x / over_s)
    integral = _integral(x, over_s)
    slope = slope / over_s
    if for_s is not None:
        down, back, _ = smooth_step((x - for_s) / over_s)
        up, slope, integral = up - down, slope - back / over_s, integral - _integral(x - for_s, over_s)
    return up, slope, integral


def _integral(x: F64, over_s: float) -> F64:
    u = np.clip(x / over_s, 0.0, 1.0)
    return np.asarray(over_s * u**4 * (2.5 + u * (u - 3.0)) + np.maximum(x - over_s, 0.0))


def _tilted(eta: F64, rate: F64) -> tuple[F64, F64]:
    """Return the rotation by roll, then pitch, then yaw of (T, 6) motions, and its angular velocity in the axes before it."""
    roll, pitch, yaw = eta[:, 3], eta[:, 4], eta[:, 5]
    x, y, z = (_about(axis, angle) for axis, angle in ((0, roll), (1, pitch), (2, yaw)))
    zero = np.zeros_like(roll)
    w = np.stack([rate[:, 3], zero, zero], -1)
    w = w + (x @ np.stack([zero, rate[:, 4], zero], -1)[..., None])[..., 0]
    w = w + (x @ y @ np.stack([zero, zero, rate[:, 5]], -1)[..., None])[..., 0]
    return x @ y @ z, w


def _about(axis: int, angle: F64) -> F64:
    """Return (T, 3, 3) rotations about one axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out = np.zeros((angle.size, 3, 3))
    out[:, axis, axis] = 1.0
    out[:, i, i] = out[:, j, j] = np.cos(angle)
    out[:, i, j], out[:, j, i] = -np.sin(angle), np.sin(angle)
    return out
