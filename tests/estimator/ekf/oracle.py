"""A second implementation of the filter, in numpy, against which the core is held (docs/estimator.md derives it).

`process` returns the state after one event and the event's outcome; `answer` and `forecast` say what a state means at an instant.
The functions between them change the state `b` that they are given: `process` gives them a copy. They replace arrays and never
write into them. Constants have the core's values, and its comments give the reasons. Oscillators come from the matrix exponential
and Lyapunov's equation, where the core has closed forms.
"""

import math
from functools import lru_cache
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation as Turn

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.geometry import F64, orthonormalised, rpy_matrix, skew, wrap_pi
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range, VesselMotion, VesselReport
from estimator.ekf import Event
from estimator.ekf.options import EkfOptions
from estimator.ekf.params import (
    ACCEL_BIAS,
    ATT_BIAS,
    ATT_ERR,
    BARO_OFFSET,
    CAMERA_DELAY,
    CAMERA_LEVER,
    CAMERA_MOUNT,
    CARRIED,
    DECK_DISP,
    DECK_RATE,
    DECK_TRIM,
    GYRO_BIAS,
    LOG_PRIOR,
    NIS_MAX,
    NOT_MEASURED_VAR,
    PAD_YAW,
    POS_DOWN,
    POS_HORIZONTAL,
    POS_REL,
    RANGE_OFFSET,
    REST_ODDS,
    SIGMA,
    TURN_RATE,
    VEL,
    VEL_AXES,
    VEL_DOWN,
    VEL_SCALE,
    VESSEL_VEL,
    WAVE_YAW,
    WAVES,
    YAW_RATE,
    ZETA,
    FilterParams,
    N,
    W,
)
from tests.estimator.ekf.core_state import State, heading

ATTITUDE, VELOCITY, RANGE, HEIGHT = range(4)
"""Kinds of aiding that are averaged before they are fused."""
HORIZONS_S = np.array([1.0, 2.0, 3.0])
"""Horizons at which past forecasts are compared with what happened."""
I3, I_N = np.eye(3), np.eye(N)
_DOWN = np.array([0.0, 0.0, 1.0])
_G_NED = G_M_S2 * _DOWN
_QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])
"""A horizontal vector v that turns at w rad/s, clockwise from above, has the rate w QUARTER v."""
_POS = np.arange(N)[POS_REL]
_ANGLES = [DECK_DISP[3], DECK_DISP[4], PAD_YAW]
_UNIFORM_VAR = math.pi**2 / 3.0
_BY_V_PAD = np.zeros((3, N))
"""Jacobian of the velocity of the pad's centre."""
_BY_V_PAD[[0, 1, 2], DECK_RATE[:3]] = 1.0
_BY_V_PAD[:2, VESSEL_VEL] = np.eye(2)


class Outcome(NamedTuple):
    """The result of an event; the members that a comparison gives are None where nothing was compared."""

    verdict: Verdict
    innov: F64 | None = None
    S: F64 | None = None
    nis: float = math.nan
    nis_max: float = math.nan
    axes: tuple[int, ...] = ()


class Rows(NamedTuple):
    """A linearised measurement of m numbers: innovation, Jacobian (m, N), noise; the Jacobian (3, N) of a sighting's rate."""

    innov: F64
    H: F64
    R: F64
    by_rate: F64 = np.zeros((0, N))


class Fix(NamedTuple):
    """A Kalman correction: of the state, the covariance after it, the innovation's covariance and NIS."""

    dx: F64
    P: F64
    S: F64
    nis: float


# Algebra, rotations, oscillators


def nis_of(innov: F64, S: F64) -> float | None:
    """Return the normalised innovation squared; None if S is not positive definite or the value is not finite."""
    try:
        y = np.linalg.solve(np.linalg.cholesky(S), innov)
    except np.linalg.LinAlgError:
        return None
    with np.errstate(over="ignore"):
        nis = float(y @ y)
    return nis if math.isfinite(nis) else None


def correction(P: F64, z: Rows) -> Fix | None:
    """Return the Kalman correction in Joseph's form; None if S is not positive definite."""
    S = z.H @ P @ z.H.T + z.R
    scale = 1.0 / np.sqrt(np.diagonal(S))
    nis = nis_of(z.innov * scale, S * scale * scale[:, None])
    if nis is None:
        return None
    K = np.linalg.solve(S * scale * scale[:, None], (P @ z.H.T).T * scale[:, None]).T * scale
    rest = I_N - K @ z.H
    return Fix(K @ z.innov, rest @ P @ rest.T + K @ z.R @ K.T, S, nis)


def exp(v: F64) -> F64:
    """Return the rotation (3, 3) by a rotation vector (3,), rad."""
    return np.asarray(Turn.from_rotvec(np.array(v)).as_matrix())


def log(R: F64) -> F64:
    """Return the rotation vector (3,), rad, of a rotation."""
    return np.asarray(Turn.from_matrix(np.array(R)).as_rotvec())


def left_jacobian(v: F64) -> F64:
    """Return the left Jacobian (3, 3) of SO(3) (Sola, Deravat, Atchuthan, 2018, eq. 145)."""
    angle, k = math.hypot(*v), skew(v)
    if angle < 1e-3:
        return np.asarray(I3 + 0.5 * k + k @ k / 6.0)
    return np.asarray(I3 + (1.0 - math.cos(angle)) / angle**2 * k + (angle - math.sin(angle)) / angle**3 * (k @ k))


def about_down(angle_rad: float) -> F64:
    """Return the rotation (3, 3) by an angle about the down axis."""
    return rpy_matrix(0.0, 0.0, angle_rad)


def heading_row(R: F64) -> F64:
    """Return the derivative (3,) of the heading by a small rotation in R's outer frame."""
    flat = max(R[0, 0] ** 2 + R[1, 0] ** 2, 1e-12)
    return np.array([-R[2, 0] * R[0, 0] / flat, -R[2, 0] * R[1, 0] / flat, 1.0])


def exponential(M: F64) -> F64:
    """Return the matrix exponentials of matrices (..., n, n), by scaling and squaring of the series."""
    halvings = max(0, math.ceil(math.log2(float(np.abs(M).max()) + 1e-9)) + 4)
    term = made = np.broadcast_to(np.eye(M.shape[-1]), M.shape)
    for k in range(1, 14):
        term = term @ M / (k * 2.0**halvings)
        made = made + term
    for _ in range(halvings):
        made = made @ made
    return made


def oscillators(w: F64, zeta: F64) -> tuple[F64, F64]:
    """Return the generators of [x, x', f, f'] (estimator.ekf.params) and the stationary covariances for sigma = 1, (G, 4, 4)."""
    J, eye = np.zeros((w.size, 4, 4)), np.eye(4)
    J[:, [0, 1, 2], [1, 3, 3]] = 1.0
    J[:, [1, 3], [0, 2]], J[:, [1, 3], [1, 3]] = -(w**2)[:, None], -(2.0 * zeta * w)[:, None]
    # Lyapunov's equation with white noise on f', row by row of the covariance.
    lyapunov = np.einsum("gij,kl->gikjl", J, eye) + np.einsum("ij,gkl->gikjl", eye, J)
    P = np.linalg.solve(lyapunov.reshape(-1, 16, 16), np.full((w.size, 16, 1), -np.eye(16)[:, [15]])).reshape(-1, 4, 4)
    return J, P / P[:, :1, :1]


def transition(w: F64, zeta: F64, dt_s: float) -> tuple[F64, F64]:
    """Return the transitions over a time and the covariances of their noise for sigma = 1, both (G, 4, 4)."""
    J, P = oscillators(w, zeta)
    A = exponential(J * dt_s)
    return A, P - A @ P @ A.transpose(0, 2, 1)


@lru_cache(maxsize=64)
def _members(dt_s: float) -> tuple[F64, F64]:
    """Return the transition and the noise of the bank's members."""
    return transition(W, ZETA, dt_s)


def waves_unknown(b: State, size: F64 | None = None) -> list[F64]:
    """Return the covariances (4, 4) of the five oscillators while only their sizes are known."""
    return list(((b.wave_sigma if size is None else size) ** 2)[:, None, None] * oscillators(b.wave_w, b.wave_zeta)[1])


def without(P: F64, states: Any, var: float) -> F64:
    """Return a covariance in which some states are uncorrelated with all others and have a variance."""
    P, states = P.copy(), np.arange(N)[states]
    P[states, :] = P[:, states] = 0.0
    P[states, states] = var
    return P


# Events


def process(b: State | None, event: Event, params: FilterParams) -> tuple[State | None, Outcome]:
    """Return the state after one event, which must not be older than the state, and the event's outcome."""
    if b is None:
        return _begin(event, params)
    b, t = b.copy(), int(event.stamp.measured_at)
    match event:
        case Imu():
            return b, _imu(b, event, params)
        case VesselReport():
            ready_to_fuse(b, t, params)
            return b, _vessel(b, event, params)
        case VesselMotion():
            ready_to_fuse(b, t, params)
            return b, _motion(b, event, params)
        case Sighting():
            if event.confidence < params.options.min_confidence:
                return b, Outcome(Verdict.LOW_CONFIDENCE)
            ready_to_fuse(b, t, params)
            _forget_the_pad(b, params.options)
            return b, _sighting(b, event, params)
    propagate(b, t, params)
    if isinstance(event, Attitude):
        return b, _attitude(b, event, params)
    return b, {BodyVelocity: _velocity, Range: _range, Baro: _height}[type(event)](b, event, params)


def _begin(event: Event, params: FilterParams) -> tuple[State | None, Outcome]:
    o, t = params.options, int(event.stamp.measured_at)
    f = event.f_body if isinstance(event, Imu) else np.zeros(3)
    if isinstance(event, Attitude):
        R, tilt, north = event.R_ned_body.matrix, o.sigma_initial_tilt_rad, o.sigma_initial_heading_rad
    elif abs(np.linalg.norm(f) - G_M_S2) < 0.5 * G_M_S2:
        R = rpy_matrix(math.atan2(-f[1], -f[2]), math.atan2(f[0], math.hypot(f[1], f[2])), 0.0)
        tilt, north = math.radians(12.0), math.radians(2.0)
    else:
        return None, Outcome(Verdict.NO_ATTITUDE)
    bank = bank_unknown()
    x, zero = np.zeros(N), np.zeros(3)
    x[VEL_SCALE] = o.velocity_scale
    b = State(
        t=t, t_cov=t, t_imu=-1, t_velocity=-1, sighted=-1, agreed=0, is_levelled=0, heading_is_given=0, heading_known=0,
        heading_seen=-1, steered=-1, swung=-1, pictured=-1, baselined=-1, reported=-1, turn_since=-1, turn_last=-1,
        turn_heading=-1, turn_left_out=-1, turn_deviate=0.0, R=R, x=x, R_cov=R, dv=zero, dp=zero,
        turned=np.zeros((3, 3)), coast_s=0.0, w=zero,
        w_smooth=zero, f=zero, levelled_by=np.zeros((3, 3)), cov_levelled_by=np.zeros((3, 3)), ins_p=zero, ins_v=zero,
        ins_var_m2_s2=0.0, jolt_var_m2_s2=0.0, jolt_var_rad2=0.0, over_pad=0.0, wave_w=bank.w_rad_s, wave_zeta=bank.zeta,
        wave_sigma=bank.sigma, nis_mean=1.0, nis_claimed=1.0, heading_held_s=0.0, vessel_before=np.zeros(2),
        rejections=no_streak(), excesses=[], bank=bank,
        aids=[SimpleNamespace(fused=-1, refused=-1, first=np.zeros(3), gathered=None) for _ in range(4)],
    )  # fmt: skip
    b.P = np.diag(params.initial_var)
    b.P[WAVES[0, 0] : WAVES[-1, -1] + 1, WAVES[0, 0] : WAVES[-1, -1] + 1] = block_diag(*waves_unknown(b))
    b.P[ATT_ERR, ATT_ERR] = _tilt_var(R, tilt, north)
    if isinstance(event, Attitude):
        _level_by(b, event, o)
    else:
        b.t_imu, b.w, b.w_smooth, b.f = t, event.w_body, event.w_body, f
    return b, Outcome(Verdict.FUSED)


