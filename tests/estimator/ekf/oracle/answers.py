"""Answers of the filter for an instant, in numpy: the oracle of estimator/core/filter/answer.c."""

from typing import NamedTuple

import numpy as np

from estimator.contracts.estimates import UNKNOWN_YAW_VAR
from estimator.contracts.geometry import F64, skew, wrap_pi
from estimator.ekf.params import FilterParams
from estimator.ekf.state import (
    ACCEL_BIAS,
    ATT_ERR,
    CAMERA_DELAY,
    DECK_DISP,
    DECK_RATE,
    DECK_TRIM,
    GYRO_BIAS,
    PAD_YAW,
    POS_REL,
    TURN_RATE,
    VEL,
    VESSEL_VEL,
    WAVES,
    N,
)
from tests.estimator.ekf.belief import G_NED, Belief
from tests.estimator.ekf.oracle import motion, so3
from tests.estimator.ekf.oracle.motion import QUARTER
from tests.estimator.ekf.oracle.pad_velocity import BY_V_PAD, v_pad_ned
from tests.estimator.ekf.oracle.propagate import propagated
from tests.estimator.ekf.oracle.so3 import about_down, heading

_IMU_HZ = 200.0


class Settled(NamedTuple):
    """The belief propagated to an instant, with the covariance of at most `EkfOptions.tick_s` before."""

    b: Belief
    """Everything but `P` holds at the instant."""
    F: F64
    Q: F64
    """(N, N): with F they propagate `P` to the instant."""
    x: F64
    """(N,) state with the deck moved from the camera's time to the body's."""
    T: F64
    """(N, N) Jacobian of `x`."""


class Pad(NamedTuple):
    """Place and velocity in level, the heading against the arrow, and their covariance."""

    d: F64
    v: F64
    yaw: float | None
    cov: F64


class Body(NamedTuple):
    heading: float
    a: F64
    cov_a: F64
    w: F64


class Deck(NamedTuple):
    v: F64
    a: F64
    cov: F64
    tilt: F64
    cov_tilt: F64


def aligned(b: Belief) -> tuple[F64, F64]:
    """Return the (N,) state with the deck moved from the camera's time to the body's, and the (N, N) Jacobian of that."""
    late, rate = b.x[CAMERA_DELAY], b.x[DECK_RATE]
    x = b.x.copy()
    x[DECK_DISP] -= late * rate
    x[POS_REL] -= late * rate[:3]
    T = np.eye(N)
    T[DECK_DISP, DECK_RATE] = -late
    T[np.arange(POS_REL.start, POS_REL.stop), DECK_RATE[:3]] = -late
    T[DECK_DISP, CAMERA_DELAY] = -rate
    T[POS_REL, CAMERA_DELAY] = -rate[:3]
    return x, T


def settled(b: Belief, t: int, params: FilterParams) -> Settled:
    b, F, Q = motion.moved(propagated(b, t, params), params)
    return Settled(b, F, Q, *aligned(b))


def pad(now: Settled) -> Pad:
    b, F, Q, x, T = now
    psi = heading(b.R)
    Z = about_down(-psi)
    d, v = Z.dot(x[POS_REL]), Z.dot(v_pad_ned(x) - x[VEL])
    turning = so3.heading_row(b.R).dot(b.R)
    J = np.zeros((7, N))
    J[:3, POS_REL] = Z
    J[:3, ATT_ERR] = np.outer([d[1], -d[0], 0.0], turning)
    J[3:6] = Z.dot(BY_V_PAD)
    J[3:6, VEL] = -Z
    J[3:6, ATT_ERR] = np.outer([v[1], -v[0], 0.0], turning)
    J[6, ATT_ERR] = turning
    J[6, PAD_YAW] = -1.0
    J = J.dot(T)
    cov = J.dot(Q).dot(J.T)
    J = J.dot(F)
    cov += J.dot(b.P).dot(J.T)
    if b.heading_known:
        return Pad(d, v, wrap_pi(psi - float(x[PAD_YAW])), cov)
    cov[6, :] = cov[:, 6] = 0.0
    cov[6, 6] = UNKNOWN_YAW_VAR
    return Pad(d, v, None, cov)


def body(now: Settled, params: FilterParams) -> Body:
    b, R = now.b, now.b.R
    Z = about_down(-heading(R))
    f = R.dot(b.f - b.x[ACCEL_BIAS])
    J = np.zeros((3, N))
    J[:, ATT_ERR] = Z.dot(-skew(f)).dot(R)
    J[:, ACCEL_BIAS] = -Z.dot(R)
    cov = J.dot(b.P).dot(J.T) + np.eye(3) * (params.options.asd_accel_m_s2**2 * _IMU_HZ)
    return Body(heading(R), Z.dot(f + G_NED), cov, b.w - b.x[GYRO_BIAS])


def deck(now: Settled) -> Deck:
    b, x, T = now.b, now.x, now.T
    sea, P = b.sea, T.dot(b.P).dot(T.T)
    Z = about_down(-heading(b.R))
    w2, damp = sea.w_rad_s**2, 2.0 * sea.zeta * sea.w_rad_s
    rows = np.zeros((5, N))
    channel = np.arange(5)
    rows[channel, WAVES[:, 0]] = -w2
    rows[channel, WAVES[:, 1]] = -damp
    rows[channel, WAVES[:, 3]] = 1.0
    J = np.zeros((10, N))
    J[:3] = Z.dot(BY_V_PAD)
    accelerate = rows[:3].copy()
    accelerate[:2, VESSEL_VEL] = float(x[TURN_RATE]) * QUARTER
    accelerate[:2, TURN_RATE] = QUARTER.dot(x[VESSEL_VEL])
    J[3:6] = Z.dot(accelerate)
    for k in range(2):
        J[6 + k, [DECK_DISP[3 + k], DECK_TRIM[k]]] = 1.0
        J[8 + k, DECK_RATE[3 + k]] = 1.0
    cov = J.dot(P).dot(J.T)
    a = rows[:3].dot(x)
    a[:2] += float(x[TURN_RATE]) * QUARTER.dot(x[VESSEL_VEL])
    return Deck(Z.dot(v_pad_ned(x)), Z.dot(a), cov[:6, :6], J[6:].dot(x), cov[6:, 6:])
