"""The velocity of the pad's centre by the state, in numpy."""

import numpy as np

from estimator.contracts.geometry import F64
from estimator.ekf.so3 import Vec3
from estimator.ekf.state import DECK_RATE, SWAY_EAST, SWAY_NORTH, SWAY_PER_HEAVE, VESSEL_EAST, VESSEL_NORTH, N

_SURGING, _SWAYING, _HEAVING = DECK_RATE[:3].tolist()
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