def _tilt_var(R: F64, sigma_tilt_rad: float, sigma_heading_rad: float) -> F64:
    along = np.outer(R[2], R[2])
    return np.asarray(sigma_tilt_rad**2 * (I3 - along) + sigma_heading_rad**2 * along)


def _level_by(b: State, event: Attitude, o: EkfOptions) -> None:
    var, axes = o.sigma_attitude_bias_rad**2, [0, 1]
    P = without(b.P, ATT_BIAS, var)
    P[axes, axes] += var
    P[axes, ATT_BIAS] = P[ATT_BIAS, axes] = -var
    b.P, b.levelled_by, b.cov_levelled_by = P, event.R_ned_body.matrix, event.cov_body
    b.is_levelled = b.heading_is_given = 1


def _imu(b: State, event: Imu, params: FilterParams) -> Outcome:
    o, t, (w, f) = params.options, int(event.stamp.measured_at), (event.w_body, event.f_body)
    if event.gyro_lost_s > 0.0:
        w = w + b.x[GYRO_BIAS]
        b.jolt_var_rad2 += (1.0 if event.gyro_lost_s > o.hold_s else 0.02) * params.psd_coast_turn * event.gyro_lost_s
    if event.accel_lost_s > 0.0:
        f = b.x[ACCEL_BIAS] - _G_NED / max(b.R[2, 2], 0.7)
        b.jolt_var_m2_s2 += (1.0 if event.accel_lost_s > o.hold_s else 0.03) * params.psd_coast * event.accel_lost_s
    smooth = w
    if _imu_holds(b, t, o):
        dt = (t - b.t) * 1e-9
        f, jolt = _limited(f, b.f, o.accel_step_m_s2, dt)
        b.jolt_var_m2_s2 += jolt
        w, jolt = _limited(w, b.w, o.gyro_step_rad_s, dt)
        b.jolt_var_rad2 += jolt
        smooth = b.w_smooth - math.expm1(-(t - b.t_imu) * 1e-9 / 0.03) * (w - b.w_smooth)
        _propagate_state(b, t, 0.5 * (b.w + w), 0.5 * (b.f + f), o)
    else:
        propagate(b, t, params)
    b.t_imu, b.w, b.w_smooth, b.f = t, w, smooth, f
    _propagate_covariance_each_tick(b, params)
    _forget_the_pad(b, o)
    return Outcome(Verdict.FUSED)


def _limited(sample: F64, before: F64, step_max: float, dt: float) -> tuple[F64, float]:
    """Return a sample whose change is cut to what the vehicle can do, and the variance that the part cut off adds."""
    step = float(np.abs(sample - before).max())
    if step <= step_max:
        return sample, 0.0
    return before + step_max / step * (sample - before), (step * dt) ** 2


def _forget_the_pad(b: State, o: EkfOptions) -> None:
    if (b.t - b.sighted) * 1e-9 > o.forget_s:
        b.sighted, b.agreed, b.rejections = -1, 0, no_streak()


def _attitude(b: State, event: Attitude, params: FilterParams) -> Outcome:
    o, R = params.options, event.R_ned_body.matrix
    if b.heading_is_given and b.P.diagonal()[ATT_ERR].max() <= 0.35**2:
        roll, pitch, yaw = log(b.R.T @ R)
        innov = np.array([roll - b.x[ATT_BIAS[0]], pitch - b.x[ATT_BIAS[1]], yaw])
        outcome = _gather(b, ATTITUDE, innov, event.cov_body, params)
        b.levelled_by, b.cov_levelled_by, b.is_levelled, b.heading_is_given = R, event.cov_body, 1, 1
        return outcome
    propagate_covariance(b, params)
    if not b.heading_is_given:
        angle = heading(R) - heading(b.R)
        Z, turn = about_down(angle), I_N.copy()
        for vector in (_POS, np.arange(N)[VEL], *WAVES[:3].T):
            turn[np.ix_(vector, vector)] = Z
        turn[VESSEL_VEL, VESSEL_VEL] = Z[:2, :2]
        b.x, b.P, b.ins_p, b.ins_v = turn @ b.x, turn @ b.P @ turn.T, Z @ b.ins_p, Z @ b.ins_v
        b.x[PAD_YAW] = wrap_pi(b.x[PAD_YAW] + angle)
    b.P = without(b.P, ATT_ERR, 0.0)
    b.P[ATT_ERR, ATT_ERR] = _tilt_var(R, o.sigma_initial_tilt_rad, o.sigma_initial_heading_rad)
    b.R = b.R_cov = R
    _level_by(b, event, o)
    return Outcome(Verdict.FUSED)


# Propagation


def _imu_holds(b: State, t: int, o: EkfOptions) -> bool:
    return bool(b.t_imu >= 0 and t - b.t_imu <= round(o.hold_s * 1e9))


def propagate(b: State, t: int, params: FilterParams) -> None:
    """Propagate to instant `t`, ns, by the IMU sample while it holds, and the covariance as often as the options ask."""
    until = b.t_imu + round(params.options.hold_s * 1e9)
    if b.t_imu >= 0 and b.t < until < t:
        _propagate_state(b, until, b.w, b.f, params.options)
    _propagate_state(b, t, b.w, b.f, params.options)
    _propagate_covariance_each_tick(b, params)


def _propagate_state(b: State, t: int, w_body: F64, f_body: F64, o: EkfOptions) -> None:
    dt = (t - b.t) * 1e-9
    if dt <= 0.0:
        return
    if not _imu_holds(b, t, o):
        step, dv, b.coast_s = b.R * dt, -_G_NED * dt, b.coast_s + dt
    else:
        turn = exp((w_body - b.x[GYRO_BIAS]) * dt)
        step = (b.R + b.R @ turn) * (0.5 * dt)
        dv = step @ (f_body - b.x[ACCEL_BIAS])
        b.R, b.levelled_by = b.R @ turn, b.levelled_by @ turn
    b.t, b.turned, b.dp, b.dv = t, b.turned + step, b.dp + b.dv * dt + 0.5 * dt * dv, b.dv + dv


def _propagate_covariance_each_tick(b: State, params: FilterParams) -> None:
    if (b.t - b.t_cov) * 1e-9 >= params.options.tick_s:
        propagate_covariance(b, params)


def propagate_covariance(b: State, params: FilterParams) -> None:
    """Bring `x` and `P` from `t_cov` to `t`."""
    if b.t > b.t_cov:
        F, Q = move(b, params)
        b.P = F @ b.P @ F.T + Q


def _turned(rate_rad_s: float, T: float) -> tuple[F64, F64]:
    """Return the rotation (2, 2) by a steady rate over T s, and its integral over time."""
    angle = rate_rad_s * T
    along, across = T * (1.0 - angle * angle / 6.0), 0.5 * T * angle
    if abs(angle) > 1e-3:
        along, across = math.sin(angle) / rate_rad_s, (1.0 - math.cos(angle)) / rate_rad_s
    return about_down(angle)[:2, :2], np.array([[along, -across], [across, along]])


def move(b: State, params: FilterParams) -> tuple[F64, F64]:
    """Propagate everything but `P` from `t_cov` to `t`; return the (N, N) F and Q that propagate `P`."""
    o, T = params.options, (b.t - b.t_cov) * 1e-9
    A, q_waves = transition(b.wave_w, b.wave_zeta, T)
    # A sea has short waves too: white acceleration of a part of the energy.
    short = (4.0 * 0.002 * b.wave_zeta * b.wave_w**3)[:, None, None] * np.array([[T**3 / 3, T**2 / 2], [T**2 / 2, T]])
    q_waves[:, :2, :2] += short
    q_waves *= (b.wave_sigma**2)[:, None, None]
    w_yaw, yaw = math.tau / o.wave_yaw_period_s, [WAVE_YAW, YAW_RATE]
    A_yaw = exponential(np.array([[0.0, 1.0], [-(w_yaw**2), -w_yaw]]) * T)
    at_rest = np.diag([1.0 / w_yaw**2, 1.0])
    q_yaw = (at_rest - A_yaw @ at_rest @ A_yaw.T) * o.sigma_wave_yaw_rate_rad_s**2
    by, reach = _turned(float(b.x[TURN_RATE]), T)
    before, u = b.x, b.x[VESSEL_VEL]
    fall = 0.5 * T * T * _G_NED

    x = before.copy()
    x[WAVES] = np.einsum("kij,kj->ki", A, before[WAVES])
    x[yaw] = A_yaw @ before[yaw]
    x[PAD_YAW] += before[TURN_RATE] * T + x[WAVE_YAW] - before[WAVE_YAW]
    x[VESSEL_VEL] = by @ u
    x[POS_REL] += x[DECK_DISP[:3]] - before[DECK_DISP[:3]] - before[VEL] * T - b.dp - fall
    x[POS_HORIZONTAL] += reach @ u
    x[VEL] += b.dv + _G_NED * T
    # The downward accelerometer bias is not removed: a change of its estimate would look like a jerk of the deck.
    biased = _DOWN * (b.turned[2] @ before[ACCEL_BIAS])
    b.ins_p = b.ins_p + b.ins_v * T + b.dp + 0.5 * T * biased + fall
    b.ins_v = b.ins_v + b.dv + biased + _G_NED * T

    F, Q = I_N.copy(), np.zeros((N, N))
    back, dv_R, dp_R = b.R.T @ b.R_cov, skew(b.dv) @ b.R_cov, skew(b.dp) @ b.R_cov
    F[ATT_ERR, ATT_ERR], F[ATT_ERR, GYRO_BIAS] = back, -0.5 * T * (I3 + back)
    F[VEL, ATT_ERR], F[VEL, GYRO_BIAS], F[VEL, ACCEL_BIAS] = -dv_R, 0.5 * T * dv_R, -b.turned
    F[POS_REL, VEL] = -T * I3
    F[POS_REL, ATT_ERR], F[POS_REL, GYRO_BIAS], F[POS_REL, ACCEL_BIAS] = dp_R, -T / 3.0 * dp_R, 0.5 * T * b.turned
    F[POS_HORIZONTAL, VESSEL_VEL], F[VESSEL_VEL, VESSEL_VEL] = reach, by
    F[VESSEL_VEL, TURN_RATE], F[POS_HORIZONTAL, TURN_RATE] = T * _QUARTER @ x[VESSEL_VEL], 0.5 * T * T * _QUARTER @ u
    F[PAD_YAW, TURN_RATE] = T
    F[np.ix_(yaw, yaw)], F[PAD_YAW, yaw] = A_yaw, A_yaw[0] - [1.0, 0.0]

    force = params.psd_accel * T + params.psd_coast * b.coast_s
    np.fill_diagonal(Q, params.psd * T)
    Q[ATT_ERR, ATT_ERR] += I3 * (params.psd_coast_turn * b.coast_s + b.jolt_var_rad2)
    Q[VEL, VEL] = I3 * (force + b.jolt_var_m2_s2)
    Q[POS_REL, POS_REL] = I3 * (force / 3.0 + b.jolt_var_m2_s2) * T * T
    Q[POS_REL, VEL] = Q[VEL, POS_REL] = -I3 * (0.5 * force + b.jolt_var_m2_s2) * T
    for k, states in enumerate(WAVES):
        F[np.ix_(states, states)], Q[np.ix_(states, states)] = A[k], q_waves[k]
        if k < 3:
            F[_POS[k], states] = A[k, 0] - [1.0, 0.0, 0.0, 0.0]
            Q[_POS[k], _POS[k]] += q_waves[k, 0, 0]
            Q[_POS[k], states] = Q[states, _POS[k]] = q_waves[k, 0]
    steering = steers(b, b.t_cov)
    Q[VESSEL_VEL, VESSEL_VEL] += 0.4 * T * steering * np.eye(2)
    turn = params.psd[TURN_RATE] + 0.025 * steering
    Q[TURN_RATE, TURN_RATE], Q[PAD_YAW, PAD_YAW] = turn * T, q_yaw[0, 0] + turn * T**3 / 3.0
    Q[PAD_YAW, TURN_RATE] = Q[TURN_RATE, PAD_YAW] = 0.5 * T * T * turn
    Q[np.ix_(yaw, yaw)] = q_yaw
    Q[PAD_YAW, yaw] = Q[yaw, PAD_YAW] = q_yaw[0]
    if is_swung(b, b.t_cov):
        # A first-order Gauss-Markov process about the motion before.
        settling, stays, M = [*range(N)[VESSEL_VEL], TURN_RATE], math.exp(-T / 0.3), I_N.copy()
        about = np.append(x[VEL][:2] - b.ins_v[:2] + b.vessel_before, 0.0)
        x[settling] = about + stays * (x[settling] - about)
        M[settling, settling] = stays
        M[VESSEL_VEL, VEL] = (1.0 - stays) * I3[:2]
        F, Q = M @ F, M @ Q @ M.T
        Q[settling, settling] += (1.0 - stays**2) * np.array([0.7, 0.7, 0.5]) ** 2

    b.ins_var_m2_s2 += b.jolt_var_m2_s2 + params.psd_coast * b.coast_s
    b.x, b.t_cov, b.R, b.dv, b.dp, b.turned = x, b.t, orthonormalised(b.R), np.zeros(3), np.zeros(3), np.zeros((3, 3))
    b.R_cov, b.coast_s, b.jolt_var_m2_s2, b.jolt_var_rad2 = b.R, 0.0, 0.0, 0.0
    return F, Q


