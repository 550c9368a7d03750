"""The ship: its steady course and speed, its six-degree-of-freedom motion on the waves, and the pad that it carries.

Two special vessels do not keep a steady course: one turns, and the motion of the other was recorded. Faults of the vessel add to
her motion another course and speed, a roll, and the wake of another ship: her pose is her own, then rolled and lifted in her own
axes, then turned about her origin and carried along the course that she really takes. Every part has its exact rate.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike, NDArray

from estimator.contracts.geometry import F64, Rotation
from sitl.core.library import SIM
from sitl.faults.kinds import DeckRoll, FerryWake, ShipFault, ShipSpeed, ShipTurn
from sitl.sea.sea import Waves
from sitl.vessel.file import RecordedMotion
from sitl.vessel.seakeeping import (
    Course,
    Hull,
    Turn,
    TurningCourse,
    encounter_rad_s,
    heel_rad,
    responses,
    smooth_step,
    speed_in_turn_m_s,
)

_EYE = np.eye(3)
_HEADINGS = 96
"""Headings at which a turning ship's responses are computed; between them fifth-order polynomials meet value, slope and bend."""
_APART_S = 1e-3
"""Distance of the velocities whose difference is the acceleration."""


class Mooring(Struct, frozen=True):
    """Slow drift of a hull at anchor: one harmonic each in surge, sway and yaw, of these amplitudes and periods."""

    surge_m: float = 0.05
    sway_m: float = 0.15
    yaw_rad: float = 0.02
    period_s: float = 45.0
    """Period of the sway. Surge has half of it and yaw one and a half of it, so that the path does not close soon."""


class Motion(Struct, frozen=True, eq=False):
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


