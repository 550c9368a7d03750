"""Ground truth over a ship that shares no formula with the simulator or the other benches, and sensors that err in every way.

The sea is a random spectrum turned into time series by an inverse FFT and passed through the hull as a frequency response. Paths
are splines through those series; velocities, accelerations and body rates are derivatives of the splines. Sensor noise is ARMA.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation as Spin
from scipy.spatial.transform import RotationSpline

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Sighting
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, BodyVelocity, Imu, Range
from estimator.contracts.time import MonoNs, Stamp
from estimator.ekf import EkfOptions

EPOCH_NS = 7_000_000_000
GRAVITY = 9.80665
ARM_M = (3.0, 0.5, -1.0)
"""Pad from the vessel's centre of motion: forward, starboard, down."""
_STEP_S = 0.02
_MARGIN_S = 5.0
_LEGS = (
    (-9.0, 2.5, 1.5, -5.0), (3.0, 2.5, 1.5, -5.0), (8.0, 0.3, -0.2, -2.0), (24.0, 0.2, 0.2, -2.0), (29.0, -0.6, 0.5, -4.0),
    (34.0, 0.1, 0.0, -2.0),
)  # fmt: skip
"""(s, forward, starboard, down) of the body from the pad's mean place, m."""


@dataclass(frozen=True)
class HullResponse:
    """The response of a vessel to waves."""

    heave_rad_s: float
    """Waves quicker than this move it less and less."""
    roll_rad_s: float
    roll_damping: float
    slope_fraction: float
    """Deck slope over wave slope for long waves."""


FERRY = HullResponse(1.6, 1.1, 0.15, 0.5)
BOAT = HullResponse(4.0, 3.0, 0.2, 0.7)
PLATFORM = HullResponse(1.2, 0.6, 0.2, 0.2)

SEAS: dict[str, tuple[HullResponse, tuple[tuple[float, float, float], ...]]] = {
    "calm": (FERRY, ()),
    "moored": (FERRY, ()),
    "jonswap": (FERRY, ((1.5, 7.0, 3.3),)),
    "small boat": (BOAT, ((0.5, 3.5, 3.3),)),
    "platform": (PLATFORM, ((0.4, 9.0, 7.0),)),
    "wake": (BOAT, ((0.05, 4.0, 1.0),)),
    "swell and wind": (FERRY, ((1.2, 12.0, 5.0), (0.6, 4.5, 1.0))),
    "narrow": (FERRY, ()),
    "turning": (FERRY, ((1.5, 7.0, 3.3),)),
}
"""Seas by name: the hull, and its wave systems as (significant height m, peak period s, peakedness)."""


@dataclass(frozen=True)
class VoyageScene:
    """One flight. Angles in degrees because a person writes these."""

    seed: int = 0
    sea: str = "jonswap"
    duration_s: float = 40.0
    imu_hz: float = 100.0
    sighting_hz: float = 15.0
    speed_m_s: float | None = None
    """None draws one of 0.5 to 2; it is 0 with the sea "moored", whatever is given."""
    turn_deg_s: float | None = None
    """None: 3 with the sea "turning", else 0. The sense is drawn."""
    hidden_delay_s: float = 0.03
    mount_deg: float = 2.0
    attitude_bias_deg: float = 0.5
    heading_bias_deg: float = 3.0
    vibration_m_s2: float = 1.5
    outliers: float = 0.03
    gaps: int = 3
    """Rate of gaps of 0.5 to 1.5 s in the sightings."""
    blind: tuple[tuple[float, float], ...] = ()
    range_hz: float = 20.0


IDEAL: dict[str, Any] = {
    "hidden_delay_s": 0.0, "mount_deg": 0.0, "attitude_bias_deg": 0.0, "heading_bias_deg": 0.0, "vibration_m_s2": 0.0,
    "outliers": 0.0, "gaps": 0,
}  # fmt: skip
"""The fields of a scene without sensor errors but white noise."""

