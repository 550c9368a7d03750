"""How the belief moves on between measurements: at every IMU sample a little, and all of it where something is to be fused.

Derivation: docs/estimator.md, sections "Motion" and "Error".
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from estimator.contracts.geometry import F64
from estimator.ekf import so3
from estimator.ekf.algebra import Algebra
from estimator.ekf.options import EkfOptions
from estimator.ekf.oscillator import transition
from estimator.ekf.sea import carrying
from estimator.ekf.state import (
    BA,
    BARO,
    BG,
    DELAY,
    DISPLACEMENT,
    G_NED,
    GRAVITY_M_S2,
    HEAD,
    MOUNT,
    RATE,
    SCALE,
    SHORT,
    TH,
    TILT,
    TURN,
    WAVES,
    Belief,
    D,
    N,
    U,
    V,
)  # fmt: skip

_I3 = np.eye(3)
_IN = np.eye(N)
_D3 = np.arange(3, 6)
_SHORT_SHARE = 0.002
"""Of a direction's energy, in waves too short for the learned oscillators: these leave next to nothing above twice their own
frequency, a sea does not. It enters as white acceleration, the drive of a single oscillator with that energy."""
_SEA = slice(int(WAVES[0, 0]), int(WAVES[-1, -1]) + 1)
# Places in a flattened (N, N) matrix: assigning by one list of them takes a third of the time of assigning by two.
_BLOCKS = (WAVES[:, :, None] * N + WAVES[:, None, :]).ravel()
_D_BY_WAVES = (_D3[:, None] * N + WAVES[:3]).ravel()
_WAVES_BY_D = (WAVES[:3] * N + _D3[:, None]).ravel()
_D_BY_V, _V_BY_D = slice(3 * N + 6, 6 * N, N + 1), slice(6 * N + 3, 9 * N, N + 1)
_FIRST = np.array([1.0, 0.0, 0.0, 0.0])
_ZERO3, _ZERO33 = np.zeros(3), np.zeros((3, 3))


class Walk:
    """Noise that enters in proportion to time: (N,) densities, computed once."""

    def __init__(self, o: EkfOptions) -> None:
        self.options = o
        q = np.zeros(N)
        q[TH] = o.asd_gyro_rad_s**2
        q[BG] = o.asd_gyro_bias_rad_s2**2
        q[BA] = o.asd_accel_bias_m_s3**2
        q[SCALE] = o.asd_velocity_scale**2
        q[U] = o.asd_vessel_velocity_m_s2**2
        q[DELAY] = o.delay_drift_s_sqrt_s**2
        q[MOUNT] = o.mount_drift_rad_sqrt_s**2
        q[BARO] = o.asd_baro_offset_m**2
        q[SHORT] = o.asd_range_offset_m**2
        q[TILT] = o.asd_attitude_bias_rad_s**2
        self.psd = q
        self.carrying = carrying(o.asd_accel_m_s2, o.asd_gyro_rad_s, o.asd_accel_bias_m_s3)
        self.psd_accel = o.asd_accel_m_s2**2
        self.psd_coast = o.asd_coast_m_s2**2
        self.psd_coast_turn = o.asd_coast_rad_s**2


def carry(b: Belief, t: int, w_body: F64, f_body: F64, hold_ns: int, **also: Any) -> Belief:
    """To instant `t` (ns) with the rate and specific force as measured, or coasting where no IMU sample holds.

    Fields of the belief given in `also` are replaced along the way.
    """
    dt = (t - b.t) * 1e-9
    if dt <= 0.0:
        return b._replace(**also) if also else b
    if b.t_imu < 0 or t - b.t_imu > hold_ns:
        free = -G_NED
        return b._replace(
            t=t,
            dp=b.dp + b.dv * dt + free * (0.5 * dt * dt),
            dv=b.dv + free * dt,
            turned=b.turned + b.R * dt,
            coast_s=b.coast_s + dt,
            **also,
        )
    turn = so3.exp((w_body - b.x[BG]) * dt)
    R = b.R.dot(turn)
    mid = 0.5 * (b.R + R)
    a = mid.dot(f_body - b.x[BA])
    return b._replace(
        t=t,
        R=R,
        dp=b.dp + b.dv * dt + a * (0.5 * dt * dt),
        dv=b.dv + a * dt,
        turned=b.turned + mid * dt,
        levelled_by=None if b.levelled_by is None else b.levelled_by.dot(turn),
        **also,
    )


def settle(b: Belief, walk: Walk, algebra: Algebra) -> Belief:
    """Bring `x` and `P` from `t_cov` to `t`."""
    if b.t <= b.t_cov:
        return b
    after, F, Q = moved(b, walk)
    return after._replace(P=algebra.predict(b.P, F, Q))


class Linear(NamedTuple):
    """What moving on over some time does that the IMU has no part in. Shared by all who move so far: never written to."""

    A: F64
    """(5, 4, 4) of the oscillators."""
    fade: float
    """What is left of the rate of turn."""
    reach: float
    """s: what the rate of turn does to the heading."""
    F: F64
    """(N, N) but for what is turned or pushed."""
    Q: F64
    """(N, N)"""


# A late sighting has the same steps made again, and the sea's summary stays for some of them.
@lru_cache(maxsize=48)
def _linear(walk: Walk, T: float, coast_s: float, summary: bytes) -> Linear:
    """Over T s, `coast_s` of them without an IMU. `summary`: w_rad_s, zeta, sigma of the sea, one after the other."""
    o = walk.options
    w, zeta, sigma = np.frombuffer(summary).reshape(3, 5)
    A, q_unit = transition(w, zeta, T)
    q_unit[:, :2, :2] += (4.0 * _SHORT_SHARE * zeta * w**3)[:, None, None] * np.array(
        [[T**3 / 3.0, T * T / 2.0], [T * T / 2.0, T]]
    )
    q_waves = (sigma**2)[:, None, None] * q_unit
    fade = math.exp(-T / o.turn_rate_memory_s)
    reach = o.turn_rate_memory_s * (1.0 - fade)

    F = _IN.copy()
    F[D, V] = -T * _I3
    F[3, 16] = F[4, 17] = T
    flat = F.reshape(-1)
    flat[_BLOCKS] = A.ravel()
    flat[_D_BY_WAVES] = (A[:3, 0] - _FIRST).ravel()
    F[HEAD, TURN] = reach
    F[TURN, TURN] = fade

    Q = np.zeros((N, N))
    q = walk.psd * T
    force, spin = walk.psd_accel * T, 0.0
    if coast_s > 0.0:
        force += walk.psd_coast * coast_s
        spin = walk.psd_coast_turn * coast_s
    q[TH] += spin
    q[V] = force
    q[D] = force * (T * T / 3.0)
    sigma2 = o.sigma_turn_rate_rad_s**2
    q[TURN] = sigma2 * (1.0 - fade * fade)
    memory2 = o.turn_rate_memory_s**2
    q[HEAD] = max(0.0, sigma2 * memory2 * (2.0 * T / o.turn_rate_memory_s - 3.0 + 4.0 * fade - fade * fade))
    # What the noise does to a pad's displacement it does to its distance as well.
    q[D] += q_waves[:3, 0, 0]
    flat = Q.reshape(-1)
    flat[:: N + 1] = q
    flat[_BLOCKS] = q_waves.ravel()
    flat[_D_BY_WAVES] = flat[_WAVES_BY_D] = q_waves[:3, 0].ravel()
    flat[_D_BY_V] = flat[_V_BY_D] = -0.5 * T * force
    Q[HEAD, TURN] = Q[TURN, HEAD] = sigma2 * o.turn_rate_memory_s * (1.0 - fade) ** 2
    for part in (A, F, Q):
        part.setflags(write=False)
    return Linear(A, fade, reach, F, Q)


def moved(b: Belief, walk: Walk) -> tuple[Belief, F64, F64]:
    """The belief with all but `P` brought from `t_cov` to `t`, and the (N, N) F and Q by which `P` goes there."""
    T = (b.t - b.t_cov) * 1e-9
    sea = b.sea
    same = _linear(walk, T, b.coast_s, sea.w_rad_s.tobytes() + sea.zeta.tobytes() + sea.sigma.tobytes())

    x = b.x.copy()
    waves = b.x[_SEA].reshape(WAVES.shape)
    after = (same.A @ waves[:, :, None])[:, :, 0]
    x[_SEA] = after.ravel()
    fall = 0.5 * GRAVITY_M_S2 * T * T
    moved = (after - waves)[:3, 0] - b.x[V] * T - b.dp
    moved[2] -= fall
    moved[:2] += b.x[U] * T
    x[D] += moved
    x[V] += b.dv
    x[8] += GRAVITY_M_S2 * T
    x[HEAD] += b.x[TURN] * same.reach
    x[TURN] *= same.fade
    ins_p = b.ins_p + b.ins_v * T + b.dp
    ins_v = b.ins_v + b.dv
    ins_p[2] += fall
    ins_v[2] += GRAVITY_M_S2 * T

    F = same.F.copy()
    back = b.R.T.dot(b.R_cov)
    dv_R = so3.cross_matrix(b.dv).dot(b.R_cov)
    dp_R = so3.cross_matrix(b.dp).dot(b.R_cov)
    F[TH, TH] = back
    F[TH, BG] = (-0.5 * T) * (_I3 + back)
    F[V, TH] = -dv_R
    F[V, BG] = (0.5 * T) * dv_R
    F[V, BA] = -b.turned
    F[D, TH] = dp_R
    F[D, BG] = (-T / 3.0) * dp_R
    F[D, BA] = (0.5 * T) * b.turned

    R = so3.orthonormalised(b.R)
    belief = b._replace(R=R, x=x, t_cov=b.t, R_cov=R, dv=_ZERO3, dp=_ZERO3, turned=_ZERO33, coast_s=0.0, ins_p=ins_p, ins_v=ins_v)
    return belief, F, same.Q


def peek(b: Belief) -> F64:
    """(N,) the state at `t` without settling: exact in velocity, to (t - t_cov)^2 in the sea's motion."""
    T = (b.t - b.t_cov) * 1e-9
    if T <= 0.0:
        return b.x
    x = b.x.copy()
    drift = b.x[RATE[:3]] * T - b.x[V] * T - b.dp
    drift[2] -= 0.5 * GRAVITY_M_S2 * T * T
    drift[:2] += b.x[U] * T
    x[D] += drift
    x[DISPLACEMENT] += b.x[RATE] * T
    x[V] += b.dv
    x[8] += GRAVITY_M_S2 * T
    x[HEAD] += b.x[TURN] * T
    return x


def peek_velocity(b: Belief) -> F64:
    """(3,) of `peek`, v_body_ned alone."""
    v = b.x[V] + b.dv
    v[2] += GRAVITY_M_S2 * 1e-9 * (b.t - b.t_cov)
    return v


def peek_height(b: Belief) -> float:
    """Of `peek`, how far below the body the pad's mean level is, m."""
    T = (b.t - b.t_cov) * 1e-9
    x = b.x
    return float(x[5] - x[DISPLACEMENT[2]] - x[8] * T - b.dp[2]) - 0.5 * GRAVITY_M_S2 * T * T
