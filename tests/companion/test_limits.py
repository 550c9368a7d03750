"""The limits of gate and commit hold up to their number and not beyond.

The drone is higher where the deck will rise faster than the drone can climb.
"""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.base.observer import ResponseInUse, ResponseState
from companion.guidance.controller import HORIZONS_S, AtContact, Knowledge
from companion.guidance.mission.clearance import SwellWatch, rise_beyond_climb_m, watched_swell
from companion.guidance.mission.descend import descent_rate_m_s
from companion.guidance.mission.limits import (
    LEANS_MORE_M_S2,
    commit,
    gate,
    impossible_deck,
    lift_m,
    no_return_m,
    of_try,
    sigma_m,
    to_contact_s,
)
from companion.guidance.mission.machine import PHASES, aim
from companion.guidance.mission.progress import GuidanceCycle, InputQuality, Progress
from companion.settings.guidance import ClimbResponse, GuidanceOptions
from companion.settings.mission import ConeOptions, LandingLimits
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2, BodyMotion, DeckMotion
from estimator.ekf import Forecast
from tests.make import body, deck, estimate, ns

NOW = 50.0
CLIMB_M_S, PERIOD_S = 1.0, 9.0
OMEGA = math.tau / PERIOD_S
LIMITS, CONE = LandingLimits(), ConeOptions()
CLIMB = ClimbResponse(0.06, 0.43, 1.0)
TO_CONTACT_S = 0.3 / CONE.commit_rate_m_s


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


def tilted(roll_deg: float = 0.0, pitch_deg: float = 0.0, down_m_s: float = 0.0, *, sigma_deg: float = 1e-4) -> DeckMotion:
    roll, pitch = math.radians(roll_deg), math.radians(pitch_deg)
    return replace(deck(NOW, (0.0, 0.0, down_m_s), roll=roll, pitch=pitch), cov_tilt=math.radians(sigma_deg) ** 2 * np.eye(4))


def tilting(roll_deg: float, pitch_deg: float) -> Forecast:
    """Return a deck that is level now and has this tilt when the drone comes down."""
    to_come = np.radians(np.array(HORIZONS_S)[:, None] / TO_CONTACT_S * [roll_deg, pitch_deg])
    level = forecast(np.zeros(len(HORIZONS_S)), NOW)
    fields = {name: getattr(level, name) for name in Forecast.__struct_fields__}
    return Forecast(**fields | {"roll_rad": to_come[:, 0], "pitch_rad": to_come[:, 1]})


def falling(m_s: float, at_s: tuple[float, ...] = HORIZONS_S, ago_s: float = 0.0) -> Forecast:
    """Return a deck that falls at some horizons of a forecast made some time ago, and is still at the others."""
    return forecast(np.where(np.isin(HORIZONS_S, at_s), -m_s, 0.0), NOW - ago_s)


def shut(
    seen: dict[str, Any] | None = None,
    deck: DeckMotion | None = None,
    ahead: Forecast | None = None,
    quality: InputQuality | None = None,
    *,
    aligned: bool = False,
    contact: AtContact | None = None,
) -> Reason | None:
    one = estimate(NOW, **{"d": (0.0, 0.0, CONE.feet_below_m + 0.3)} | (seen or {}))
    knowledge = Knowledge(ns(NOW), one, deck=deck, forecast=ahead, climb_max_m_s=1.0, at_contact=contact)
    return gate(ns(NOW), one, knowledge, quality or InputQuality(), LIMITS, CONE, aligned=aligned)


