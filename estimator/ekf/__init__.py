"""An error-state Kalman filter that estimates a vehicle's pose relative to a heaving deck (docs/estimator.md).

filter = Filter(EkfOptions())
results = filter.put(samples)
answer = filter.answer(now)
"""

from estimator.ekf.event import Event
from estimator.ekf.filter import Filter, FilterAnswer, Forecast
from estimator.ekf.options import EkfOptions

__all__ = ["EkfOptions", "Event", "Filter", "FilterAnswer", "Forecast"]
