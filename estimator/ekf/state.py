"""The index of each quantity in the vectors of the filter's state. Derivation: docs/estimator.md."""

import numpy as np

from estimator.core import abi
from estimator.core.library import CORE

_FIRST = CORE.names("dl_filter_state")


def _part(name: str) -> slice:
    first = _FIRST[f"DL_{name}"]
    return slice(first, min(other for other in _FIRST.values() if other > first))


N = abi.DL_N
"""Number of states."""

ATT_ERR = _part("ATT_ERR")
"""Attitude error, rad, in `body`: `R_true = R @ exp(x[ATT_ERR])`. The nominal is `R`, so `x[ATT_ERR]` is always zero."""
POS_REL = _part("POS_REL")
"""d_body_pad_ned, m."""
POS_NORTH, POS_EAST, POS_DOWN = POS_AXES = range(N)[POS_REL]
"""Indices of the components of `POS_REL`."""
POS_HORIZONTAL = slice(POS_NORTH, POS_DOWN)
"""North and east of `POS_REL`."""
VEL = _part("VEL")
"""v_body_ned, m/s over the ground."""
VEL_NORTH, VEL_EAST, VEL_DOWN = VEL_AXES = range(N)[VEL]
"""Indices of the components of `VEL`."""
GYRO_BIAS = _part("GYRO_BIAS")
"""Gyro bias, rad/s, in `body`: measured minus true."""
ACCEL_BIAS = _part("ACCEL_BIAS")
"""Accelerometer bias, m/s^2, in `body`: measured minus true."""
VEL_SCALE = abi.DL_VEL_SCALE
"""Scale of the horizontal velocity: measured over true."""
VESSEL_VEL = _part("VESSEL_VEL")
"""The vessel's steady velocity, north and east, m/s."""
VESSEL_NORTH, VESSEL_EAST = range(N)[VESSEL_VEL]
"""Indices of the components of `VESSEL_VEL`."""
WAVES = np.arange(N)[_part("WAVES")].reshape(5, 4)
"""(5, 4) indices of [displacement, rate, force, rate of the force] for the pad's motion north, east, down (m) and the deck's
roll and pitch (rad)."""
DECK_DISP, DECK_RATE = WAVES[:, 0], WAVES[:, 1]
PAD_YAW = abi.DL_PAD_YAW
"""Heading of the pad's arrow, rad clockwise from north."""
YAW_RATE = abi.DL_YAW_RATE
"""Rate of the pad's yaw on waves, rad/s; the steady turn is `TURN_RATE`."""
DECK_TRIM = np.arange(N)[_part("DECK_TRIM")]
"""Constant list and trim of the deck, rad."""
CAMERA_DELAY = abi.DL_CAMERA_DELAY
"""Camera delay, s: sightings show the world this much later than their stamps say."""
CAMERA_MOUNT = _part("CAMERA_MOUNT")
"""Rotation vector, rad, in `body`: the camera is rotated by `exp(x[CAMERA_MOUNT])` from the mounting in its file."""
BARO_OFFSET = abi.DL_BARO_OFFSET
"""Height that the barometer shows minus the height over the pad's mean level, m."""
ATT_BIAS = np.arange(N)[_part("ATT_BIAS")]
"""Constant error of the vehicle's own attitude about the body's x and y axes, rad: measured minus true."""
RANGE_OFFSET = abi.DL_RANGE_OFFSET
"""Constant error of the range sensor, m: measured minus true. The sensor's position and the air temperature cause it."""
WAVE_YAW = abi.DL_WAVE_YAW
"""The vessel's yaw on waves, rad; it is a part of `PAD_YAW`."""
TURN_RATE = abi.DL_TURN_RATE
"""Steady rate at which the vessel turns, rad/s clockwise from above. Its velocity turns with it (coordinated turn)."""
