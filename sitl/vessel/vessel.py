"""The ship: its steady course and speed, its six-degree-of-freedom motion on the waves, and the pad that it carries."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike

from estimator.contracts.geometry import F64, Rotation, known_rotation
from estimator.core.library import start_of
from sitl.core.library import size_of
from sitl.native import address, vessel_mounted, vessel_moved
from sitl.sea.sea import Waves
from sitl.vessel.seakeeping import Hull, encounter_rad_s, responses

_MODES = 6
_MOTION, _ORIGIN, _MOUNTED = size_of("vessel_motion"), size_of("vessel_origin"), size_of("mounted")
_EYE = np.eye(3)


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
        c = coefficient.transpose(1, 2, 0)
        self._harmonics = np.ascontiguousarray(np.concatenate([w[..., None], c.real, c.imag], axis=-1))
        """(B, N, 13) the core's `harmonic`s of the motion."""

    @property
    def batch(self) -> int:
        return self.waves.batch

    def motion(self, t_s: ArrayLike) -> Motion:
        """Return the motion about the steady course at times (...): arrays (B, ..., 6) with exact derivatives."""
        t = np.asarray(t_s, dtype=float)
        flat = np.ascontiguousarray(t).reshape(-1)
        out = np.empty((self.batch, flat.size, _MOTION))
        for harmonics, moved in zip(self._harmonics, out, strict=True):
            vessel_moved(len(harmonics), address(harmonics, float), flat.size, address(flat, float), start_of(moved))
        whole = out.reshape(self.batch, *t.shape, _MOTION)
        return Motion(whole[..., :_MODES], whole[..., _MODES : 2 * _MODES], whole[..., 2 * _MODES :])

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
        origin = np.empty((self.batch, *t.shape, _ORIGIN))
        origin[..., 0:3], origin[..., 3:6], origin[..., 6:9], origin[..., 9] = p0, v0, a0, heading
        motion = np.concatenate([m.eta, m.eta_dot, m.eta_ddot], axis=-1)
        mount = np.concatenate([d, (_EYE if R_vessel is None else R_vessel.matrix).reshape(-1)])
        out = np.empty((self.batch, *t.shape, _MOUNTED))
        vessel_mounted(self.batch * t.size, start_of(origin), start_of(motion), start_of(mount), start_of(out))
        R = out[..., 9:18].reshape(self.batch, *t.shape, 3, 3)
        return Mounted(out[..., 0:3], out[..., 3:6], out[..., 6:9], R, out[..., 18:21])

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