def steers(b: State, t: int) -> bool:
    """Return whether the ship manoeuvres at an instant, ns."""
    return bool(b.steered >= 0 and (t - b.steered) * 1e-9 < 0.4)


def is_adrift(b: State, t: int) -> bool:
    """Return whether the pad went out of sight while its ship swung it aside."""
    lost = any(shown >= 0 and (b.sighted - shown) * 1e-9 < within_s for shown, within_s in ((b.swung, 1.0), (b.steered, 0.1)))
    return bool(b.sighted >= 0 and lost and (t - b.sighted) * 1e-9 > 0.3)


def is_swung(b: State, t: int) -> bool:
    """Return whether the swing of a pad that is adrift may go on."""
    return is_adrift(b, t) and (t - b.sighted) * 1e-9 < 2.0


def ready_to_fuse(b: State, t: int, params: FilterParams) -> None:
    """Propagate state and covariance to `t`, ns, and fuse what was gathered: later it would count twice."""
    propagate(b, t, params)
    propagate_covariance(b, params)
    _fuse_gathered(b, params)


def correct(b: State, fix: Fix) -> None:
    """Apply a correction. Its attitude part turns `R`, and the covariance is rewritten about the new attitude."""
    dx, x, T = fix.dx, b.x + fix.dx, I_N.copy()
    x[ATT_ERR], x[PAD_YAW], x[VEL_SCALE] = 0.0, wrap_pi(x[PAD_YAW]), np.clip(x[VEL_SCALE], 0.2, 3.0)
    T[POS_REL, ATT_ERR] = -skew(dx[POS_REL]) @ b.R
    T[ATT_ERR, ATT_ERR] -= 0.5 * skew(dx[ATT_ERR])
    b.x, b.P, b.R = x, T @ fix.P @ T.T, b.R @ exp(dx[ATT_ERR])
    b.R_cov = b.R


# Aiding by the vehicle's own sensors


def _ahead_of_covariance(b: State) -> F64:
    """Return the (N,) state at `t` to first order in the time since `t_cov`."""
    T, x = (b.t - b.t_cov) * 1e-9, b.x.copy()
    rates = b.x[DECK_RATE]
    x[POS_REL] += rates[:3] * T - b.x[VEL] * T - b.dp - 0.5 * T * T * _G_NED
    x[POS_HORIZONTAL] += b.x[VESSEL_VEL] * T
    x[DECK_DISP] += rates * T
    x[VEL] += b.dv + _G_NED * T
    x[PAD_YAW] += (b.x[YAW_RATE] + b.x[TURN_RATE]) * T
    return x


def _sensed(v_ned: F64, by_v_ned: F64, R: F64, scale: float) -> tuple[F64, F64]:
    """Return a velocity as a sensor with that scale measures it in level, (3,) m/s, and its Jacobian (3, N)."""
    to_level = about_down(-heading(R)).copy()
    to_level[:2] *= scale
    v, H = to_level @ v_ned, to_level @ by_v_ned
    H[:2, ATT_ERR] += np.outer([v[1], -v[0]], heading_row(R) @ R)
    H[:2, VEL_SCALE] += v[:2] / scale
    return v, H


def _velocity_rows(x: F64, R: F64, event: BodyVelocity, deck_weight: float, axes: list[int]) -> Rows:
    by_v = -deck_weight * _BY_V_PAD
    by_v[:, VEL] += I3
    v, H = _sensed(by_v @ x, by_v, R, x[VEL_SCALE])
    return Rows((event.v_level - v)[axes], H[axes], event.cov_level[np.ix_(axes, axes)])


def _velocity(b: State, event: BodyVelocity, params: FilterParams) -> Outcome:
    o = params.options
    axes = [i for i in range(3) if event.cov_level[i, i] < NOT_MEASURED_VAR]
    is_open = o.velocity_is_over in ("auto", "either") and (b.sighted >= 0 or np.trace(b.P[VESSEL_VEL, VESSEL_VEL]) < 0.25)
    deck_weight = 1.0 if o.velocity_is_over == "pad" else 0.0
    if is_open:
        _weigh_surfaces(b, event, axes, o)
        deck_weight = 1.0 / (1.0 + math.exp(-b.over_pad))
        deck_weight = 0.0 if deck_weight < 0.03 else 1.0 if deck_weight > 0.97 else deck_weight
    if not axes or (deck_weight == 1.0 and b.sighted < 0 and not is_open) or is_swung(b, b.t):
        return Outcome(Verdict.GATED)
    x = b.x.copy()
    x[VEL] += b.dv + _G_NED * ((b.t - b.t_cov) * 1e-9)
    row = _velocity_rows(x, b.R, event, deck_weight, axes)
    if is_open and (edge := _refused_at_an_edge(b, event, row, tuple(axes), deck_weight, params)) is not None:
        return edge
    return _gather(b, VELOCITY, row.innov, row.R, params, tuple(axes), deck_weight)


def _weigh_surfaces(b: State, event: BodyVelocity, axes: list[int], o: EkfOptions) -> None:
    """Update the log-odds that the sensor sees the pad's deck. Correlated samples count as one."""
    since = 1.0 if b.t_velocity < 0 else (b.t - b.t_velocity) * 1e-9
    if since < 0.5 * o.velocity_correlation_s or not axes:
        return
    away, spread = _foot(b)
    expected = 0.0
    if b.sighted < 0:
        expected = -4.0
    elif away + 2.0 * spread < o.deck_radius_m:
        expected = 3.0
    elif away - 2.0 * spread > 4.0 * o.deck_radius_m:
        expected = -3.0
    odds = expected + (b.over_pad - expected) * math.exp(-since / 3.0)
    odds += _evidence_of_the_deck(b, event, axes) * min(1.0, 0.5 * since / o.velocity_correlation_s)
    b.over_pad, b.t_velocity = max(-4.0 if b.sighted < 0 else -6.0, min(6.0, odds)), b.t


def _evidence_of_the_deck(b: State, event: BodyVelocity, axes: list[int]) -> float:
    """Return the log-odds, -3..3, by which a sample favours the deck against the ground below it."""
    x = _ahead_of_covariance(b)
    rows = [_velocity_rows(x, b.R, event, deck_weight, axes) for deck_weight in (0.0, 1.0)]
    spreads = [row.H @ b.P @ row.H.T + row.R for row in rows]
    misfits, least = [nis_of(row.innov, S) for row, S in zip(rows, spreads, strict=True)], 6.0
    if all(misfit is not None and misfit < 6.0 for misfit in misfits):
        both, least = spreads[0] + spreads[1] - rows[0].R, 0.0
        misfits = [nis_of(row.innov, both) for row in rows]
    ground, deck = misfits
    return 0.0 if ground is None or deck is None else max(-3.0, min(3.0, 0.5 * (max(ground, least) - max(deck, least))))


def _refused_at_an_edge(
    b: State, event: BodyVelocity, row: Rows, axes: tuple[int, ...], deck_weight: float, params: FilterParams
) -> Outcome | None:
    """Return the outcome of a sample that contradicts the assumed surface and not the other one; None of others."""
    S = _gathered_so_far(b, VELOCITY, row.innov, params, axes, deck_weight).spread + row.R
    nis = nis_of(row.innov, S)
    if nis is None or nis < 6.0 or (1.0 if deck_weight < 0.5 else -1.0) * _evidence_of_the_deck(b, event, list(axes)) <= 0.0:
        return None
    return Outcome(Verdict.GATED, row.innov, S, nis, NIS_MAX[len(axes) - 1], axes)


def _foot(b: State) -> tuple[float, float]:
    """Return how far from the pad's centre the body's down axis meets the deck, and its sigma, m."""
    d, c = _ahead_of_covariance(b)[POS_REL], b.R[:, 2]
    foot = d - c * d[2] / max(c[2], 0.3)
    return math.hypot(foot[0], foot[1]), math.sqrt(np.trace(b.P[POS_HORIZONTAL, POS_HORIZONTAL]) / 2.0)


def _by_range(x: F64, R: F64) -> tuple[float, F64] | None:
    """Return the distance along the body's down axis to the deck, m, and its Jacobian (1, N); None if they do not meet."""
    R_pad, axes = deck_attitude(x)
    n, c = R_pad[:, 2], R[:, 2]
    cosine = float(n @ c)
    if cosine < 0.3:
        return None
    r, H = float(n @ x[POS_REL]) / cosine, np.zeros((1, N))
    H[0, POS_REL], H[0, ATT_ERR] = n / cosine, r / cosine * n @ R @ skew(_DOWN)
    H[0, _ANGLES] = skew(n) @ ((x[POS_REL] - r * c) / cosine) @ axes
    H[0, DECK_TRIM], H[0, RANGE_OFFSET] = H[0, DECK_DISP[3:]], 1.0
    return r, H