OPTIONS = EkfOptions(
    velocity_scale=0.9,
    sigma_mount_rad=math.radians(1.5),
    sigma_gyro_bias_rad_s=0.01,
    sigma_accel_bias_m_s2=0.15,
    sigma_attitude_bias_rad=math.radians(2.0),
)
"""Filter options from a data sheet; nothing of the errors drawn."""


def ns(t_s: float) -> MonoNs:
    return MonoNs(EPOCH_NS + round(t_s * 1e9))


def stamp(measured_at_s: float, received_at_s: float | None = None, sigma_s: float = 0.002) -> Stamp:
    measured_at = ns(measured_at_s)
    return Stamp(measured_at, measured_at if received_at_s is None else max(measured_at, ns(received_at_s)), sigma_s, "sim")


def coloured(rng: np.random.Generator, n: int, step_s: float, sigma: float, memory_s: float, width: int) -> F64:
    """(n, width) ARMA(1, 1) noise of standard deviation `sigma`, already settled."""
    from scipy.signal import lfilter  # loads scipy.stats: not where tests are only collected

    a, b = math.exp(-step_s / memory_s), 0.3
    spare = round(8 * memory_s / step_s)
    raw = lfilter([1.0, b], [1.0, -a], rng.standard_normal((n + spare, width)), axis=0)[spare:]
    return np.asarray(sigma * raw / math.sqrt((1.0 + 2.0 * a * b + b * b) / (1.0 - a * a)))


