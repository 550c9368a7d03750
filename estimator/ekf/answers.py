"""Motion of body and deck by a settled belief: what a control law needs beside the pad's place."""

from __future__ import annotations

import numpy as np

from estimator.contracts.geometry import Rotation, skew
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.time import MonoNs
from estimator.ekf import measure, so3
from estimator.ekf.motion import QUARTER
from estimator.ekf.options import EkfOptions
from estimator.ekf.state import (
    ACCEL_BIAS,
    ATT_ERR,
    DECK_DISP,
    DECK_RATE,
    DECK_TRIM,
    G_NED,
    GYRO_BIAS,
    SWAY_EAST,
    SWAY_NORTH,
    SWAY_PER_HEAVE,
    TURN_RATE,
    VESSEL_VEL,
    WAVES,
    Belief,
    N,
)

_IMU_HZ = 200.0
"""Rate at which a noise density is the noise of one sample, Hz."""


def body_motion(b: Belief, at: MonoNs, o: EkfOptions) -> BodyMotion | None:
    """Return the body's motion by the newest IMU sample; None while there is none or no attitude was reported.

    Args:
        b: the belief at `at`.
    """
    if b.t_imu < 0 or (at - b.t_imu) * 1e-9 > o.hold_s or b.levelled_by is None:
        return None
    R, P = b.R, b.P
    Z = so3.about_down(-so3.heading(R))
    f = R.dot(b.f - b.x[ACCEL_BIAS])
    J = np.zeros((3, N))
    J[:, ATT_ERR] = Z.dot(-skew(f)).dot(R)
    J[:, ACCEL_BIAS] = -Z.dot(R)
    cov = J.dot(P).dot(J.T) + np.eye(3) * (o.asd_accel_m_s2**2 * _IMU_HZ)
    return BodyMotion(
        at,
        so3.heading(R),
        Z.dot(f + G_NED),
        0.5 * (cov + cov.T),
        b.w - b.x[GYRO_BIAS],
        Rotation(b.levelled_by),
        b.cov_levelled_by,
    )


def deck_motion(b: Belief, at: MonoNs) -> DeckMotion:
    """Return the deck's motion by the oscillators of the main state (docs/estimator.md, section "Waves").

    Args:
        b: the belief at `at`, moved on by the camera's delay (`measure.aligned`).
    """
    x, P, sea = b.x, b.P, b.sea
    Z = so3.about_down(-so3.heading(b.R))
    w2, damp = sea.w_rad_s**2, 2.0 * sea.zeta * sea.w_rad_s
    rows = np.zeros((5, N))
    channel = np.arange(5)
    rows[channel, WAVES[:, 0]] = -w2
    rows[channel, WAVES[:, 1]] = -damp
    rows[channel, WAVES[:, 3]] = 1.0
    by_wave = rows[:3].dot(x)
    sway = x[SWAY_PER_HEAVE]

    J = np.zeros((10, N))
    J[:3] = Z.dot(measure.by_v_pad_ned(x))
    accelerate = rows[:3].copy()
    accelerate[:2] += np.outer(sway, rows[2])
    accelerate[[0, 1], [SWAY_NORTH, SWAY_EAST]] = by_wave[2]
    accelerate[:2, VESSEL_VEL] = float(x[TURN_RATE]) * QUARTER
    accelerate[:2, TURN_RATE] = QUARTER.dot(x[VESSEL_VEL])
    J[3:6] = Z.dot(accelerate)
    for k in range(2):
        J[6 + k, [DECK_DISP[3 + k], DECK_TRIM[k]]] = 1.0
        J[8 + k, DECK_RATE[3 + k]] = 1.0
    cov = J.dot(P).dot(J.T)
    cov = 0.5 * (cov + cov.T)

    a = by_wave.copy()
    a[:2] += sway * by_wave[2] + float(x[TURN_RATE]) * QUARTER.dot(x[VESSEL_VEL])
    roll, pitch, roll_rate, pitch_rate = J[6:].dot(x).tolist()
    return DeckMotion(
        at, Z.dot(measure.v_pad_ned(x)), Z.dot(a), cov[:6, :6], roll, pitch, roll_rate, pitch_rate, cov[6:, 6:]
    )  # fmt: skip
