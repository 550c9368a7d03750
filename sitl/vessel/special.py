"""Vessels whose motion is not that of a steady course: one that turns, and one whose motion somebody recorded."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.contracts.geometry import F64
from sitl.sea.sea import Waves
from sitl.vessel.recorded_motion import RecordedMotion
from sitl.vessel.seakeeping import Hull, responses
from sitl.vessel.turn import Course, Turn, TurningCourse, heel_rad
from sitl.vessel.vessel import Motion, Vessel, horizontal

_HEADINGS = 96
"""Headings at which a turning ship's responses are computed; between them fifth-order polynomials meet value, slope and bend."""
_STEP_RAD = math.tau / _HEADINGS
_HERMITE = np.array(
    [
        [1, 0, 0, -10, 15, -6],
        [0, 1, 0, -6, 8, -3],
        [0, 0, 0.5, -1.5, 1.5, -0.5],
        [0, 0, 0, 10, -15, 6],
        [0, 0, 0, -4, 7, -3],
        [0, 0, 0, 0.5, -1, 0.5],
    ]
)
"""Coefficients of 1 to u^5 for value, slope and bend at u = 0, then at u = 1."""


class RecordedVessel(Vessel):
    """A vessel that moves as recorded, about a steady course; the waves only show around it and do not move it.

    Args:
        starts_s: (B,) places in the recording at which each vessel begins.
    """

    def __init__(self, hull: Hull, waves: Waves, recorded: RecordedMotion, starts_s: ArrayLike = 0.0, **course: Any) -> None:
        super().__init__(hull, waves, **course)
        self._recorded = recorded
        self._starts_s = np.broadcast_to(np.asarray(starts_s, dtype=float), (waves.batch,))

    def motion(self, t_s: ArrayLike) -> Motion:
        """Return the recorded motion at times (...): arrays (B, ..., 6)."""
        t = np.asarray(t_s, dtype=float)
        flat = (self._starts_s[:, None] + t.reshape(-1)).ravel()
        eta, dot, ddot = (x.reshape(self.batch, *t.shape, 6) for x in self._recorded.at(flat))
        return Motion(eta, dot, ddot)


