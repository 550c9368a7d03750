"""The filter's options and noises as the native core reads them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimator.contracts.geometry import F64
from estimator.core import abi
from estimator.core.abi import ROWS_MAX
from estimator.core.interface import places_of, size_of
from estimator.ekf import deck_motion_bank, gate

if TYPE_CHECKING:
    from estimator.ekf.motion import ProcessNoise


def packed_params(noise: ProcessNoise) -> F64:
    """Return the core's `filter_params` for these options and noises."""
    o, places = noise.options, places_of("filter_params")
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
        words[places[name]] = getattr(noise, name)
    words[places["correlation_s"]] = (
        o.attitude_correlation_s, o.velocity_correlation_s, o.range_correlation_s, o.baro_correlation_s,
    )  # fmt: skip
    words[places["nis_max"]] = [gate.nis_max(o.gate_probability, dof) for dof in range(1, ROWS_MAX + 1)]
    by = noise.carrying
    for name, asd in (("accel", by.asd_accel), ("drift", by.asd_drift), ("tilt", by.asd_tilt)):
        words[places[f"carrying_psd_{name}"]] = asd**2
    words[places["members"]] = deck_motion_bank.packed_members()
    words[places["wave_yaw_rad_s"]] = 2.0 * np.pi / o.wave_yaw_period_s
    words.setflags(write=False)
    return words
