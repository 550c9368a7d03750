"""The parameters that every step of the filter needs and no step changes: its options, and the noises that follow from them.

Derivation: docs/estimator.md, section "Motion".
"""

from __future__ import annotations

import numpy as np

from estimator.contracts.geometry import F64
from estimator.contracts.samples import UNKNOWN_VAR
from estimator.core import abi
from estimator.core.abi import ROWS_MAX
from estimator.core.interface import places_of, size_of
from estimator.core.library import address
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
    SWAY_PER_HEAVE,
    TURN_RATE,
    VEL_SCALE,
    VESSEL_VEL,
    N,
)  # fmt: skip

NOT_MEASURED_VAR = 0.1 * UNKNOWN_VAR
"""Variance of a component of a sample from which on it was not measured."""


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
        self._packed = _packed(self)
        self.packed_address = address(self._packed)
        """Address of the core's `filter_params`."""


def _packed(params: FilterParams) -> F64:
    """Return the core's `filter_params` for these parameters."""
    o, places = params.options, places_of("filter_params")
    words = np.zeros(size_of("filter_params"))
    integers = words.view(np.int64)
    surface = {"auto": "OVER_EITHER", "either": "OVER_EITHER", "pad": "OVER_PAD"}.get(o.velocity_is_over, "OVER_GROUND")
    integers[places["hold_ns"]] = round(o.hold_s * 1e9)
    integers[places["velocity_is_over"]] = getattr(abi, surface)
    for name in ("reopen_count", "sighting_has_attitude_error"):
        integers[places[name]] = getattr(o, name)
    for name in (
        "tick_s",
        "forget_s",
        "aiding_period_s",
        "accel_step_m_s2",
        "gyro_step_rad_s",
        "deck_radius_m",
        "sigma_wave_yaw_rate_rad_s",
        "min_confidence",
        "reopen_s",
        "heading_memory_s",
        "sigma_sway_per_heave",
        "sigma_turn_rate_rad_s",
        "pad_yaw_in_vessel_rad",
    ):
        words[places[name]] = getattr(o, name)
    for name in ("psd", "psd_accel", "psd_coast", "psd_coast_turn", "not_measured_var"):
        words[places[name]] = getattr(params, name)
    words[places["correlation_s"]] = (
        o.attitude_correlation_s, o.velocity_correlation_s, o.range_correlation_s, o.baro_correlation_s,
    )  # fmt: skip
    words[places["nis_max"]] = [gate.nis_max(o.gate_probability, dof) for dof in range(1, ROWS_MAX + 1)]
    by = params.carrying
    for name, asd in (("accel", by.asd_accel), ("drift", by.asd_drift), ("tilt", by.asd_tilt)):
        words[places[f"carrying_psd_{name}"]] = asd**2
    words[places["members"]] = packed_members()
    words[places["wave_yaw_rad_s"]] = 2.0 * np.pi / o.wave_yaw_period_s
    words.setflags(write=False)
    return words
