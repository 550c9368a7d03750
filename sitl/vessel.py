"""The ship: its steady course and speed, its six-degree-of-freedom motion on the waves, and the pad that it carries."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike

from estimator.contracts.geometry import F64, Rotation, known_rotation
from sitl.sea import Waves
from sitl.seakeeping import Hull, encounter_rad_s, responses


@dataclass(frozen=True, slots=True)
class Mooring:
    """Slow drift of a hull at anchor: one harmonic each in surge, sway and yaw, of these amplitudes and periods."""

    surge_m: float = 0.05
    sway_m: float = 0.15
    yaw_rad: float = 0.02
    period_s: float = 45.0
    """Period of the sway. Surge has half of it and yaw one and a half of it, so that the path does not close soon."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """[surge forward, sway to starboard, heave down, roll, pitch, yaw] about the steady course, and its two derivatives."""

    eta: F64
    """(..., 6) displacement, m and rad."""
    eta_dot: F64
    """(..., 6) rate, m/s and rad/s."""
    eta_ddot: F64
    """(..., 6) acceleration, m/s^2 and rad/s^2."""


class Mounted(Struct, frozen=True, eq=False):
    """A point fixed to the vessel, with axes fixed to it."""

    p_ned: F64
    """(..., 3) position, m."""
    v_ned: F64
    """(..., 3) velocity, m/s."""
    a_ned: F64
    """(..., 3) acceleration of the motion, without gravity, m/s^2."""
    R_ned: F64
    """(..., 3, 3) rotation from the mounted frame to ned."""
    w: F64
    """(..., 3) angular velocity in the mounted frame, rad/s."""

    def rotation(self) -> Rotation:
        """Return `R_ned` of a single mounted point.

        Raises:
            ValueError: this is a batch.
        """
        if self.R_ned.ndim != 2:
            raise ValueError(f"{len(self.R_ned)} mounted points have no single rotation")
        return known_rotation(self.R_ned)


class Vessel:
    """B vessels of one hull, each on its own sea. Frames: origin amidships at the calm waterline, x forward, y starboard, z down.

    Args:
        waves: of batch B; the vessels ride the very waves that the sea's surface shows.
        heading_rad: of the bow, clockwise from north; or (B,).
        speed_m_s: along the heading, 0 or more.
        p0_ne_m: (2,) place at time 0, north and east.
        pad_yaw_rad: the pad's arrow against the bow, clockwise from above.
        mooring: None under way.
        seeds: phases of the mooring's wandering, one a vessel; needed with a mooring only.

    Raises:
        ValueError: shapes that do not meet, or a negative speed.
    """

    def __init__(
        self,
        hull: Hull,
        waves: Waves,
        *,
        heading_rad: ArrayLike = 0.0,
        speed_m_s: float = 0.0,
        p0_ne_m: tuple[float, float] = (0.0, 0.0),
        pad_yaw_rad: float = 0.0,
        mooring: Mooring | None = None,
        seeds: int | Sequence[int] = 0,
    ) -> None:
        if not speed_m_s >= 0:
            raise ValueError(f"speed_m_s must be 0 or more, got {speed_m_s!r}")
        self.hull, self.waves, self.speed_m_s = hull, waves, speed_m_s
        batch = waves.batch
        self.heading_rad = np.broadcast_to(np.asarray(heading_rad, dtype=float), (batch,))
        self.d_vessel_pad = np.array([*hull.d_vessel_pad_m, -hull.freeboard_m])
        self.R_vessel_pad = Rotation.from_rpy(0.0, 0.0, pad_yaw_rad)
        self._p0 = np.array([*p0_ne_m, 0.0])
        ahead = np.stack([np.cos(self.heading_rad), np.sin(self.heading_rad), np.zeros(batch)], axis=-1)
        self._v0 = speed_m_s * ahead
        current = waves.current_ne_m_s
        if current != (0.0, 0.0) and mooring is None:
            self._v0 = self._v0 + np.array([*current, 0.0])
        self._axes = np.stack([ahead, np.stack([-ahead[:, 1], ahead[:, 0], ahead[:, 2]], axis=-1)], axis=-1)
        beta = waves.towards_rad - self.heading_rad[:, None]
        phase = waves.k_ne @ self._p0[:2] + waves.phase_rad
        w = encounter_rad_s(waves.w_rad_s, beta, speed_m_s)
        if current != (0.0, 0.0) and mooring is not None:
            w = waves.seen_rad_s
        coefficient = responses(hull, waves.w_rad_s, beta, speed_m_s, w) * waves.amplitude_m * np.exp(1j * phase)
        if mooring is not None:
            chosen = [seeds] * batch if isinstance(seeds, int) else list(seeds)
            if len(chosen) != batch:
                raise ValueError(f"{len(chosen)} seeds for {batch} vessels")
            start = math.tau * np.stack([np.random.default_rng([s, 0xA2C4]).random(3) for s in chosen])
            slow = np.zeros((6, batch, 3), dtype=complex)
            for axis, n, size in ((0, 0, mooring.surge_m), (1, 1, mooring.sway_m), (5, 2, mooring.yaw_rad)):
                slow[axis, :, n] = size * np.exp(1j * start[:, n])
            periods = mooring.period_s * np.array([0.5, 1.0, 1.5])
            coefficient = np.concatenate([coefficient, slow], axis=-1)
            w = np.concatenate([w, np.broadcast_to(math.tau / periods, (batch, 3))], axis=-1)
        c, rate = np.ascontiguousarray(coefficient.transpose(1, 2, 0)), (-1j * w)[..., None]
        self._derivatives = [c * rate**n for n in range(3)]
        """The harmonics' complex amplitudes of the motion and of its two derivatives, each (B, N, 6)."""
        self._w = w

    @property
    def batch(self) -> int:
        return self.waves.batch

    def motion(self, t_s: ArrayLike) -> Motion:
        """Return the motion about the steady course at times (...): arrays (B, ..., 6) with exact derivatives."""
        t = np.asarray(t_s, dtype=float)
        flat = t.reshape(-1)
        turn = np.exp(-1j * self._w[:, None, :] * flat[:, None])
        shape = (self.batch, *t.shape, 6)
        eta, dot, ddot = ((turn @ c).real.reshape(shape) for c in self._derivatives)
        return Motion(eta, dot, ddot)

    def origin(self, t: F64) -> tuple[F64, F64, F64, F64, Motion]:
        """Return the origin's position, velocity and acceleration in ned, the heading of the course, and the motion, (B, ...)."""
        m = self.motion(t)
        lead = (slice(None), *([None] * t.ndim))
        axes = self._axes[lead]
        travelled = self._p0 + self._v0[lead] * t[..., None]
        return (
            travelled + horizontal(axes, m.eta[..., :3]),
            self._v0[lead] + horizontal(axes, m.eta_dot[..., :3]),
            horizontal(axes, m.eta_ddot[..., :3]),
            self.heading_rad[lead],
            m,
        )

    def way_at(self, t_s: float) -> F64:
        """Return the velocity of the pad's place on the course of the first vessel, without the waves, (3,) m/s in ned."""
        return np.array(self._v0[0])

    def mounted(self, t_s: ArrayLike, d_vessel_m: ArrayLike, R_vessel: Rotation | None = None) -> Mounted:
        """Return the motion at times (...) of a point (3,) m from the vessel's origin, with axes rotated by `R_vessel`.

        Every array of the result leads with (B, ...).
        """
        t = np.asarray(t_s, dtype=float)
        d = np.asarray(d_vessel_m, dtype=float)
        p0, v0, a0, heading, m = self.origin(t)
        R = _from_rpy(m.eta[..., 3], m.eta[..., 4], heading + m.eta[..., 5])
        w, w_dot = body_rates(m)
        arm_v = _cross(w, d)
        arm_a = _cross(w_dot, d) + _cross(w, arm_v)
        mount = np.eye(3) if R_vessel is None else R_vessel.matrix
        return Mounted(
            p0 + R @ d,
            v0 + np.einsum("...ij,...j->...i", R, arm_v),
            a0 + np.einsum("...ij,...j->...i", R, arm_a),
            R @ mount,
            w @ mount,
        )

    def pad(self, t_s: ArrayLike) -> Mounted:
        """Return the pad's centre and frame at times (...), with the leading shape (B, ...)."""
        return self.mounted(t_s, self.d_vessel_pad, self.R_vessel_pad)

    def pad_at(self, t_s: float, index: int = 0) -> Mounted:
        """Return the pad of one vessel at one instant, with shapes (3,) and (3, 3)."""
        m = self.pad(t_s)
        return Mounted(m.p_ned[index], m.v_ned[index], m.a_ned[index], m.R_ned[index], m.w[index])

    def pose(self, t_s: float, index: int = 0) -> tuple[F64, Rotation]:
        """Return the position in ned of one vessel's origin, (3,) m, and `R_ned_vessel`."""
        m = self.mounted(t_s, np.zeros(3))
        return m.p_ned[index], Rotation(m.R_ned[index])