def _range(b: State, event: Range, params: FilterParams) -> Outcome:
    if b.sighted < 0:
        return Outcome(Verdict.GATED)
    (away, spread), x = _foot(b), _ahead_of_covariance(b)
    found = _by_range(x, b.R)
    if away + 2.0 * spread > params.options.deck_radius_m or found is None:
        return Outcome(Verdict.GATED)
    return _gather(b, RANGE, np.array([event.range_m - found[0] - x[RANGE_OFFSET]]), np.array([[event.sigma_m**2]]), params)


def _height(b: State, event: Baro, params: FilterParams) -> Outcome:
    if b.sighted < 0:
        return Outcome(Verdict.GATED)
    T, x = (b.t - b.t_cov) * 1e-9, b.x
    below = x[POS_DOWN] - x[DECK_DISP[2]] - x[VEL_DOWN] * T - b.dp[2] - 0.5 * G_M_S2 * T * T
    return _gather(b, HEIGHT, np.array([event.height_m - below - x[BARO_OFFSET]]), np.array([[event.sigma_m**2]]), params)


def _predicted(b: State, kind: int, axes: tuple[int, ...], deck_weight: float) -> tuple[F64, F64]:
    """Return the (m, N) Jacobian of a kind of aiding, and the (m, m) noise that an uncertain surface adds."""
    x = _ahead_of_covariance(b)
    if kind == ATTITUDE:
        H = np.zeros((3, N))
        H[:, ATT_ERR] = I3
        H[[0, 1], ATT_BIAS] = 1.0
    elif kind == HEIGHT:
        H = np.zeros((1, N))
        H[0, [POS_DOWN, DECK_DISP[2], BARO_OFFSET]] = 1.0, -1.0, 1.0
    elif kind == RANGE:
        found = _by_range(x, b.R)
        H = found[1]
    else:
        by_v = -deck_weight * _BY_V_PAD
        by_v[:, VEL] += I3
        H = _sensed(by_v @ x, by_v, b.R, x[VEL_SCALE])[1][list(axes)]
    ambiguity = deck_weight * (1.0 - deck_weight)
    if ambiguity == 0.0:
        return H, np.zeros((len(H), len(H)))
    gap, slope = (part[list(axes)] for part in _sensed(_BY_V_PAD @ x, _BY_V_PAD, b.R, x[VEL_SCALE]))
    return H, ambiguity * (np.outer(gap, gap) + slope @ b.P @ slope.T + 1e-9 * np.eye(gap.size))


def _is_stale(gathered: SimpleNamespace, t: int, o: EkfOptions) -> bool:
    return bool((t - gathered.since) * 1e-9 > 2.0 * o.aiding_period_s)


def _gathered_so_far(
    b: State, kind: int, innov: F64, params: FilterParams, axes: tuple[int, ...], deck_weight: float
) -> SimpleNamespace:
    """Return the samples so far of a kind, or a new period."""
    found = b.aids[kind].gathered
    if found is not None and (found.axes, found.deck_weight) == (axes, deck_weight) and not _is_stale(found, b.t, params.options):
        return SimpleNamespace(**vars(found))
    H, ambiguity = _predicted(b, kind, axes, deck_weight)
    return SimpleNamespace(
        n=0, since=b.t, axes=axes, deck_weight=deck_weight, H=H, ambiguity=ambiguity, spread=H @ b.P @ H.T + ambiguity,
        innov=np.zeros(innov.size), R=np.zeros_like(ambiguity),
    )  # fmt: skip


def _gather(
    b: State, kind: int, innov: F64, R: F64, params: FilterParams, axes: tuple[int, ...] = (), deck_weight: float = 0.0
) -> Outcome:
    """Add a sample to those that are fused at the end of the aiding period, unless the gate rejects it."""
    o, aid = params.options, b.aids[kind]
    so_far = _gathered_so_far(b, kind, innov, params, axes, deck_weight)
    S = so_far.spread + R
    nis, limit = nis_of(innov, S), NIS_MAX[innov.size - 1]
    if nis is None:
        return Outcome(Verdict.SINGULAR, innov, S, axes=axes)
    if nis > limit:
        if aid.refused < 0:
            aid.refused, aid.first = b.t, np.append(innov, np.zeros(3 - innov.size))
        if (b.t - aid.refused) * 1e-9 > 1.0:
            b.P, aid.refused = _inflated(b, kind, innov, axes), -1
        return Outcome(Verdict.GATED, innov, S, nis, limit, axes)
    if kind == VELOCITY and aid.refused >= 0 and axes[:2] == (0, 1):
        b.P = _drifting(b.P, np.append(innov, np.zeros(3 - innov.size)))
    so_far.n, so_far.innov, so_far.R = so_far.n + 1, so_far.innov + innov, so_far.R + R
    aid.gathered, aid.refused = so_far, -1
    first = min(other.gathered.since for other in b.aids if other.gathered)
    if (b.t - first) * 1e-9 >= o.aiding_period_s or aid.fused < 0:
        _fuse_gathered(b, params)
    return Outcome(Verdict.FUSED, innov, S, nis, limit, axes)


def _fuse_gathered(b: State, params: FilterParams) -> None:
    """Fuse the means of all gathered samples together."""
    o = params.options
    correlation_s = o.attitude_correlation_s, o.velocity_correlation_s, o.range_correlation_s, o.baro_correlation_s
    if not any(aid.gathered for aid in b.aids):
        return
    propagate_covariance(b, params)
    rows = []
    for aid, correlated_s in zip(b.aids, correlation_s, strict=True):
        some, aid.gathered = aid.gathered, None
        if some is not None and not _is_stale(some, b.t, o):
            window = (b.t - aid.fused) * 1e-9 if aid.fused >= 0 else math.inf
            inflation = max(1.0 / some.n, 2.0 * correlated_s / max(window, 1e-3))
            rows.append(Rows(some.innov / some.n, some.H, (some.R / some.n + some.ambiguity) * inflation))
            aid.fused = b.t
    fix = correction(b.P, _together(rows)) if rows else None
    if fix is not None:
        correct(b, fix)


def _together(rows: list[Rows]) -> Rows:
    return Rows(np.concatenate([r.innov for r in rows]), np.concatenate([r.H for r in rows]), block_diag(*(r.R for r in rows)))


_COMMON = np.stack([I_N[body] + I_N[deck] for body, deck in zip(VEL_AXES, (*range(N)[VESSEL_VEL], DECK_RATE[2]), strict=True)])
"""(3, N) the velocity of body and deck together."""


def _drifting(P: F64, innov: F64) -> F64:
    """Return the covariance after body and vessel drifted together."""
    level = float(innov[:2] @ innov[:2])
    return np.asarray(P + (_COMMON.T * (level, level, innov[2] ** 2)) @ _COMMON)


def _split_leap_and_bias(b: State, innov: F64) -> F64:
    """Return the covariance after a streak of refused velocities: its first error is a leap, what grew is the bias."""
    aid, R_ned_level = b.aids[VELOCITY], about_down(math.atan2(b.R[1, 0], b.R[0, 0]))
    made = np.append(innov, np.zeros(3 - innov.size))
    grows = (made - aid.first) / ((b.t - aid.refused) * 1e-9)
    leap = aid.first - grows * np.clip(aid.first @ grows / max(grows @ grows, 1e-9), 0.0, 2.0)
    if innov.size < 3:
        leap[2] = 0.0
    g = (R_ned_level @ made) @ (_COMMON if b.sighted > aid.refused else I_N[VEL])
    g[ACCEL_BIAS] -= b.R.T @ R_ned_level @ grows
    return np.asarray(_drifting(b.P, leap) + np.outer(g, g))


def _inflated(b: State, kind: int, innov: F64, axes: tuple[int, ...]) -> F64:
    """Return the covariance where what a rejected sensor contradicts is uncertain, and the pad's position is not."""
    P, x = b.P.copy(), b.x
    if kind == ATTITUDE:
        # All directions turn together about the vertical.
        g = np.zeros(N)
        g[ATT_ERR], g[PAD_YAW], g[VESSEL_VEL] = b.R[2], 1.0, _QUARTER @ x[VESSEL_VEL]
        for north, east in (_POS[:2], np.arange(N)[VEL][:2], *WAVES[:2].T):
            g[[north, east]] = -x[east], x[north]
        P += np.outer(g, g) * float(innov @ b.R[2]) ** 2
        size = min(float(innov @ innov), 0.1)
        P[ATT_ERR, ATT_ERR] += I3 * (0.1 * size)
        P[ATT_BIAS, ATT_BIAS] += size
    elif kind == VELOCITY:
        P = _split_leap_and_bias(b, innov) if axes[:2] == (0, 1) else P
        P[VEL_SCALE, VEL_SCALE] += 0.01
    elif kind == HEIGHT:
        P[BARO_OFFSET, BARO_OFFSET] += float(innov[0]) ** 2
    return P


def _vessel(b: State, event: VesselReport, params: FilterParams) -> Outcome:
    """Fuse what a ship reports of herself: her velocity, her heading or both, and her rate of turn."""
    o, rows, axes, outcome = params.options, list[Rows](), tuple[int, ...](), Outcome(Verdict.GATED)
    bow = b.x[PAD_YAW] - o.pad_yaw_in_vessel_rad
    ahead, aside = about_down(bow)[:2, :2] @ (o.pad_forward_m, o.pad_right_m)
    swing = np.array([-aside, ahead, 0.0])
    turns = I_N[TURN_RATE] + I_N[YAW_RATE]
    if event.v_vessel_ned is not None and event.cov_v_ned is not None:
        H = _BY_V_PAD - np.outer(swing, turns)
        R = event.cov_v_ned + (0.5**2 * np.eye(3) if o.velocity_is_over in ("either", "auto") else 0.0)
        rows, axes = [Rows(event.v_vessel_ned - H @ b.x, H, R)], (0, 1, 2)
    in_sight, shows_arrow = (t >= 0 and (b.t - t) * 1e-9 <= 0.6 for t in (b.sighted, b.heading_seen))
    due = b.turn_heading < 0 or (b.t - b.turn_heading) * 1e-9 >= 1.0 or event.turn_rad_s is None
    if event.heading_rad is not None and event.sigma_heading_rad is not None and due and not shows_arrow:
        innov = np.array([wrap_pi(event.heading_rad + o.pad_yaw_in_vessel_rad - b.x[PAD_YAW])])
        rows, axes = [*rows, Rows(innov, I_N[[PAD_YAW]], np.array([[event.sigma_heading_rad**2]]))], (*axes, 3)
    if rows:
        outcome = _gated(b, _together(rows), params, axes, velocities_alone=in_sight and 3 not in axes)
        if outcome.verdict is Verdict.FUSED and 3 in axes:
            b.heading_known, b.turn_heading = 1, b.t
    if event.turn_rad_s is None or event.sigma_turn_rad_s is None:
        return outcome
    own = event.sigma_turn_rad_s**2
    z = Rows(np.array([event.turn_rad_s - turns @ b.x]), turns[None], np.array([[own + 0.05**2]]))
    if _turn_shows(b, float(z.innov[0]), math.sqrt(max(0.0, turns @ b.P @ turns) + own + 0.01**2)):
        bow = b.x[PAD_YAW] - o.pad_yaw_in_vessel_rad
        ahead, aside = about_down(bow)[:2, :2] @ (o.pad_forward_m, o.pad_right_m)
        g = I_N[TURN_RATE] - aside * I_N[16] + ahead * I_N[17]
        b.P = b.P + float(z.innov[0]) ** 2 * (np.outer(g, g) + np.diag(I_N[16] + I_N[17]))
        if b.steered < 0 or (b.t - b.steered) * 1e-9 > 2.0:
            b.vessel_before = b.x[VESSEL_VEL] - b.x[VEL][:2] + b.ins_v[:2]
        b.steered, b.swung = b.t, b.t if abs(z.innov[0]) > 0.2 else b.swung
    turned = outcome if b.t < b.turn_left_out else _gated(b, z, params, (4,))
    return turned if outcome.innov is None else outcome