class TurningVessel(Vessel):
    """A vessel that begins to turn at some instant, and meets the waves from another side as it does.

    At each instant it responds as it would to the same waves on a steady course of that heading; the derivatives are those of
    what it does. Speed and heel follow the turn (`sitl.vessel.turn`).
    """

    def __init__(self, hull: Hull, waves: Waves, turn: Turn, **course: Any) -> None:
        super().__init__(hull, waves, **course)
        self._course = course_of = TurningCourse(turn, self.speed_m_s, hull.length_m)
        psi = _STEP_RAD * np.arange(_HEADINGS)
        beta = waves.towards_rad - self.heading_rad[:, None] - psi[:, None, None]
        scale = waves.amplitude_m * np.exp(1j * waves.phase_rad)
        before, after = (
            responses(hull, waves.w_rad_s, beta, speed) * scale for speed in (course_of.before_m_s, course_of.after_m_s)
        )
        self._steady, self._gain = _nodes(before), _nodes(after - before)

    def motion(self, t_s: ArrayLike) -> Motion:
        """Return the motion about the course at times (...): arrays (B, ..., 6) with exact derivatives; roll holds the heel."""
        t = np.asarray(t_s, dtype=float)
        flat = t.reshape(-1)
        c = self._course.at(flat)
        # The response C and its time derivatives, as heading and speed change.
        shape = (self.batch, flat.size, -1, 6)
        steady, gain = (tuple(x.reshape(shape) for x in _between(n, c)) for n in (self._steady, self._gain))
        s, s1, s2 = (c.share[:, i, None, None] for i in range(3))
        c0 = steady[0] + s * gain[0]
        c1 = steady[1] + s * gain[1] + s1 * gain[0]
        c2 = steady[2] + s * gain[2] + 2.0 * s1 * gain[1] + s2 * gain[0]
        # The wave's phase where the ship is, and its derivatives.
        k = self.waves.k_ne[:, None]
        p, v, a = (x[..., :2] for x in self._path(flat))
        angle = (k * p[:, :, None]).sum(axis=-1) - self.waves.seen_rad_s[:, None] * flat[:, None]
        w = ((k * v[:, :, None]).sum(axis=-1) - self.waves.seen_rad_s[:, None])[..., None]
        w_dot = (k * a[:, :, None]).sum(axis=-1)[..., None]
        carrier = np.exp(1j * angle)[..., None]
        eta = (c0 * carrier).real.sum(axis=2)
        dot = ((c1 + 1j * w * c0) * carrier).real.sum(axis=2)
        ddot = ((c2 + 2j * w * c1 + (1j * w_dot - w**2) * c0) * carrier).real.sum(axis=2)
        for out, heel in zip((eta, dot, ddot), self._heel(c.share), strict=True):
            out[..., 3] += heel
        shape_out = (self.batch, *t.shape, 6)
        return Motion(eta.reshape(shape_out), dot.reshape(shape_out), ddot.reshape(shape_out))

    def origin(self, t: F64) -> tuple[F64, F64, F64, F64, Motion]:
        """Return the origin's position, velocity and acceleration in ned, the heading of the course, and the motion, (B, ...).

        The turn's rate is in the motion's yaw rate.
        """
        flat, lead = t.reshape(-1), (self.batch, *t.shape)
        c, m = self._course.at(flat), self.motion(t)
        p, v, a = self._path(flat)
        heading = self.heading_rad[:, None] + c.yaw
        ahead = np.stack([np.cos(heading), np.sin(heading), np.zeros_like(heading)], axis=-1)
        aside = np.stack([-ahead[..., 1], ahead[..., 0], ahead[..., 2]], axis=-1)
        axes = np.stack([ahead, aside], axis=-1)
        turned = np.stack([aside, -ahead], axis=-1)
        eta, dot, ddot = (x.reshape(self.batch, flat.size, 6)[..., :3] for x in (m.eta, m.eta_dot, m.eta_ddot))
        r, r_dot = c.rate[:, None], c.rate_dot[:, None]
        flat_eta, flat_dot = eta * np.array([1.0, 1.0, 0.0]), dot * np.array([1.0, 1.0, 0.0])
        p0 = p + horizontal(axes, eta)
        v0 = v + horizontal(axes, dot) + r * horizontal(turned, flat_eta)
        a0 = a + horizontal(axes, ddot) + 2.0 * r * horizontal(turned, flat_dot)
        a0 = a0 + r_dot * horizontal(turned, flat_eta) - r**2 * horizontal(axes, flat_eta)
        rate, rate_dot = np.zeros((flat.size, 6)), np.zeros((flat.size, 6))
        rate[:, 5], rate_dot[:, 5] = c.rate, c.rate_dot
        whole = Motion(m.eta, m.eta_dot + rate.reshape(*t.shape, 6), m.eta_ddot + rate_dot.reshape(*t.shape, 6))
        return p0.reshape(*lead, 3), v0.reshape(*lead, 3), a0.reshape(*lead, 3), heading.reshape(lead), whole

    def way_at(self, t_s: float) -> F64:
        at = np.array([t_s])
        course = self._course.at(at)
        heading, rate = float(self.heading_rad[0] + course.yaw[0]), float(course.rate[0])
        ahead, aside, _ = self.d_vessel_pad
        # A place ahead of the ship's middle is carried aside by the turn.
        c, s = math.cos(heading), math.sin(heading)
        carried = rate * np.array([-s * ahead - c * aside, c * ahead - s * aside, 0.0])
        return np.asarray(self._path(at)[1][0, 0] + carried)

    def _path(self, t_s: F64) -> tuple[F64, F64, F64]:
        """Return position, velocity and acceleration of the course in ned, (B, T, 3)."""
        c = self._course.at(t_s)
        drift = np.array([*self.waves.current_ne_m_s, 0.0])
        level = [np.concatenate([x, np.zeros((t_s.size, 1))], axis=-1) for x in (c.p, c.v, c.a)]
        axes = self._axes[:, None]
        p, v, a = (horizontal(axes, np.broadcast_to(x, (self.batch, *x.shape))) for x in level)
        return self._p0 + p + t_s[:, None] * drift, v + drift, a

    def _heel(self, share: F64) -> tuple[F64, F64, F64]:
        """Return the heel at (T, 3) shares of the turn, rad, with its two derivatives: speed and rate grow with the share."""
        turn, before = self._course.turn, self._course.before_m_s
        gained = self._course.after_m_s - before
        unit = float(heel_rad(self.hull, np.asarray(1.0), np.asarray(turn.rate_rad_s)))
        s, s1, s2 = share.T
        return (
            unit * (before + gained * s) * s,
            unit * (before + 2.0 * gained * s) * s1,
            unit * ((before + 2.0 * gained * s) * s2 + 2.0 * gained * s1**2),
        )


def _nodes(grid: NDArray[np.complex128]) -> tuple[NDArray[np.complex128], ...]:
    """Return (B, M, N * 6) values of (6, M, B, N) responses round the circle, with their slopes and bends times the step.

    The derivatives are those of the Fourier series through the values.
    """
    moved = grid.transpose(2, 1, 3, 0)
    values = moved.reshape(*moved.shape[:2], -1)
    orders = 1j * np.fft.fftfreq(_HEADINGS, 1.0 / _HEADINGS)[:, None] * _STEP_RAD
    series = np.fft.fft(values, axis=1)
    return values, np.fft.ifft(series * orders, axis=1), np.fft.ifft(series * orders**2, axis=1)


def _between(nodes: tuple[NDArray[np.complex128], ...], c: Course) -> tuple[NDArray[np.complex128], ...]:
    """Return (B, T, K) responses at the headings of a course, with their two derivatives by time.

    Not as a matrix product: BLAS would wake its threads, which then spin between the few calls that a flight makes.
    """
    place = c.yaw / _STEP_RAD
    i = np.floor(place).astype(int)
    u = (place - i)[:, None]
    powers = np.arange(6)
    by_u = (
        u**powers,
        powers * u ** np.maximum(powers - 1, 0) / _STEP_RAD,
        powers * (powers - 1) * u ** np.maximum(powers - 2, 0) / _STEP_RAD**2,
    )
    ends = [n[:, (i + side) % _HEADINGS] for side in (0, 1) for n in nodes]
    value, slope, bend = (_weighted((p @ _HERMITE.T).T, ends) for p in by_u)
    rate, rate_dot = c.rate[:, None], c.rate_dot[:, None]
    return value, slope * rate, bend * rate**2 + slope * rate_dot


def _weighted(weights: F64, parts: list[NDArray[np.complex128]]) -> NDArray[np.complex128]:
    out: NDArray[np.complex128] = weights[0][:, None] * parts[0]
    for w, part in zip(weights[1:], parts[1:], strict=True):
        out += w[:, None] * part
    return out
