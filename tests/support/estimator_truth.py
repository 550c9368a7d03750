"""A flight over a ship with everything known: truth at any instant, and what imperfect sensors would tell of it.

The vessel is sitl's; the body follows a smooth path, its attitude is the one that thrust along its down axis needs. Sensors err
by white noise, constant biases and first-order wandering, all from one seed.
"""

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from estimator import ekf
from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Pose6, Sighting
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, Baro, BodyVelocity, Imu, Range
from estimator.contracts.time import MonoNs, Stamp
from sitl.sea.sea import SEA_STATES, Waves
from sitl.vessel.seakeeping import HULLS
from sitl.vessel.vessel import Vessel
from tests.make import tuned

G = 9.80665
EPOCH_NS = 5_000_000_000


@dataclass(frozen=True)
class Setting:
    """The parameters of a flight. Angles are in degrees because a person writes them."""

    seed: int = 0
    sea: int = 4
    duration_s: float = 60.0
    vessel_speed_m_s: float | None = None
    """None draws one of 0..1.5."""
    imu_hz: float = 200.0
    accel_bias: float = 0.15
    sighting_hz: float = 30.0
    sigma_lateral_per_m: float = 0.002
    sigma_range_per_m: float = 0.005
    sigma_yaw_deg: float = 1.0
    sigma_tilt_deg: float = 1.0
    pose6: bool = False
    delay_s: float = 0.12
    hidden_delay_s: float = 0.0
    """Sightings show the world this much later than their stamps say."""
    mount_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lens_off_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Place of the lens in the body less the one that sightings are made with."""
    outliers: float = 0.0
    """Share of sightings that show something else."""
    blind: tuple[tuple[float, float], ...] = ()
    """(from, to) s without sightings."""
    attitude_hz: float = 50.0
    attitude_bias_deg: float = 0.2
    attitude_wander_deg: float = 0.3
    velocity_hz: float = 50.0
    velocity_scale: float = 0.83
    velocity_over: str = "ground"
    """Or "pad": the sensor sees the moving deck."""
    range_hz: float = 0.0
    baro_hz: float = 0.0
    lively: float = 1.0
    """Size of the body's wandering about its path."""
    legs: tuple[tuple[float, float, float, float], ...] = field(
        default=(
            (0.0, 2.5, 1.5, 5.0),
            (5.0, 2.5, 1.5, 5.0),
            (12.0, 0.3, -0.2, 2.0),
            (36.0, 0.2, 0.2, 2.0),
            (42.0, -0.6, 0.6, 4.0),
            (46.0, -0.6, 0.6, 4.0),
            (52.0, 0.1, 0.0, 2.0),
        )
    )
    """(s, north, east, up) m from the pad's mean place; reached smoothly."""


