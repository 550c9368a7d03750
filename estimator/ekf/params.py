"""The parameters that every step of the filter needs and no step changes: its options, and the noises that follow from them.

Derivation: docs/estimator.md, section "Motion".
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.samples import UNKNOWN_VAR
from estimator.core import abi
from estimator.core.abi import ROWS_MAX
from estimator.core.library import CORE
from estimator.ekf import gate
from estimator.ekf.deck_motion_bank import carrying, packed_members
from estimator.ekf.options import EkfOptions
from estimator.ekf.state import (
    ACCEL_BIAS,
    ATT_BIAS,
    ATT_ERR,
    BARO_OFFSET,
    CAMERA_DELAY,
    CAMERA_MOUNT,
    GYRO_BIAS,
    RANGE_OFFSET,
    TURN_RATE,
    VEL_SCALE,
    VESSEL_VEL,
    N,
)  # fmt: skip

NOT_MEASURED_VAR = 0.1 * UNKNOWN_VAR
"""Variance of a component of a sample from which it was not measured."""


class FilterParams:
    """The options and what is computed from them once; `psd` has (N,) densities of noise whose variance grows with time."""

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
        self.carrying = carrying(o.asd_accel_m_s2, o.asd_gyro_rad_s, o.asd_accel_bias_m_s3)
        self.psd_accel = o.asd_accel_m_s2**2
        self.psd_coast = o.asd_coast_m_s2**2
        self.psd_coast_turn = o.asd_coast_rad_s**2
        self.not_measured_var = NOT_MEASURED_VAR
        self.core = CORE.array("dl_filter_params", _packed(self))
        """The core's `dl_filter_params`."""


_SURFACES = {"auto": abi.DL_OVER_EITHER, "either": abi.DL_OVER_EITHER, "pad": abi.DL_OVER_PAD, "ground": abi.DL_OVER_GROUND}
_FROM_OPTIONS = (
    "reopen_count", "sighting_has_attitude_error", "tick_s", "forget_s", "aiding_period_s", "accel_step_m_s2", "gyro_step_rad_s",
    "deck_radius_m", "sigma_wave_yaw_rate_rad_s", "min_confidence", "reopen_s", "heading_memory_s", "sigma_turn_rate_rad_s",
    "pad_yaw_in_vessel_rad",
)  # fmt: skip
_FROM_NOISE = ("psd", "psd_accel", "psd_coast", "psd_coast_turn", "not_measured_var")


def _packed(params: FilterParams) -> NDArray[Any]:
    """Return the core's `dl_filter_params` for these parameters."""
    o, by = params.options, params.carrying
    record = CORE.record(
        "dl_filter_params",
        **{name: getattr(o, name) for name in _FROM_OPTIONS},
        **{name: getattr(params, name) for name in _FROM_NOISE},
        hold_ns=round(o.hold_s * 1e9),
        velocity_is_over=_SURFACES[o.velocity_is_over],
        correlation_s=(o.attitude_correlation_s, o.velocity_correlation_s, o.range_correlation_s, o.baro_correlation_s),
        nis_max=[gate.nis_max(o.gate_probability, dof) for dof in range(1, ROWS_MAX + 1)],
        carrying_psd_accel=by.asd_accel**2,
        carrying_psd_drift=by.asd_drift**2,
        carrying_psd_tilt=by.asd_tilt**2,
        wave_yaw_rad_s=2.0 * np.pi / o.wave_yaw_period_s,
    )
    record["members"] = packed_members()
    record.setflags(write=False)
    return record
