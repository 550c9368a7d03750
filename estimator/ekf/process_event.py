"""Process one event: propagate the belief to its instant and fuse it. `history.py` passes events in order of their instants."""

from __future__ import annotations

import math

import numpy as np

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.geometry import F64, rpy_matrix
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range, VesselReport
from estimator.ekf import deck_motion_bank, measure, motion, so3
from estimator.ekf.aiding import fuse_baro, fuse_range, fuse_velocity, fuse_vessel, gather
from estimator.ekf.options import EkfOptions
from estimator.ekf.propagate import Event, FilterParams, Outcome, forgotten, propagated, propagated_with_covariance
from estimator.ekf.so3 import Vec3
from estimator.ekf.state import (
    ATT_BIAS,
    ATT_ERR,
    ATTITUDE,
    PAD_YAW,
    POS_REL,
    SWAY_PER_HEAVE,
    VEL,
    VESSEL_VEL,
    WAVES,
    Belief,
    N,
    initial,
)  # fmt: skip
from estimator.ekf.vision_update import fuse_sighting

_FORCE_AT_REST = 9.80665
_DIVERGED_VAR = 0.35**2
"""Variance of the attitude error, rad^2, above which the small-angle approximation no longer holds."""
_FELT_TILT_RAD = math.radians(12.0)
"""Standard deviation of the tilt from the accelerometer alone: a multirotor measures its thrust, which tilts with the body."""
_SMOOTH_S = 0.03
"""Time constant of the smoothed body rate, s."""


def process_event(b: Belief | None, event: Event, params: FilterParams) -> tuple[Belief | None, Outcome]:
    """Return the belief after one event, which must not be older than the belief, and the event's result.

    A refused event leaves the belief unchanged. `b` is None before the first attitude.
    """
    if b is None:
        return _first(event, params)
    match event:
        case Imu():
            return _imu(b, event, params)
        case Attitude():
            return _attitude(b, event, params)
        case Sighting():
            return fuse_sighting(b, event, params)
        case BodyVelocity():
            return fuse_velocity(b, event, params)
        case Range():
            return fuse_range(b, event, params)
        case Baro():
            return fuse_baro(b, event, params)
        case VesselReport():
            return fuse_vessel(b, event, params)


def _first(event: Event, params: FilterParams) -> tuple[Belief | None, Outcome]:
    """Initialize the belief from an attitude, or from the tilt that an accelerometer at about 1 g shows."""
    o = params.options
    t = event.stamp.measured_at
    if isinstance(event, Attitude):
        b = initial(
            o, t, event.R_ned_body.matrix, o.sigma_initial_tilt_rad, o.sigma_initial_heading_rad, deck_motion_bank.unknown()
        )
        return _levelled(_correlated(b, o), event), Outcome(Verdict.FUSED)
    if isinstance(event, Imu):
        f = event.f_body
        size = float(np.linalg.norm(f))
        if abs(size - _FORCE_AT_REST) < 0.5 * _FORCE_AT_REST:
            x, y, z = f.tolist()
            R = rpy_matrix(math.atan2(-y, -z), math.atan2(x, math.hypot(y, z)), 0.0)
            b = initial(o, t, R, _FELT_TILT_RAD, math.radians(2.0), deck_motion_bank.unknown())
            w = _floats(event.w_body)
            return b._replace(t_imu=t, w=w, w_smooth=w, f=(x, y, z)), Outcome(Verdict.FUSED)
    return None, Outcome(Verdict.NO_ATTITUDE)


def _correlated(b: Belief, o: EkfOptions) -> Belief:
    """Correlate the attitude error with the attitude bias: the belief was just set from the vehicle's own attitude."""
    P = b.P.copy()
    var = o.sigma_attitude_bias_rad**2
    P[ATT_BIAS, :] = P[:, ATT_BIAS] = 0.0
    for i in range(2):
        P[ATT_BIAS[i], ATT_BIAS[i]] = var
        P[i, i] += var
        P[i, ATT_BIAS[i]] = P[ATT_BIAS[i], i] = -var
    return b._replace(P=P)


def _levelled(b: Belief, event: Attitude) -> Belief:
    return b.changed(levelled_by=event.R_ned_body.matrix, cov_levelled_by=event.cov_body, heading_is_given=True)


