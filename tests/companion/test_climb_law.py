"""The vertical speed that is commanded, flown by a vehicle that answers as its response says."""

from __future__ import annotations

import math

import pytest

from companion.settings.response import ClimbResponse
from tests.companion.oracle.climb_law import climb_command, predicted, pushed

T = 0.005
RESPONSE = ClimbResponse(delay_s=0.0, lag_s=0.3)


@pytest.mark.parametrize("truth", [0.8, -0.8, 4.0, -4.0])
def test_what_pushes_the_body_is_learned_in_its_time_and_bounded(truth: float) -> None:
    v, arrived, d = 0.3, -0.2, 0.0
    for _ in range(round(0.15 / T)):
        d = pushed(d, (arrived - v) / RESPONSE.lag_s + truth, v, arrived, T, RESPONSE)
    assert d == pytest.approx(max(-1.5, min(1.5, (1.0 - math.exp(-1.0)) * truth)))


def test_the_commands_under_way_act_one_after_the_other_the_oldest_first() -> None:
    assert predicted(0.4, 0.0, (), T, RESPONSE) == (0.4, 0.0)
    n = round(RESPONSE.lag_s / T)
    v, way = predicted(0.0, 0.0, (1.0,) * n, T, RESPONSE)
    assert v == pytest.approx(1.0 - math.exp(-1.0), rel=0.01)
    assert way == pytest.approx(RESPONSE.lag_s * math.exp(-1.0), rel=0.01)
    v, way = predicted(0.0, 0.0, (1.0,) * n + (0.0,) * n, T, RESPONSE)
    assert v == pytest.approx(1.0 - math.exp(-1.0), rel=0.01), "the newest command acts last"
    v, way = predicted(0.5, 0.6, (0.5 - 0.6 * RESPONSE.lag_s,) * n, T, RESPONSE)
    assert (v, way) == pytest.approx((0.5, 0.5 * n * T)), "a push that is commanded against changes nothing"
    assert predicted(0.0, 0.6, (0.0,), T, RESPONSE) == pytest.approx((0.6 * T, 0.3 * T * T))


def flown(
    error_m: float, v: float, rate_m_s: float | None, seconds: float, rate_max_m_s: float = 9.0, push: float = 0.7
) -> list[tuple[float, float]]:
    """Return the error of the height and the rate against a deck that accelerates, of a vehicle under a push."""
    v_deck, a_deck, out = 0.5, 0.2, list[tuple[float, float]]()
    v += v_deck
    for _ in range(round(seconds / T)):
        u = climb_command(RESPONSE, v, push, v_deck, a_deck, error_m, rate_m_s, rate_max_m_s)
        a = (u - v) / RESPONSE.lag_s + push
        error_m -= T * (v - v_deck) + 0.5 * T * T * (a - a_deck)
        v, v_deck = v + T * a, v_deck + T * a_deck
        out.append((error_m, v - v_deck))
    return out


@pytest.mark.parametrize("rate_m_s", [0.45, -0.5, 0.0])
def test_a_wanted_rate_is_reached_in_a_quarter_of_a_second_and_held(rate_m_s: float) -> None:
    course = [v for _, v in flown(1.0, 1.0, rate_m_s, 3.0)]
    assert course[round(0.25 / T) - 1] - rate_m_s == pytest.approx(math.exp(-1.0) * (1.0 - rate_m_s), rel=0.02)
    assert course[-1] == pytest.approx(rate_m_s, abs=1e-3)


@pytest.mark.parametrize("error_m", [0.4, -0.4])
def test_a_wanted_height_is_come_to_as_an_exponential(error_m: float) -> None:
    course = flown(error_m, 1.5 * error_m, None, 4.0)
    for t in (0.5, 1.0, 2.0):
        assert course[round(t / T) - 1][0] == pytest.approx(error_m * math.exp(-1.5 * t), rel=0.02)
    assert course[-1] == pytest.approx((0.0, 0.0), abs=2e-3)


@pytest.mark.parametrize("error_m", [5.0, -5.0])
def test_on_the_way_to_a_height_no_rate_is_larger_than_allowed(error_m: float) -> None:
    course = flown(error_m, 0.0, None, 3.0, rate_max_m_s=0.5)
    assert course[-1][1] == pytest.approx(math.copysign(0.5, error_m), abs=1e-3)
    assert max(abs(v) for _, v in course) <= 0.5 + 1e-9
