"""An error-state Kalman filter that estimates a vehicle's pose relative to a heaving deck (docs/estimator.md).

Every function is pure: it takes a filter and returns another.

ekf = start(EkfOptions())
ekf, outcomes = step(ekf, sample)
state = at(ekf, now)
"""

from estimator.ekf.filter import Ekf, at, forecast, motion_at, moving, start, step, step_all
from estimator.ekf.forecast import Forecast
from estimator.ekf.options import EkfOptions
from estimator.ekf.packed_event import Event

__all__ = [
    "Ekf",
    "EkfOptions",
    "Event",
    "Forecast",
    "at",
    "forecast",
    "motion_at",
    "moving",
    "start",
    "step",
    "step_all",
]