def horizontal(axes: F64, v: F64) -> F64:
    """Return (..., 3) surge, sway and down rotated into ned by the course's axes (..., 3, 2)."""
    out: F64 = np.einsum("...ij,...j->...i", axes, v[..., :2])
    out[..., 2] += v[..., 2]
    return out


def _from_rpy(roll: F64, pitch: F64, yaw: F64) -> F64:
    """Return `Rotation.from_rpy` for arrays, (..., 3, 3)."""
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    out = np.empty((*roll.shape, 3, 3))
    for i, row in enumerate(rows):
        for j, value in enumerate(row):
            out[..., i, j] = value
    return out


def _cross(a: F64, b: F64) -> F64:
    """Return `np.cross(a, b)` of (..., 3) vectors. For few of them that takes most of its time to look at their shapes."""
    (ax, ay, az), (bx, by, bz) = ((v[..., 0], v[..., 1], v[..., 2]) for v in (a, b))
    out = np.empty(np.broadcast(a, b).shape)
    out[..., 0], out[..., 1], out[..., 2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return out


def body_rates(m: Motion) -> tuple[F64, F64]:
    """Return the angular velocity and acceleration in the vessel's frame, (..., 3) rad/s and rad/s^2.

    Source: Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., eq. 2.41, and its time derivative.
    """
    roll, pitch = m.eta[..., 3], m.eta[..., 4]
    r1, p1, y1 = (m.eta_dot[..., i] for i in (3, 4, 5))
    r2, p2, y2 = (m.eta_ddot[..., i] for i in (3, 4, 5))
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    w = np.stack([r1 - sp * y1, cr * p1 + cp * sr * y1, -sr * p1 + cp * cr * y1], axis=-1)
    w_dot = np.stack(
        [
            r2 - sp * y2 - cp * p1 * y1,
            cr * p2 - sr * r1 * p1 + cp * sr * y2 + (cp * cr * r1 - sp * sr * p1) * y1,
            -sr * p2 - cr * r1 * p1 + cp * cr * y2 - (cp * sr * r1 + sp * cr * p1) * y1,
        ],
        axis=-1,
    )
    return w, w_dot
