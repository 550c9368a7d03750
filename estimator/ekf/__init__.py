"""An error-state Kalman filter for a body over a heaving deck. Values in, values out: docs/estimator.md.

ekf = start(EkfOptions())
ekf, outcomes = step(ekf, sample)
state = at(ekf, now)
"""

from __future__ import annotations

from estimator.ekf.filter import Ekf, at, forecast, moving, start, step
from estimator.ekf.forecast import Forecast
from estimator.ekf.options import EkfOptions
from estimator.ekf.propagate import Event

__all__ = ["Ekf", "EkfOptions", "Event", "Forecast", "at", "forecast", "moving", "start", "step"]
