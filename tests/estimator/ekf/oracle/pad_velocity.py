"""The velocity of the pad's centre by the state, in numpy."""

import numpy as np

from estimator.contracts.geometry import F64
from estimator.ekf.state import DECK_RATE, VESSEL_EAST, VESSEL_NORTH, N
from tests.estimator.ekf.belief import Vec3

_SURGING, _SWAYING, _HEAVING = DECK_RATE[:3].tolist()
BY_V_PAD = np.zeros((3, N))
"""(3, N) Jacobian of `v_pad_ned`."""
BY_V_PAD[[0, 1, 0, 1, 2], [VESSEL_NORTH, VESSEL_EAST, *DECK_RATE[:3]]] = 1.0
BY_V_PAD.setflags(write=False)


def v_pad_ned(x: F64) -> F64:
    """Return the velocity of the pad's centre in ned, (3,) m/s."""
    return np.array(pad_velocity(x))


def pad_velocity(x: F64) -> Vec3:
    """Return `v_pad_ned` in Python floats."""
    return x.item(_SURGING) + x.item(VESSEL_NORTH), x.item(_SWAYING) + x.item(VESSEL_EAST), x.item(_HEAVING)