def _turn_shows(b: State, innov: float, sigma: float) -> bool:
    """Return whether a reported rate of turn, off by so many rad/s, shows a manoeuvre that sight does not contradict."""
    before, now = b.turn_deviate, innov / sigma
    b.turn_deviate = now
    shows = abs(now) > 5.0 or (min(abs(now), abs(before)) > 3.0 and now * before > 0.0)
    goes_on = b.turn_last >= 0 and (b.t - b.turn_last) * 1e-9 <= 1.0
    if not (shows or (goes_on and abs(innov) > 0.1)) or b.agreed < 8 or (b.t - b.sighted) * 1e-9 > 0.6:
        return False
    b.turn_since = b.turn_since if goes_on else b.t
    b.turn_last = b.t
    if (b.t - b.turn_since) * 1e-9 > 1.5:
        b.turn_left_out = b.t + 10_000_000_000
    return bool(shows and b.t >= b.turn_left_out)


def _gated(b: State, z: Rows, params: FilterParams, axes: tuple[int, ...], *, velocities_alone: bool = False) -> Outcome:
    """Correct a state, or its horizontal velocities alone, by numbers that pass the gate."""
    fix, limit = correction(b.P, z), NIS_MAX[z.innov.size - 1]
    if fix is None:
        return Outcome(Verdict.SINGULAR, z.innov, axes=axes)
    if fix.nis > limit:
        return Outcome(Verdict.GATED, z.innov, fix.S, fix.nis, limit, axes)
    if velocities_alone:
        others = np.delete(np.arange(N), [6, 7, 16, 17])
        fix.dx[others], fix.P[np.ix_(others, others)] = 0.0, b.P[np.ix_(others, others)]
    correct(b, fix)
    return Outcome(Verdict.FUSED, z.innov, fix.S, fix.nis, limit, axes)


def _motion(b: State, event: VesselMotion, params: FilterParams) -> Outcome:
    """Fuse what a ship's motion sensor reports of the pad: roll, pitch, displacement downward, or some of them."""
    roll, pitch, down = event.roll_rad, event.pitch_rad, event.heave_down_m
    tilts = roll is not None and pitch is not None
    rows = [(3, roll, event.sigma_tilt_rad), (4, pitch, event.sigma_tilt_rad)] if tilts else []
    rows += [] if down is None else [(2, down, event.sigma_heave_m)]
    if not rows:
        return Outcome(Verdict.GATED)
    axes = (*((0, 1) if tilts else ()), *(() if down is None else (2,)))
    if not 0 <= b.bank.sighted > b.t - 2e9 and not 0 <= b.bank.t > b.t - 0.18e9:
        y, var = np.zeros(5), np.full(5, 1e6)
        for k, value, sigma in rows:
            y[k], var[k] = value, sigma**2
        learned = observe(b.bank, b.t, y, var, params, by_sensor=True)
        b.bank, b.wave_w, b.wave_zeta, b.wave_sigma = learned, learned.w_rad_s, learned.zeta, learned.sigma
    at = DECK_DISP[[k for k, *_ in rows]]
    z = Rows(np.array([value for _, value, _ in rows]) - b.x[at], I_N[at], np.diag([sigma**2 for *_, sigma in rows]))
    outcome = _gated(b, z, params, axes)
    b.reported = b.t if outcome.verdict is Verdict.FUSED else b.reported
    return outcome


# The model of a sighting


def deck_attitude(x: F64) -> tuple[F64, F64]:
    """Return R_ned_pad, and the axes in ned, as columns, about which roll, pitch and heading turn the pad."""
    (roll, pitch), yaw = x[DECK_DISP[3:]] + x[DECK_TRIM], float(x[PAD_YAW])
    by_roll = about_down(yaw) @ [math.cos(pitch), 0.0, -math.sin(pitch)]
    return rpy_matrix(roll, pitch, yaw), np.column_stack([by_roll, about_down(yaw)[:, 1], _DOWN])


def levelling(b: State) -> F64:
    """Return the R_level_body by which vision levelled a sighting."""
    source = b.levelled_by if b.is_levelled else b.R
    return np.asarray(about_down(-heading(source)) @ source)


def _place_of(s: Sighting) -> F64:
    return s.d_body_pad_level if s.pose6 is None else s.pose6.d_body_pad_level


def sighting_rows(b: State, s: Sighting, cov_levelled_by: F64, yaw_sigma: float, *, place_only: bool = False) -> Rows:
    """Return the measurement of the pad's place in body axes, and of its heading or whole orientation.

    A late frame shows the body at a later instant; the deck that it shows is the one of the state.

    Args:
        b: the state at the sighting's stamp.
        s: the sighting.
        cov_levelled_by: (3, 3) rad^2, the part of the sighting's covariance that comes from the levelling attitude.
        yaw_sigma: sigma of the relative heading, rad: an ambiguous heading is of use only if it is small.
        place_only: use the place alone.
    """
    x, R, A, late = b.x, b.R, levelling(b), float(b.x[CAMERA_DELAY])
    E, jl = exp(-x[CAMERA_MOUNT]), left_jacobian(x[CAMERA_MOUNT])
    d_b, turning = R.T @ x[POS_REL], skew(b.w - x[GYRO_BIAS])
    v_b = R.T @ (np.append(x[VESSEL_VEL], 0.0) - x[VEL])
    rates = v_b - turning @ d_b
    shown, arm, ER = d_b + late * rates - x[CAMERA_LEVER], skew(d_b), E @ R.T
    has_heading = s.yaw_rad is not None and s.cov[3, 3] < 2.0 and not (s.yaw_ambiguous and yaw_sigma > 0.5)
    m = 3 if place_only else 6 if s.pose6 is not None else 4 if has_heading else 3
    H, innov, by_rate = np.zeros((m, N)), np.zeros(m), np.zeros((3, N))
    by_rate[:, ATT_ERR] = E @ (skew(v_b) - turning @ arm)
    by_rate[:, POS_REL], by_rate[:, VEL] = -E @ turning @ R.T, -ER
    by_rate[:, VESSEL_VEL], by_rate[:, GYRO_BIAS] = ER[:, :2], -E @ arm
    H[:3, ATT_ERR], H[:3, POS_REL] = E @ arm, ER
    H[:3] += late * by_rate
    H[:3, CAMERA_MOUNT], H[:3, CAMERA_DELAY], H[:3, CAMERA_LEVER] = E @ skew(shown) @ jl, E @ rates, -E
    innov[:3] = A.T @ _place_of(s) - E @ shown
    # An error of the levelling attitude changes what vision reports by its tilt and never by its heading.
    tilt, J, turn = A - np.outer(_DOWN, heading_row(A) @ A), np.zeros((m, 3)), np.eye(m)
    J[:3], turn[:3, :3] = -skew(_place_of(s)) @ tilt, A.T
    if m > 3:
        (R_pad, axes), AE = deck_attitude(x), A @ E
        spin, columns = AE @ (x[GYRO_BIAS] - b.w), AE @ R.T @ axes
        M, G = exp(late * spin) @ AE @ R.T @ R_pad, np.zeros((3, N))
        G[:, ATT_ERR], G[:, CAMERA_MOUNT], G[:, GYRO_BIAS], G[:, CAMERA_DELAY] = -AE, -AE @ jl, late * AE, spin
        G[:, _ANGLES], G[:, DECK_TRIM] = columns, columns[:, :2]
        if s.pose6 is None:
            off = wrap_pi((s.yaw_rad or 0.0) + heading(M))
            innov[3] = wrap_pi(off + math.pi) if s.yaw_ambiguous and abs(off) > math.pi / 2 else off
            H[3] = -heading_row(M) @ G
        else:
            seen = s.pose6.R_level_pad.matrix
            if s.yaw_ambiguous and np.trace(seen @ M.T) < 1.0:
                seen = seen @ about_down(math.pi)
            innov[3:], H[3:], J[3:] = log(seen @ M.T), G, tilt
    cov = (s.cov if s.pose6 is None else s.pose6.cov)[:m, :m]
    noise, slip = turn @ remove_attitude(cov, J, cov_levelled_by) @ turn.T, s.stamp.sigma_s
    rate = H[:, CAMERA_DELAY] + H[:, POS_REL] @ x[DECK_RATE[:3]]
    rate += H[:, _ANGLES] @ [x[DECK_RATE[3]], x[DECK_RATE[4]], x[YAW_RATE] + x[TURN_RATE]]
    seen, unsteady = A.T @ _place_of(s), float((b.w - b.w_smooth) @ (b.w - b.w_smooth))
    noise += slip**2 * (np.outer(rate, rate) + unsteady * np.diag([*(seen @ seen - seen**2), *[1.0] * (m - 3)]))
    return Rows(innov, H, 0.5 * (noise + noise.T), by_rate)


def remove_attitude(cov: F64, J: F64, cov_attitude: F64) -> F64:
    """Return `cov` minus `J cov_attitude J'`, and a fiftieth of each direction at least; `cov` if it cannot contain that part."""
    part = J @ cov_attitude @ J.T
    try:
        half = np.linalg.inv(np.linalg.cholesky(cov))
    except np.linalg.LinAlgError:
        return cov
    fraction, axes = np.linalg.eigh(half @ part @ half.T)
    if not part.any() or fraction[-1] > 1.5:
        return cov
    back = np.linalg.inv(half) @ axes
    return np.asarray((back * np.maximum(1.0 - fraction, 0.02)) @ back.T)


# Sightings


def no_streak() -> SimpleNamespace:
    """Return the streak before the first rejected sighting."""
    return SimpleNamespace(n=0, since=0, last=0, offset_ned=np.zeros(3), var_m2=0.0, by_baseline=0)


