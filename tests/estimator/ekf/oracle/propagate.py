"""Propagation to an instant in numpy."""

from __future__ import annotations

from estimator.ekf.propagate import FilterParams
from estimator.ekf.state import Belief
from tests.estimator.ekf.oracle import motion


def propagated(b: Belief, t: int, params: FilterParams) -> Belief:
    """Propagate to instant `t`, ns, by the IMU sample that holds, or coast if none does.

    The covariance is propagated as often as the options ask.
    """
    o = params.options
    hold_ns = round(o.hold_s * 1e9)
    if b.t_imu >= 0 and b.t < b.t_imu + hold_ns < t:
        b = motion.propagate_state(b, b.t_imu + hold_ns, b.w, b.f, hold_ns)
    b = motion.propagate_state(b, t, b.w, b.f, hold_ns)
    if (b.t - b.t_cov) * 1e-9 >= o.tick_s:
        b = motion.propagate_covariance(b, params.process_noise, params.algebra)
    return b


def propagated_with_covariance(b: Belief, t: int, params: FilterParams) -> Belief:
    """Propagate the state as `propagated` does, and the covariance to `t` as well."""
    return motion.propagate_covariance(propagated(b, t, params), params.process_noise, params.algebra)
