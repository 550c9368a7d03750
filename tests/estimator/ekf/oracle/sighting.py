"""The measurement models of sightings and vessel reports in numpy, against which the core's are held.

Derivation: docs/estimator.md, section "Measurements". Each model takes the parts of the settled state and returns a
`LinearizedMeasurement`.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64, rpy_matrix, skew, wrap_pi
from estimator.ekf.state import (
    ATT_ERR,
    CAMERA_DELAY,
    CAMERA_MOUNT,
    DECK_DISP,
    DECK_RATE,
    DECK_TRIM,
    GYRO_BIAS,
    PAD_YAW,
    POS_REL,
    TURN_RATE,
    VEL,
    VESSEL_EAST,
    VESSEL_NORTH,
    VESSEL_VEL,
    YAW_RATE,
    N,
)
from tests.estimator.ekf.belief import Vec3
from tests.estimator.ekf.oracle import so3
from tests.estimator.ekf.oracle.pad_velocity import BY_V_PAD, v_pad_ned
from tests.estimator.ekf.oracle.so3 import about_down, heading

_DOWN = np.array([0.0, 0.0, 1.0])
_NONE = np.zeros((0, N))
_ROLL, _PITCH = int(DECK_DISP[3]), int(DECK_DISP[4])
_NOT_A_PART = 1.5
"""An attitude covariance above this many times the covariance that should contain it is no part of it. The different
linearisations of vision and filter cause a few hundredths."""
KNOWN_YAW_VAR = 2.0
"""Variance, rad^2, above which a heading carries no information."""


class LinearizedMeasurement(NamedTuple):
    """A measurement of m numbers, linearised about the state."""

    innov: F64
    """(m,) innovation: measured minus predicted."""
    H: F64
    """(m, N) Jacobian of the prediction with respect to the error state."""
    R: F64
    """(m, m) covariance of the measurement noise."""
    G: F64
    """(3, N) Jacobian of the rate of the position that a sighting shows; (0, N) for every other measurement."""


class PadAttitude(NamedTuple):
    """The pad's attitude and angular velocity."""

    R: F64
    """(3, 3) R_ned_pad."""
    axes: F64
    """(3, 3) matrix whose columns are the axes, in ned, about which roll, pitch and heading turn the pad."""
    w_ned: F64
    """(3,) angular velocity in ned, rad/s."""


def deck(x: F64) -> PadAttitude:
    """Return the pad's attitude by its heading, its list and trim, and the oscillators of roll and pitch."""
    roll, pitch, yaw = float(x[_ROLL] + x[DECK_TRIM[0]]), float(x[_PITCH] + x[DECK_TRIM[1]]), float(x[PAD_YAW])
    R = rpy_matrix(roll, pitch, yaw)
    c, s = math.cos(yaw), math.sin(yaw)
    cp = math.cos(pitch)
    axes = np.array([[c * cp, -s, 0.0], [s * cp, c, 0.0], [-math.sin(pitch), 0.0, 1.0]])
    return PadAttitude(R, axes, axes.dot([x[DECK_RATE[3]], x[DECK_RATE[4]], x[YAW_RATE] + x[TURN_RATE]]))


