"""The planner at each of its edges: one guidance cycle from a given memory."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from companion.guidance.budget import Spent
from companion.guidance.lease import Lease
from companion.guidance.pid import SetPoint
from companion.guidance.plan import Plan
from companion.guidance.planner import Aim, GoAround, Phase, Planner, Question, planner_step
from estimator.contracts.commands import Hover, Land, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.time import MonoNs
from tests.companion.plans import changed, planned

PLAN = Plan.over_the_pad()
AUTOMATIC = changed(PLAN, another_pad="automatic")
NOW = 100.0
SAFE_M, NEARLY_SAFE_M = PLAN.options.safe_height_m, PLAN.options.safe_height_m - 0.25


def at(seconds: float) -> MonoNs:
    return MonoNs(round(seconds * 1e9))


def belief(
    height_m: float, aside: tuple[float, float] = (0.0, 0.0), *, v: tuple[float, float, float] = (0.0, 0.0, 0.0),
    sigma_m: float = 0.01, yaw_rad: float | None = 0.0, track: int = 1, age_s: float = 0.0, computed_s: float = 0.0,
) -> RelativeState:  # fmt: skip
    cov = np.diag([0.25 * sigma_m**2, sigma_m**2, 9.0, 1e-4, 1e-4, 1e-4, 1e-4])
    d = np.array([*aside, height_m])
    return RelativeState(
        at(NOW - computed_s), "ekf", d, np.array(v), yaw_rad, cov, at(NOW - age_s), True, track=track
    )  # fmt: skip


def flying(since_last_s: float = 0.0, **memory: Any) -> Planner:
    """In sight of pad 1 at three metres, a cycle ago."""
    known: dict[str, Any] = {"seen": at(NOW - since_last_s), "sighted_height_m": 3.0, "in_sight": True, "track": 1}
    return Planner(last=at(NOW - since_last_s), **{**known, **memory})


def lost(for_s: float, height_m: float = 3.0, **memory: Any) -> Planner:
    return flying(0.25, seen=at(NOW - for_s), sighted_height_m=height_m, in_sight=False, **memory)


def cycle(state: Planner, estimate: RelativeState | None, plan: Plan = PLAN) -> tuple[Planner, Aim, Phase]:
    return planner_step(state, plan, at(NOW), estimate)


def test_a_new_planner_knows_nothing_and_waits() -> None:
    assert not any((Planner().leg, Planner().in_sight, Planner().go_arounds, Planner().questions, Planner().gave_up))
    assert (Planner().since_last_s, Planner().sighted_height_m) == (0.0, math.inf)
    state, aim, phase = cycle(Planner.start(), None)
    assert (aim, phase, state.since_last_s, state.last) == (Hover(), Phase.WAITING, 0.0, at(NOW))
    assert cycle(replace(Planner.start(), last=at(NOW - 0.5)), None)[0].since_last_s == 0.5
    assert cycle(replace(Planner.start(), last=at(NOW + 0.5)), None)[0].since_last_s == 0.0
    assert cycle(flying(gave_up=True), belief(3.0))[1:] == (Hover(), Phase.GAVE_UP)


@pytest.mark.parametrize(
    ("height_m", "aside", "near"),
    [
        (2.0, (0.25, 0.0), True), (2.0, (0.0, -0.25), True), (2.0, (0.26, 0.0), False), (2.0, (0.0, -0.26), False),
        (2.0, (0.2, 0.2), False), (2.25, (0.0, 0.0), True), (1.75, (0.0, 0.0), True), (2.26, (0.0, 0.0), False),
        (1.74, (0.0, 0.0), False),
    ],
)  # fmt: skip
def test_near_a_way_point_is_within_both_its_distances(height_m: float, aside: tuple[float, float], near: bool) -> None:
    assert cycle(flying(), belief(height_m, aside))[0].near_since == (at(NOW) if near else None)
    assert cycle(flying(near_since=at(NOW - 0.1)), belief(height_m, aside))[0].near_since == (at(NOW - 0.1) if near else None)


@pytest.mark.parametrize(
    ("aside", "v", "sigma_m", "near"),
    [
        ((0.0, 0.0), (0.19, 0.0, 0.0), 0.01, True), ((0.0, 0.0), (0.21, 0.0, 0.0), 0.01, False),
        ((0.0, 0.0), (0.0, -0.19, 0.0), 0.01, True), ((0.0, 0.0), (0.0, -0.21, 0.0), 0.01, False),
        ((0.1, 0.0), (-0.3, 0.0, 0.0), 0.01, True), ((0.0, 0.1), (0.0, 0.1, 0.0), 0.01, False),
        ((0.0, 0.0), (0.0, 0.0, 9.0), 0.149, True), ((0.0, 0.0), (0.0, 0.0, 0.0), 0.151, False),
        ((0.13, 0.0), (-0.1, 0.0, 0.0), 0.01, False), ((0.12, 0.0), (0.0, 0.0, 0.0), 0.15, True),
    ],
)  # fmt: skip
def test_near_the_last_way_point_is_still_to_be_there_and_sure_of_it(
    aside: tuple[float, float], v: tuple[float, float, float], sigma_m: float, near: bool
) -> None:
    state, _, phase = cycle(flying(leg=1), belief(0.3, aside, v=v, sigma_m=sigma_m))
    assert (state.near_since is not None, phase) == (near, Phase.DESCEND)
    assert cycle(flying(), belief(2.0, v=(9.0, 0.0, 0.0), sigma_m=0.9))[0].near_since is not None, "the first asks for less"


def test_a_way_point_is_reached_when_it_has_been_near_for_its_time() -> None:
    state, _, phase = cycle(flying(near_since=at(NOW - 0.299)), belief(2.0))
    assert (state.leg, state.spent.descending, phase) == (0, None, Phase.APPROACH)
    state, _, phase = cycle(flying(near_since=at(NOW - 0.3)), belief(2.0))
    assert (state.leg, state.near_since, state.spent.descending, phase) == (1, None, at(NOW), Phase.DESCEND)
    assert cycle(flying(leg=1, near_since=at(NOW - 0.199)), belief(0.3))[2] is Phase.DESCEND
    state, aim, phase = cycle(flying(leg=1, near_since=at(NOW - 0.2)), belief(0.3))
    assert (aim, phase, state.landing) == (Land(), Phase.LAND, Lease(at(NOW), 0.3, at(NOW), 0.3))


@pytest.mark.parametrize(("heading", "yaw_rad"), [("align", 0.0), ("keep", None)])
def test_the_heading_is_asked_for_where_the_plan_says_so(heading: Any, yaw_rad: float | None) -> None:
    aim = cycle(flying(), belief(3.0), changed(PLAN, heading=heading))[1]
    assert isinstance(aim, SetPoint)
    assert aim.yaw_rad == yaw_rad


@pytest.mark.parametrize(
    ("memory", "losses"),
    [
        ({"sighted_height_m": NEARLY_SAFE_M}, 0), ({"sighted_height_m": NEARLY_SAFE_M - 0.01}, 1), ({"leg": 1}, 1),
        ({"leg": 1, "in_sight": False}, 0), ({"leg": 0}, 0),
    ],
)  # fmt: skip
def test_a_loss_is_counted_once_on_the_last_leg_or_low(memory: dict[str, Any], losses: int) -> None:
    state, _, _ = cycle(flying(0.25, **memory), None)
    assert (state.spent.losses, state.in_sight, state.spent.without_sight_s) == (losses, False, 0.25)
    assert cycle(Planner(last=at(NOW - 0.25)), None)[0].spent == Spent(), "before the first sight nothing is lost"


def test_height_lost_between_a_last_and_a_next_sight_is_counted() -> None:
    assert cycle(lost(1.0), belief(2.75))[0].spent.blind_descent_m == 0.25
    assert cycle(lost(1.0), belief(3.5))[0].spent.blind_descent_m == 0.0
    assert cycle(flying(), belief(2.75))[0].spent.blind_descent_m == 0.0
    first, _, _ = cycle(Planner.start(), belief(2.75))
    assert (first.spent.blind_descent_m, first.spent.began, first.sighted_height_m, first.track) == (0.0, at(NOW), 2.75, 1)


def test_a_budget_used_up_ends_the_try_and_a_go_around_uses_none() -> None:
    spent = Spent(began=at(NOW - 121.0))
    state, _, phase = cycle(flying(leg=1, spent=spent), belief(1.0))
    assert (phase, state.go_arounds, state.leg, state.landing) == (Phase.GO_AROUND, 1, 0, None)
    assert state.going_around == GoAround(at(NOW), 1.0)
    assert cycle(flying(spent=spent, going_around=state.going_around, go_arounds=1), belief(1.0))[0].go_arounds == 1


@pytest.mark.parametrize(
    ("for_s", "height_m", "phase"),
    [(1.5, 1.99, Phase.LOST), (1.51, 1.99, Phase.CLIMB), (1.51, 2.0, Phase.LOST), (9.0, 3.0, Phase.LOST)],
)
def test_a_pad_lost_low_is_sought_from_higher_up_after_a_while(for_s: float, height_m: float, phase: Phase) -> None:
    state, aim, now = cycle(lost(for_s, height_m), None)
    assert now is phase
    assert (state.point, state.near_since) == (None, None)
    if phase is Phase.CLIMB:
        assert isinstance(aim, Velocity)
        assert aim.v_level.tolist() == [0.0, 0.0, -PLAN.options.climb_m_s]
        assert "lost at 2.0 m" in state.reason


@pytest.mark.parametrize(
    ("without_s", "height_m", "phase"),
    [(19.75, 2.0, Phase.LOST), (20.0, 2.0, Phase.GAVE_UP), (19.75, 1.9, Phase.LOST), (20.0, 1.9, Phase.CLIMB)],
)
def test_it_gives_up_when_it_has_been_without_sight_for_too_long(without_s: float, height_m: float, phase: Phase) -> None:
    state, _, now = cycle(lost(0.75, height_m, spent=Spent(without_sight_s=without_s)), None)
    assert now is phase
    assert state.gave_up is (phase is Phase.GAVE_UP)
    if state.gave_up:
        assert state.reason == "the pad was not found again"
        assert cycle(lost(0.75, height_m, spent=Spent(without_sight_s=without_s), reason="why"), None)[0].reason == "why"


@pytest.mark.parametrize(
    ("from_m", "for_s", "gave_up"),
    [(2.0, 10.0, False), (2.0, 10.01, True), (9.0, 10.0, False), (9.0, 10.01, True), (0.5, 24.9, False), (0.5, 25.1, True)],
)
def test_a_go_around_that_does_not_climb_is_given_up(from_m: float, for_s: float, gave_up: bool) -> None:
    state, _, phase = cycle(flying(going_around=GoAround(at(NOW - for_s), from_m), go_arounds=1, reason="late"), belief(1.0))
    assert phase is (Phase.GAVE_UP if gave_up else Phase.GO_AROUND)
    assert state.reason == ("late, and it did not climb" if gave_up else "late")


@pytest.mark.parametrize("go_arounds", [3, 4])
def test_a_go_around_ends_at_the_safe_height_in_a_new_try_or_for_good(go_arounds: int) -> None:
    climbing = flying(0.25, going_around=GoAround(at(NOW - 1.0), 1.0), go_arounds=go_arounds, spent=Spent(losses=7), reason="why")
    state, aim, phase = cycle(climbing, belief(NEARLY_SAFE_M - 0.01, (0.5, 0.0)))
    assert phase is Phase.GO_AROUND
    assert isinstance(aim, SetPoint)
    assert aim.yaw_rad is None
    state, aim, phase = cycle(climbing, belief(NEARLY_SAFE_M))
    if go_arounds > PLAN.options.go_arounds_max:
        assert (aim, phase, state.reason) == (Hover(), Phase.GAVE_UP, "why")
    else:
        assert (phase, state.going_around, state.spent) == (Phase.APPROACH, None, Spent(began=at(NOW)))


def test_a_go_around_climbs_over_the_first_way_point() -> None:
    plan = planned(pad_ahead_m=0.4)
    climbing = flying(0.1, going_around=GoAround(at(NOW - 1.0), 1.0), go_arounds=1, point=np.array([0.4, 0.0, 1.0]))
    _, aim, _ = cycle(climbing, belief(1.0, (0.4, 0.0)), plan)
    assert isinstance(aim, SetPoint)
    assert aim.d_body_pad_level == pytest.approx([0.4, 0.0, 1.04])
    assert aim.v_body_level == pytest.approx([0.0, 0.0, -0.4])


@pytest.mark.parametrize("go_arounds", [3, 4])
@pytest.mark.parametrize(("since_s", "seen_s"), [(1.9, 8.0), (8.0, 1.9), (2.1, 8.0), (8.0, 2.1)])
def test_without_sight_it_climbs_for_as_long_as_it_lacks_height(since_s: float, seen_s: float, go_arounds: int) -> None:
    climb = GoAround(at(NOW - since_s), 1.4)
    state = lost(seen_s, 1.4, going_around=climb, go_arounds=go_arounds, spent=Spent(losses=7, without_sight_s=6.0))
    after, aim, phase = cycle(state, None)
    if min(since_s, seen_s) < 2.0:
        assert phase is Phase.CLIMB
        assert isinstance(aim, Velocity)
        assert aim.v_level.tolist() == [0.0, 0.0, -PLAN.options.climb_m_s]
        assert aim.yaw_rate_rad_s == 0.0
    elif go_arounds > PLAN.options.go_arounds_max:
        assert (aim, phase) == (Hover(), Phase.GAVE_UP)
    else:
        assert (aim, phase, after.going_around, after.sighted_height_m) == (Hover(), Phase.LOST, None, SAFE_M)
        assert after.spent == Spent(without_sight_s=6.25)


def test_a_climb_without_sight_ends_when_the_height_that_lacked_is_made_up() -> None:
    plan = changed(PLAN, climb_m_s=0.5)
    state = lost(8.0, 1.5, going_around=GoAround(at(NOW - 1.0), 1.5), go_arounds=1)
    assert cycle(state, None, plan)[1:] == (Hover(), Phase.LOST)
    assert cycle(asked(1.0, 1.5), None, plan)[1:] == (Hover(), Phase.ANOTHER_PAD)


def test_a_landing_goes_on_with_its_lease_and_ends_in_a_go_around() -> None:
    landing = flying(leg=1, sighted_height_m=0.3, landing=Lease(at(NOW - 1.0), 0.3, at(NOW - 1.0), 0.3))
    state, aim, phase = cycle(landing, belief(0.2))
    assert (aim, phase) == (Land(), Phase.LAND)
    assert state.landing == Lease(at(NOW - 1.0), 0.3, at(NOW), 0.2)
    state, _, phase = cycle(landing, belief(0.8))
    assert (phase, state.landing, state.go_arounds) == (Phase.GO_AROUND, None, 1)


@pytest.mark.parametrize(
    ("estimate", "for_s", "v"),
    [
        (belief(4.0, (0.5, 0.0), age_s=1.0), 1.0, (0.2, 0.0)),
        (belief(4.0, (3.0, -4.0), age_s=1.0), 1.0, (0.24, -0.32)),
        (belief(4.0, (0.5, 0.0), age_s=4.0), 4.0, (0.2, 0.0)),
        (belief(4.0, (0.5, 0.0), age_s=4.01), 4.01, (0.0, 0.0)),
        (belief(4.0, (0.5, 0.0), age_s=1.0, sigma_m=1.0), 1.0, (0.2, 0.0)),
        (belief(4.0, (0.5, 0.0), age_s=1.0, sigma_m=1.01), 1.0, (0.0, 0.0)),
        (belief(4.0, (0.5, 0.0), age_s=1.0, computed_s=0.5), 1.0, (0.2, 0.0)),
        (belief(4.0, (0.5, 0.0), age_s=1.0, computed_s=0.51), 1.0, (0.0, 0.0)),
        (belief(4.0, (0.0, 0.0), age_s=1.0), 1.0, (0.0, 0.0)),
    ],
)
def test_dead_reckoning_flies_level_for_as_long_as_it_tells_something(
    estimate: RelativeState, for_s: float, v: tuple[float, float]
) -> None:
    _, aim, phase = cycle(lost(for_s), estimate)
    if any(v):
        assert phase is Phase.BLIND
        assert isinstance(aim, Velocity)
        assert aim.v_level == pytest.approx([*v, 0.0])
        assert aim.yaw_rate_rad_s == 0.0
    else:
        assert (aim, phase) == (Hover(), Phase.LOST)


def test_dead_reckoning_flies_to_the_way_point_it_was_about() -> None:
    plan = planned(pad_ahead_m=0.3)
    _, aim, _ = cycle(lost(1.0), belief(4.0, (0.5, 0.1), age_s=1.0), plan)
    assert isinstance(aim, Velocity)
    assert aim.v_level == pytest.approx([0.08, 0.04, 0.0])


@pytest.mark.parametrize(
    ("since_last_s", "height_m", "to_m", "speed_m_s"),
    [
        (0.1, 4.0, 3.96, 0.4), (0.2, 4.0, 3.92, 0.4), (5.0, 4.0, 3.92, 0.4), (0.1, 2.5, 2.48, 0.2), (0.1, 3.0, 2.96, 0.4),
        (0.1, 2.05, 2.046, 0.04), (0.1, 2.003, 2.0, 0.0), (0.1, 2.0, 2.0, 0.0), (0.0, 4.0, 4.0, 0.4), (0.1, 1.5, 1.52, -0.2),
    ],
)  # fmt: skip
def test_the_set_point_flies_and_slows_down_near_its_way_point(
    since_last_s: float, height_m: float, to_m: float, speed_m_s: float
) -> None:
    _, aim, _ = cycle(flying(since_last_s, point=np.array([0.0, 0.0, height_m]), yaw_rad=0.0), belief(height_m))
    assert isinstance(aim, SetPoint)
    assert aim.d_body_pad_level == pytest.approx([0.0, 0.0, to_m])
    assert aim.v_body_level == pytest.approx([0.0, 0.0, speed_m_s])


@pytest.mark.parametrize(("within_m", "set_point_m_s", "blind_m_s"), [(0.25, 0.4, 0.4), (0.5, 0.4, 0.4), (2.0, 0.1, 0.1)])
def test_it_slows_down_within_the_distance_that_the_plan_names(within_m: float, set_point_m_s: float, blind_m_s: float) -> None:
    plan = changed(PLAN, slow_radius_m=within_m)
    _, aim, _ = cycle(flying(0.1, point=np.array([0.0, 0.0, 2.5]), yaw_rad=0.0), belief(2.5), plan)
    assert isinstance(aim, SetPoint)
    assert aim.v_body_level == pytest.approx([0.0, 0.0, set_point_m_s])
    _, aim, _ = cycle(lost(1.0), belief(4.0, (0.0, -0.5), age_s=1.0), plan)
    assert isinstance(aim, Velocity)
    assert aim.v_level == pytest.approx([0.0, -blind_m_s, 0.0])


def test_a_set_point_that_arrives_in_this_cycle_stands_still() -> None:
    plan = changed(PLAN, speed_m_s=0.5, slow_floor=0.5)
    _, aim, _ = cycle(flying(0.125, point=np.array([0.0, 0.0, 2.03125]), yaw_rad=0.0), belief(2.03125), plan)
    assert isinstance(aim, SetPoint)
    assert aim.d_body_pad_level.tolist() == [0.0, 0.0, 2.0]
    assert aim.v_body_level.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(("behind_m", "waits"), [(0.74, False), (0.75, False), (0.76, True)])
def test_the_set_point_waits_for_a_drone_that_is_too_far_behind(behind_m: float, waits: bool) -> None:
    point = np.array([0.0, 0.0, 4.0])
    _, aim, _ = cycle(flying(0.1, point=point, yaw_rad=0.0), belief(4.0 + behind_m), changed(PLAN, lead_m=0.75))
    assert isinstance(aim, SetPoint)
    assert bool(aim.d_body_pad_level[2] == 4.0) is waits
    assert np.any(aim.v_body_level != 0.0) != waits


@pytest.mark.parametrize(
    ("before", "now", "point"),
    [
        (0.2, 0.2 + math.atan2(3.0, 4.0), (-0.4, -2.2)), (0.0, math.pi / 2, (-2.0, -1.0)),
        (3.0, 3.0 - math.pi / 2, (2.0, 1.0)), (None, 1.0, (1.0, -2.0)), (1.0, None, (1.0, -2.0)),
    ],
)  # fmt: skip
def test_the_set_point_keeps_its_place_against_the_pad_while_the_body_turns(
    before: float | None, now: float | None, point: tuple[float, float]
) -> None:
    """A turn to the right by a quarter: what was ahead is to the left."""
    state = flying(0.0, point=np.array([1.0, -2.0, 3.0]), yaw_rad=before)
    after, aim, _ = cycle(state, belief(3.0, point, yaw_rad=now))
    assert isinstance(aim, SetPoint)
    assert aim.d_body_pad_level == pytest.approx([*point, 3.0])
    assert after.yaw_rad == now


def asked(since_s: float, from_m: float = 3.0, steady_s: float | None = None, **memory: Any) -> Planner:
    steady = None if steady_s is None else at(NOW - steady_s)
    return flying(0.25, question=Question(at(NOW - since_s), from_m, 2, steady), **{"questions": 1, **memory})


def test_another_pad_ends_whatever_was_under_way() -> None:
    before = flying(
        leg=1, sighted_height_m=1.1, point=np.zeros(3), near_since=at(NOW), landing=Lease(at(NOW), 0.3, at(NOW), 0.3),
        going_around=GoAround(at(NOW), 1.0),
    )  # fmt: skip
    state, aim, phase = cycle(before, belief(1.0, track=2))
    assert phase is Phase.ANOTHER_PAD
    assert isinstance(aim, Velocity)
    assert aim.v_level.tolist() == [0.0, 0.0, -PLAN.options.climb_m_s]
    assert aim.yaw_rate_rad_s == 0.0
    assert (state.leg, state.point, state.near_since, state.landing, state.going_around) == (0, None, None, None, None)
    assert (state.questions, state.in_sight, state.question) == (1, False, Question(at(NOW), 1.1, 2, at(NOW)))
    assert cycle(Planner.start(), belief(3.0, track=2))[0].question is None, "the first pad is no other"


@pytest.mark.parametrize(("since_s", "climbs"), [(1.9, True), (2.1, False)])
def test_it_climbs_to_the_safe_height_and_waits_there(since_s: float, climbs: bool) -> None:
    _, aim, phase = cycle(asked(since_s, 1.4), None)
    assert phase is Phase.ANOTHER_PAD
    assert isinstance(aim, Velocity) is climbs


@pytest.mark.parametrize(("since_s", "gave_up"), [(60.0, False), (60.01, True)])
def test_it_waits_for_a_person_for_a_minute(since_s: float, gave_up: bool) -> None:
    state, aim, phase = cycle(asked(since_s, reason="another"), None)
    assert (aim, phase) == (Hover(), Phase.GAVE_UP if gave_up else Phase.ANOTHER_PAD)
    assert state.reason == ("another, and nobody said to go on" if gave_up else "another")


@pytest.mark.parametrize(
    ("state", "estimate", "goes_on"),
    [
        (asked(9.0, steady_s=5.0), belief(3.0, track=2), True),
        (asked(9.0, steady_s=4.999), belief(3.0, track=2), False),
        (asked(9.0, steady_s=9.0), belief(3.0, track=3), False),
        (asked(9.0, steady_s=9.0, questions=2), belief(3.0, track=2), False),
        (asked(9.0, NEARLY_SAFE_M, steady_s=9.0), belief(NEARLY_SAFE_M, track=2), True),
        (asked(9.0, NEARLY_SAFE_M - 0.01, steady_s=9.0), belief(3.0, track=2), False),
        (asked(9.0, 3.0, steady_s=9.0), belief(NEARLY_SAFE_M - 0.01, track=2), False),
        (asked(0.5, NEARLY_SAFE_M, steady_s=9.0), belief(3.0, track=2), False),
        (asked(9.0, steady_s=9.0), None, False),
    ],
)
def test_on_its_own_it_goes_on_once_high_up_after_unbroken_sight(
    state: Planner, estimate: RelativeState | None, goes_on: bool
) -> None:
    after, _, phase = cycle(state, estimate, AUTOMATIC)
    assert phase is (Phase.APPROACH if goes_on else Phase.ANOTHER_PAD)
    if goes_on:
        assert (after.question, after.track, after.questions, after.in_sight, after.last) == (None, 2, 1, True, at(NOW))
    assert cycle(state, estimate)[2] is Phase.ANOTHER_PAD, "where a person decides it never does"


def test_sight_of_the_other_pad_is_unbroken_since_it_alone_was_seen() -> None:
    def question(state: Planner, estimate: RelativeState | None) -> Question:
        after, _, _ = cycle(state, estimate, AUTOMATIC)
        assert after.question is not None
        return after.question

    assert question(asked(9.0, steady_s=2.0), belief(3.0, track=2)).steady_since == at(NOW - 2.0)
    assert question(asked(9.0), belief(3.0, track=2)).steady_since == at(NOW)
    assert question(asked(9.0, steady_s=2.0), None) == Question(at(NOW - 9.0), 3.0, 2, None)
    assert question(asked(9.0, steady_s=2.0), belief(3.0, track=3)) == Question(at(NOW - 9.0), 3.0, 3, None)