@pytest.mark.hazard("H3")
@pytest.mark.parametrize(
    ("within", "beyond", "cause", "limit"),
    [
        ({"seen": {"age": 0.29}}, {"seen": {"age": 0.31}}, ReasonCause.SIGHTING_AGE, 0.3),
        ({"seen": {"sigma": 0.149}}, {"seen": {"sigma": 0.151}}, ReasonCause.SIGMA, 0.15),
        ({"quality": InputQuality(4.0)}, {"quality": InputQuality(4.01)}, ReasonCause.NIS, 4.0),
        ({}, {"quality": InputQuality(math.nan)}, ReasonCause.NIS, 4.0),
        ({"quality": InputQuality(None, 0.03)}, {"quality": InputQuality(None, 0.031)}, ReasonCause.TIME_LOCK, 0.03),
        ({"seen": {"d": (0.05, -0.06, 0.3)}}, {"seen": {"d": (0.06, -0.06, 0.3)}}, ReasonCause.ERROR, 0.08),
        ({"seen": {"v": (0.2, -0.22, 9.0)}}, {"seen": {"v": (0.22, -0.22, 0.0)}}, ReasonCause.RELATIVE_SPEED, 0.3),
        (
            {"quality": InputQuality(delay_s=0.3), "seen": {"age": 0.59}},
            {"quality": InputQuality(delay_s=0.3), "seen": {"age": 0.61}},
            ReasonCause.SIGHTING_AGE,
            0.3,
        ),
        ({"contact": AtContact(0.079, 0.0, 0.0)}, {"contact": AtContact(0.081, 0.0, 0.0)}, ReasonCause.ERROR_AHEAD, 0.08),
        ({"contact": AtContact(0.0, 0.0, 0.039)}, {"contact": AtContact(0.0, 0.0, 0.041)}, ReasonCause.ERROR_AHEAD, 0.08),
        ({"contact": AtContact(0.05, 0.0, 0.03)}, {"contact": AtContact(0.056, 0.0, 0.03)}, ReasonCause.ERROR_AHEAD, 0.08),
        ({"contact": AtContact(0.0, 0.199, 0.0)}, {"contact": AtContact(0.0, 0.201, 0.0)}, ReasonCause.SPEED_AHEAD, 0.2),
        ({"contact": AtContact(0.0, 0.0, 0.0, 1.9, 2.0)}, {"contact": AtContact(0.0, 0.0, 0.0, 2.1, 2.0)}, ReasonCause.GUST, 2.0),
        ({"deck": tilted(1.7, -1.8)}, {"deck": tilted(1.8, -1.8)}, ReasonCause.DECK_TILT, 2.5),
        ({"deck": tilted(2.2, 2.2, sigma_deg=0.7)}, {"deck": tilted(2.2, 2.2, sigma_deg=0.5)}, ReasonCause.DECK_TILT, 2.5),
        ({"deck": tilted(down_m_s=1.19)}, {"deck": tilted(down_m_s=1.21)}, ReasonCause.DECK_RATE, 1.2),
        ({"deck": tilted(down_m_s=-1.19)}, {"deck": tilted(down_m_s=-1.21)}, ReasonCause.DECK_RATE, 1.2),
        ({"ahead": tilting(1.0, -1.1)}, {"ahead": tilting(1.1, -1.1)}, ReasonCause.DECK_TILT, 1.5),
        ({"ahead": forecast(swell(1.0), NOW)}, {"ahead": forecast(swell(1.6), NOW)}, ReasonCause.DECK_RISE, 0.1),
        ({"ahead": falling(0.49)}, {"ahead": falling(0.51)}, ReasonCause.DECK_FALL, 0.5),
        ({"seen": {"yaw": -0.2}, "aligned": True}, {"seen": {"yaw": -0.22}, "aligned": True}, ReasonCause.HEADING, 12.0),
        ({"seen": {"yaw": 3.0}}, {"seen": {"yaw": None}, "aligned": True}, ReasonCause.HEADING, 12.0),
    ],
)
def test_the_gate_is_open_up_to_a_limit_and_shut_beyond_it(within, beyond, cause, limit):
    assert shut(**within) is None
    found = shut(**beyond)
    assert (found.cause, found.limit) == (cause, pytest.approx(limit))
    assert not found.measured <= limit
    assert math.isnan(found.measured) or cause is ReasonCause.DECK_RISE or found.measured < 1.1 * limit or limit == 12.0


@pytest.mark.parametrize(
    ("at_s", "ago_s", "opens"),
    [
        ((0.0, 0.1, 0.2, 0.3, 0.5), 0.0, True), ((0.5, 0.75), 0.0, False), ((1.0,), 0.0, False),
        ((1.5,), 0.0, True), ((1.5,), 0.2, False), ((2.0, 3.0), 0.2, True),
    ],
)  # fmt: skip
def test_a_deck_may_fall_before_the_contact_and_when_the_motors_stand(at_s: tuple[float, ...], ago_s: float, opens: bool) -> None:
    """The contact comes after 0.75 s, the motors stand 0.6 s later."""
    found = shut(ahead=falling(0.7, at_s, ago_s))
    assert (found is None) is opens
    assert shut(ahead=falling(-0.9)) is None, "a deck that rises presses by itself"


@pytest.mark.parametrize("seed", range(5))
def test_sigma_is_that_of_the_worst_horizontal_direction(seed: int) -> None:
    root = np.random.default_rng(seed).normal(size=(7, 7))
    cov = root @ root.T
    one = replace(estimate(NOW, (0.0, 0.0, 1.0)), cov=cov)
    assert sigma_m(one) ** 2 == pytest.approx(np.linalg.eigvalsh(cov[:2, :2])[-1])