def sighting(
    x: F64,
    R: F64,
    w: Vec3,
    s: Sighting,
    levelled_by: F64 | None,
    cov_levelled_by: F64,
    yaw_sigma: float,
    *,
    place_only: bool = False,
    rate_var: float = 0.0,
) -> LinearizedMeasurement:
    """Return the measurement of the pad's position in body axes, and of its heading or whole orientation.

    A sighting is written in `level`, which vision found with the vehicle's own attitude. The inverse rotation by that attitude
    gives what the camera saw, without that attitude's error.

    When the frame is later than its stamp, the deck in it is later too. The state holds the deck that the camera shows: its waves
    cannot be distinguished from the same waves a little later. So only the body's motion is corrected by the delay; `aligned`
    does the rest.

    Args:
        x: (N,), R: (3, 3) R_ned_body, at the sighting's stamp.
        w: (3,) rad/s, gyro as measured.
        levelled_by: (3, 3) R_ned_body by the vehicle's own attitude; None when the filter's own must do.
        cov_levelled_by: (3, 3) rad^2, the part of the sighting's covariance that comes from that attitude; zeros leave it in.
        yaw_sigma: sigma of the relative heading, rad: an ambiguous heading is of use only when the sigma is small.
        place_only: use the position only, without heading and orientation.
        rate_var: (rad/s)^2, variance of the turn rate about each axis over the time by which the stamp may err.
    """
    A = levelling(R, levelled_by)
    E = so3.exp(-x[CAMERA_MOUNT])
    d_b = R.T.dot(x[POS_REL])
    late = float(x[CAMERA_DELAY])
    turning = skew(w - x[GYRO_BIAS])
    v_b = R.T.dot(np.array([x[VESSEL_NORTH], x[VESSEL_EAST], 0.0]) - x[VEL])
    rates = v_b - turning.dot(d_b)
    shown = d_b + late * rates
    jl = so3.left_jacobian(x[CAMERA_MOUNT])

    whole = s.pose6
    m = 3
    if place_only:
        pass
    elif whole is not None:
        m = 6
    elif s.yaw_rad is not None and s.cov[3, 3] < KNOWN_YAW_VAR and not (s.yaw_ambiguous and yaw_sigma > 0.5):
        m = 4
    H = np.zeros((m, N))
    innov = np.zeros(m)
    ER = E.dot(R.T)
    arm = skew(d_b)
    by_rate = np.zeros((3, N))
    by_rate[:, ATT_ERR] = E.dot(skew(v_b) - turning.dot(arm))
    by_rate[:, POS_REL] = -E.dot(turning).dot(R.T)
    by_rate[:, VEL] = -ER
    by_rate[:, VESSEL_VEL] = ER[:, :2]
    by_rate[:, GYRO_BIAS] = -E.dot(arm)
    H[:3, ATT_ERR] = E.dot(arm)
    H[:3, POS_REL] = ER
    H[:3] += late * by_rate
    H[:3, CAMERA_MOUNT] = E.dot(skew(shown)).dot(jl)
    H[:3, CAMERA_DELAY] = E.dot(rates)
    # An error of the levelling attitude, about body axes, changes what vision reports by its tilt and never by its heading.
    tilt = A - np.outer(_DOWN, so3.heading_row(A).dot(A))
    J = np.zeros((m, 3))
    d_level = s.d_body_pad_level if whole is None else whole.d_body_pad_level
    cov = s.cov[:m, :m] if whole is None else whole.cov[:m, :m]
    J[:3] = -skew(d_level).dot(tilt)
    innov[:3] = A.T.dot(d_level) - E.dot(shown)
    turn = np.eye(m)
    turn[:3, :3] = A.T
    if m > 3:
        pad = deck(x)
        AE = A.dot(E)
        spin = AE.dot(x[GYRO_BIAS] - w)
        M = so3.exp(late * spin).dot(AE.dot(R.T.dot(pad.R)))
        G = np.zeros((3, N))
        G[:, ATT_ERR] = -AE
        G[:, CAMERA_MOUNT] = -AE.dot(jl)
        columns = AE.dot(R.T.dot(pad.axes))
        G[:, _ROLL] = G[:, DECK_TRIM[0]] = columns[:, 0]
        G[:, _PITCH] = G[:, DECK_TRIM[1]] = columns[:, 1]
        G[:, PAD_YAW] = columns[:, 2]
        G[:, GYRO_BIAS] = late * AE
        G[:, CAMERA_DELAY] = spin
        if whole is None:
            row = so3.heading_row(M)
            yaw = wrap_pi((s.yaw_rad or 0.0) + heading(M))
            if s.yaw_ambiguous and abs(yaw) > math.pi / 2:
                yaw = wrap_pi(yaw + math.pi)
            innov[3] = yaw
            H[3] = -row.dot(G)
        else:
            seen = whole.R_level_pad.matrix
            if s.yaw_ambiguous and float(np.trace(seen.dot(M.T))) < 1.0:
                seen = seen.dot(about_down(math.pi))
            innov[3:] = so3.log(seen.dot(M.T))
            H[3:] = G
            J[3:] = tilt
    R_noise = turn.dot(without(cov, J, cov_levelled_by)).dot(turn.T)
    slip = s.stamp.sigma_s
    if slip > 0.0:
        rate_ned = np.array(v_pad_ned(x))
        rate_ned[:2] -= x[VESSEL_VEL]
        turning_deck = np.array([x[DECK_RATE[3]], x[DECK_RATE[4]], x[YAW_RATE] + x[TURN_RATE]])
        rate = H[:, CAMERA_DELAY] + H[:, POS_REL].dot(rate_ned) + H[:, [_ROLL, _PITCH, PAD_YAW]].dot(turning_deck)
        R_noise = R_noise + np.outer(rate, rate) * (slip * slip)
        seen = A.T.dot(d_level)
        R_noise += np.diag([*(seen.dot(seen) - seen**2), *[1.0] * (m - 3)]) * (slip * slip * rate_var)
    return LinearizedMeasurement(innov, H, 0.5 * (R_noise + R_noise.T), by_rate)


