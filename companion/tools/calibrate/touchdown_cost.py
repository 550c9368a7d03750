"""What an error of mount, delay or readout costs at touchdown, centimetres beside the pad's centre.

A camera that is turned by an angle sees the pad beside its place by the angle times the distance. Lower than
`LAST_SIGHTING_M` the pad fills the frame, and the filter carries on by the IMU. A delay shows the pad where it was, beside its
place by a speed times the delay, and by the angle that the vehicle has turned meanwhile, times the distance. The law that follows
the deck reacts late as well, so the speed is not that across the pad but what simulated landings show. A readout time that is
wrong is a delay that differs from row to row.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64

LAST_SIGHTING_M = 0.4
DELAY_SPEED_M_S = 0.9
"""What a second of delay would cost: 50 ms added 4.7 cm rms to ten landings of the scenario demo."""
TURN_RATE_RAD_S = 0.25
"""Rate of roll and pitch while the vehicle follows a deck."""
APPROACH_M = 3.0
"""Height at which guidance begins to descend, where an error costs most."""


class TouchdownCost(NamedTuple):
    """Centimetres at touchdown, and at the beginning of the descent."""

    touchdown_cm: float
    approach_cm: float


def of_mount(rotvec_rad: F64) -> TouchdownCost:
    """Return the cost of a camera turned by a rotation vector in `body`; a turn about the vertical does not shift the pad."""
    angle = float(np.hypot(rotvec_rad[0], rotvec_rad[1]))
    return TouchdownCost(100.0 * angle * LAST_SIGHTING_M, 100.0 * angle * APPROACH_M)


def of_mount_sigma(cov: F64) -> TouchdownCost:
    """Return the cost of a mount that is known with this covariance, (3, 3) rad^2: one standard deviation."""
    return of_mount(np.array([math.sqrt(cov[0, 0]), math.sqrt(cov[1, 1]), 0.0]))


def of_delay(seconds: float) -> TouchdownCost:
    """Return the cost of a delay that is wrong by so much."""
    late = abs(seconds)
    touchdown, approach = (
        math.hypot(DELAY_SPEED_M_S, TURN_RATE_RAD_S * distance_m) * late for distance_m in (LAST_SIGHTING_M, APPROACH_M)
    )
    return TouchdownCost(100.0 * touchdown, 100.0 * approach)


def of_readout(seconds: float) -> TouchdownCost:
    """Return the cost of a readout time that is wrong by so much, for a pad a quarter of the frame off the middle row."""
    return of_delay(0.25 * seconds)
