"""The measurement models of the vehicle's samples in numpy: innovation, Jacobian and noise."""

import math

import numpy as np

from estimator.contracts.geometry import F64, skew
from estimator.ekf.params import NOT_MEASURED_VAR
from estimator.ekf.state import (
    ATT_BIAS,
    ATT_ERR,
    BARO_OFFSET,
    DECK_DISP,
    DECK_RATE,
    DECK_TRIM,
    PAD_YAW,
    POS_AXES,
    POS_DOWN,
    POS_REL,
    RANGE_OFFSET,
    VEL,
    VEL_SCALE,
    VESSEL_EAST,
    VESSEL_NORTH,
    N,
)
from tests.estimator.ekf.belief import Vec3
from tests.estimator.ekf.oracle import so3
from tests.estimator.ekf.oracle.pad_velocity import BY_V_PAD, pad_velocity, v_pad_ned
from tests.estimator.ekf.oracle.sighting import LinearizedMeasurement, deck
from tests.estimator.ekf.oracle.so3 import about_down, heading

_I3 = np.eye(3)
_POS = np.array(POS_AXES)
_DOWN = np.array([0.0, 0.0, 1.0])
_NONE = np.zeros((0, N))
_ROLL, _PITCH = int(DECK_DISP[3]), int(DECK_DISP[4])
_SURGING, _SWAYING, _HEAVING = DECK_RATE[:3].tolist()
_IN = np.eye(N)
_BY_RATE = np.concatenate([DECK_DISP * N + DECK_RATE, _POS * N + DECK_RATE[:3]])
"""Indices into a flattened (N, N) matrix of the derivatives of displacements and position by the deck's rates."""
_ATT_BIAS_X, _ATT_BIAS_Y = ATT_BIAS.tolist()

BY_ATTITUDE, BY_HEIGHT = np.zeros((3, N)), np.zeros((1, N))
"""(3, N), (1, N): the Jacobians of `attitude` and `height`, the same at any state."""
BY_ATTITUDE[:, ATT_ERR] = _I3
BY_ATTITUDE[[0, 1], ATT_BIAS] = 1.0
BY_HEIGHT[0, [5, DECK_DISP[2], BARO_OFFSET]] = 1.0, -1.0, 1.0
_BY_VEL, _BY_V_PAD = np.zeros((3, N)), np.zeros((3, N))
_BY_VEL[:, VEL] = _I3
_BY_V_PAD[[0, 1, 0, 1, 2], [VESSEL_NORTH, VESSEL_EAST, *DECK_RATE[:3]]] = 1.0
BY_ATTITUDE.setflags(write=False)
BY_HEIGHT.setflags(write=False)


def attitude(x: F64, R: F64, seen: F64, cov_body: F64) -> LinearizedMeasurement:
    """Return the measurement of the vehicle's own attitude, (3, 3) R_ned_body, which has a constant tilt error."""
    return LinearizedMeasurement(np.array(attitude_innov(x, R, seen)), BY_ATTITUDE, cov_body, _NONE)


def attitude_innov(x: F64, R: F64, seen: F64) -> Vec3:
    """Return only the innovation of `attitude`, rad."""
    roll, pitch, yaw = so3.rotation_vector(R.T.dot(seen))
    return roll - x.item(_ATT_BIAS_X), pitch - x.item(_ATT_BIAS_Y), yaw


def velocity(x: F64, R: F64, v_level: F64, cov_level: F64, deck_weight: float) -> LinearizedMeasurement | None:
    """Return the measurement of a velocity in `level`, or None if no axis was measured.

    The sensor's scale applies to the horizontal components only.

    Args:
        deck_weight: 0 for a velocity over the ground, 1 for one over the pad's deck, and a value between if that is uncertain.
    """
    axes = measured_axes(cov_level)
    if not axes:
        return None
    over = x[VEL] - deck_weight * v_pad_ned(x)
    innov = v_level - measured_velocity(over.tolist(), R, x.item(VEL_SCALE))
    H = by_velocity(x, R, deck_weight)
    if len(axes) == 3:
        return LinearizedMeasurement(innov, H, cov_level, _NONE)
    pick = list(axes)
    return LinearizedMeasurement(innov[pick], H[pick], cov_level[np.ix_(axes, axes)], _NONE)