@pytest.mark.hazard("H3")
@given(rim_m=st.floats(0.02, 0.3), aside_m=st.floats(0.0, 0.3), go_arounds=st.integers(0, 5), lands=st.booleans())
def test_no_widened_limit_lets_a_foot_over_the_rim(rim_m: float, aside_m: float, go_arounds: int, *, lands: bool) -> None:
    o = of_try(GuidanceOptions(), go_arounds)
    now_m, then_m = (0.0, aside_m) if lands else (aside_m, 0.0)
    one = estimate(NOW, (0.0, now_m, 0.3))
    known = Knowledge(ns(NOW), one, at_contact=AtContact(then_m, 0.0, 0.0), rim_m=rim_m)
    ends = commit(ns(NOW), one, known, o.limits, o.cone)
    shuts = gate(ns(NOW), one, known, InputQuality(), o.limits, o.cone, aligned=False)
    if aside_m > rim_m:
        assert ends is not None
        assert shuts is not None
    wide = commit(ns(NOW), one, replace(known, rim_m=math.inf), o.limits, o.cone)
    assert (ends is None) == (wide is None and aside_m <= rim_m), "the rim alone makes the difference"


def in_commit(seen: dict[str, Any], deck: DeckMotion | None = None, longer_s: float | None = None) -> Reason | None:
    one = estimate(NOW, **{"d": (0.0, 0.0, 0.3)} | seen)
    response = None if longer_s is None else ResponseInUse(ResponseState.IDENTIFIED, 0.1, 0.01, longer_s)
    return commit(ns(NOW), one, Knowledge(ns(NOW), one, deck=deck, response=response), LIMITS, CONE)


def test_the_commit_has_limits_of_its_own() -> None:
    for within, beyond, cause in (
        ({"age": 1.49}, {"age": 1.51}, ReasonCause.SIGHTING_AGE),
        ({"d": (0.0, 0.24, 0.3)}, {"d": (0.0, 0.26, 0.3)}, ReasonCause.ERROR),
    ):
        assert in_commit(within) is None
        found = in_commit(beyond)
        assert found.cause is cause
    assert in_commit({}, tilted(2.4)) is None
    assert in_commit({"d": (0.0, 0.0, 1.0)}) is None


@pytest.mark.hazard("H3")
def test_a_commit_ends_on_the_error_to_come_while_a_climb_comes_before_the_contact() -> None:
    for height_m, ends in ((0.3, True), (CONE.feet_below_m + 0.1, False)):
        one = estimate(NOW, (0.0, 0.0, height_m))
        for contact in (AtContact(0.13, 0.0, 0.0), AtContact(0.0, 0.31, 0.0), AtContact(0.0, 0.0, 0.0, 3.1, 3.0)):
            found = commit(ns(NOW), one, Knowledge(ns(NOW), one, at_contact=contact), LIMITS, CONE)
            assert (found is not None) is ends
        calm = Knowledge(ns(NOW), one, at_contact=AtContact(0.11, 0.29, 0.0))
        assert commit(ns(NOW), one, calm, LIMITS, CONE) is None


@pytest.mark.hazard("H4")
def test_a_vehicle_whose_feet_the_deck_holds_does_not_go_around_for_a_gust_or_a_speed_to_come() -> None:
    """WHY: on a falling deck that nothing felt, its tilt without a motion was a gust of 3.9 m/s."""
    for feet_m, ends in ((0.06, True), (0.04, False)):
        one = estimate(NOW, (0.0, 0.0, CONE.feet_below_m + feet_m))
        for contact in (AtContact(0.0, 0.31, 0.0), AtContact(0.0, 0.0, 0.0, 3.1, 3.0)):
            knowledge = Knowledge(ns(NOW), one, at_contact=contact, climb=ClimbResponse(0.14, 0.12))
            assert (commit(ns(NOW), one, knowledge, LIMITS, CONE) is not None) is ends


