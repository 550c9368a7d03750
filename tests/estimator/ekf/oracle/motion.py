"""Propagation of the belief in numpy: the nominal state at every IMU sample, the rest just before a fusion."""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from estimator.contracts.geometry import F64, orthonormalised, skew
from estimator.contracts.motion import G_M_S2
from estimator.ekf.params import FilterParams
from estimator.ekf.state import (
    ACCEL_BIAS,
    ATT_AXES,
    ATT_ERR,
    GYRO_BIAS,
    PAD_YAW,
    POS_AXES,
    POS_DOWN,
    POS_HORIZONTAL,
    POS_NORTH,
    POS_REL,
    TURN_RATE,
    VEL,
    VEL_AXES,
    VEL_DOWN,
    VEL_NORTH,
    VESSEL_VEL,
    WAVE_YAW,
    WAVES,
    YAW_RATE,
    N,
)
from tests.estimator.ekf.belief import NO_VEC3, Belief, Vec3
from tests.estimator.ekf.oracle import so3
from tests.estimator.ekf.oracle.algebra import Algebra
from tests.estimator.ekf.oracle.oscillator import transition

QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])
"""Rotation of a horizontal vector clockwise by 90 degrees. A vector v that turns at w rad/s has the rate w QUARTER v."""
_I3 = np.eye(3)
_IN = np.eye(N)
_POS = np.array(POS_AXES)
_SHORT_FRACTION = 0.002
"""Fraction of a direction's energy that lies in waves too short for the learned oscillators. They have almost no energy
above twice their own frequency, but a sea has. This fraction enters as white acceleration, which drives one oscillator of that
energy."""
_STEERS_S, _STEERS_PSD, _STEERS_TURN_PSD = 0.4, 0.4, 0.025
"""Time for which a ship that manoeuvres is assumed to go on, s, and the densities of her accelerations meanwhile."""
_SEA = slice(int(WAVES[0, 0]), int(WAVES[-1, -1]) + 1)
_DISPLACEMENTS, _RATES = (slice(_SEA.start + i, _SEA.stop, WAVES.shape[1]) for i in (0, 1))
# These are indices into a flattened (N, N) matrix. Assignment by one index list takes a third of the time of assignment by two.
_BLOCKS = (WAVES[:, :, None] * N + WAVES[:, None, :]).ravel()
_POS_BY_WAVES = (_POS[:, None] * N + WAVES[:3]).ravel()
_WAVES_BY_POS = (WAVES[:3] * N + _POS[:, None]).ravel()
_POS_BY_VEL = slice(POS_NORTH * N + VEL_NORTH, (POS_DOWN + 1) * N, N + 1)
_VEL_BY_POS = slice(VEL_NORTH * N + POS_NORTH, (VEL_DOWN + 1) * N, N + 1)
_FIRST = np.array([1.0, 0.0, 0.0, 0.0])
_ZERO33 = np.zeros((3, 3))
_IMU_BIASES = slice(GYRO_BIAS.start, ACCEL_BIAS.stop)
_HEAVE = int(WAVES[2, 0])
_YAW = np.array([WAVE_YAW, YAW_RATE])
_YAW_DAMPING = 0.5


def propagate_state(b: Belief, t: int, w_body: Vec3, f_body: Vec3, hold_ns: int, **also: Any) -> Belief:
    """Propagate the nominal state to instant `t`, ns, by the measured rate and specific force; coast if no IMU sample holds.

    The fields of the belief that `also` names are replaced in the same step.
    """
    dt = (t - b.t) * 1e-9
    if dt <= 0.0:
        return b.changed(**also) if also else b
    if b.t_imu < 0 or t - b.t_imu > hold_ns:
        dp, dv = _moved_by(b, (0.0, 0.0, -G_M_S2 * dt), dt)
        return b.changed(t=t, dp=dp, dv=dv, turned=b.turned + b.R * dt, coast_s=b.coast_s + dt, **also)
    gx, gy, gz, ax, ay, az = b.x[_IMU_BIASES].tolist()
    (wx, wy, wz), (fx, fy, fz) = w_body, f_body
    turn = so3.rotation_by((wx - gx) * dt, (wy - gy) * dt, (wz - gz) * dt)
    R = b.R.dot(turn)
    step = (b.R + R) * (0.5 * dt)
    dp, dv = _moved_by(b, step.dot((fx - ax, fy - ay, fz - az)).tolist(), dt)
    levelled_by = None if b.levelled_by is None else b.levelled_by.dot(turn)
    return b.changed(t=t, R=R, dp=dp, dv=dv, turned=b.turned + step, levelled_by=levelled_by, **also)


