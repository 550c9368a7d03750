"""Find how much higher over the deck the drone has to stay because the deck is about to rise faster than the drone can climb.

A drone that climbs at `c` at most is reached by a deck that rises at `r > c` unless it flies higher before. The height that it
needs is the largest sum that `r - c` reaches over any part of the forecast: what the drone can gain before that part begins is
flown, not counted. In a swell of rate `V` and circular frequency `w` that sum is 2 (V sin a - c a) / w with cos a = c / V. Beyond
the forecast the rate goes on with the swell's own frequency, the ratio of the deviations of acceleration and rate.
"""

import math
from functools import lru_cache

from msgspec import Struct

from companion.guidance.controller import SWELL_RAD_S, Knowledge
from estimator.contracts.motion import DeckMotion
from estimator.contracts.time import MonoNs, seconds_between
from estimator.ekf import Forecast

_OLD_S = 0.5
"""A forecast older than this is not used, s."""
WAITING_SIGMAS = 2.0
"""Standard deviations of the forecast rate that a waiting drone keeps clear of."""
SWELL_MEAN_S = 30.0
"""Time constant of the swell's deviations, s."""
_KNOWN_S = 5.0
"""Time of watching from which on they count, s."""
_SLOWEST_RAD_S = math.tau / 16.0  # slowest circular frequency of a deck's motion
_FASTEST_RAD_S = math.tau / 5.0  # fastest circular frequency of it
_SWELL_S = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
"""Times after the forecast's end at which it is."""


class SwellWatch(Struct, frozen=True):
    """The deck's vertical motion over some waves."""

    at: MonoNs | None = None
    known_s: float = 0.0
    """Time that has been watched."""
    var_rate: float = 0.0
    """Variance of the rate, (m/s)^2."""
    var_accel: float = 0.0
    """Variance of the acceleration, (m/s^2)^2."""

    @property
    def rad_s(self) -> float:
        """Its circular frequency; that of a slow swell before it is known."""
        if self.known_s < _KNOWN_S or self.var_rate <= 0.0:
            return SWELL_RAD_S
        return max(_SLOWEST_RAD_S, min(_FASTEST_RAD_S, math.sqrt(self.var_accel / self.var_rate)))

    def gained_m(self, climb_m_s: float) -> float:
        """Return how far a swell of twice its standard deviation rises above a drone that climbs at most so fast, m."""
        most = WAITING_SIGMAS * math.sqrt(self.var_rate)
        if self.known_s < _KNOWN_S or most <= climb_m_s:
            return 0.0
        a = math.acos(climb_m_s / most)
        return 2.0 * (most * math.sin(a) - climb_m_s * a) / self.rad_s


def watched_swell(watch: SwellWatch, now: MonoNs, deck: DeckMotion | None) -> SwellWatch:
    """Return the memory after one guidance cycle; one without a deck's motion changes nothing."""
    if deck is None:
        return watch
    since_s = 0.0 if watch.at is None else seconds_between(watch.at, now)
    if not 0.0 < since_s <= _OLD_S:
        return SwellWatch(now, watch.known_s, watch.var_rate, watch.var_accel)
    known_s = watch.known_s + since_s
    share, rate, accel = since_s / min(SWELL_MEAN_S, known_s), deck.v_level.item(2), deck.a_level.item(2)
    var_rate = watch.var_rate + share * (rate * rate - watch.var_rate)
    return SwellWatch(now, known_s, var_rate, watch.var_accel + share * (accel * accel - watch.var_accel))


def rise_beyond_climb_m(knowledge: Knowledge, sigmas: float = 1.0) -> float:
    """Return how far the deck rises above a drone that climbs as fast as it can, m; 0 if it does not, or nothing is forecast.

    Args:
        sigmas: standard deviations of the forecast rate that are added to it.
    """
    ahead, climb_m_s = knowledge.forecast, knowledge.climb_max_m_s
    if ahead is None or climb_m_s is None:
        return 0.0
    age_s = seconds_between(ahead.at, knowledge.at)
    beyond = _beyond(ahead, climb_m_s, sigmas, knowledge.swell_rad_s)
    return _largest_sum_m(beyond, age_s) if 0.0 <= age_s <= _OLD_S else 0.0


def _largest_sum_m(course: tuple[list[float], list[float], bool], from_s: float) -> float:
    """Return the largest integral of the rate beyond the climb over any part of the time from `from_s` on, m."""
    horizons, beyond, ever = course
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
def _beyond(ahead: Forecast, climb_m_s: float, sigmas: float, swell_rad_s: float) -> tuple[list[float], list[float], bool]:
    """Return times after the forecast, s, the rate beyond `climb_m_s` there, and whether it ever is; for some ten cycles."""
    horizons, rates = ahead.horizons_s.tolist(), ahead.rise_m_s.tolist()
    last, slope = rates[-1], (rates[-1] - rates[-2]) / (horizons[-1] - horizons[-2])
    beyond = [rate + sigmas * sigma - climb_m_s for rate, sigma in zip(rates, ahead.sigma_rise_m_s.tolist(), strict=True)]
    for t in _SWELL_S:
        swell = last * math.cos(swell_rad_s * t) + slope / swell_rad_s * math.sin(swell_rad_s * t)
        horizons.append(horizons[len(rates) - 1] + t)
        beyond.append(swell + sigmas * float(ahead.sigma_rise_m_s[-1]) - climb_m_s)
    return horizons, beyond, max(beyond) > 0.0