def levelling(R: F64, levelled_by: F64 | None) -> F64:
    """Return the (3, 3) R_level_body that vision used."""
    source = R if levelled_by is None else levelled_by
    return np.asarray(about_down(-heading(source)).dot(source))


def seen_from_body(s: Sighting, A: F64) -> F64:
    """Return the pad's position in body axes by the mounting in the camera's file, (3,) m."""
    d_level = s.d_body_pad_level if s.pose6 is None else s.pose6.d_body_pad_level
    return np.asarray(A.T.dot(d_level))


def without(cov: F64, J: F64, cov_attitude: F64, keep: float = 0.02) -> F64:
    """Return `cov` minus `J cov_attitude J'`; at least the fraction `keep` of each direction remains.

    A `cov` that is clearly too small to contain that part in some direction comes from an attitude that was taken as exact. It is
    returned unchanged.
    """
    part = J.dot(cov_attitude).dot(J.T)
    if not part.any():
        return cov
    try:
        np.linalg.cholesky((1.0 - keep) * cov - part)
    except np.linalg.LinAlgError:
        pass
    else:
        return np.asarray(cov - part)
    try:
        L = np.linalg.cholesky(cov)
    except np.linalg.LinAlgError:
        return cov
    inverse = np.linalg.inv(L)
    fraction, axes = np.linalg.eigh(inverse.dot(part).dot(inverse.T))
    if fraction[-1] > _NOT_A_PART:
        return cov
    half = L.dot(axes)
    return np.asarray((half * np.maximum(1.0 - fraction, keep)).dot(half.T))


def vessel_velocity(x: F64, v_ned: F64, cov_ned: F64) -> LinearizedMeasurement:
    """Return the measurement of the velocity that the ship's own navigation reports: steady and wave motion together."""
    return LinearizedMeasurement(v_ned - v_pad_ned(x), BY_V_PAD, cov_ned, _NONE)


def vessel_heading(x: F64, heading_rad: float, sigma_rad: float) -> LinearizedMeasurement:
    """Return the measurement of the arrow's heading that the ship reports."""
    H = np.zeros((1, N))
    H[0, PAD_YAW] = 1.0
    innovation = np.array([wrap_pi(heading_rad - float(x[PAD_YAW]))])
    return LinearizedMeasurement(innovation, H, np.array([[sigma_rad * sigma_rad]]), _NONE)
