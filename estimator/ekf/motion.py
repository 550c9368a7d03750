"""The noise with which the filter's state changes, and the effect of a steady turn. estimator/core/propagate.c propagates.

Derivation: docs/estimator.md, section "Motion".
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64
from estimator.core.library import address
from estimator.ekf.deck_motion_bank import carrying
from estimator.ekf.measure import NOT_MEASURED_VAR
from estimator.ekf.options import EkfOptions
from estimator.ekf.packed_params import packed_params
from estimator.ekf.state import (
    ACCEL_BIAS,
    ATT_BIAS,
    ATT_ERR,
    BARO_OFFSET,
    CAMERA_DELAY,
    CAMERA_MOUNT,
    GYRO_BIAS,
    RANGE_OFFSET,
    SWAY_PER_HEAVE,
    TURN_RATE,
    VEL_SCALE,
    VESSEL_VEL,
    N,
)  # fmt: skip

QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])
"""Rotation of a horizontal vector clockwise by 90 degrees. A vector v that turns at w rad/s has the rate w QUARTER v."""


class ProcessNoise:
    """Process noise whose variance grows in proportion to time: (N,) densities, computed once."""

    def __init__(self, o: EkfOptions) -> None:
        self.options = o
        q = np.zeros(N)
        q[ATT_ERR] = o.asd_gyro_rad_s**2
        q[GYRO_BIAS] = o.asd_gyro_bias_rad_s2**2
        q[ACCEL_BIAS] = o.asd_accel_bias_m_s3**2
        q[VEL_SCALE] = o.asd_velocity_scale**2
        q[VESSEL_VEL] = o.asd_vessel_velocity_m_s2**2
        q[TURN_RATE] = o.asd_turn_rate_rad_s2**2
        q[SWAY_PER_HEAVE] = o.asd_sway_per_heave**2
        q[CAMERA_DELAY] = o.delay_drift_s_sqrt_s**2
        q[CAMERA_MOUNT] = o.mount_drift_rad_sqrt_s**2
        q[BARO_OFFSET] = o.asd_baro_offset_m**2
        q[RANGE_OFFSET] = o.asd_range_offset_m**2
        q[ATT_BIAS] = o.asd_attitude_bias_rad_s**2
        self.psd = q
        self.carrying = carrying(o.asd_accel_m_s2, o.asd_gyro_rad_s, o.asd_accel_bias_m_s3)
        self.psd_accel = o.asd_accel_m_s2**2
        self.psd_coast = o.asd_coast_m_s2**2
        self.psd_coast_turn = o.asd_coast_rad_s**2
        self.not_measured_var = NOT_MEASURED_VAR
        self._packed = packed_params(self)
        self.packed_address = address(self._packed)
        """Address of the core's `filter_params`."""


class Turned(NamedTuple):
    """The effect of a steady turn on a horizontal vector that turns with the vessel."""

    by: F64
    """(2, 2) rotation."""
    reach: F64
    """(2, 2) integral of the rotation over time, s."""


def turned(rate_rad_s: float, T: float) -> Turned:
    """Return the turn by a steady rate over T s. A positive rate is clockwise from above."""
    angle = rate_rad_s * T
    s, c = math.sin(angle), math.cos(angle)
    along, across = T * (1.0 - angle * angle / 6.0), 0.5 * T * angle
    if abs(angle) > 1e-3:
        along, across = s / rate_rad_s, (1.0 - c) / rate_rad_s
    return Turned(np.array([[c, -s], [s, c]]), np.array([[along, -across], [across, along]]))