class TruthFlight:
    """Truth as functions of time, s since the start."""

    def __init__(self, s: Setting) -> None:
        self.s = s
        rng = np.random.default_rng([s.seed, 1])
        towards, heading = rng.uniform(-math.pi, math.pi, 2)
        waves = Waves.draw(SEA_STATES[s.sea], s.seed, towards_rad=towards)
        speed = float(rng.uniform(0.0, 1.5)) if s.vessel_speed_m_s is None else s.vessel_speed_m_s
        self.vessel = Vessel(HULLS["ferry"], waves, heading_rad=heading, speed_m_s=speed)
        self.u = speed * np.array([math.cos(heading), math.sin(heading), 0.0])
        rest = Vessel(HULLS["ferry"], Waves.draw(SEA_STATES[0], 1), heading_rad=heading).pad(0.0)
        self.p0 = rest.p_ned[0]
        self._w = math.tau * rng.uniform(0.15, 0.6, (3, 3))
        self._a = s.lively * rng.uniform(0.3, 1.0, (3, 3)) * 0.35 / self._w * np.array([[1.0], [1.0], [0.5]])
        self._phase = rng.uniform(0.0, math.tau, (3, 3))
        self._yaw = (
            rng.uniform(-math.pi, math.pi),
            rng.uniform(0.3, 0.9),
            math.tau / rng.uniform(15.0, 30.0),
            rng.uniform(0.0, 6.0),
        )

    def pad(self, t: F64) -> tuple[F64, F64, F64]:
        """(n, 3) p and v in ned, (n, 3, 3) R_ned_pad."""
        m = self.vessel.pad(t)
        return m.p_ned[0], m.v_ned[0], m.R_ned[0]

    def body(self, t: F64) -> tuple[F64, F64, F64]:
        """(n, 3) p, v, a in ned."""
        legs = np.array(self.s.legs)
        p = np.broadcast_to(legs[0, 1:], (t.size, 3)).copy()
        v, a = np.zeros((t.size, 3)), np.zeros((t.size, 3))
        for one, two in pairwise(legs):
            span = two[0] - one[0]
            x = np.clip((t - one[0]) / span, 0.0, 1.0)[:, None]
            d = two[1:] - one[1:]
            p += d * (x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3))
            v += d * (140 * x**3 * (1 - x) ** 3) / span
            a += d * (420 * x**2 * (1 - x) ** 2 * (1 - 2 * x)) / span**2
        p[:, 2], v[:, 2], a[:, 2] = -p[:, 2], -v[:, 2], -a[:, 2]
        angle = self._w * t[:, None, None] + self._phase
        p += (self._a * np.sin(angle)).sum(axis=2)
        v += (self._a * self._w * np.cos(angle)).sum(axis=2)
        a -= (self._a * self._w**2 * np.sin(angle)).sum(axis=2)
        return p + self.p0 + self.u * t[:, None], v + self.u, a

    def attitude(self, t: F64) -> F64:
        """(n, 3, 3) R_ned_body: the down axis against the specific force, save for a little drag."""
        _, v, a = self.body(t)
        f = a - np.array([0.0, 0.0, G]) + 0.15 * (v - self.u)
        down = -f / np.linalg.norm(f, axis=1, keepdims=True)
        first, size, rate, phase = self._yaw
        yaw = first + size * np.sin(rate * t + phase)
        ahead = np.stack([np.cos(yaw), np.sin(yaw), np.zeros(t.size)], axis=1)
        right = np.cross(down, ahead)
        right /= np.linalg.norm(right, axis=1, keepdims=True)
        return np.stack([np.cross(right, down), right, down], axis=2)

    def rates(self, t: F64) -> F64:
        """(n, 3) rad/s in body."""
        h = 1e-4
        before, after = self.attitude(t - h), self.attitude(t + h)
        turn = np.einsum("nji,njk->nik", before, after)
        return np.stack([turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1) / (
            4 * h
        )

    def relative(self, t: F64) -> tuple[F64, F64, F64]:
        """(n, 3) d_body_pad_level, (n, 3) v_pad_level, (n,) yaw of the body against the arrow."""
        p, v, _ = self.body(t)
        pp, vp, Rp = self.pad(t)
        R = self.attitude(t)
        psi = np.arctan2(R[:, 1, 0], R[:, 0, 0])
        c, s, o, i = np.cos(psi), np.sin(psi), np.zeros(t.size), np.ones(t.size)
        Z = np.stack([np.stack([c, s, o], -1), np.stack([-s, c, o], -1), np.stack([o, o, i], -1)], axis=1)
        arrow = np.arctan2(Rp[:, 1, 0], Rp[:, 0, 0])
        yaw = np.remainder(psi - arrow + math.pi, math.tau) - math.pi
        return np.einsum("nij,nj->ni", Z, pp - p), np.einsum("nij,nj->ni", Z, vp - v), yaw


def stamp(measured_at_s: float, received_at_s: float | None = None, sigma_s: float = 0.0) -> Stamp:
    measured_at = EPOCH_NS + round(measured_at_s * 1e9)
    received_at = measured_at if received_at_s is None else EPOCH_NS + round(received_at_s * 1e9)
    return Stamp(MonoNs(measured_at), MonoNs(max(measured_at, received_at)), sigma_s, "sim")


def ns(t_s: float) -> MonoNs:
    return MonoNs(EPOCH_NS + round(t_s * 1e9))


def wander(rng: np.random.Generator, n: int, dt: float, sigma: float, tau: float, width: int) -> F64:
    """(n, width) first-order Gauss-Markov in its steady state."""
    keep = math.exp(-dt / tau)
    fresh = rng.standard_normal((n, width)) * sigma * math.sqrt(1.0 - keep**2)
    out = np.empty((n, width))
    out[0] = sigma * rng.standard_normal(width)
    for k in range(1, n):
        out[k] = keep * out[k - 1] + fresh[k]
    return out


Event = Imu | Attitude | BodyVelocity | Range | Baro | Sighting


def events(flight: TruthFlight) -> list[Event]:
    """Everything the sensors tell, in the order in which it is received."""
    s = flight.s
    rng = np.random.default_rng([s.seed, 2])
    out: list[Event] = []

    t = np.arange(0.0, s.duration_s, 1.0 / s.imu_hz)
    R, w = flight.attitude(t), flight.rates(t)
    a = flight.body(t)[2]
    f = np.einsum("nji,nj->ni", R, a - np.array([0.0, 0.0, G]))
    w = w + 0.005 * rng.standard_normal(3) + 0.0025 * math.sqrt(s.imu_hz) * rng.standard_normal(w.shape)
    f = f + s.accel_bias * rng.standard_normal(3) + 0.02 * math.sqrt(s.imu_hz) * rng.standard_normal(f.shape)
    out += [Imu(stamp(x), wi, fi) for x, wi, fi in zip(t.tolist(), w, f, strict=True)]

    # The vehicle's own attitude: told at its rate, and what vision levels with at any exposure.
    error = wander(rng, t.size, 1.0 / s.imu_hz, math.radians(s.attitude_wander_deg), 1.0, 3)
    error[:, :2] += math.radians(s.attitude_bias_deg) * rng.standard_normal(2)
    error[:, 2] += math.radians(2.0) * rng.standard_normal()
    sigma_att = math.radians(math.hypot(s.attitude_wander_deg, 0.0))
    cov_att = np.eye(3) * sigma_att**2

    def measured(x: float) -> F64:
        e = np.array([np.interp(x, t, error[:, k]) for k in range(3)])
        return np.asarray(flight.attitude(np.array([x]))[0] @ Rotation.from_rotvec(e).matrix)

    every = max(1, round(s.imu_hz / s.attitude_hz))
    out += [
        Attitude(stamp(t[k]), Rotation(R[k] @ Rotation.from_rotvec(error[k]).matrix), cov_att) for k in range(0, t.size, every)
    ]

    if s.velocity_hz > 0:
        tv = np.arange(0.0, s.duration_s, 1.0 / s.velocity_hz)
        noise = wander(rng, tv.size, 1.0 / s.velocity_hz, 0.02, 0.25, 2)
        Rv, vv = flight.attitude(tv), flight.body(tv)[1]
        if s.velocity_over == "pad":
            vv = vv - flight.pad(tv)[1]
        psi = np.arctan2(Rv[:, 1, 0], Rv[:, 0, 0])
        fwd = np.cos(psi) * vv[:, 0] + np.sin(psi) * vv[:, 1]
        rgt = np.cos(psi) * vv[:, 1] - np.sin(psi) * vv[:, 0]
        cov_v = np.diag([0.02**2, 0.02**2, UNKNOWN_VAR])
        for k in range(tv.size):
            measured_v = s.velocity_scale * np.array([fwd[k], rgt[k], 0.0])
            measured_v[:2] += noise[k]
            out.append(BodyVelocity(stamp(tv[k]), measured_v, cov_v))
    if s.range_hz > 0:
        tr = np.arange(0.0, s.duration_s, 1.0 / s.range_hz)
        p, pp, Rp, Rb = flight.body(tr)[0], flight.pad(tr)[0], flight.pad(tr)[2], flight.attitude(tr)
        n, c = Rp[:, :, 2], Rb[:, :, 2]
        r = np.einsum("ni,ni->n", n, pp - p) / np.einsum("ni,ni->n", n, c) + 0.02 * rng.standard_normal(tr.size)
        out += [Range(stamp(x), max(0.0, float(y)), 0.02) for x, y in zip(tr.tolist(), r, strict=True)]
    if s.baro_hz > 0:
        tb = np.arange(0.0, s.duration_s, 1.0 / s.baro_hz)
        h = 37.0 - flight.body(tb)[0][:, 2] + 0.3 * rng.standard_normal(tb.size)
        out += [Baro(stamp(x), float(y), 0.3) for x, y in zip(tb.tolist(), h, strict=True)]

    mount = Rotation.from_rotvec(np.radians(s.mount_deg)).matrix
    seq = 0
    for measured_at in np.arange(0.3, s.duration_s - s.hidden_delay_s, 1.0 / s.sighting_hz).tolist():
        seq += 1
        if any(a0 <= measured_at <= b0 for a0, b0 in s.blind):
            continue
        at = np.array([measured_at + s.hidden_delay_s])
        Rb, pb = flight.attitude(at)[0], flight.body(at)[0][0]
        pp, _, Rp = (x[0] for x in flight.pad(at))
        d_measured = mount.T @ Rb.T @ (pp - pb) - s.lens_off_m
        level = Rotation(measured(measured_at)).without_heading().matrix
        size = float(np.linalg.norm(d_measured))
        sigma = size * np.array([s.sigma_lateral_per_m, s.sigma_lateral_per_m, s.sigma_range_per_m]) + 0.001
        d = level @ (d_measured + sigma * rng.standard_normal(3))
        seen = level @ mount.T @ Rb.T @ Rp
        e_rot = np.radians([s.sigma_tilt_deg, s.sigma_tilt_deg, s.sigma_yaw_deg]) * rng.standard_normal(3)
        seen = Rotation.from_rotvec(e_rot).matrix @ seen
        lever = -np.array([[0, -d[2], d[1]], [d[2], 0, -d[0]], [-d[1], d[0], 0]]) @ np.diag([1.0, 1.0, 0.0])
        cov3 = level @ np.diag(sigma**2) @ level.T + sigma_att**2 * lever @ lever.T
        wrong = rng.random() < s.outliers
        if wrong:
            d = d + rng.uniform(-3.0, 3.0, 3) * np.array([1.0, 1.0, 0.5])
        yaw = wrap_pi(-math.atan2(seen[1, 0], seen[0, 0]))
        cov = np.zeros((4, 4))
        cov[:3, :3] = 0.5 * (cov3 + cov3.T)
        cov[3, 3] = min(UNKNOWN_YAW_VAR, math.radians(s.sigma_yaw_deg) ** 2 + (0.05 * math.radians(s.sigma_tilt_deg)) ** 2)
        pose = None
        if s.pose6:
            cov6 = np.zeros((6, 6))
            both = np.vstack([lever, np.diag([1.0, 1.0, 0.0])])
            cov6[:3, :3] = level @ np.diag(sigma**2) @ level.T
            cov6[3:, 3:] = np.diag(np.radians([s.sigma_tilt_deg, s.sigma_tilt_deg, s.sigma_yaw_deg]) ** 2)
            cov6 += sigma_att**2 * both @ both.T
            pose = Pose6(d, Rotation(seen), 0.5 * (cov6 + cov6.T))
        received_at = measured_at + max(0.03, s.delay_s + 0.04 * rng.standard_normal())
        out.append(Sighting(stamp(measured_at, received_at), seq, "registration", d, yaw, False, cov, 1.0, pose))
    rank: dict[type, int] = {Imu: 0, Attitude: 1, BodyVelocity: 2, Range: 3, Baro: 4, Sighting: 5}
    return sorted(out, key=lambda e: (e.stamp.received_at, rank[type(e)]))


LEGS = (
    (0.0, 2.5, 1.5, 5.0), (3.0, 2.5, 1.5, 5.0), (9.0, 0.3, -0.2, 2.0), (26.0, 0.2, 0.2, 2.0), (31.0, -0.6, 0.6, 4.0),
    (36.0, 0.1, 0.0, 2.0),
)  # fmt: skip
OPTIONS = tuned(
    ekf.EkfOptions,
    asd_gyro_rad_s=0.0025,
    asd_accel_m_s2=0.02,
    sigma_accel_bias_m_s2=0.15,
    sigma_accel_bias_down_m_s2=0.15,
    sigma_gyro_bias_rad_s=0.005,
    sigma_attitude_bias_rad=math.radians(0.2),
    asd_attitude_bias_rad_s=2e-4,
    sigma_mount_rad=math.radians(0.4),
)
"""The filter is told what a data sheet would tell of these sensors, and nothing of the errors drawn."""


def setting(seed: int) -> Setting:
    rng = np.random.default_rng([seed, 7])
    mount = 0.4 * rng.standard_normal(3)
    return Setting(
        seed=seed,
        sea=(0, 2, 4)[seed % 3],
        duration_s=40.0,
        imu_hz=100.0,
        attitude_hz=50.0,
        velocity_hz=25.0,
        sighting_hz=(10.0, 30.0)[seed // 3 % 2],
        legs=LEGS,
        hidden_delay_s=float(rng.uniform(-0.02, 0.02)),
        mount_deg=(float(mount[0]), float(mount[1]), float(mount[2])),
        velocity_scale=float(rng.uniform(0.8, 1.1)),
        velocity_over=("ground", "pad")[seed // 6 % 2],
        pose6=seed // 12 % 2 == 0,
        outliers=0.02,
    )