def _sighting(b: State, s: Sighting, params: FilterParams) -> Outcome:
    """Gate a sighting, reset the state of the pad after a streak of rejections, fuse, and feed the bank."""
    o, fresh, turned_round = params.options, b.sighted < 0, False

    def limit(z: Rows) -> float:
        return NIS_MAX[z.innov.size - 1]

    if fresh:
        _initialise(b, s, o, reset=False)
    z, fix = _compared(b, s, params)
    if fix is not None and not fresh:
        z, fix = _jolted(b, s, z, fix, params)
    if fix is not None and z.innov.size > 3 and b.heading_known and fix.nis > limit(z):
        place, by_place = _compared(b, s, params, place_only=True)
        if by_place is not None and by_place.nis <= limit(place):
            turned_round, z, fix = True, place, by_place
    if fix is not None and (turned_round or (z.innov.size > 3 and fix.nis <= limit(z))):
        since = 0.0 if b.heading_seen < 0 else min((b.t - b.heading_seen) * 1e-9, 0.5)
        held = b.heading_held_s - since if turned_round else b.heading_held_s + since
        b.heading_held_s, b.heading_seen = min(held, o.heading_memory_s), b.t
        if turned_round and b.heading_held_s <= 0.0:
            _set_new_heading(b, s)
            z, fix = _compared(b, s, params)
    if fix is None:
        return Outcome(Verdict.SINGULAR, z.innov)
    dof = z.innov.size
    if not fresh:
        slight = np.where(np.arange(dof) < 3, 0.008, 0.01)
        nis = nis_of(z.innov, fix.S + np.diag(slight**2))
        b.nis_mean += 0.05 * (min(math.inf if nis is None else nis / dof, 20.0) - b.nis_mean)
    if fix.nis > limit(z):
        _extend_streak(b, _camera_to_ned(b) @ z.innov[:3], float(np.trace(z.R[:3, :3])) / 3.0)
        if not _streak_resets(b, o):
            return Outcome(Verdict.GATED, z.innov, fix.S, fix.nis, limit(z))
        _initialise(b, s, o, reset=True)
        b.nis_mean = 1.0
        z, fix = _compared(b, s, params)
        if fix is None:
            return Outcome(Verdict.SINGULAR, z.innov)
    lost = math.sqrt(max(np.trace(b.P[POS_REL, POS_REL]) / 3.0, 0.0)) > 0.3
    correct(b, _withheld(b, fix))
    b.sighted, b.pictured, b.agreed, b.rejections = b.t, b.t, 1 if fresh or lost else b.agreed + 1, no_streak()
    b.heading_known = int(b.heading_known or (dof >= 4 and not s.yaw_ambiguous))
    if _moves_aside(b):
        b.swung = b.t
    _learn(b, s, z, params)
    return Outcome(Verdict.FUSED, z.innov, fix.S, fix.nis, limit(z))


def _camera_to_ned(b: State) -> F64:
    return np.asarray(b.R @ exp(b.x[CAMERA_MOUNT]))


def _compared(b: State, s: Sighting, params: FilterParams, *, place_only: bool = False) -> tuple[Rows, Fix | None]:
    yaw_sigma = math.sqrt(float(b.P[PAD_YAW, PAD_YAW])) if b.heading_known else math.inf
    z = sighting_rows(b, s, b.cov_levelled_by, yaw_sigma, place_only=place_only)
    # While the rate of the measured place is poorly known, the delay is not corrected and its effect counts as noise.
    cov_rate = z.by_rate @ b.P @ z.by_rate.T
    if np.trace(cov_rate) > 0.35**2:
        rate, var = z.H[:, CAMERA_DELAY], float(b.P[CAMERA_DELAY, CAMERA_DELAY])
        R, H = z.R + var * np.outer(rate, rate), z.H.copy()
        R[:3, :3] += var * cov_rate
        H[:, CAMERA_DELAY] = 0.0
        z = z._replace(H=H, R=R)
    return z, correction(b.P, z)


def _initialise(b: State, s: Sighting, o: EkfOptions, *, reset: bool) -> None:
    """Set the pad's place by a sighting; with `reset`, drop the rest that is known of the pad as well."""
    x, seen = b.x.copy(), levelling(b).T @ _place_of(s)
    x[POS_REL] = _camera_to_ned(b) @ seen + b.R @ x[CAMERA_LEVER]
    P = without(b.P, POS_REL, 1e2 + float(seen @ seen))
    if reset:
        P = without(without(P, VESSEL_VEL, 4.0), TURN_RATE, o.sigma_turn_rate_rad_s**2)
        P = without(P, WAVES[:3].ravel(), 0.0)
        for states, cov in zip(WAVES[:3], waves_unknown(b), strict=False):
            P[np.ix_(states, states)] = cov
        x[TURN_RATE], x[WAVES[:3]], b.swung = 0.0, 0.0, -1
    elif b.reported >= 0:
        P = without(P, WAVES[2:].ravel(), 0.0)
        size = np.maximum(b.wave_sigma, np.sqrt((np.exp(LOG_PRIOR) * SIGMA**2).sum(axis=1)))
        for states, cov in zip(WAVES[2:], waves_unknown(b, size)[2:], strict=True):
            P[np.ix_(states, states)] = cov
    if b.sighted < 0 and o.velocity_is_over in ("either", "auto"):
        P[6:8, 6:8] += np.outer(x[VESSEL_VEL], x[VESSEL_VEL])
    if (reset or not b.heading_known) and s.yaw_rad is not None and not s.yaw_ambiguous:
        x[PAD_YAW] = wrap_pi(heading(b.R) - s.yaw_rad)
        P = without(P, PAD_YAW, _UNIFORM_VAR)
    b.x, b.P, b.rejections, b.heading_held_s = x, P, no_streak(), 0.0


def _set_new_heading(b: State, s: Sighting) -> None:
    yaw = s.yaw_rad if s.pose6 is None else -heading(s.pose6.R_level_pad.matrix)
    if yaw is not None:
        x = b.x.copy()
        x[PAD_YAW], x[YAW_RATE], x[WAVE_YAW] = wrap_pi(heading(b.R) - yaw), 0.0, 0.0
        b.x, b.P, b.heading_held_s = x, without(b.P, PAD_YAW, _UNIFORM_VAR), 0.0


def _extend_streak(b: State, offset_ned: F64, var_m2: float) -> None:
    """Count one more rejected sighting, or the first one if it contradicts the last."""
    streak, dt = b.rejections, (b.t - b.rejections.last) * 1e-9
    limit = 4.0 * math.sqrt(var_m2 + streak.var_m2) + min(2.0 * dt, 0.6) + 0.02 * math.hypot(*offset_ned)
    agrees = streak.n > 0 and 0.0 <= dt <= 2.0 and math.dist(offset_ned, streak.offset_ned) <= limit
    n, since = (streak.n + 1, streak.since) if agrees else (1, b.t)
    b.rejections = SimpleNamespace(n=n, since=since, last=b.t, offset_ned=offset_ned, var_m2=var_m2, by_baseline=0)


def _streak_resets(b: State, o: EkfOptions) -> bool:
    """Return whether the rejected sightings outweigh those that the state of the pad came from."""
    n, since, last = b.rejections.n, b.rejections.since, b.rejections.last
    return bool(n > b.agreed if b.agreed < 3 else n >= o.reopen_count and (last - since) * 1e-9 >= o.reopen_s)


def _withheld(b: State, fix: Fix) -> Fix:
    """Return the correction of which a part is withheld from the camera's mounting and delay on a rough sea (Brink, 2017)."""
    heave = float(b.wave_sigma[2] * b.wave_w[2]) ** 2
    rough, part, part_cov = heave / (heave + 0.1**2), np.zeros(N), np.zeros(N)
    part[CAMERA_MOUNT] = part_cov[CAMERA_MOUNT] = 0.95 * rough
    part[CAMERA_DELAY], part_cov[CAMERA_DELAY] = 0.85 * rough, 0.975 * rough
    return fix._replace(dx=fix.dx * (1.0 - part), P=fix.P + part_cov[:, None] * (b.P - fix.P) * part_cov)


def _moves_aside(b: State) -> bool:
    """Return whether a manoeuvre shown in the last half second moves the pad across the ship's way."""
    if b.steered < 0 or (b.t - b.steered) * 1e-9 > 0.5:
        return False
    was = b.x[VEL][:2] - b.ins_v[:2] + b.vessel_before
    change, speed = b.x[VESSEL_VEL] - was, math.hypot(*was)
    return (abs(change[0] * was[1] - change[1] * was[0]) / speed if speed > 0.3 else math.hypot(*change)) > 0.5


def _learn(b: State, s: Sighting, z: Rows, params: FilterParams) -> None:
    """Update the bank with the pad's measured place and tilt."""
    since = (b.t - b.bank.sighted) * 1e-9
    if b.bank.sighted >= 0 and since < 0.9 * 0.2:
        return
    A, back, y, var = levelling(b), _camera_to_ned(b), np.zeros(5), np.full(5, 1e6)
    seen = A.T @ _place_of(s) - z.H[:3, CAMERA_DELAY] * b.x[CAMERA_DELAY]
    y[:3], var[:3] = back @ seen + b.R @ b.x[CAMERA_LEVER] + b.ins_p, np.diag(back @ z.R[:3, :3] @ back.T)
    if z.innov.size == 6 and s.pose6 is not None:
        R_pad = back @ A.T @ s.pose6.R_level_pad.matrix
        y[3], y[4] = math.atan2(R_pad[2, 1], R_pad[2, 2]), math.asin(max(-1.0, min(1.0, -R_pad[2, 0])))
        into_pad = R_pad.T @ back @ A.T
        var[3:] = np.diag(into_pad @ z.R[3:, 3:] @ into_pad.T)[:2]
    b.bank = observe(b.bank, b.t, y, var, params, reach_m=math.hypot(*seen), ins_var=b.ins_var_m2_s2)
    b.wave_w, b.wave_zeta, b.wave_sigma, b.ins_var_m2_s2 = b.bank.w_rad_s, b.bank.zeta, b.bank.sigma, 0.0


# Sightings that miss the deck by more than the filter claims


def _jolted(b: State, s: Sighting, z: Rows, fix: Fix, params: FilterParams) -> tuple[Rows, Fix]:
    """Compare again with a wider covariance if the last sightings missed the deck by more than the filter claims.

    Sources: covariance matching by Mehra, 1972; a matched filter for the ship's acceleration by Willsky and Jones, 1976.
    """
    back = _camera_to_ned(b)
    innov_ned, var_ned = back @ z.innov[:3], np.diag(back @ fix.S[:3, :3] @ back.T)
    displaced, moves = _by_manoeuvre(b.x)
    deviate, steered = _manoeuvre(b, z, fix, displaced + 2.0 / 0.15 * moves)
    excess = innov_ned**2 - 2.5 * var_ned
    if not (innov_ned**2 > np.maximum(49.0 * var_ned, 0.18**2)).any():
        recent = [one for one in b.excesses[len(b.excesses) == 24 :] if one[0] >= b.t - 350_000_000]
        b.excesses = [*recent, (b.t, np.concatenate([excess, deviate]))]
    missing = np.zeros(3)
    if len(b.excesses) >= 3 and b.excesses[-1][0] - b.excesses[0][0] >= 120_000_000:
        missing = np.maximum(np.median([values[:3] for _, values in b.excesses], axis=0), 0.0)
    last = [np.clip(v[3:], [-5, -5, -9], [5, 5, 9]) for t, v in b.excesses if (b.t - t) * 1e-9 <= 0.16][-3:]
    shows = [np.abs(sum(last[-n:])) > 5.0 * math.sqrt(n) for n in range(2, len(last) + 1)]
    counted = bool(b.excesses) and b.excesses[-1][0] == b.t
    steered = np.where(np.any(shows, axis=0), steered, 0.0) if counted and shows else np.zeros(3)
    if not missing.any() and not steered.any():
        return z, fix
    wider = b.copy()
    for axis, var in enumerate(missing * [0.0, 0.0, 1.0] if steered[:2].any() else missing):
        wider.P = wider.P + var * _accelerated(I_N[_POS[axis]] + I_N[WAVES[axis, 0]], I_N[WAVES[axis, 1]], 0.3)
    for place, rate, var in zip(displaced, moves, steered, strict=True):
        wider.P = wider.P + var * _accelerated(place, rate, 0.15)
    again, second = _compared(wider, s, params)
    if second is None:
        return z, fix
    b.P = wider.P
    if not steered.any():
        b.excesses = []
    else:
        if b.steered < 0 or (b.t - b.steered) * 1e-9 > 2.0:
            b.vessel_before = b.x[VESSEL_VEL] - b.x[VEL][:2] + b.ins_v[:2]
        b.steered = b.t
        b.swung = b.t if steered[2] > 0.012**2 else b.swung
    return again, second