def _moved_by(b: Belief, dv: Vec3, dt: float) -> tuple[Vec3, Vec3]:
    """Return the belief's `dp` and `dv` after a step of dt s in which the velocity changes steadily by `dv`, m/s."""
    (px, py, pz), (vx, vy, vz), (x, y, z), half = b.dp, b.dv, dv, 0.5 * dt
    dp = px + vx * dt + x * half, py + vy * dt + y * half, pz + vz * dt + z * half
    return dp, (vx + x, vy + y, vz + z)


def propagate_covariance(b: Belief, params: FilterParams, algebra: Algebra) -> Belief:
    """Bring `x` and `P` from `t_cov` to `t`."""
    if b.t <= b.t_cov:
        return b
    after, F, Q = moved(b, params)
    return after.changed(P=algebra.predict(b.P, F, Q))


class Linear(NamedTuple):
    """The part of a propagation that does not depend on the IMU. The cache shares it between callers, so it is read-only."""

    A: F64
    """(5, 4, 4) transition of the oscillators."""
    A_yaw: F64
    """(2, 2) transition of the yaw on waves and its rate."""
    F: F64
    """(N, N) transition of the error, without the blocks that depend on the attitude, the specific force or the turn."""
    Q: F64
    """(N, N) process noise."""


# A late sighting repeats the same steps, and the summary of the sea stays the same for some of them.
@lru_cache(maxsize=48)
def _linear(params: FilterParams, T: float, coast_s: float, summary: bytes) -> Linear:
    """Return the linear part of a propagation over T s, of which `coast_s` had no IMU.

    `summary` holds the bytes of the sea's w_rad_s, zeta and sigma, one after the other.
    """
    o = params.options
    w, zeta, sigma = np.frombuffer(summary).reshape(3, 5)
    A, q_unit = transition(w, zeta, T)
    q_unit[:, :2, :2] += (4.0 * _SHORT_FRACTION * zeta * w**3)[:, None, None] * np.array(
        [[T**3 / 3.0, T * T / 2.0], [T * T / 2.0, T]]
    )
    q_waves = (sigma**2)[:, None, None] * q_unit
    A_yaw, q_yaw = _yawing(math.tau / o.wave_yaw_period_s, T)
    q_yaw = q_yaw * o.sigma_wave_yaw_rate_rad_s**2

    F = _IN.copy()
    F[POS_REL, VEL] = -T * _I3
    flat = F.reshape(-1)
    flat[_BLOCKS] = A.ravel()
    flat[_POS_BY_WAVES] = (A[:3, 0] - _FIRST).ravel()
    F[_YAW[:, None], _YAW] = A_yaw
    F[PAD_YAW, _YAW] = A_yaw[0] - _FIRST[:2]
    F[PAD_YAW, TURN_RATE] = T

    Q = np.zeros((N, N))
    q = params.psd * T
    force, spin = params.psd_accel * T, 0.0
    if coast_s > 0.0:
        force += params.psd_coast * coast_s
        spin = params.psd_coast_turn * coast_s
    q[ATT_ERR] += spin
    q[VEL] = force
    q[POS_REL] = force * (T * T / 3.0)
    q[PAD_YAW] = q_yaw[0, 0] + q[TURN_RATE] * (T * T / 3.0)
    # The noise changes the pad's relative position by as much as its displacement.
    q[POS_REL] += q_waves[:3, 0, 0]
    flat = Q.reshape(-1)
    flat[:: N + 1] = q
    flat[_BLOCKS] = q_waves.ravel()
    flat[_POS_BY_WAVES] = flat[_WAVES_BY_POS] = q_waves[:3, 0].ravel()
    flat[_POS_BY_VEL] = flat[_VEL_BY_POS] = -0.5 * T * force
    Q[_YAW[:, None], _YAW] = q_yaw
    Q[PAD_YAW, _YAW] = Q[_YAW, PAD_YAW] = q_yaw[0]
    Q[PAD_YAW, TURN_RATE] = Q[TURN_RATE, PAD_YAW] = 0.5 * T * q[TURN_RATE]
    for part in (A, A_yaw, F, Q):
        part.setflags(write=False)
    return Linear(A, A_yaw, F, Q)


