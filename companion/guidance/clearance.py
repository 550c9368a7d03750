"""Find how much higher over the deck the drone has to stay because the deck is about to rise faster than the drone can climb.

A drone that climbs at `c` at most is reached by a deck that rises at `r > c` unless it flies higher before. The height that it
needs is the largest sum that `r - c` reaches over any part of the forecast: what the drone can gain before that part begins is
flown, not counted. In a swell of rate `V` and circular frequency `w` that sum is 2 (V sin a - c a) / w with cos a = c / V.
"""

import math
from functools import lru_cache

from companion.guidance.controller import Knowledge
from estimator.contracts.time import seconds_between
from estimator.ekf import Forecast

_OLD_S = 0.5
"""A forecast older than this is not used, s."""
_SIGMAS = 1.0
"""Standard deviations of the forecast rate that are added to it."""
_SWELL_RAD_S = math.tau / 9.0
"""Circular frequency with which the deck's rate is carried on beyond the forecast."""
_SWELL_S = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
"""Times after the forecast's end at which it is."""


def rise_beyond_climb_m(knowledge: Knowledge) -> float:
    """Return how far the deck rises above a drone that climbs as fast as it can, m; 0 if it does not, or nothing is forecast."""
    ahead, climb_m_s = knowledge.forecast, knowledge.climb_max_m_s
    if ahead is None or climb_m_s is None:
        return 0.0
    age_s = seconds_between(ahead.at, knowledge.at)
    return _largest_sum_m(ahead, climb_m_s, age_s) if 0.0 <= age_s <= _OLD_S else 0.0


def _largest_sum_m(ahead: Forecast, climb_m_s: float, from_s: float) -> float:
    """Return the largest integral of the rate beyond `climb_m_s` over any part of the time from `from_s` on, m."""
    horizons, beyond, ever = _beyond(ahead, climb_m_s)
    if not ever:
        return 0.0
    largest_m = sum_m = 0.0
    for k in range(1, len(horizons)):
        span_s, before, after = horizons[k] - max(horizons[k - 1], from_s), beyond[k - 1], beyond[k]
        if span_s <= 0.0:
            continue
        # The rate runs on a straight line, so where it passes the limit is part of the way.
        part = before / (before - after) if before * after < 0.0 else 0.0
        for area_m in (0.5 * part * span_s * before, 0.5 * span_s * ((1.0 - part) * after + (part == 0.0) * before)):
            sum_m = max(0.0, sum_m + area_m)
            largest_m = max(largest_m, sum_m)
    return largest_m


@lru_cache(maxsize=4)
def _beyond(ahead: Forecast, climb_m_s: float) -> tuple[list[float], list[float], bool]:
    """Return times after the forecast, s, the rate beyond `climb_m_s` there, and whether it ever is; for some ten cycles."""
    horizons, rates = ahead.horizons_s.tolist(), ahead.rise_m_s.tolist()
    last, slope = rates[-1], (rates[-1] - rates[-2]) / (horizons[-1] - horizons[-2])
    beyond = [rate + _SIGMAS * sigma - climb_m_s for rate, sigma in zip(rates, ahead.sigma_rise_m_s.tolist(), strict=True)]
    for t in _SWELL_S:
        swell = last * math.cos(_SWELL_RAD_S * t) + slope / _SWELL_RAD_S * math.sin(_SWELL_RAD_S * t)
        horizons.append(horizons[len(rates) - 1] + t)
        beyond.append(swell + _SIGMAS * float(ahead.sigma_rise_m_s[-1]) - climb_m_s)
    return horizons, beyond, max(beyond) > 0.0
