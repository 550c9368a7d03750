"""What the answers take from the state: the velocity of the pad, and the deck at the body's time.

Derivation: docs/estimator.md, section "Measurements".
"""

from __future__ import annotations

import math

import numpy as np

from estimator.contracts.geometry import F64
from estimator.contracts.samples import UNKNOWN_VAR
from estimator.ekf.so3 import Vec3
from estimator.ekf.state import (
    CAMERA_DELAY,
    DECK_DISP,
    DECK_RATE,
    POS_AXES,
    POS_EAST,
    POS_HORIZONTAL,
    POS_NORTH,
    POS_REL,
    SWAY_EAST,
    SWAY_NORTH,
    SWAY_PER_HEAVE,
    VESSEL_EAST,
    VESSEL_NORTH,
    Belief,
    N,
)

_POS = np.array(POS_AXES)
_SURGING, _SWAYING, _HEAVING = DECK_RATE[:3].tolist()
_IN = np.eye(N)
_BY_RATE = np.concatenate([DECK_DISP * N + DECK_RATE, _POS * N + DECK_RATE[:3]])
"""Indices into a flattened (N, N) matrix of the derivatives of displacements and position by the deck's rates."""
NOT_MEASURED_VAR = 0.1 * UNKNOWN_VAR

_BY_V_PAD = np.zeros((3, N))
_BY_V_PAD[[0, 1, 0, 1, 2], [VESSEL_NORTH, VESSEL_EAST, *DECK_RATE[:3]]] = 1.0


def v_pad_ned(x: F64) -> F64:
    """Return the velocity of the pad's centre in ned, (3,) m/s."""
    return np.array(pad_velocity(x))


def pad_velocity(x: F64) -> Vec3:
    """Return `v_pad_ned` in Python floats."""
    north, east, down = x.item(_SURGING), x.item(_SWAYING), x.item(_HEAVING)
    north += x.item(VESSEL_NORTH) + x.item(SWAY_NORTH) * down
    east += x.item(VESSEL_EAST) + x.item(SWAY_EAST) * down
    return north, east, down


def by_v_pad_ned(x: F64) -> F64:
    """Return the (3, N) Jacobian of `v_pad_ned`."""
    J = _BY_V_PAD.copy()
    J[:2, _HEAVING] = x[SWAY_PER_HEAVE]
    J[0, SWAY_NORTH] = J[1, SWAY_EAST] = x.item(_HEAVING)
    return J


def wrap(angle: float) -> float:
    """Return the angle in -pi to pi, radians."""
    return float(math.remainder(angle, math.tau))


def aligned(b: Belief) -> tuple[F64, F64]:
    """Return the (N,) state with the deck moved from the camera's time to the body's, and the (N, N) Jacobian of that.

    The result is for the filter's output; the filter does not continue from it.
    """
    late, rate = b.x.item(CAMERA_DELAY), b.x[DECK_RATE]
    x = b.x.copy()
    x[DECK_DISP] -= late * rate
    sway, heaving = b.x[SWAY_PER_HEAVE], b.x.item(_HEAVING)
    rate_ned = rate[:3].copy()
    rate_ned[:2] += sway * heaving
    x[POS_REL] -= late * rate_ned
    T = _IN.copy()
    T.reshape(-1)[_BY_RATE] = -late
    T[POS_HORIZONTAL, _HEAVING] = -late * sway
    T[POS_NORTH, SWAY_NORTH] = T[POS_EAST, SWAY_EAST] = -late * heaving
    T[DECK_DISP, CAMERA_DELAY] = -rate
    T[POS_REL, CAMERA_DELAY] = -rate_ned
    return x, T