def _yawing(w: float, T: float) -> tuple[F64, F64]:
    """Return the (2, 2) transition of yaw on waves and its rate over T s, and the (2, 2) noise for a unit rate.

    The model is a damped oscillator.
    """
    delta = _YAW_DAMPING * w
    wd = math.sqrt(w * w - delta * delta)
    e = math.exp(-delta * T)
    c, s = e * math.cos(wd * T), e * math.sin(wd * T) / wd
    a, b, d, f = c + delta * s, s, -w * w * s, c - delta * s
    # P - A P A' with the stationary P = diag(1 / w^2, 1).
    at_rest = 1.0 / (w * w)
    across = -(a * d * at_rest + b * f)
    q = np.array([[at_rest - (a * a * at_rest + b * b), across], [across, 1.0 - (d * d * at_rest + f * f)]])
    return np.array([[a, b], [d, f]]), q


def moved(b: Belief, params: FilterParams) -> tuple[Belief, F64, F64]:
    """Return the belief with everything but `P` propagated from `t_cov` to `t`, and the (N, N) F and Q that propagate `P`."""
    T = (b.t - b.t_cov) * 1e-9
    sea = b.sea
    same = _linear(params, T, b.coast_s, sea.w_rad_s.tobytes() + sea.zeta.tobytes() + sea.sigma.tobytes())

    x = b.x.copy()
    waves = b.x[_SEA].reshape(WAVES.shape)
    after = (same.A @ waves[:, :, None])[:, :, 0]
    x[_SEA] = after.ravel()
    fall = 0.5 * G_M_S2 * T * T
    moved = (after - waves)[:3, 0] - b.x[VEL] * T - b.dp
    moved[2] -= fall
    turn, rate = turned(float(b.x[TURN_RATE]), T), b.x[TURN_RATE]
    u = b.x[VESSEL_VEL]
    x[VESSEL_VEL] = turn.by.dot(u)
    moved[:2] += turn.reach.dot(u)
    x[POS_REL] += moved
    x[VEL] += b.dv
    x[VEL_DOWN] += G_M_S2 * T
    x[_YAW] = same.A_yaw.dot(b.x[_YAW])
    x[PAD_YAW] += rate * T + float(x[WAVE_YAW] - b.x[WAVE_YAW])
    # The downward accelerometer bias is not removed: a change of its estimate in flight would look like a jerk of the deck.
    biased = float(b.turned[2].dot(b.x[ACCEL_BIAS]))
    ins_p = b.ins_p + b.ins_v * T + b.dp
    ins_v = b.ins_v + b.dv
    ins_p[2] += 0.5 * T * biased
    ins_v[2] += biased
    ins_p[2] += fall
    ins_v[2] += G_M_S2 * T

    F = same.F.copy()
    back = b.R.T.dot(b.R_cov)
    dv_R = skew(b.dv).dot(b.R_cov)
    dp_R = skew(b.dp).dot(b.R_cov)
    F[ATT_ERR, ATT_ERR] = back
    F[ATT_ERR, GYRO_BIAS] = (-0.5 * T) * (_I3 + back)
    F[VEL, ATT_ERR] = -dv_R
    F[VEL, GYRO_BIAS] = (0.5 * T) * dv_R
    F[VEL, ACCEL_BIAS] = -b.turned
    F[POS_REL, ATT_ERR] = dp_R
    F[POS_REL, GYRO_BIAS] = (-T / 3.0) * dp_R
    F[POS_REL, ACCEL_BIAS] = (0.5 * T) * b.turned
    F[POS_HORIZONTAL, VESSEL_VEL] = turn.reach
    F[VESSEL_VEL, VESSEL_VEL] = turn.by
    F[VESSEL_VEL, TURN_RATE] = T * QUARTER.dot(x[VESSEL_VEL])
    F[POS_HORIZONTAL, TURN_RATE] = (0.5 * T * T) * QUARTER.dot(u)
    Q = same.Q.copy()

    if b.steered >= 0 and (b.t_cov - b.steered) * 1e-9 < _STEERS_S:
        Q[VESSEL_VEL, VESSEL_VEL] += _STEERS_PSD * T * np.eye(2)
        Q[TURN_RATE, TURN_RATE] += _STEERS_TURN_PSD * T
        Q[PAD_YAW, PAD_YAW] += _STEERS_TURN_PSD * T**3 / 3.0
        Q[PAD_YAW, TURN_RATE] += 0.5 * T * T * _STEERS_TURN_PSD
        Q[TURN_RATE, PAD_YAW] = Q[PAD_YAW, TURN_RATE]

    if b.jolt_var_m2_s2 > 0.0 or b.jolt_var_rad2 > 0.0:
        # The whole jolt is assumed to have come at the beginning, which makes the position most uncertain.
        flat, jolt = Q.reshape(-1), b.jolt_var_m2_s2
        for att, pos, vel in zip(ATT_AXES, POS_AXES, VEL_AXES, strict=True):
            Q[att, att] += b.jolt_var_rad2
            Q[vel, vel] += jolt
            Q[pos, pos] += jolt * T * T
        flat[_POS_BY_VEL] -= jolt * T
        flat[_VEL_BY_POS] -= jolt * T

    if is_swung(b, b.t_cov):
        # A first-order Gauss-Markov process about the motion before.
        settling, stays = [*range(N)[VESSEL_VEL], TURN_RATE], math.exp(-T / 0.3)
        about = np.append(x[VEL][:2] - ins_v[:2] + b.vessel_before, 0.0)
        x[settling] = about + stays * (x[settling] - about)
        M = np.eye(N)
        M[settling, settling], M[settling[:2], VEL_AXES[:2]] = stays, 1.0 - stays
        F, Q = M.dot(F), M.dot(Q).dot(M.T)
        Q[settling, settling] += (1.0 - stays**2) * np.array([0.7, 0.7, 0.5]) ** 2

    R = orthonormalised(b.R)
    belief = b.changed(R=R, x=x, t_cov=b.t, R_cov=R, dv=NO_VEC3, dp=NO_VEC3, turned=_ZERO33, coast_s=0.0,
        ins_p=ins_p, ins_v=ins_v, ins_var_m2_s2=b.ins_var_m2_s2 + b.jolt_var_m2_s2 + params.psd_coast * b.coast_s,
        jolt_var_m2_s2=0.0, jolt_var_rad2=0.0,
    )  # fmt: skip
    return belief, F, Q