class Vessel:
    """B vessels of one hull, each on its own sea, at time 0 at the world's origin.

    Frames: origin amidships at the calm waterline, x forward, y starboard, z down.

    Args:
        waves: of batch B; the vessels ride the very waves that the sea's surface shows.
        heading_rad: of the bow, clockwise from north; or (B,).
        speed_m_s: along the heading, 0 or more.
        pad_yaw_rad: the pad's arrow against the bow, clockwise from above.
        mooring: None under way.
        seeds: phases of the mooring's wandering, one a vessel; needed with a mooring only.
    """

    def __init__(
        self,
        hull: Hull,
        waves: Waves,
        *,
        heading_rad: ArrayLike = 0.0,
        speed_m_s: float = 0.0,
        pad_yaw_rad: float = 0.0,
        mooring: Mooring | None = None,
        seeds: int | Sequence[int] = 0,
    ) -> None:
        self.hull, self.waves, self.speed_m_s = hull, waves, speed_m_s
        batch = waves.batch
        self.heading_rad = np.broadcast_to(np.asarray(heading_rad, dtype=float), (batch,))
        self.d_vessel_pad = np.array([*hull.d_vessel_pad_m, -hull.freeboard_m])
        self.R_vessel_pad = Rotation.from_rpy(0.0, 0.0, pad_yaw_rad)
        ahead = np.stack([np.cos(self.heading_rad), np.sin(self.heading_rad), np.zeros(batch)], axis=-1)
        self._v0 = speed_m_s * ahead
        current = waves.current_ne_m_s
        if current != (0.0, 0.0) and mooring is None:
            self._v0 = self._v0 + np.array([*current, 0.0])
        self._axes = np.stack([ahead, np.stack([-ahead[:, 1], ahead[:, 0], ahead[:, 2]], axis=-1)], axis=-1)
        beta = waves.towards_rad - self.heading_rad[:, None]
        w = encounter_rad_s(waves.w_rad_s, beta, speed_m_s)
        if current != (0.0, 0.0) and mooring is not None:
            w = waves.seen_rad_s
        coefficient = responses(hull, waves.w_rad_s, beta, speed_m_s, w) * waves.amplitude_m * np.exp(1j * waves.phase_rad)
        if mooring is not None:
            chosen = [seeds] * batch if isinstance(seeds, int) else list(seeds)
            start = math.tau * np.stack([np.random.default_rng([s, 0xA2C4]).random(3) for s in chosen])
            slow = np.zeros((6, batch, 3), dtype=complex)
            for axis, n, size in ((0, 0, mooring.surge_m), (1, 1, mooring.sway_m), (5, 2, mooring.yaw_rad)):
                slow[axis, :, n] = size * np.exp(1j * start[:, n])
            periods = mooring.period_s * np.array([0.5, 1.0, 1.5])
            coefficient = np.concatenate([coefficient, slow], axis=-1)
            w = np.concatenate([w, np.broadcast_to(math.tau / periods, (batch, 3))], axis=-1)
        c = coefficient.transpose(1, 2, 0)
        self.harmonics = np.empty(w.shape, SIM.dtype("dl_sim_harmonic"))
        """(B, N) of the motion."""
        self.harmonics["w_rad_s"], self.harmonics["re"], self.harmonics["im"] = w, c.real, c.imag

    @property
    def batch(self) -> int:
        return self.waves.batch

    def motion(self, t_s: ArrayLike) -> Motion:
        """Return the motion about the steady course at times (...): arrays (B, ..., 6) with exact derivatives."""
        t = np.asarray(t_s, dtype=float)
        flat = np.ascontiguousarray(t).reshape(-1)
        out = np.empty((self.batch, flat.size), SIM.dtype("dl_sim_vessel_motion"))
        for harmonics, moved in zip(self.harmonics, out, strict=True):
            numbers, times = SIM.array("dl_sim_harmonic", harmonics), SIM.array("double", flat)
            SIM.lib.dl_sim_vessel_moved(len(harmonics), numbers, flat.size, times, SIM.array("dl_sim_vessel_motion", moved))
        whole = out.reshape(self.batch, *t.shape)
        return Motion(whole["eta"], whole["eta_dot"], whole["eta_ddot"])

    def origin(self, t: F64) -> tuple[F64, F64, F64, F64, Motion]:
        """Return the origin's position, velocity and acceleration in ned, the heading of the course, and the motion, (B, ...)."""
        m = self.motion(t)
        lead = (slice(None), *([None] * t.ndim))
        axes = self._axes[lead]
        return (
            self._v0[lead] * t[..., None] + horizontal(axes, m.eta[..., :3]),
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
        shape = (self.batch, *t.shape)
        origin, motion = np.empty(shape, SIM.dtype("dl_sim_vessel_origin")), np.empty(shape, SIM.dtype("dl_sim_vessel_motion"))
        origin["p"], origin["v"], origin["a"], origin["heading_rad"] = p0, v0, a0, heading
        motion["eta"], motion["eta_dot"], motion["eta_ddot"] = m.eta, m.eta_dot, m.eta_ddot
        mount = SIM.new("dl_sim_mount", d=d, R=_EYE if R_vessel is None else R_vessel.matrix)
        out = np.empty(shape, SIM.dtype("dl_sim_mounted"))
        given = SIM.array("dl_sim_vessel_origin", origin), SIM.array("dl_sim_vessel_motion", motion)
        SIM.lib.dl_sim_vessel_mounted(out.size, *given, mount, SIM.array("dl_sim_mounted", out))
        return Mounted(out["p"], out["v"], out["a"], out["R"].reshape(*shape, 3, 3), out["w"])

    def pad(self, t_s: ArrayLike) -> Mounted:
        """Return the pad's centre and frame at times (...), with the leading shape (B, ...)."""
        return self.mounted(t_s, self.d_vessel_pad, self.R_vessel_pad)

    def pad_at(self, t_s: float) -> Mounted:
        """Return the pad of the first vessel at one instant, with shapes (3,) and (3, 3)."""
        m = self.pad(t_s)
        return Mounted(m.p_ned[0], m.v_ned[0], m.a_ned[0], m.R_ned[0], m.w[0])


def horizontal(axes: F64, v: F64) -> F64:
    """Return (..., 3) surge, sway and down rotated into ned by the course's axes (..., 3, 2)."""
    out: F64 = np.einsum("...ij,...j->...i", axes, v[..., :2])
    out[..., 2] += v[..., 2]
    return out


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
    what it does. Speed and heel follow the turn (`sitl.vessel.seakeeping`).
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
        return p + t_s[:, None] * drift, v + drift, a

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

    def begin(self, fault: ShipFault, at_s: float) -> None:
        """Take note of a fault that begins at an instant. Earlier results of `pad` for later times become invalid."""
        if self._begun:
            times, d_ne = self._newest
            i = max(0, int(np.searchsorted(times, at_s + 1e-9)) - 1)
            self._at_s, self._d_ne = float(times[i]), d_ne[i]
        else:
            self._at_s, self._newest = at_s, (np.array([at_s]), np.zeros((1, 2)))
        self._begun.append((fault, at_s))

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
