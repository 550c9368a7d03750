"""Propagation to an instant and the application of a correction in numpy."""

import numpy as np

from estimator.contracts.geometry import F64, skew, wrap_pi
from estimator.ekf.options import EkfOptions
from estimator.ekf.params import FilterParams
from estimator.ekf.state import ATT_ERR, PAD_YAW, POS_REL, VEL_SCALE, N
from tests.estimator.ekf.belief import Belief, RejectionStreak
from tests.estimator.ekf.oracle import algebra, motion, so3
from tests.estimator.ekf.oracle.algebra import Correction


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
        b = motion.propagate_covariance(b, params, algebra.ALGEBRA)
    return b


def propagated_with_covariance(b: Belief, t: int, params: FilterParams) -> Belief:
    """Propagate the state as `propagated` does, and the covariance to `t` as well."""
    return motion.propagate_covariance(propagated(b, t, params), params, algebra.ALGEBRA)


def ready_to_fuse(b: Belief, t: int, params: FilterParams) -> Belief:
    """Propagate state and covariance to `t`, ns, and fuse the means of all gathered samples together.

    Gathered samples must be fused before any other correction; otherwise that correction would be applied twice.
    """
    from tests.estimator.ekf.oracle.aiding import aided

    return aided(propagated_with_covariance(b, t, params), params)


def forgotten(b: Belief, o: EkfOptions) -> Belief:
    """Return the belief without its pad if the last sighting is older than `o.forget_s`, else as it is."""
    if b.sighted >= 0 and (b.t - b.sighted) * 1e-9 > o.forget_s:
        return b._replace(sighted=-1, agreed=0, rejections=RejectionStreak())
    return b


def partial(before: F64, fix: Correction, withheld: F64, withheld_cov: F64) -> Correction:
    """Return the fraction 1 - `withheld` of a correction for each state, with as much of its gain in certainty as is honest.

    A deck's sway and heave belong to one wave, but the model takes them as independent. From their correlation over a few waves
    it would learn a camera tilt or a delay that does not exist. With `withheld_cov` equal to `withheld` the covariance is that of
    the smaller correction if the innovations are white. On waves they are alike for many sightings in a row, and a greater
    `withheld_cov` counts them as fewer.
    Source: Brink, Partial-update Schmidt-Kalman filter, J. Guidance, Control, and Dynamics 40(9), 2017.

    Args:
        before: (N, N) covariance before the correction.
        fix: the whole correction.
        withheld: (N,) fraction of each state's correction that is not applied.
        withheld_cov: (N,) the same for the root of the change of covariance, not less than `withheld`.
    """
    P = fix.P + withheld_cov[:, None] * (before - fix.P) * withheld_cov
    return fix._replace(dx=fix.dx * (1.0 - withheld), P=P)


def corrected(b: Belief, dx: F64, P: F64) -> Belief:
    """Apply a correction. Its attitude part rotates `R`, and the covariance is rewritten about the new attitude."""
    x = b.x + dx
    x[ATT_ERR] = 0.0
    x[PAD_YAW] = wrap_pi(float(x[PAD_YAW]))
    x[VEL_SCALE] = min(max(float(x[VEL_SCALE]), 0.2), 3.0)
    turn = so3.exp(dx[ATT_ERR])
    R = b.R.dot(turn)
    T = np.eye(N)
    # The corrected place tilts with the attitude (Barrau, Bonnabel 2017).
    T[POS_REL, ATT_ERR] = -skew(dx[POS_REL]).dot(b.R)
    # The error is now an error about the new attitude, so its axes turn by half the step (Sola 2017, eq. 287).
    T[ATT_ERR, ATT_ERR] -= 0.5 * skew(dx[ATT_ERR])
    P = T.dot(P).dot(T.T)
    return b.changed(x=x, P=P, R=R, R_cov=R)
