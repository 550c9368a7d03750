"""The deck a short time ahead: its present rate carried on by the forecast's change of rate, or by its acceleration alone.

The forecast is some cycles old and comes less often than guidance runs, so only what changes in it is used, from its own age on.
"""

from __future__ import annotations

from bisect import bisect_right
from functools import lru_cache

from msgspec import Struct

from estimator.contracts.motion import DeckMotion
from estimator.contracts.time import MonoNs, seconds_between
from estimator.ekf import Forecast

_OLD_S = 0.5
"""A forecast older than this is not used, s."""


class DeckAhead(Struct, frozen=True):
    """The deck some time ahead, axis by axis in `level`."""

    v_m_s: tuple[float, float, float]
    a_m_s2: tuple[float, float, float]
    moved_m: tuple[float, float, float]
    """How far it has moved until then."""


STILL = DeckAhead((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def deck_ahead(deck: DeckMotion | None, forecast: Forecast | None, now: MonoNs, ahead_s: float) -> DeckAhead:
    """Return the deck `ahead_s` s after `now`; still where nothing is known of its motion."""
    if deck is None:
        return STILL
    (vx, vy, vz), (ax, ay, az) = deck.v_level.tolist(), deck.a_level.tolist()
    x, y, z = ax * ahead_s, ay * ahead_s, az * ahead_s
    if forecast is not None:
        age_s = seconds_between(forecast.at, now)
        horizons, rates, slopes = _course(forecast)
        if 0.0 <= age_s <= _OLD_S and age_s + ahead_s <= horizons[-1]:
            i, k = _span(horizons, age_s), _span(horizons, age_s + ahead_s)
            since, then = age_s - horizons[i], age_s + ahead_s - horizons[k]
            (bx, by, bz), (sx, sy, sz), (cx, cy, cz), (ax, ay, az) = rates[i], slopes[i], rates[k], slopes[k]
            x = (cx + ax * then) - (bx + sx * since)
            y = (cy + ay * then) - (by + sy * since)
            z = (cz + az * then) - (bz + sz * since)
    moved = ahead_s * (vx + 0.5 * x), ahead_s * (vy + 0.5 * y), ahead_s * (vz + 0.5 * z)
    return DeckAhead((vx + x, vy + y, vz + z), (ax, ay, az), moved)


@lru_cache(maxsize=4)
def _course(forecast: Forecast) -> tuple[list[float], list[list[float]], list[list[float]]]:
    """Return the horizons of a forecast, the rates there, and their slopes up to the next; a forecast serves some ten cycles."""
    horizons, rates = forecast.horizons_s.tolist(), forecast.v_pad_level.tolist()
    slopes = [
        [(b - a) / (horizons[i + 1] - horizons[i]) for a, b in zip(rates[i], rates[i + 1], strict=True)]
        for i in range(len(horizons) - 1)
    ]
    return horizons, rates, slopes


def _span(horizons: list[float], t: float) -> int:
    """Return the number of the horizon from which the straight line to the next one holds at a time."""
    i = bisect_right(horizons, t) - 1
    return min(i, len(horizons) - 2) if i > 0 else 0
