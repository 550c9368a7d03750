"""Further height of the drone where the deck will rise faster than the drone can climb."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.mission import Event, ReasonCause, State
from companion.guidance.controller import HORIZONS_S, Knowledge, Target
from companion.guidance.mission.clearance import SwellWatch, rise_beyond_climb_m, watched_swell
from companion.guidance.mission.descend import descent_rate_m_s
from companion.guidance.mission.limits import gate
from companion.guidance.mission.machine import PHASES, aim
from companion.guidance.mission.progress import GuidanceCycle, InputQuality, Progress
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.geometry import F64
from estimator.ekf import Forecast
from tests.make import deck, estimate, ns

CLIMB_M_S = 1.0
PERIOD_S = 9.0
OMEGA = math.tau / PERIOD_S


def forecast(rise_m_s: F64, at_s: float = 0.0, sigma_m_s: float = 0.0) -> Forecast:
    n = len(HORIZONS_S)
    flat, still = np.zeros(n), np.zeros((n, 3))
    v = np.column_stack([flat, flat, -rise_m_s])
    return Forecast(
        ns(at_s), np.array(HORIZONS_S), still, np.zeros((n, 3, 3)), v, flat, flat, rise_m_s, np.full(n, sigma_m_s),
        flat, flat, flat, flat,
    )  # fmt: skip


def swell(largest_m_s: float, t_s: float = 0.0) -> F64:
    """Return the rate at the horizons after `t_s`, whose largest comes 1.5 s after 0."""
    return largest_m_s * np.cos(OMEGA * (np.array(HORIZONS_S) + t_s - 1.5))


def knowledge(
    ahead: Forecast | None, at_s: float = 0.0, climb_m_s: float | None = CLIMB_M_S, height_m: float = 0.35
) -> Knowledge:
    return Knowledge(ns(at_s), estimate(at_s, [0.0, 0.0, height_m]), forecast=ahead, climb_max_m_s=climb_m_s, swell_rad_s=OMEGA)


def test_a_deck_that_the_drone_can_follow_needs_no_further_height() -> None:
    assert rise_beyond_climb_m(knowledge(forecast(swell(0.95)))) == 0.0
    assert rise_beyond_climb_m(knowledge(None)) == 0.0
    assert rise_beyond_climb_m(knowledge(forecast(swell(1.6)), climb_m_s=None)) == 0.0, "somebody else limits the climb"
    falls = np.array([1.6 - 0.6 * t for t in HORIZONS_S])
    assert rise_beyond_climb_m(knowledge(forecast(falls))) == pytest.approx(0.3, abs=0.01)
    assert rise_beyond_climb_m(knowledge(forecast(swell(1.6)), at_s=0.6)) == 0.0, "a forecast that old says nothing"


@pytest.mark.parametrize("seed", range(12))
def test_it_is_the_largest_sum_over_any_part_of_the_forecast_and_of_the_swell_that_follows(seed: int) -> None:
    """The rate goes straight from one horizon to the next, then on for 3 s as a swell of 9 s with its last rate and slope."""
    rng = np.random.default_rng(seed)
    h, rise = np.array(HORIZONS_S), 1.0 + np.cumsum(rng.normal(0.0, 0.35, len(HORIZONS_S)))
    sigma, w = 0.07, math.tau / 9.0
    t = np.arange(0.5, 3.1, 0.5)
    swells = rise[-1] * np.cos(w * t) + (rise[-1] - rise[-2]) / (h[-1] - h[-2]) / w * np.sin(w * t)
    at = np.arange(0.0, h[-1] + 3.0, 1e-3)
    beyond = np.interp(at, np.concatenate([h, h[-1] + t]), np.concatenate([rise, swells])) + sigma - CLIMB_M_S
    total = np.concatenate([[0.0], np.cumsum(beyond) * 1e-3])
    found = rise_beyond_climb_m(knowledge(forecast(rise, sigma_m_s=sigma)))
    assert found == pytest.approx((total - np.minimum.accumulate(total)).max(), abs=3e-3)


def test_what_of_a_forecast_is_over_does_not_count_and_an_old_one_reports_nothing() -> None:
    steady = forecast(np.full(len(HORIZONS_S), 1.6))
    whole = rise_beyond_climb_m(knowledge(steady))
    for age_s in (0.1, 0.3, 0.5):
        assert rise_beyond_climb_m(knowledge(steady, at_s=age_s)) == pytest.approx(whole - 0.6 * age_s)
    for age_s in (-0.001, 0.501):
        assert rise_beyond_climb_m(knowledge(steady, at_s=age_s)) == 0.0


def test_a_drone_that_keeps_this_height_is_not_reached_by_a_swell_that_it_cannot_follow() -> None:
    """WHAT: a perfect follower with a limit of 1 m/s under whom the rate of the deck swings to 1.6 m/s, for two minutes."""
    dt, height_m, lowest_m, needed_m = 0.02, 2.0, math.inf, 0.0
    for i in range(6000):
        t = i * dt
        needed_m = rise_beyond_climb_m(knowledge(forecast(swell(1.6, t)))) if i % 10 == 0 else needed_m
        rise = 1.6 * math.cos(OMEGA * (t - 1.5))
        rate = descent_rate_m_s(0.0, height_m, GuidanceOptions().cone, 0.3 + needed_m)
        height_m += dt * (min(CLIMB_M_S, rise - rate) - rise)
        lowest_m = min(lowest_m, height_m)
    assert 0.25 < lowest_m < 0.4, "not reached, and as low as the gate between two seas"


def test_the_gate_stays_shut_and_the_drone_goes_up_before_such_a_sea_comes() -> None:
    o, rough = GuidanceOptions(), knowledge(forecast(swell(1.6)))
    assert rough.relative is not None
    kept_shut = gate(ns(0.0), rough.relative, rough, InputQuality(), o.limits, o.cone, aligned=False)
    assert kept_shut is not None
    assert kept_shut.cause is ReasonCause.DECK_RISE
    assert "the deck will rise 0.95 m more than the drone can climb" in kept_shut.text
    open_to = knowledge(forecast(swell(0.9)))
    assert gate(ns(0.0), rough.relative, open_to, InputQuality(), o.limits, o.cone, aligned=False) is None
    for state in (State.INTERCEPT, State.DESCEND, State.GATE, State.HOLD_BLIND):
        p = replace(Progress.start(automatic=True), state=state, begun=True, entered_height_m=0.35, seen_height_m=0.35, track=1)
        _, high = aim(p, GuidanceCycle(ns(0.0), rough), o)
        _, low = aim(p, GuidanceCycle(ns(0.0), open_to), o)
        assert isinstance(high, Target)
        assert isinstance(low, Target)
        assert high.d_body_pad_level[2] > 1.2
        assert low.d_body_pad_level[2] < 0.4
        assert high.descent_rate_m_s is None or high.descent_rate_m_s < -0.89


@pytest.mark.parametrize(("period_s", "rate_m_s"), [(7.0, 0.4), (9.0, 0.9), (12.0, 0.8)])
def test_a_swell_has_its_own_period_and_asks_for_what_twice_its_deviation_gains(period_s: float, rate_m_s: float) -> None:
    """A swell whose rate has this deviation, watched for a minute; a slow one is assumed before."""
    watch, w, dt = SwellWatch(), math.tau / period_s, 0.02
    assert watch.rad_s == pytest.approx(math.tau / 12.0)
    for i in range(3000):
        rate = math.sqrt(2.0) * rate_m_s
        v, a = (np.array([0.0, 0.0, x]) for x in (rate * math.cos(w * i * dt), -w * rate * math.sin(w * i * dt)))
        watch = watched_swell(watch, ns(i * dt), deck(i * dt, v, a))
    assert watch.rad_s == pytest.approx(w, rel=0.1)
    if 2.0 * rate_m_s <= CLIMB_M_S:
        assert watch.gained_m(CLIMB_M_S) == 0.0
    else:
        angle = math.acos(CLIMB_M_S / (2.0 * rate_m_s))
        gained = 2.0 * (2.0 * rate_m_s * math.sin(angle) - CLIMB_M_S * angle) / w
        assert watch.gained_m(CLIMB_M_S) == pytest.approx(gained, rel=0.2)


def test_a_deck_that_outruns_the_climb_by_more_than_the_safe_height_is_refused_before_the_descent() -> None:
    """One wave says little of a swell: what was watched for less than its mean time refuses nothing."""
    for outrun_m, watched_s, refused in ((1.6, 31.0, False), (1.8, 31.0, True), (1.8, 29.0, False)):
        s = GuidanceCycle(ns(9.0), replace(knowledge(None, at_s=9.0), outrun_m=outrun_m, swell_watched_s=watched_s))
        p = Progress(State.INTERCEPT, automatic=True, begun=True, since=ns(8.0), seen=ns(9.0), in_sight=True, track=1)
        found = [why.cause for event, why in PHASES[p.state].events(p, s, GuidanceOptions()) if event is Event.NO_CONDITIONS]
        assert found == ([ReasonCause.DECK_RISE] if refused else [])
