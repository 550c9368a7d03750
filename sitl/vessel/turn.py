"""A ship's turn: rate of turn, speed lost in it, heel outwards, and the path that follows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimator.contracts.geometry import F64
from sitl.sea.spectra import GRAVITY_M_S2
from sitl.vessel.seakeeping import Hull

_NODES = 1001
"""Points of the path through the beginning of the turn; the path between them is exact to a micrometre."""


def speed_in_turn_m_s(speed_m_s: float, rate_rad_s: float, length_m: float) -> float:
    """Return the steady speed in a turn that was begun at `speed_m_s`.

    Source: Lyster & Knights, Prediction equations for ships' turning circles, Trans. NECIES 95 (1979): the speed in the turn over
    that before it is 0.074 of the turning diameter in lengths, plus 0.149. The diameter is twice the new speed over the rate.
    """
    diameter_per_speed = 2.0 / (abs(rate_rad_s) * length_m)
    share = 0.074 * speed_m_s * diameter_per_speed
    return speed_m_s if share >= 1.0 - 0.149 else 0.149 * speed_m_s / (1.0 - share)


def heel_rad(hull: Hull, speed_m_s: F64, rate_rad_s: F64) -> F64:
    """Return the steady roll in a turn, starboard down positive: a turn to starboard heels the ship to port.

    Source: Rawson & Tupper, Basic Ship Theory, chapter on manoeuvrability, angle of heel when turning. The centripetal force acts
    at half the draught, the ship's inertia at its centre of gravity.
    """
    assert hull.gm_m is not None
    assert hull.kg_m is not None
    return np.asarray(-speed_m_s * rate_rad_s * (hull.kg_m - 0.5 * hull.draught_m) / (GRAVITY_M_S2 * hull.gm_m))


@dataclass(frozen=True, slots=True)
class Turn:
    """A turn that begins at some instant: rate and speed go over smoothly, then the ship runs in a circle."""

    rate_rad_s: float
    """Clockwise from above positive, not 0."""
    at_s: float
    over_s: float
    """How long it takes until rate and speed are steady."""


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """Where the ship would be without waves at times (T,), relative to its place and heading at time 0."""

    p: F64
    """(T, 2) m ahead and to starboard of the first place, along the first heading."""
    v: F64
    a: F64
    yaw: F64
    """(T,) rad from the first heading."""
    rate: F64
    rate_dot: F64
    share: F64
    """(T, 3): how far the turn has developed, 0 to 1, with its two derivatives."""
    speed: F64
    """(T,) m/s."""


class TurningCourse:
    """The course of a ship that turns; `at` is exact but for the path while the turn develops."""

    def __init__(self, turn: Turn, speed_m_s: float, length_m: float) -> None:
        self.turn, self.before_m_s = turn, speed_m_s
        self.after_m_s = speed_in_turn_m_s(speed_m_s, turn.rate_rad_s, length_m)
        self._t = np.linspace(0.0, turn.over_s, _NODES)
        h = self._t[1]
        v = self._velocity(self._t)
        middle = self._velocity(self._t[:-1] + 0.5 * h)
        steps = h / 6.0 * (v[:-1] + 4.0 * middle + v[1:])
        self._p = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        self._v = v

    def at(self, t_s: F64) -> Course:
        """Return the course at times (T,)."""
        turn = self.turn
        x = t_s - turn.at_s
        s, s1, s2 = smooth_step(x / turn.over_s)
        share = np.stack([s, s1 / turn.over_s, s2 / turn.over_s**2], axis=-1)
        yaw, gained = self._yaw(x), self.after_m_s - self.before_m_s
        speed = self.before_m_s + gained * share[:, 0]
        rate, rate_dot = turn.rate_rad_s * share[:, 0], turn.rate_rad_s * share[:, 1]
        ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
        across = np.stack([-np.sin(yaw), np.cos(yaw)], axis=-1)
        v = speed[:, None] * ahead
        a = (gained * share[:, 1])[:, None] * ahead + (speed * rate)[:, None] * across
        p = self._path(x) + np.array([self.before_m_s * turn.at_s, 0.0])
        return Course(p, v, a, yaw, rate, rate_dot, share, speed)

    def _path(self, x: F64) -> F64:
        """(T, 2) m from where the turn begins, x s after that."""
        turn, straight = self.turn, np.stack([self.before_m_s * x, np.zeros_like(x)], axis=-1)
        h = self._t[1]
        i = np.clip((x / h).astype(int), 0, _NODES - 2)
        u = np.clip((x - self._t[i]) / h, 0.0, 1.0)[:, None]
        p0, p1, v0, v1 = self._p[i], self._p[i + 1], self._v[i], self._v[i + 1]
        within = (1 + 2 * u) * (1 - u) ** 2 * p0 + u * (1 - u) ** 2 * h * v0 + u**2 * (3 - 2 * u) * p1 + u**2 * (u - 1) * h * v1
        late = np.maximum(x - turn.over_s, 0.0)
        yaw0 = 0.5 * turn.rate_rad_s * turn.over_s
        yaw, radius = yaw0 + turn.rate_rad_s * late, self.after_m_s / turn.rate_rad_s
        circle = np.stack([np.sin(yaw) - math.sin(yaw0), math.cos(yaw0) - np.cos(yaw)], axis=-1) * radius
        return np.where((x < 0)[:, None], straight, within + circle)

    def _velocity(self, x: F64) -> F64:
        yaw = self._yaw(x)
        speed = self.before_m_s + (self.after_m_s - self.before_m_s) * smooth_step(x / self.turn.over_s)[0]
        return np.stack([speed * np.cos(yaw), speed * np.sin(yaw)], axis=-1)

    def _yaw(self, x: F64) -> F64:
        u = np.clip(x / self.turn.over_s, 0.0, 1.0)
        developing = u**4 * (2.5 + u * (u - 3.0))
        return self.turn.rate_rad_s * (self.turn.over_s * developing + np.maximum(x - self.turn.over_s, 0.0))


def smooth_step(x: F64) -> tuple[F64, F64, F64]:
    """Return the fifth-order step from 0 to 1 and its two derivatives, which are 0 at both ends."""
    u = np.clip(x, 0.0, 1.0)
    return (
        u**3 * (10.0 + u * (6.0 * u - 15.0)),
        30.0 * u**2 * (1.0 - u) ** 2,
        60.0 * u * (1.0 - u) * (1.0 - 2.0 * u),
    )
