"""The time by which an autopilot's inertial readings are older than their stamps, from its parameters.

ArduPilot's RAW_IMU has passed a low-pass filter, a Butterworth one of the second order, and is stamped as it is sent; PX4's
HIGHRES_IMU is the mean over an interval, stamped at its end. Attitude and velocity are not late in either: a filter that is given
both as they are stamped takes the difference for a camera that is slow.

Sources: ArduPilot, LowPassFilter2p and the parameters INS_GYRO_FILTER and INS_ACCEL_FILTER, equal by default; PX4,
HIGHRES_IMU.hpp and the parameter IMU_INTEG_RATE.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers.mavlink.vehicle import Stack

_CUTOFF_HZ, _INTERVALS_HZ = "INS_GYRO_FILTER", "IMU_INTEG_RATE"
PARAMETERS: dict[Stack, tuple[str, ...]] = {Stack.ARDUPILOT: (_CUTOFF_HZ,), Stack.PX4: (_INTERVALS_HZ,)}
"""The parameters that say it, by stack."""
_MOST_S = 0.05
"""Longest delay that is believed: a cutoff of 4.5 Hz, with which nothing flies."""


def inertial_delay_s(stack: Stack, values: Mapping[str, float]) -> float:
    """Return the delay of gyro and accelerometer, s; 0 while the parameter is not known, and where it switches the filter off.

    A Butterworth filter of the second order has a group delay of sqrt(2) / (2 pi cutoff) far below its cutoff.
    """
    name = PARAMETERS.get(stack, ("",))[0]
    rate_hz = values.get(name, 0.0)
    if not rate_hz > 0.0:
        return 0.0
    return min(_MOST_S, (math.sqrt(2.0) / math.tau if name == _CUTOFF_HZ else 0.5) / rate_hz)