def _accelerated(place: F64, rate: F64, T: float) -> F64:
    """Return the covariance (N, N) after white acceleration for T s that adds a unit variance to a displacement."""
    by = np.stack([place, rate], axis=1)
    return np.asarray(by @ np.array([[1.0, 1.5 / T], [1.5 / T, 3.0 / T**2]]) @ by.T)


def _by_manoeuvre(x: F64) -> tuple[F64, F64]:
    """Return the directions of state (3, N) along the ship's way, across it and in heading: of displacements and of rates."""
    north, east = x[VESSEL_VEL] / speed if (speed := math.hypot(*x[VESSEL_VEL])) > 0.3 else (1.0, 0.0)
    way, displaced, moves = np.array([[north, east], [-east, north]]), np.zeros((3, N)), np.zeros((3, N))
    displaced[:2, POS_HORIZONTAL], displaced[2, PAD_YAW] = way, 1.0
    moves[:2, VESSEL_VEL], moves[2, TURN_RATE] = way, 1.0
    return displaced, moves


def _manoeuvre(b: State, z: Rows, fix: Fix, directions: F64) -> tuple[F64, F64]:
    """Return by how many sigmas an acceleration of each kind displaced the ship, and the variance that each would add, (3,)."""
    by, usual = z.H @ directions.T, min(1.0, max(0.2, b.nis_claimed))
    inverse = np.linalg.inv(fix.S)
    information, along, nis = by.T @ inverse @ by, by.T @ inverse @ z.innov, float(z.innov @ inverse @ z.innov)
    by_turn = float(along[1:] @ np.linalg.pinv(information[1:, 1:]) @ along[1:])
    by_all = float(along @ np.linalg.pinv(information, hermitian=True) @ along)
    square = np.diagonal(information)
    explained = np.divide(along**2, square, out=np.zeros(3), where=square > 0.0)
    wholly = nis - by_all < nis * (0.25 if steers(b, b.t) else 0.05) and max(explained[:2]) > explained[2]
    left = np.array([nis - explained[0], nis - by_turn, nis - by_turn])
    shown = (square > 0.0) & (np.abs(along) < 0.25 * square) & (wholly | (left < 12.0))
    b.nis_claimed += 0.1 * (min(5.0, nis / z.innov.size) - b.nis_claimed)
    size = np.where(shown, square, 1.0)
    return np.where(shown, along / np.sqrt(size * usual), 0.0), np.where(shown, np.maximum(explained - usual, 0.0) / size, 0.0)


# The bank of oscillators


_DRIFT = np.array([[25.0, 9.0, 1.0]] * 3 + [[math.radians(2.0) ** 2, 0.0, 0.0]] * 2)


def bank_unknown() -> SimpleNamespace:
    """Return a bank that has received no sighting."""
    P = np.zeros((5, W.size, 7, 7))
    P[:, :, :4, :4] = (SIGMA**2)[:, :, None, None] * oscillators(W, ZETA)[1]
    P[:, :, [4, 5, 6], [4, 5, 6]] = _DRIFT[:, None]
    sums = {name: np.zeros((3, 5, 2)) for name in ("product", "square", "came")}
    bank = SimpleNamespace(t=-1, sighted=-1, log_weight=np.tile(LOG_PRIOR, (5, 1)), x=np.zeros((5, W.size, 7)), P=P)
    bank.skill = SimpleNamespace(issued=[], n=np.zeros(3), **sums)
    summarise(bank)
    return bank


def observe(
    before: SimpleNamespace, t: int, y: F64, var: F64, params: FilterParams, *, reach_m: float = 2.0, ins_var: float = 0.0,
    by_sensor: bool = False,
) -> SimpleNamespace:  # fmt: skip
    """Return the bank after one sighting of the deck's motion, or after one report of a ship's motion sensor.

    Args:
        before: the bank so far.
        t: instant, ns.
        y: (5,) pad north, east, down plus the body's place by the IMU alone, m; the deck's roll and pitch, rad.
        var: (5,) their variances; 1e6 and more of what was not seen.
        params: how an IMU's place drifts.
        reach_m: how far away the pad is.
        ins_var: variance that the IMU's velocity gained beyond its noise since the last sighting, (m/s)^2.
    """
    x, P, seen, fade = before.x, before.P, var < 1e5, 1.0
    if 0 <= before.t < t:
        dt = (t - before.t) * 1e-9
        x, P = _carried(x, P, dt, params, reach_m, ins_var, by_sensor)
        fade = math.exp(-dt / 180.0)
    if before.t < 0 or (before.sighted >= 0) is by_sensor:
        # The first sighting sets the offset's origin; a sensor has taken its own mean off.
        x, P = x.copy(), P.copy()
        x[..., 4:] = P[..., 4:] = P[:, :, 4:, :] = 0.0
        of_sensor = np.array([[0.01, 0.0, 0.0]] * 3 + [[2.5e-5, 0.0, 0.0]] * 2)
        P[:, :, [4, 5, 6], [4, 5, 6]] = (of_sensor if by_sensor else _DRIFT)[:, None]
        if not by_sensor:
            x[:3, :, 4] = np.where(seen[:3, None], y[:3, None] - x[:3, :, 0], 0.0)
    log_weight = fade * (before.log_weight - LOG_PRIOR) + LOG_PRIOR
    if before.t >= 0 > before.sighted and not by_sensor:
        # A sensor proves little, and no rest.
        log_weight = LOG_PRIOR + np.maximum(log_weight - LOG_PRIOR, -5.0)
        log_weight[:, 0] = REST_ODDS + np.log(np.exp(log_weight[:, 1:]).sum(axis=1))
    PH = P[..., 0] + P[..., 4]
    S = PH[..., 0] + PH[..., 4] + var[:, None]
    innov, observed = y[:, None] - x[..., 0] - x[..., 4], seen[:, None].astype(float)
    K = PH * (observed / S)[..., None]
    log_weight = log_weight - 0.5 * observed * (np.log(S) + np.minimum(innov**2 / S, 16.0))
    log_weight = np.maximum(log_weight - log_weight.max(axis=1, keepdims=True), -30.0)
    x, P = x + K * innov[..., None], P - K[..., :, None] * PH[..., None, :]
    bank = SimpleNamespace(t=t, sighted=-1 if by_sensor else t, log_weight=log_weight, x=x, P=P, skill=before.skill)
    summarise(bank)
    if not bank.skill.issued or t - bank.skill.issued[-1][0] >= 500_000_000:
        waves = weight_ahead(bank)[..., None] * x[..., :4]
        ahead = np.stack([np.einsum("gri,cgi->cr", _members(h)[0][:, :2], waves) for h in HORIZONS_S.tolist()])
        bank.skill = _compare_forecasts(bank.skill, t, waves[..., :2].sum(axis=1), ahead)
    return bank


def _carried(x: F64, P: F64, dt: float, params: FilterParams, reach_m: float, ins_var: float, by_sensor: bool) -> tuple[F64, F64]:
    A, q = _members(dt)
    F, by = np.zeros((W.size, 7, 7)), params.carrying
    F[:, :4, :4], F[:, 4:, 4:] = A, [[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, 1.0]]
    P = F @ P @ F.transpose(0, 2, 1)
    P[:, :, :4, :4] += (SIGMA**2)[:, :, None, None] * q
    qa, qb = by.asd_accel**2 + ins_var / dt * CARRIED, by.asd_drift**2
    noise = np.zeros((5, 3, 3))
    noise[:, 0, 0] = qa * dt**3 / 3 + qb * dt**5 / 20 + (reach_m * by.asd_tilt) ** 2 * dt
    noise[:, 0, 1] = noise[:, 1, 0] = qa * dt**2 / 2 + qb * dt**4 / 8
    noise[:, 0, 2] = noise[:, 2, 0] = qb * dt**3 / 6
    noise[:, 1, 1] = qa * dt + qb * dt**3 / 3
    noise[:, 1, 2] = noise[:, 2, 1] = qb * dt**2 / 2
    noise[:, 2, 2] = qb * dt
    if by_sensor:
        noise[:] = 0.0
        noise[:, 0, 0] = np.where(np.arange(5) < 3, 1e-4, 2.5e-7) * dt
    P[:, :, 4:, 4:] += noise[:, None]
    return (F @ x[..., None])[..., 0], P


def summarise(bank: SimpleNamespace) -> None:
    """Set the members' weights, (5, G), and frequency, damping and size of each direction's mixture."""
    top = bank.log_weight.max(axis=1, keepdims=True)
    weight = np.exp(bank.log_weight - top)
    moving = weight[:, 1:].sum(axis=1)
    # Heave, roll and pitch say whether the deck is at rest, together; the prior comes in once.
    odds = float(np.sum((bank.log_weight[:, 0] - top[:, 0] - np.log(moving))[2:]) - 2 * REST_ODDS)
    rest = 1.0 / (1.0 + math.exp(min(-odds, 500.0)))
    weight[:, 1:] *= ((1.0 - rest) / moving)[:, None]
    weight[:, 0] = rest
    energy = weight * SIGMA**2
    fraction = energy / energy.sum(axis=1, keepdims=True)
    bank.weight, bank.w_rad_s, bank.zeta = weight, np.sqrt(fraction @ W**2), np.exp(fraction @ np.log(ZETA))
    bank.sigma = np.sqrt(energy.sum(axis=1))


def weight_ahead(bank: SimpleNamespace) -> F64:
    """Return the (5, G) weights of the members in a forecast."""
    log_weight, rest = 0.6 * (bank.log_weight - LOG_PRIOR)[:, 1:], bank.weight[:, :1]
    weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
    return np.concatenate([rest, (1.0 - rest) * weight / weight.sum(axis=1, keepdims=True)], axis=1)


# The skill of past forecasts


def _compare_forecasts(skill: SimpleNamespace, t: int, now: F64, ahead: F64) -> SimpleNamespace:
    """Return the sums after comparing the motion (5, 2) with earlier forecasts of it, with a new one (3, 5, 2) kept."""
    fade = math.exp(-(t - skill.issued[-1][0]) * 1e-9 / 60.0) if skill.issued else 1.0
    n, product, square, came = (fade * a for a in (skill.n, skill.product, skill.square, skill.came))
    for k, horizon in enumerate(HORIZONS_S.tolist()):
        then = t - round(horizon * 1e9)
        for (t_a, a), (t_b, b) in pairwise(skill.issued):
            if t_a <= then < t_b and t_b - t_a <= 1_000_000_000:
                weight = (then - t_a) / (t_b - t_a)
                f = (1.0 - weight) * a[k] + weight * b[k]
                n[k] += 1.0
                product[k] += f * now
                square[k] += f * f
                came[k] += now * now
    kept = [one for one in skill.issued if t - one[0] <= 4_000_000_000]
    return SimpleNamespace(issued=[*kept, (t, ahead)], n=n, product=product, square=square, came=came)


def _factor(bank: SimpleNamespace, horizons_s: F64) -> F64:
    """Return the factor, 0..1, by which to scale a forecast, (H, 5, 2)."""
    skill, periods, n = bank.skill, HORIZONS_S[:, None] * bank.w_rad_s / math.tau, bank.skill.n[:, None, None]
    prior, weight = 0.8 * np.exp(-(periods**2))[..., None], (20.0 + 100.0 * periods**4)[..., None]
    known = np.clip((weight * prior + n * skill.product / np.maximum(skill.square, 1e-12)) / (weight + n), 0.0, 1.0)
    return _interpolated(horizons_s, np.concatenate([np.ones((1, 5, 2)), known]))


