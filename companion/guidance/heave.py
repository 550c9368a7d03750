"""The deck a short time ahead: its present rate carried on by the forecast's change of rate, or by its acceleration alone.

The forecast is some cycles old and comes less often than guidance runs, so only what changes in it is used, from its own age on.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import NamedTuple

from estimator.contracts.motion import DeckMotion
from estimator.contracts.time import MonoNs, seconds_between
from estimator.ekf import Forecast

_OLD_S = 0.5
"""A forecast older than this is not used, s."""


class DeckAhead(NamedTuple):
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
    v, a = deck.v_level.tolist(), deck.a_level.tolist()
    change, there = [x * ahead_s for x in a], a
    if forecast is not None:
        age_s = seconds_between(forecast.at, now)
        if 0.0 <= age_s <= _OLD_S and age_s + ahead_s <= float(forecast.horizons_s[-1]):
            horizons, rates = forecast.horizons_s.tolist(), forecast.v_pad_level.tolist()
            before, _ = _at(horizons, rates, age_s)
            after, there = _at(horizons, rates, age_s + ahead_s)
            change = [x - y for x, y in zip(after, before, strict=True)]
    x, y, z = ((v[k] + change[k], there[k], ahead_s * (v[k] + 0.5 * change[k])) for k in range(3))
    return DeckAhead((x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2]))


def _at(horizons: list[float], rates: list[list[float]], t: float) -> tuple[list[float], list[float]]:
    """Return rate and slope of the forecast at one time, between the horizons on a straight line."""
    i = max(0, min(len(horizons) - 2, bisect_right(horizons, t) - 1))
    span = horizons[i + 1] - horizons[i]
    slope = [(b - a) / span for a, b in zip(rates[i], rates[i + 1], strict=True)]
    return [a + s * (t - horizons[i]) for a, s in zip(rates[i], slope, strict=True)], slope
