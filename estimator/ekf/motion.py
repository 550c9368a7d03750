"""The noise with which the filter's state changes. estimator/core/filter/propagate.c propagates.

Derivation: docs/estimator.md, section "Motion".
"""

from __future__ import annotations

import numpy as np

from estimator.contracts.samples import UNKNOWN_VAR
from estimator.core.library import address
from estimator.ekf.deck_motion_bank import carrying
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

NOT_MEASURED_VAR = 0.1 * UNKNOWN_VAR
"""Variance of a component of a sample from which on it was not measured."""


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