class Voyage:
    """Truth at any instant, s since the start."""

    def __init__(self, scene: VoyageScene) -> None:
        self.scene = scene
        rng = np.random.default_rng([scene.seed, 41])
        t = np.arange(-_MARGIN_S, scene.duration_s + _MARGIN_S, _STEP_S)
        given = 0.0 if scene.sea == "moored" else scene.speed_m_s
        speed = float(rng.uniform(0.5, 2.0)) if given is None else given
        turn = (3.0 if scene.sea == "turning" else 0.0) if scene.turn_deg_s is None else scene.turn_deg_s
        turn = math.radians(turn) * float(rng.choice([-1.0, 1.0]))
        # Every other ship begins to turn in the middle of the flight, over four seconds.
        begin = -60.0 if scene.seed % 2 == 0 else 14.0
        course = turn * gaussian_filter1d(np.maximum(t - begin, 0.0) if begin > 0 else t, 2.0 / _STEP_S, mode="nearest")
        course += rng.uniform(-math.pi, math.pi)
        sway = self._waves(rng, t, course)
        path = CubicSpline(t, speed * np.stack([np.cos(course), np.sin(course)], axis=1)).antiderivative()(t)
        roll, pitch, yaw = sway[:, 3], sway[:, 4], course + sway[:, 5]
        self.deck_at = Spin.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1))
        steady = Spin.from_euler("Z", course[:, None])
        base = np.concatenate([path, np.zeros((t.size, 1))], axis=1) + steady.apply(ARM_M)
        pad = np.concatenate([path, np.zeros((t.size, 1))], axis=1) + sway[:, :3] + self.deck_at.apply(ARM_M)
        self._pad, self._pad_angles = CubicSpline(t, pad), CubicSpline(t, np.stack([yaw, pitch, roll], axis=1))
        self.level_down_m = float(np.mean(pad[:, 2]))

        legs = np.array(_LEGS)
        offset = np.stack([np.interp(t, legs[:, 0], legs[:, k]) for k in (1, 2, 3)], axis=1)
        offset = gaussian_filter1d(offset, 1.0 / _STEP_S, axis=0, mode="nearest")
        body = base + steady.apply(offset) + self._spectral(rng, t, 0.35, 3) * [0.2, 0.2, 0.1]
        self._body = CubicSpline(t, body)
        drag = 0.1 * (self._body(t, 1) - CubicSpline(t, base)(t, 1))
        thrust = self._body(t, 2) - [0.0, 0.0, GRAVITY] + drag
        up = -thrust / np.linalg.norm(thrust, axis=1, keepdims=True)
        tilt = np.cross([0.0, 0.0, 1.0], up)
        lean = np.arccos(np.clip(up[:, 2], -1.0, 1.0)) / np.maximum(np.linalg.norm(tilt, axis=1), 1e-12)
        nose = course - course[0] + rng.uniform(-math.pi, math.pi) + 0.4 * self._spectral(rng, t, 0.05, 1)[:, 0]
        self._spin = RotationSpline(t[::2], (Spin.from_rotvec(tilt * lean[:, None]) * Spin.from_euler("Z", nose[:, None]))[::2])

    @staticmethod
    def _spectral(rng: np.random.Generator, t: F64, cut_hz: float, width: int) -> F64:
        """(n, width) of unit variance, band-limited by a Gaussian in frequency."""
        f = np.fft.rfftfreq(t.size, _STEP_S)
        shape = np.exp(-((f / cut_hz) ** 2))[:, None]
        z = shape * (rng.standard_normal((f.size, width)) + 1j * rng.standard_normal((f.size, width)))
        x = np.fft.irfft(z, t.size, axis=0)
        return np.asarray((x - x.mean(axis=0)) / x.std(axis=0))

    def _waves(self, rng: np.random.Generator, t: F64, course: F64) -> F64:
        """(n, 6) surge north, sway east, heave down (m), roll, pitch, yaw (rad) of the centre of motion."""
        hull, systems = SEAS[self.scene.sea]
        n = 2 ** math.ceil(math.log2(t.size * 2))
        w = math.tau * np.fft.rfftfreq(n, _STEP_S)
        dw = float(w[1])
        out = np.zeros((t.size, 6))
        tones = (
            [(1.5 / 4.0 * math.sqrt(0.4), math.tau / p) for p in rng.uniform(6.3, 8.7, 5)] if self.scene.sea == "narrow" else []
        )
        for height, period, peak in systems:
            x = np.maximum(w, 1e-6) * period / math.tau
            rest = np.where(x < 1.0, 0.07, 0.09)
            S = x**-5.0 * np.exp(-1.25 * np.maximum(x, 0.05) ** -4.0) * peak ** np.exp(-0.5 * ((x - 1.0) / rest) ** 2)
            S[w > 12.0] = 0.0
            S *= height**2 / 16.0 / float(np.sum(S) * dw)
            z = np.sqrt(S * dw / 2.0) * (rng.standard_normal(w.size) + 1j * rng.standard_normal(w.size)) * n / math.sqrt(2.0)
            out += self._answered(rng, hull, w, z, n, t.size, course)
        for size, rate in tones:
            z = np.zeros(w.size, dtype=complex)
            z[round(rate / dw)] = size * np.exp(1j * rng.uniform(0.0, math.tau)) * n / 2.0
            out += self._answered(rng, hull, w, z, n, t.size, course)
        if self.scene.sea == "wake":
            since = t - float(rng.uniform(12.0, 22.0))
            packet = np.exp(-0.5 * (since / 3.0) ** 2) * np.sin(math.tau * since * (1.0 + 0.02 * since) / 2.8)
            out += packet[:, None] * np.array([0.05, 0.05, 0.2, 0.08, 0.04, 0.0])
        return out

    @staticmethod
    def _answered(
        rng: np.random.Generator,
        hull: HullResponse,
        w: NDArray[np.floating],
        z: NDArray[np.complexfloating],
        n: int,
        size: int,
        course: F64,
    ) -> F64:
        towards = float(rng.uniform(-math.pi, math.pi))
        low = 1.0 / np.sqrt(1.0 + (w / hull.heave_rad_s) ** 6)
        slope = hull.slope_fraction * w * w / GRAVITY * low
        resonant = hull.roll_rad_s**2 / (hull.roll_rad_s**2 - w * w + 2j * hull.roll_damping * hull.roll_rad_s * w)
        series = np.fft.irfft(
            np.stack([0.7j * low * z, -low * z, slope * resonant * z, 1j * slope * z, 0.2 * slope * z]), n, axis=1
        )
        orbit, heave, roll, pitch, yaw = series[:, :size]
        abeam, ahead = np.sin(towards - course), np.cos(towards - course)
        return np.stack(
            [orbit * math.cos(towards), orbit * math.sin(towards), heave, roll * abeam, pitch * ahead, yaw * abeam * ahead],
            axis=1,
        )

    def pad(self, t: F64) -> tuple[F64, F64, F64]:
        """(n, 3) p and v in ned, (n, 3, 3) R_ned_pad."""
        return self._pad(t), self._pad(t, 1), Spin.from_euler("ZYX", self._pad_angles(t)).as_matrix()

    def body(self, t: F64) -> tuple[F64, F64, F64]:
        """(n, 3) p, v, a in ned."""
        return self._body(t), self._body(t, 1), self._body(t, 2)

    def attitude(self, t: F64) -> F64:
        """(n, 3, 3) R_ned_body."""
        return np.asarray(self._spin(t).as_matrix())

    def rates(self, t: F64) -> F64:
        """(n, 3) rad/s in body, by differences of the rotation."""
        h = 1e-3
        return np.asarray((self._spin(t - h).inv() * self._spin(t + h)).as_rotvec()) / (2 * h)

    def relative(self, t_s: float) -> tuple[F64, F64, float]:
        """d_body_pad_level, v_pad_level, heading of the body against the arrow."""
        t = np.array([t_s])
        (p, v, _), (pp, vp, Rp), R = self.body(t), self.pad(t), self.attitude(t)[0]
        psi = math.atan2(R[1, 0], R[0, 0])
        Z = Spin.from_rotvec([0.0, 0.0, -psi])
        yaw = math.remainder(psi - math.atan2(Rp[0, 1, 0], Rp[0, 0, 0]), math.tau)
        return Z.apply((pp - p)[0]), Z.apply((vp - v)[0]), yaw