@pytest.mark.parametrize(("longer_s", "more_m"), [(None, 0.0), (-0.1, 0.0), (0.1, 0.1 * CONE.commit_rate_m_s)])
def test_a_tilt_ends_the_commit_only_above_the_height_of_no_return(longer_s: float | None, more_m: float) -> None:
    height_m = CONE.feet_below_m + CONE.no_return_s * CONE.commit_rate_m_s + more_m
    response = None if longer_s is None else ResponseInUse(ResponseState.IDENTIFIED, 0.1, 0.01, longer_s)
    assert no_return_m(Knowledge(ns(NOW), None, response=response), CONE) == pytest.approx(height_m)
    for off_m in (-0.01, 0.01):
        found = in_commit({"d": (0.0, 0.0, height_m + off_m)}, tilted(2.6), longer_s)
        assert (found is not None and found.cause is ReasonCause.DECK_TILT) is (off_m > 0.0)


def swings(
    down_m_s: float = 0.0, a_m_s2: float = 0.0, roll_deg_s: float = 0.0, pitch_deg_s: float = 0.0, sigma: float = 0.0
) -> DeckMotion:
    v, a = np.array([9.0, 0.0, down_m_s]), np.array([9.0, 0.0, a_m_s2])
    rates = math.radians(roll_deg_s), math.radians(pitch_deg_s)
    return DeckMotion(ns(NOW), v, a, sigma**2 * np.eye(6), 0.0, 0.0, *rates, np.zeros((4, 4)))


@pytest.mark.parametrize(
    ("deck", "impossible"),
    [
        (swings(4.9, 4.9, 39.0, 39.0), False), (swings(-5.1), True), (swings(5.1), True), (swings(0.0, 5.1), True),
        (swings(roll_deg_s=-41.0), True), (swings(pitch_deg_s=41.0), True), (swings(pitch_deg_s=-41.0), True),
        (swings(6.0, sigma=0.6), False), (swings(6.0, sigma=0.4), True), (None, False),
    ],
)  # fmt: skip
def test_a_deck_moves_up_and_down_no_faster_than_any_vessel_does(deck: DeckMotion | None, impossible: bool) -> None:
    assert impossible_deck(deck) is impossible


@pytest.mark.hazard("H3")
@pytest.mark.parametrize(
    ("height_m", "speed_m_s", "ahead_m_s", "ends"),
    [
        (0.2, 0.46, None, True), (0.2, 0.46, 0.29, True), (0.2, 0.44, None, False), (0.12, 0.9, None, True),
        (0.12, 0.9, 0.46, True), (0.12, 0.9, 0.44, False), (0.09, 0.9, None, False),
    ],
)  # fmt: skip
def test_a_commit_that_would_slide_ends_in_time(height_m: float, speed_m_s: float, ahead_m_s: float | None, ends: bool) -> None:
    """WHY: 4 cm over the deck a drone that was braking already, from 0.46 m/s to 0.38, brushed it on its way up."""
    seen = estimate(NOW, (0.0, 0.0, height_m), (speed_m_s, 0.0, -0.4))
    contact = None if ahead_m_s is None else AtContact(0.0, ahead_m_s, 0.0)
    found = commit(ns(NOW), seen, Knowledge(ns(NOW), seen, climb=CLIMB, at_contact=contact), LIMITS, CONE)
    assert (found is not None and found.cause is ReasonCause.RELATIVE_SPEED) is ends


def leaning(lean_deg: float) -> BodyMotion:
    R = Rotation.from_rpy(math.radians(lean_deg), 0.0, 0.0)
    return body(NOW, reported=R)


@pytest.mark.hazard("H3")
@given(
    st.floats(0.0, 1.2),
    st.floats(0.0, 0.3),
    st.floats(0.05, 0.8),
    st.floats(0.3, 2.0),
    st.floats(-1.0, 1.0),
    st.floats(0.0, 25.0),
)
def test_a_climb_from_the_height_of_lifting_keeps_the_feet_off_and_one_from_below_does_not(
    down_m_s: float, delay_s: float, lag_s: float, most_m_s: float, deck_down_m_s: float, lean_deg: float
) -> None:
    """WHY: in weather_4 a drone went around 4 cm over the deck, 17 degrees to one side, and slid over it at 0.6 m/s."""
    seen = estimate(NOW, (0.0, 0.0, 0.3), (0.0, 0.0, -down_m_s))
    deck = tilted(down_m_s=deck_down_m_s)
    known = Knowledge(ns(NOW), seen, leaning(lean_deg), deck, climb=ClimbResponse(delay_s, lag_s, most_m_s))
    lower_m = CONE.feet_aside_m * math.tan(math.radians(lean_deg))
    up_m_s, dt = most_m_s - max(0.0, -deck_down_m_s), 1e-3
    from_m = lift_m(seen, known, CONE)
    cov = seen.cov.copy()
    cov[5, 5] = 0.2**2
    slower = estimate(NOW, (0.0, 0.0, 0.3), (0.0, 0.0, 0.1 - down_m_s))
    doubted = lift_m(replace(slower, cov=cov), known, CONE)
    assert down_m_s < 0.1 or doubted == pytest.approx(from_m), "two sigma beyond the usual 0.15 m/s count"
    feet, v, t = from_m - CONE.feet_below_m - lower_m, down_m_s, 0.0
    while t < delay_s or v > 0.0:
        t += dt
        feet -= dt * v
        v -= dt * (v + max(0.2 * most_m_s, up_m_s)) / lag_s if t > delay_s else 0.0
    assert feet == pytest.approx(CONE.feet_aside_m * LEANS_MORE_M_S2 / G_M_S2, abs=0.005)


