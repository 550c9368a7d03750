"""Estimate the biases of velocity and specific force while the drone is at rest.

Source: Sundvoll 2020, sec. 4.3: the mean over ten seconds (there 1000 samples) is subtracted from every later measurement.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between
from estimator.options import DeadReckoningOptions


@dataclass(frozen=True, slots=True, eq=False)
class RestCalibration:
    """The sums so far; `done` is True once the means are final."""

    options: DeadReckoningOptions = field(default_factory=DeadReckoningOptions)
    since: MonoNs | None = None
    v_sum: F64 = field(default_factory=lambda: np.zeros(3))
    v_samples: int = 0
    a_sum: F64 = field(default_factory=lambda: np.zeros(3))
    a_samples: int = 0
    done: bool = False

    @property
    def v_bias_level(self) -> F64:
        """Return the bias of the velocity, (3,) m/s; zeros until done or without velocity samples."""
        return self.v_sum / self.v_samples if self.done and self.v_samples else np.zeros(3)

    @property
    def a_bias_body(self) -> F64:
        """Return the bias of the acceleration, (3,) m/s^2; zeros until done."""
        return self.a_sum / self.a_samples if self.done else np.zeros(3)


def add_velocity(state: RestCalibration, t: MonoNs, v_level: F64) -> RestCalibration:
    """Add one measured velocity, (3,) m/s."""
    if state.done:
        return state
    if float(np.abs(v_level).max()) > state.options.calibration_velocity_max_m_s:
        return RestCalibration(state.options)
    since = t if state.since is None else state.since
    return replace(state, since=since, v_sum=state.v_sum + v_level, v_samples=state.v_samples + 1)


def add_acceleration(state: RestCalibration, t: MonoNs, a_body: F64) -> RestCalibration:
    """Add one measured specific force minus gravity, (3,) m/s^2 in `body`; a perfect sensor at rest gives zeros."""
    o = state.options
    if state.done:
        return state
    if float(np.abs(a_body).max()) > o.calibration_acceleration_max_m_s2:
        return RestCalibration(o)
    since = t if state.since is None else state.since
    samples = state.a_samples + 1
    done = samples >= o.calibration_samples and seconds_between(since, t) >= o.calibration_s
    return replace(state, since=since, a_sum=state.a_sum + a_body, a_samples=samples, done=done)