Event = Imu | Attitude | BodyVelocity | Range | Sighting


def events(voyage: Voyage) -> list[Event]:
    """Everything the sensors tell, in the order of arrival."""
    s = voyage.scene
    rng = np.random.default_rng([s.seed, 42])
    step = 1.0 / s.imu_hz
    t = np.arange(0.0, s.duration_s, step)
    R, w, a = voyage.attitude(t), voyage.rates(t), voyage.body(t)[2]
    f = np.einsum("nji,nj->ni", R, a - [0.0, 0.0, GRAVITY])
    shake = np.sin(math.tau * np.outer(t, rng.uniform(18.0, 37.0, 3)) + rng.uniform(0.0, 6.0, 3))
    f = f + 0.12 * rng.standard_normal(3) + 0.2 * rng.standard_normal(f.shape) + s.vibration_m_s2 * shake
    w = w + 0.005 * rng.standard_normal(3) + 0.025 * rng.standard_normal(w.shape) + 0.03 * s.vibration_m_s2 * shake[:, ::-1]
    out: list[Event] = [Imu(stamp(x), wi, fi) for x, wi, fi in zip(t.tolist(), w, f, strict=True)]

    error = coloured(rng, t.size, step, math.radians(0.3), 1.0, 3)
    constant = np.radians([s.attitude_bias_deg, s.attitude_bias_deg, s.heading_bias_deg]) * rng.standard_normal(3)
    measured = Spin.from_matrix(R) * Spin.from_rotvec(error + constant)
    cov_att = np.eye(3) * math.radians(0.4) ** 2
    out += [Attitude(stamp(t[k]), Rotation(measured[k].as_matrix()), cov_att) for k in range(0, t.size, 2)]

    scale = float(rng.uniform(0.82, 1.0))
    every = slice(0, t.size, 4)
    tv, Rv = t[every], R[every]
    psi = np.arctan2(Rv[:, 1, 0], Rv[:, 0, 0])
    v = np.einsum("nij,nj->ni", Spin.from_euler("Z", -psi[:, None]).as_matrix(), voyage.body(tv)[1])
    v = scale * v + coloured(rng, tv.size, 4 * step, 0.03, 0.25, 3)
    v += (rng.random(tv.size) < 0.5 * s.outliers)[:, None] * rng.uniform(-3.0, 3.0, v.shape)
    cov_v = np.diag([0.03**2, 0.03**2, UNKNOWN_VAR])
    out += [BodyVelocity(stamp(x), np.array([vi[0], vi[1], 0.0]), cov_v) for x, vi in zip(tv.tolist(), v, strict=True)]

    tr = np.arange(0.0, s.duration_s, 1.0 / s.range_hz)
    (pr, *_), (pp, _, Rp), Rb = voyage.body(tr), voyage.pad(tr), voyage.attitude(tr)
    reach = np.einsum("ni,ni->n", Rp[:, :, 2], pp - pr) / np.einsum("ni,ni->n", Rp[:, :, 2], Rb[:, :, 2])
    foot = np.linalg.norm((pr + reach[:, None] * Rb[:, :, 2] - pp)[:, :2], axis=1)
    reach = reach + np.where(foot < 2.5, 0.0, 1.5) + 0.03 + 0.02 * rng.standard_normal(tr.size)
    reach += (rng.random(tr.size) < s.outliers) * rng.uniform(0.0, 3.0, tr.size)
    out += [Range(stamp(x), max(0.0, float(y)), 0.03) for x, y in zip(tr.tolist(), reach, strict=True)]

    axis = rng.standard_normal(3)
    mount = math.radians(s.mount_deg) * axis / float(np.linalg.norm(axis))
    away = [(b, b + float(rng.uniform(0.5, 1.5))) for b in rng.uniform(6.0, s.duration_s - 3.0, s.gaps).tolist()]
    away += list(s.blind)
    tilted = RotationSpline(t, measured)
    for seq, x in enumerate(np.arange(0.2, s.duration_s - 0.1, 1.0 / s.sighting_hz).tolist()):
        draw, wrong, late = rng.standard_normal(4), rng.random() < s.outliers, rng.standard_normal()
        elsewhere = rng.uniform(-3.0, 3.0, 4)
        if any(b <= x < e for b, e in away):
            continue
        out.append(_sighting(voyage, mount, x, seq, tilted(x), draw, elsewhere if wrong else None, 0.1 + 0.03 * abs(late)))
    return sorted(out, key=lambda e: (e.stamp.received_at, type(e).__name__))