@pytest.mark.hazard("H3")
def test_the_contact_is_that_of_the_lowest_foot_at_the_rate_that_is_flown() -> None:
    seen = estimate(NOW, (0.0, 0.0, CONE.feet_below_m + 0.2), (0.0, 0.0, -0.1))
    assert to_contact_s(seen, Knowledge(ns(NOW), seen), CONE) == pytest.approx(0.5)
    leans = Knowledge(ns(NOW), seen, leaning(20.0))
    assert to_contact_s(seen, leans, CONE) == pytest.approx((0.2 - CONE.feet_aside_m * math.tan(math.radians(20.0))) / 0.4)
    fast = estimate(NOW, (0.0, 0.0, CONE.feet_below_m + 0.2), (0.0, 0.0, -0.8))
    assert to_contact_s(fast, Knowledge(ns(NOW), fast), CONE) == pytest.approx(0.25)


def test_a_speed_that_is_no_longer_known_ends_the_commit_over_a_deck() -> None:
    """Two sigma count beyond the usual one, and a ship that is seen to brake gains speed until the contact.

    Low over the deck that takes the last chance to climb; her own sensors end it higher up as well, where a climb comes in time.
    """
    cases = (
        (0.2, 0.15, False, True, False),
        (0.2, 0.3, False, True, True),
        (0.2, 0.15, False, False, False),
        (0.2, 0.02, True, False, True),
        (0.2, 0.02, True, True, False),
        (0.25, 0.02, True, False, False),
        (0.25, 0.02, None, True, True),
        (0.08, 0.02, None, True, False),
    )
    for height_m, sigma_m_s, steers, unfelt, ends in cases:
        seen = estimate(NOW, (0.0, 0.0, height_m), (0.2, 0.0, -0.4))
        cov = seen.cov.copy()
        cov[3, 3] = cov[4, 4] = sigma_m_s**2
        seen = replace(seen, cov=cov, steers=bool(steers), jolted=steers is None)
        found = commit(ns(NOW), seen, Knowledge(ns(NOW), seen, deck=tilted(0.0, 0.0), unfelt=unfelt), LIMITS, CONE)
        assert (found is not None and found.cause is ReasonCause.RELATIVE_SPEED) is ends


def test_the_limits_and_the_cone_grow_with_each_go_around_up_to_a_half_more() -> None:
    """WHY: where the cone did not grow, gusts took the drone out of it before the wider gate could open."""
    o = GuidanceOptions()
    for n, factor in ((0, 1.0), (1, 1.25), (2, 1.5), (9, 1.5)):
        found = of_try(o, n)
        assert (found.limits.error_m, found.cone.slope) == pytest.approx((factor * o.limits.error_m, factor * o.cone.slope))
    assert of_try(o, 9).limits.sigma_m == o.limits.sigma_m


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
    kept_shut = gate(ns(0.0), rough.relative, rough, InputQuality(), o.limits, o.cone, aligned=False)
    assert kept_shut.cause is ReasonCause.DECK_RISE
    assert "the deck will rise 0.95 m more than the drone can climb" in kept_shut.text
    open_to = knowledge(forecast(swell(0.9)))
    assert gate(ns(0.0), rough.relative, open_to, InputQuality(), o.limits, o.cone, aligned=False) is None
    for state in (State.INTERCEPT, State.DESCEND, State.GATE, State.HOLD_BLIND):
        p = replace(Progress.start(automatic=True), state=state, begun=True, entered_height_m=0.35, seen_height_m=0.35, track=1)
        _, high = aim(p, GuidanceCycle(ns(0.0), rough), o)
        _, low = aim(p, GuidanceCycle(ns(0.0), open_to), o)
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