def by_velocity(x: F64, R: F64, deck_weight: float) -> F64:
    """Return the (3, N) Jacobian of `velocity` for all three components."""
    if deck_weight == 0.0:
        return _by_measured(x[VEL], _BY_VEL, R, x.item(VEL_SCALE))
    return _by_measured(x[VEL] - deck_weight * v_pad_ned(x), _BY_VEL - deck_weight * BY_V_PAD, R, x.item(VEL_SCALE))


def by_deck_velocity(x: F64, R: F64) -> tuple[F64, F64]:
    """Return the deck's own velocity as the sensor of a body at rest would measure it, (3,) m/s, and its Jacobian (3, N)."""
    v, scale = pad_velocity(x), x.item(VEL_SCALE)
    return np.array(measured_velocity(v, R, scale)), _by_measured(np.array(v), BY_V_PAD, R, scale)


def _by_measured(v_ned: F64, by_v_ned: F64, R: F64, scale: float) -> F64:
    """Return the (3, N) Jacobian of `measured_velocity` for a velocity and that velocity's own Jacobian (3, N)."""
    to_level = about_down(-heading(R))
    to_level[:2] *= scale
    ahead, aside, _ = v = to_level.dot(v_ned)
    H: F64 = to_level.dot(by_v_ned)
    H[:2, ATT_ERR] += np.array([[aside], [-ahead]]) * so3.heading_row(R).dot(R)
    H[:2, VEL_SCALE] += v[:2] / scale
    return H


def measured_axes(cov_level: F64) -> tuple[int, ...]:
    """Return the indices of the components, out of forward, right and down, that a velocity has."""
    var = cov_level.diagonal().tolist()
    return tuple([i for i in (0, 1, 2) if var[i] < NOT_MEASURED_VAR])


def measured_velocity(v_ned: Vec3, R: F64, scale: float) -> Vec3:
    """Return what a sensor with that scale measures of a velocity, m/s in `level`."""
    x, y, z = v_ned
    ahead, aside = R.item(0, 0), R.item(1, 0)
    k = scale / math.hypot(ahead, aside)
    return k * (ahead * x + aside * y), k * (ahead * y - aside * x), z


def distance(x: F64, R: F64, range_m: float, sigma_m: float) -> LinearizedMeasurement | None:
    """Return the measurement of the distance along the body's down axis to the deck's plane, or None if they do not meet.

    The sensor has a constant error, `RANGE_OFFSET`.
    """
    pad = deck(x)
    n, c = pad.R[:, 2], R[:, 2]
    cosine = float(n.dot(c))
    if cosine < 0.3:
        return None
    r = float(n.dot(x[POS_REL])) / cosine
    H = np.zeros((1, N))
    H[0, POS_REL] = n / cosine
    H[0, ATT_ERR] = (r / cosine) * n.dot(R).dot(skew(_DOWN))
    reach = (x[POS_REL] - r * c) / cosine
    by_axis = skew(n).dot(reach).dot(pad.axes)
    H[0, _ROLL] = H[0, DECK_TRIM[0]] = by_axis[0]
    H[0, _PITCH] = H[0, DECK_TRIM[1]] = by_axis[1]
    H[0, PAD_YAW] = by_axis[2]
    H[0, RANGE_OFFSET] = 1.0
    return LinearizedMeasurement(np.array([range_m - r - x[RANGE_OFFSET]]), H, np.array([[sigma_m * sigma_m]]), _NONE)


def height(x: F64, height_m: float, sigma_m: float) -> LinearizedMeasurement:
    """Return the measurement of the barometric height over the pad's mean level, which has an offset."""
    below = x[POS_DOWN] - x[DECK_DISP[2]]
    return LinearizedMeasurement(
        np.array([height_m - (below + x[BARO_OFFSET])]), BY_HEIGHT, np.array([[sigma_m * sigma_m]]), _NONE
    )