def _sighting(
    voyage: Voyage, mount: F64, x: float, seq: int, measured: Spin, draw: F64, elsewhere: F64 | None, late_s: float
) -> Sighting:
    at = np.array([x + voyage.scene.hidden_delay_s])
    (p, *_), (pp, _, Rp), R = voyage.body(at), voyage.pad(at), Spin.from_matrix(voyage.attitude(at)[0])
    camera = R * Spin.from_rotvec(mount)
    _, pitch, roll = measured.as_euler("ZYX")
    level = Spin.from_euler("ZYX", [0.0, pitch, roll])
    d = camera.inv().apply((pp - p)[0])
    sigma = 0.001 + float(np.linalg.norm(d)) * np.array([0.002, 0.002, 0.005])
    d = level.apply(d + sigma * draw[:3])
    yaw = -(level * camera.inv() * Spin.from_matrix(Rp[0])).as_euler("ZYX")[0] + math.radians(1.0) * draw[3]
    if elsewhere is not None:
        d = d + elsewhere[:3] * [1.0, 1.0, 0.3]
        yaw += elsewhere[3]
    lever = np.array([[0.0, d[2], 0.0], [-d[2], 0.0, 0.0], [d[1], -d[0], 0.0]])
    L = level.as_matrix()
    cov = np.zeros((4, 4))
    cov[:3, :3] = L @ np.diag(sigma**2) @ L.T + math.radians(0.4) ** 2 * lever @ lever.T
    cov[3, 3] = min(UNKNOWN_YAW_VAR, math.radians(1.1) ** 2)
    cov = 0.5 * (cov + cov.T)
    return Sighting(stamp(x, x + late_s), seq, "registration", d, math.remainder(yaw, math.tau), False, cov, 1.0)


def without_errors(scene: VoyageScene) -> VoyageScene:
    """Return the same sea and path seen by sensors that only have white noise."""
    return replace(scene, **IDEAL)