def is_swung(b: Belief, t: int) -> bool:
    """Return whether the pad went out of sight while its ship swung it aside, and the swing may go on."""
    lost = any(shown >= 0 and (b.sighted - shown) * 1e-9 < within_s for shown, within_s in ((b.swung, 1.0), (b.steered, 0.1)))
    return lost and b.sighted >= 0 and 0.3 < (t - b.sighted) * 1e-9 < 2.0


def peek(b: Belief) -> F64:
    """Return the (N,) state at `t` without propagating the covariance.

    The velocity is exact; the sea's motion has an error of order (t - t_cov)^2.
    """
    T = (b.t - b.t_cov) * 1e-9
    if T <= 0.0:
        return b.x
    x = b.x.copy()
    rates = b.x[_RATES]
    drift = rates[:3] * T - b.x[VEL] * T - b.dp
    drift[2] -= 0.5 * G_M_S2 * T * T
    drift[:2] += b.x[VESSEL_VEL] * T
    x[POS_REL] += drift
    x[_DISPLACEMENTS] += rates * T
    x[VEL] += b.dv
    x[VEL_DOWN] += G_M_S2 * T
    x[PAD_YAW] += (b.x[YAW_RATE] + b.x[TURN_RATE]) * T
    return x


def peek_velocity(b: Belief) -> Vec3:
    """Return only v_body_ned of `peek`, m/s."""
    (x, y, z), (dx, dy, dz) = b.x[VEL].tolist(), b.dv
    return x + dx, y + dy, z + dz + G_M_S2 * 1e-9 * (b.t - b.t_cov)


def peek_height(b: Belief) -> float:
    """Return only the depth of the pad's mean level below the body, as `peek` has it, metres."""
    T = (b.t - b.t_cov) * 1e-9
    x = b.x
    return x.item(POS_DOWN) - x.item(_HEAVE) - x.item(VEL_DOWN) * T - b.dp[2] - 0.5 * G_M_S2 * T * T


class Turned(NamedTuple):
    """The effect of a steady turn on a horizontal vector that turns with the vessel."""

    by: F64
    """(2, 2) rotation."""
    reach: F64
    """(2, 2) integral of the rotation over time, s."""


def turned(rate_rad_s: float, T: float) -> Turned:
    """Return the turn by a steady rate over T s. A positive rate is clockwise from above."""
    angle = rate_rad_s * T
    s, c = math.sin(angle), math.cos(angle)
    along, across = T * (1.0 - angle * angle / 6.0), 0.5 * T * angle
    if abs(angle) > 1e-3:
        along, across = s / rate_rad_s, (1.0 - c) / rate_rad_s
    return Turned(np.array([[c, -s], [s, c]]), np.array([[along, -across], [across, along]]))
