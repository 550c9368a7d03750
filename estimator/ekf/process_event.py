"""Process one event where Python does: what begins a belief, and an attitude that sets one outright. The core does the rest."""

import math

import numpy as np

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import F64, rpy_matrix, wrap_pi
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import Attitude, Imu
from estimator.core.abi import DL_WITH_COVARIANCE
from estimator.ekf import deck_motion_bank, so3
from estimator.ekf.options import EkfOptions
from estimator.ekf.outcome import Outcome
from estimator.ekf.packed_belief import PackedBelief
from estimator.ekf.packed_event import Event, packed_event
from estimator.ekf.params import FilterParams
from estimator.ekf.so3 import Vec3
from estimator.ekf.state import (
    ATT_BIAS,
    ATT_ERR,
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

_FELT_TILT_RAD = math.radians(12.0)
"""Standard deviation of the tilt from the accelerometer alone: a multirotor measures its thrust, which tilts with the body."""


def process_event(b: Belief | None, event: Event, params: FilterParams) -> tuple[Belief | None, Outcome]:
    """Return the belief after one event, which must not be older than the belief, and the event's outcome.

    A refused event leaves the belief unchanged. `b` is None before the first attitude.
    """
    if b is None:
        return _first(event, params)
    packed = PackedBelief.of(b)
    followed = packed.follow(params, [packed_event(event)])
    if followed:
        return followed[0].belief, followed.outcomes(1)[0]
    assert isinstance(event, Attitude)
    return _set_by(packed.propagated(event.stamp.measured_at, params, DL_WITH_COVARIANCE).belief, event, params)


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
        if abs(size - G_M_S2) < 0.5 * G_M_S2:
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


def _floats(v: F64) -> Vec3:
    x, y, z = v.tolist()
    return x, y, z


def _set_by(b: Belief, event: Attitude, params: FilterParams) -> tuple[Belief, Outcome]:
    """Set the attitude of a belief at the event's instant outright: the first gives a heading, or the belief's own diverged."""
    o, R = params.options, event.R_ned_body.matrix
    given = b.heading_is_given
    b = _set_attitude(b, R, o) if given else _turned_to(b, R, o)
    return _levelled(_correlated(b, o), event), Outcome(Verdict.FUSED)


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
    x[PAD_YAW] = wrap_pi(float(x[PAD_YAW]) + angle)
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
