"""The processing of one sample of the vehicle in numpy, against which the core is held."""

import math

import numpy as np

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range
from estimator.ekf.options import EkfOptions
from estimator.ekf.params import FilterParams
from tests.estimator.ekf.belief import ATTITUDE, Belief, Outcome, Vec3
from tests.estimator.ekf.oracle import algebra, measure, motion
from tests.estimator.ekf.oracle.aiding import fuse_baro, fuse_range, fuse_velocity, gather
from tests.estimator.ekf.oracle.propagate import forgotten, propagated

Sample = Imu | Attitude | BodyVelocity | Range | Baro
"""One of the vehicle's own samples."""
_SMOOTH_S = 0.03
"""Time constant of the smoothed body rate, s."""


def process_sample(b: Belief, event: Sample, params: FilterParams) -> tuple[Belief, Outcome]:
    """Return the belief after one sample of the vehicle and its outcome. An attitude must not set the belief's outright."""
    match event:
        case Imu():
            return _imu(b, event, params)
        case Attitude():
            return _attitude(b, event, params)
        case BodyVelocity():
            return fuse_velocity(b, event, params)
        case Range():
            return fuse_range(b, event, params)
        case Baro():
            return fuse_baro(b, event, params)


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
        b = motion.propagate_covariance(b, params, algebra.ALGEBRA)
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
    b = propagated(b, event.stamp.measured_at, params)
    innov = measure.attitude_innov(b.x, b.R, event.R_ned_body.matrix)
    b, outcome = gather(b, ATTITUDE, innov, event.cov_body, params)
    return b.changed(levelled_by=event.R_ned_body.matrix, cov_levelled_by=event.cov_body, heading_is_given=True), outcome
