"""The parameters that every step of the filter needs and no step changes: its options, and the noises that follow from them.

Derivation: docs/estimator.md, section "Motion".
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.contracts.samples import UNKNOWN_VAR
from estimator.core import abi
from estimator.core.abi import DL_ROWS_MAX
from estimator.core.library import CORE
from estimator.ekf.deck_motion_bank import carrying, packed_members
from estimator.ekf.options import EkfOptions
from estimator.ekf.state import (
    ACCEL_BIAS,
    ATT_BIAS,
    ATT_ERR,
    BARO_OFFSET,
    CAMERA_DELAY,
    CAMERA_MOUNT,
    DECK_TRIM,
    GYRO_BIAS,
    PAD_YAW,
    POS_REL,
    RANGE_OFFSET,
    TURN_RATE,
    VEL,
    VEL_SCALE,
    VESSEL_VEL,
    WAVE_YAW,
    YAW_RATE,
    N,
)  # fmt: skip

NOT_MEASURED_VAR = 0.1 * UNKNOWN_VAR
"""Variance of a component of a sample from which it was not measured."""


LOST_VAR_M2 = 1e4
"""Variance of the pad's relative position before the first sighting, per axis."""


class FilterParams:
    """The options and what is computed from them once.

    `psd` has (N,) densities of noise whose variance grows with time, `initial_var` (N,) variances before anything is known.
    """

    def __init__(self, o: EkfOptions) -> None:
        self.options = o
        q = np.zeros(N)
        q[ATT_ERR] = o.asd_gyro_rad_s**2
        q[GYRO_BIAS] = o.asd_gyro_bias_rad_s2**2
        q[ACCEL_BIAS] = o.asd_accel_bias_m_s3**2
        q[VEL_SCALE] = o.asd_velocity_scale**2
        q[VESSEL_VEL] = o.asd_vessel_velocity_m_s2**2
        q[TURN_RATE] = o.asd_turn_rate_rad_s2**2
        q[CAMERA_DELAY] = o.delay_drift_s_sqrt_s**2
        q[CAMERA_MOUNT] = o.mount_drift_rad_sqrt_s**2
        q[BARO_OFFSET] = o.asd_baro_offset_m**2
        q[RANGE_OFFSET] = o.asd_range_offset_m**2
        q[ATT_BIAS] = o.asd_attitude_bias_rad_s**2
        self.psd = q
        self.initial_var = _initial_var(o)
        self.carrying = carrying(o.asd_accel_m_s2, o.asd_gyro_rad_s, o.asd_accel_bias_m_s3)
        self.psd_accel = o.asd_accel_m_s2**2
        self.psd_coast = o.asd_coast_m_s2**2
        self.psd_coast_turn = o.asd_coast_rad_s**2
        self.not_measured_var = NOT_MEASURED_VAR
        self.core = CORE.array("dl_filter_params", _packed(self))
        """The core's `dl_filter_params`."""


def _initial_var(o: EkfOptions) -> F64:
    """Return the variances (N,) before any event; those of attitude and waves are left out."""
    var = np.zeros(N)
    var[POS_REL] = LOST_VAR_M2
    var[VEL] = o.sigma_initial_velocity_m_s**2
    var[GYRO_BIAS] = o.sigma_gyro_bias_rad_s**2
    var[ACCEL_BIAS] = o.sigma_accel_bias_m_s2**2, o.sigma_accel_bias_m_s2**2, o.sigma_accel_bias_down_m_s2**2
    var[VEL_SCALE] = o.sigma_velocity_scale**2
    var[VESSEL_VEL] = o.sigma_vessel_velocity_m_s**2
    var[PAD_YAW] = math.pi**2 / 3.0
    var[YAW_RATE] = o.sigma_wave_yaw_rate_rad_s**2
    var[WAVE_YAW] = (o.sigma_wave_yaw_rate_rad_s * o.wave_yaw_period_s / math.tau) ** 2
    var[TURN_RATE] = o.sigma_turn_rate_rad_s**2
    var[DECK_TRIM] = o.sigma_list_rad**2
    var[CAMERA_DELAY] = o.sigma_delay_s**2
    var[CAMERA_MOUNT] = o.sigma_mount_rad**2
    var[BARO_OFFSET] = o.sigma_baro_offset_m**2
    var[ATT_BIAS] = o.sigma_attitude_bias_rad**2
    var[RANGE_OFFSET] = o.sigma_range_offset_m**2
    return var


_CHI2 = {
    0.01: (6.635, 9.210, 11.345, 13.277, 15.086, 16.812, 18.475, 20.090, 21.666),
    1e-3: (10.828, 13.816, 16.266, 18.467, 20.515, 22.458, 24.322, 26.124, 27.877),
    1e-4: (15.137, 18.421, 21.108, 23.513, 25.745, 27.856, 29.878, 31.828, 33.720),
}
"""Chi-square by probability of exceeding it, for 1 to 9 degrees of freedom."""


def nis_max(probability: float, dof: int) -> float:
    """Return the limit that the NIS of a consistent measurement of `dof` numbers exceeds with this probability."""
    return _CHI2[probability][dof - 1]


_SURFACES = {"auto": abi.DL_OVER_EITHER, "either": abi.DL_OVER_EITHER, "pad": abi.DL_OVER_PAD, "ground": abi.DL_OVER_GROUND}
_FROM_OPTIONS = (
    "reopen_count", "sighting_has_attitude_error", "tick_s", "forget_s", "aiding_period_s", "accel_step_m_s2", "gyro_step_rad_s",
    "deck_radius_m", "sigma_wave_yaw_rate_rad_s", "min_confidence", "reopen_s", "heading_memory_s", "sigma_turn_rate_rad_s",
    "pad_yaw_in_vessel_rad", "velocity_scale", "sigma_initial_tilt_rad", "sigma_initial_heading_rad", "sigma_attitude_bias_rad",
    "leap_count",
)  # fmt: skip
_FROM_NOISE = ("psd", "initial_var", "psd_accel", "psd_coast", "psd_coast_turn", "not_measured_var")


def _packed(params: FilterParams) -> NDArray[Any]:
    """Return the core's `dl_filter_params` for these parameters."""
    o, by = params.options, params.carrying
    record = CORE.record(
        "dl_filter_params",
        **{name: getattr(o, name) for name in _FROM_OPTIONS},
        **{name: getattr(params, name) for name in _FROM_NOISE},
        hold_ns=round(o.hold_s * 1e9),
        history_ns=round(o.history_s * 1e9),
        max_ahead_ns=round(o.max_ahead_s * 1e9),
        leap_ns=round(o.leap_s * 1e9),
        velocity_is_over=_SURFACES[o.velocity_is_over],
        correlation_s=(o.attitude_correlation_s, o.velocity_correlation_s, o.range_correlation_s, o.baro_correlation_s),
        nis_max=[nis_max(o.gate_probability, dof) for dof in range(1, DL_ROWS_MAX + 1)],
        carrying_psd_accel=by.asd_accel**2,
        carrying_psd_drift=by.asd_drift**2,
        carrying_psd_tilt=by.asd_tilt**2,
        wave_yaw_rad_s=2.0 * np.pi / o.wave_yaw_period_s,
    )
    record["members"] = packed_members()
    record.setflags(write=False)
    return record
