"""The deck a short time ahead: its present rate, and what the forecast says will change in it."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.contracts.motion import DeckMotion
from estimator.ekf import Forecast
from tests.companion.mission_flights import ns
from tests.companion.oracle.heave import STILL, DeckAhead, deck_ahead
from tests.companion.test_clearance import forecast

HORIZONS = np.array([0.0, 0.1, 0.3, 0.6, 1.0])
V, A, JERK = np.array([2.0, -0.5, 0.4]), np.array([0.1, 0.3, -0.8]), np.array([0.6, -0.2, 1.1])
OFFSET = np.array([0.3, 0.2, -0.1])
"""The forecast is off by this in all of its rates."""


CORNERS = ((0.1, 1.0), (0.6, -2.0))
"""The horizons at which the slope changes, and by how many times JERK; between horizons a straight line fits."""


def rates(t: float) -> np.ndarray:
    return V + A * t + JERK * sum(part * max(0.0, t - at) for at, part in CORNERS)


def slope(t: float) -> np.ndarray:
    return A + JERK * sum(part for at, part in CORNERS if t >= at)


def told(at_s: float) -> Forecast:
    known = forecast(np.zeros(10), at_s)
    fields = {name: getattr(known, name) for name in Forecast.__dataclass_fields__}
    v = np.array([rates(t) + OFFSET for t in HORIZONS])
    return Forecast(**fields | {"horizons_s": HORIZONS, "v_pad_level": v})


def deck(t: float) -> DeckMotion:
    """Return the deck as it moves at a time, with an acceleration that is not the forecast's."""
    return DeckMotion(ns(t), rates(t), np.array([9.0, 9.0, 9.0]), 0.01 * np.eye(6), 0, 0, 0, 0, 1e-4 * np.eye(4))


@pytest.mark.parametrize(
    ("now_s", "ahead_s"), [(0.0, 0.05), (0.0, 0.2), (0.0, 1.0), (0.05, 0.25), (0.35, 0.1), (0.5, 0.5), (0.4, 0.55)]
)
def test_the_present_rate_goes_on_by_what_the_forecast_changes(now_s: float, ahead_s: float) -> None:
    found = deck_ahead(deck(now_s), told(0.0), ns(now_s), ahead_s)
    np.testing.assert_allclose(found.v_m_s, rates(now_s + ahead_s), atol=1e-9)
    np.testing.assert_allclose(found.a_m_s2, slope(now_s + ahead_s), atol=1e-9)
    mean = 0.5 * (rates(now_s) + rates(now_s + ahead_s))
    np.testing.assert_allclose(found.moved_m, mean * ahead_s, atol=1e-9)


@pytest.mark.parametrize(("at_s", "ahead_s"), [(None, 0.2), (-0.51, 0.2), (0.1, 0.2), (0.0, 1.01), (-0.3, 0.75)])
def test_without_a_forecast_of_that_time_the_acceleration_carries_it_on(at_s: float | None, ahead_s: float) -> None:
    """None, one that is too old, one from the time to come, and ones that end before."""
    found = deck_ahead(deck(0.0), None if at_s is None else told(at_s), ns(0.0), ahead_s)
    np.testing.assert_allclose(found.v_m_s, V + 9.0 * ahead_s)
    np.testing.assert_allclose(found.moved_m, V * ahead_s + 4.5 * ahead_s**2)
    assert found.a_m_s2 == (9.0, 9.0, 9.0)


def test_a_deck_of_which_nothing_is_known_stands_still() -> None:
    assert deck_ahead(None, told(0.0), ns(0.0), 0.3) is STILL
    assert DeckAhead((0.0,) * 3, (0.0,) * 3, (0.0,) * 3) == STILL