def _imu(b: Belief, event: Imu, params: FilterParams) -> tuple[Belief, Outcome]:
    o, t = params.options, event.stamp.measured_at
    hold_ns = round(o.hold_s * 1e9)
    w_body, f_body = _floats(event.w_body), _floats(event.f_body)
    alive = b.t_imu >= 0 and t - b.t_imu <= hold_ns
    if alive:
        (fx, fy, fz), (gx, gy, gz) = f_body, b.f
        (wx, wy, wz), (vx, vy, vz), (sx, sy, sz) = w_body, b.w, b.w_smooth
        step_f, step_w = max(abs(fx - gx), abs(fy - gy), abs(fz - gz)), max(abs(wx - vx), abs(wy - vy), abs(wz - vz))
        if step_f > o.accel_step_m_s2 or step_w > o.gyro_step_rad_s:
            b, w_body, f_body = _limited(b, event, step_f, step_w, o)
            (wx, wy, wz), (fx, fy, fz) = w_body, f_body
        weight = -math.expm1(-(t - b.t_imu) * 1e-9 / _SMOOTH_S)
        smooth = sx + weight * (wx - sx), sy + weight * (wy - sy), sz + weight * (wz - sz)
        w, f = (0.5 * (vx + wx), 0.5 * (vy + wy), 0.5 * (vz + wz)), (0.5 * (gx + fx), 0.5 * (gy + fy), 0.5 * (gz + fz))
        b = motion.propagate_state(b, t, w, f, hold_ns, t_imu=t, w=w_body, w_smooth=smooth, f=f_body)
    else:
        b = propagated(b, t, params)._replace(t_imu=t, w=w_body, w_smooth=w_body, f=f_body)
    if (b.t - b.t_cov) * 1e-9 >= o.tick_s:
        b = motion.propagate_covariance(b, params.process_noise, params.algebra)
    return forgotten(b, o), Outcome(Verdict.FUSED)


def _floats(v: F64) -> Vec3:
    x, y, z = v.tolist()
    return x, y, z


def _limited(b: Belief, event: Imu, step_f: float, step_w: float, o: EkfOptions) -> tuple[Belief, Vec3, Vec3]:
    """Return the belief, rate and force of a sample whose change was cut to what the vehicle can do.

    The part that was cut off is added to the belief's jolt variances.
    """
    dt = (event.stamp.measured_at - b.t) * 1e-9
    scale_f, scale_w = o.accel_step_m_s2 / max(step_f, o.accel_step_m_s2), o.gyro_step_rad_s / max(step_w, o.gyro_step_rad_s)
    b = b._replace(
        jolt_var_m2_s2=b.jolt_var_m2_s2 + (step_f * dt) ** 2 * (scale_f < 1.0),
        jolt_var_rad2=b.jolt_var_rad2 + (step_w * dt) ** 2 * (scale_w < 1.0),
    )
    w, f = np.array(b.w), np.array(b.f)
    return b, _floats(w + scale_w * (event.w_body - w)), _floats(f + scale_f * (event.f_body - f))


def _attitude(b: Belief, event: Attitude, params: FilterParams) -> tuple[Belief, Outcome]:
    o, t = params.options, event.stamp.measured_at
    if not b.heading_is_given:
        b = _correlated(_turned_to(propagated_with_covariance(b, t, params), event.R_ned_body.matrix, o), o)
        return _levelled(b, event), Outcome(Verdict.FUSED)
    b = propagated(b, t, params)
    if max(b.P.diagonal()[ATT_ERR].tolist()) > _DIVERGED_VAR:
        b = _correlated(_set_attitude(propagated_with_covariance(b, t, params), event.R_ned_body.matrix, o), o)
        return _levelled(b, event), Outcome(Verdict.FUSED)
    innov = measure.attitude_innov(b.x, b.R, event.R_ned_body.matrix)
    b, outcome = gather(b, ATTITUDE, innov, event.cov_body, params)
    return _levelled(b, event), outcome


def _turned_to(b: Belief, R: F64, o: EkfOptions) -> Belief:
    """Rotate the whole belief about the vertical to a heading that is now known, and set the attitude."""
    angle = so3.heading(R) - so3.heading(b.R)
    Z = so3.about_down(angle)
    T = np.eye(N)
    T[POS_REL, POS_REL] = T[VEL, VEL] = Z
    for part in WAVES[:3].T:
        T[np.ix_(part, part)] = Z
    T[VESSEL_VEL, VESSEL_VEL] = T[SWAY_PER_HEAVE, SWAY_PER_HEAVE] = Z[:2, :2]
    x = T.dot(b.x)
    x[PAD_YAW] = measure.wrap(float(x[PAD_YAW]) + angle)
    P = T.dot(b.P).dot(T.T)
    b = b._replace(x=x, P=0.5 * (P + P.T), ins_p=Z.dot(b.ins_p), ins_v=Z.dot(b.ins_v))
    return _set_attitude(b, R, o)


def _set_attitude(b: Belief, R: F64, o: EkfOptions) -> Belief:
    """Replace the attitude outright: the error of the old one is too large for the small-angle approximation."""
    P = b.P.copy()
    P[ATT_ERR, :] = P[:, ATT_ERR] = 0.0
    down = R.T[:, 2]
    along = np.outer(down, down)
    P[ATT_ERR, ATT_ERR] = o.sigma_initial_tilt_rad**2 * (np.eye(3) - along) + o.sigma_initial_heading_rad**2 * along
    return b._replace(R=R, R_cov=R, P=P)