def _interpolated(horizons_s: F64, at: F64) -> F64:
    """Interpolate values (4, 5, 2) at horizon 0 and those that are compared; beyond them they are constant."""
    knots = np.concatenate([[0.0], HORIZONS_S])
    each = [[np.interp(horizons_s, knots, at[:, k, r]) for r in range(2)] for k in range(5)]
    return np.asarray(np.array(each).transpose(2, 0, 1))


def _missed(bank: SimpleNamespace, horizons_s: F64, claimed: F64) -> F64:
    """Return the variance of a forecast, (H, 5, 2): the claimed one, or a larger one as far as past misses show it."""
    skill, f, n = bank.skill, _factor(bank, HORIZONS_S), bank.skill.n[:, None, None]
    squares = skill.came - 2.0 * f * skill.product + f**2 * skill.square
    rms = np.sqrt(np.maximum(squares, 0.0) / np.where(n > 0.0, n, math.inf))
    between = _interpolated(horizons_s, np.concatenate([np.zeros((1, 5, 2)), rms]))
    after = np.clip(np.searchsorted(HORIZONS_S, horizons_s, side="right"), 0, 2)
    trust = (skill.n / (8.0 + skill.n))[after][:, None, None]
    return np.asarray(claimed + trust * np.maximum(between**2 - claimed, 0.0))


# Answers


def _aligned(x: F64) -> tuple[F64, F64]:
    """Return the (N,) state with the deck moved from the camera's time to the body's, and the (N, N) Jacobian of that."""
    late, rate, T = x[CAMERA_DELAY], x[DECK_RATE], I_N.copy()
    x = x.copy()
    x[DECK_DISP] -= late * rate
    x[POS_REL] -= late * rate[:3]
    T[DECK_DISP, DECK_RATE] = T[_POS, DECK_RATE[:3]] = -late
    T[DECK_DISP, CAMERA_DELAY], T[_POS, CAMERA_DELAY] = -rate, -rate[:3]
    return x, T


def answer(b: State, t: int, params: FilterParams) -> dict[str, Any]:
    """Return the members of the core's `dl_answer` at an instant, ns; without pad or IMU those that need it are left out."""
    b, o = b.copy(), params.options
    propagate(b, t, params)
    F, Q = move(b, params)
    x, T = _aligned(b.x)
    P, psi, turning = T @ b.P @ T.T, heading(b.R), heading_row(b.R) @ b.R
    Z = about_down(-psi)
    told: dict[str, Any] = {
        "heading": psi, "sighted": b.sighted, "agreed": b.agreed, "heading_known": bool(b.heading_known), "nis_mean": b.nis_mean,
        "velocity_fused": b.aids[VELOCITY].fused, "adrift": is_adrift(b, t), "steers": steers(b, t),
        "turn_left_out": t < b.turn_left_out,
        "has_pad": bool(b.sighted >= 0 and (t - b.sighted) * 1e-9 <= o.forget_s),
        "has_body": bool(_imu_holds(b, t, o) and b.is_levelled), "carried_down_m": b.ins_p[2],
    }  # fmt: skip
    told["has_deck"] = told["has_pad"] or bool(b.reported >= 0 and (t - b.reported) * 1e-9 <= 3.0)
    if told["has_body"]:
        f, J = b.R @ (b.f - b.x[ACCEL_BIAS]), np.zeros((3, N))
        J[:, ATT_ERR], J[:, ACCEL_BIAS] = -Z @ skew(f) @ b.R, -Z @ b.R
        cov = J @ b.P @ J.T + I3 * (params.psd_accel * 200.0)
        told |= {"a_body": Z @ (f + _G_NED), "cov_a_body": cov, "w_body": b.w - b.x[GYRO_BIAS]}
        told |= {"levelled_by": b.levelled_by, "cov_levelled_by": b.cov_levelled_by}
    if told["has_pad"]:
        d, v, J = Z @ x[POS_REL], Z @ (_BY_V_PAD @ x - x[VEL]), np.zeros((7, N))
        J[:3, POS_REL], J[3:6], J[3:6, VEL] = Z, Z @ _BY_V_PAD, -Z
        J[:3, ATT_ERR], J[3:6, ATT_ERR] = np.outer([d[1], -d[0], 0.0], turning), np.outer([v[1], -v[0], 0.0], turning)
        J[6, ATT_ERR], J[6, PAD_YAW] = turning, -1.0
        cov = J @ T @ (F @ b.P @ F.T + Q) @ T.T @ J.T
        told |= {"d": d, "v": v, "yaw": psi - x[PAD_YAW], "cov": cov}
        told |= {"x": b.x, "var": b.P.diagonal(), "rest": b.bank.weight[0, 0], "cov_vessel": b.P[VESSEL_VEL][0, 17]}
        told |= {"wave_w": b.wave_w, "wave_zeta": b.wave_zeta, "wave_sigma": b.wave_sigma}
    if told["has_deck"]:
        accelerated, rate = np.zeros((3, N)), float(x[TURN_RATE])
        accelerated[[0, 1, 2], WAVES[:3, 0]] = -(b.wave_w[:3] ** 2)
        accelerated[[0, 1, 2], WAVES[:3, 1]] = -2.0 * b.wave_zeta[:3] * b.wave_w[:3]
        accelerated[[0, 1, 2], WAVES[:3, 3]] = 1.0
        a = accelerated @ x + np.append(rate * _QUARTER @ x[VESSEL_VEL], 0.0)
        accelerated[:2, VESSEL_VEL], accelerated[:2, TURN_RATE] = rate * _QUARTER, _QUARTER @ x[VESSEL_VEL]
        J, tilt = np.vstack([Z @ _BY_V_PAD, Z @ accelerated]), np.zeros((4, N))
        tilt[[0, 1], DECK_DISP[3:]] = tilt[[0, 1], DECK_TRIM] = tilt[[2, 3], DECK_RATE[3:]] = 1.0
        told |= {"v_deck": Z @ _BY_V_PAD @ x, "a_deck": Z @ a, "cov_deck": J @ P @ J.T}
        told |= {"tilt": tilt @ x, "cov_tilt": tilt @ P @ tilt.T}
    return told


def _waves_ahead(bank: SimpleNamespace, t: int, rate: F64, h: F64) -> SimpleNamespace:
    """Forecast the waves from `t`, ns, at H horizons, s: mean and variance (H, 5, 2), change of displacement (H, 5), by the rate.

    Every member goes on from its own state. Only the present rate, (5,), is the main filter's, which has seen more.
    """
    A, q = _members(max(0, t - bank.t) * 1e-9 if bank.t >= 0 else 0.0)
    size, weight = SIGMA**2, weight_ahead(bank)
    x = (A @ bank.x[..., :4, None])[..., 0]
    P = A @ bank.P[..., :4, :4] @ A.transpose(0, 2, 1) + size[..., None, None] * q
    x[..., 1] += (rate - (weight * x[..., 1]).sum(axis=1))[:, None]
    column = P[..., 1]
    P = P - column[..., :, None] * column[..., None, :] / np.maximum(column[..., 1], 1e-18)[..., None, None]
    made = SimpleNamespace(mean=[], by_rate=[], var=[], var_change=[])
    for horizon in h.tolist():
        step, noise = _members(horizon)
        reach = step[:, :2]
        seen = np.einsum("gri,cgi->cgr", reach, x)
        mean = (weight[..., None] * seen).sum(axis=1)
        own = np.einsum("gri,cgij,grj->cgr", reach, P, reach) + size[..., None] * noise[:, [0, 1], [0, 1]]
        change = reach[:, 0] - [1.0, 0.0, 0.0, 0.0]
        moved = seen[..., 0] - x[..., 0]
        spread = (moved - (weight * moved).sum(axis=1, keepdims=True)) ** 2
        own_change = np.einsum("gi,cgij,gj->cg", change, P, change) + size * noise[:, 0, 0]
        made.mean.append(mean)
        made.by_rate.append(np.einsum("cg,gr->cr", weight, reach[..., 1]))
        made.var.append((weight[..., None] * (own + (seen - mean[:, None]) ** 2)).sum(axis=1))
        made.var_change.append((weight * (own_change + spread)).sum(axis=1))
    mean, kept, now = np.array(made.mean), _factor(bank, h), (weight * x[..., 0]).sum(axis=1)
    skill_var, made.by_rate = ((1.0 - kept) * mean) ** 2, np.array(made.by_rate)
    made.mean, made.var = kept * mean, _missed(bank, h, np.array(made.var) + skill_var)
    changes = np.repeat((np.array(made.var_change) + skill_var[..., 0])[..., None], 2, axis=-1)
    made.change, made.var_change = made.mean[..., 0] - now, _missed(bank, h, changes)[..., 0]
    return made


def forecast(b: State, t: int, horizons_s: F64, params: FilterParams) -> list[dict[str, Any]]:
    """Return the members of the core's `dl_deck_ahead` at each horizon, s, from an instant, ns."""
    b, o = b.copy(), params.options
    propagate(b, t, params)
    propagate_covariance(b, params)
    x, A = _aligned(b.x)
    P, u, Z = A @ b.P @ A.T, x[VESSEL_VEL], about_down(-heading(b.R))
    waves, d_now, made = _waves_ahead(b.bank, t, x[DECK_RATE], horizons_s), Z @ x[POS_REL], []
    for k, T in enumerate(horizons_s.tolist()):
        mean, change, by_rate, var = waves.mean[k], waves.change[k], waves.by_rate[k], waves.var[k]
        by, reach = _turned(float(x[TURN_RATE]), T)
        J, curving = np.zeros((3, N)), _QUARTER @ u * (0.5 * T * T)
        J[:, POS_REL], J[:, VEL], J[:2, VESSEL_VEL] = I3, -T * I3, reach
        d = Z @ (J @ x + change[:3])
        J[[0, 1, 2], DECK_RATE[:3]], J[:2, TURN_RATE] = by_rate[:3, 0], curving
        J = Z @ J
        J[:, ATT_ERR] = np.outer([d_now[1], -d_now[0], 0.0], heading_row(b.R) @ b.R)
        noise = np.diag(waves.var_change[k, :3])
        noise[:2, :2] += np.eye(2) * (o.asd_vessel_velocity_m_s2**2 * T**3 / 3.0)
        noise[:2, :2] += np.outer(curving, curving) * (0.2 * o.asd_turn_rate_rad_s2**2 * T)
        heave_var = var[2] + by_rate[2] ** 2 * P[DECK_RATE[2], DECK_RATE[2]]
        one = {
            "d": d, "cov_d": J @ P @ J.T + Z @ noise @ Z.T, "v_pad": Z @ (mean[:3, 1] + np.append(by @ u, 0.0)),
            "height": -mean[2, 0], "sigma_height": math.sqrt(heave_var[0]),
            "rise": -mean[2, 1], "sigma_rise": math.sqrt(heave_var[1]),
        }  # fmt: skip
        for name, axis in (("roll", 3), ("pitch", 4)):
            c = np.zeros(N)
            c[DECK_TRIM[axis - 3]] = c[DECK_DISP[axis]] = 1.0
            one[name] = c @ x + change[axis]
            c[DECK_RATE[axis]] = by_rate[axis, 0]
            one[f"sigma_{name}"] = math.sqrt(max(c @ P @ c + waves.var_change[k, axis], 0.0))
        made.append(one)
    return made
