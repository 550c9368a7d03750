"""The ship: its steady course and speed, its six-degree-of-freedom motion on the waves, and the pad that it carries.

Two special vessels do not keep a steady course: one turns, and the motion of the other was recorded.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike, NDArray

from estimator.contracts.geometry import F64, Rotation
from sitl.core.library import SIM
from sitl.sea.sea import Waves
from sitl.vessel.file import RecordedMotion
from sitl.vessel.seakeeping import Course, Hull, Turn, TurningCourse, encounter_rad_s, heel_rad, responses

_EYE = np.eye(3)


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
