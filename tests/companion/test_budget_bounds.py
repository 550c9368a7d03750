"""The cost of a try: what each guidance cycle adds to it, and each limit at its edge."""

from __future__ import annotations

from dataclasses import replace

import pytest

from companion.guidance.budget import SIGHT_HOLDS_S, Spent
from companion.guidance.plan import Plan
from estimator.contracts.time import MonoNs

PLAN = Plan.over_the_pad()
LIMITS = PLAN.options


def at(seconds: float) -> MonoNs:
    return MonoNs(round(seconds * 1e9))


def test_a_new_try_has_cost_nothing() -> None:
    assert Spent() == Spent(None, None, 0, 0.0, 0.0, 0.0)
    assert Spent().exhausted(PLAN, at(1e6)) is None, "without a first sight no time runs"


def test_sight_begins_the_try_once_and_sums_up_its_own_time() -> None:
    spent = Spent().seen(at(3.0), 0.25)
    assert (spent.began, spent.with_sight_s) == (at(3.0), 0.25)
    spent = spent.seen(at(4.0), 0.5)
    assert (spent.began, spent.with_sight_s) == (at(3.0), 0.75)


@pytest.mark.parametrize(
    ("since_last_s", "counted_s"), [(-1.0, 0.0), (0.0, 0.0), (0.5, 0.5), (1.0, 1.0), (1.5, 1.0), (60.0, 1.0)]
)
def test_a_cycle_counts_for_no_more_than_a_second_and_never_backwards(since_last_s: float, counted_s: float) -> None:
    spent = Spent(with_sight_s=2.0, without_sight_s=3.0)
    assert spent.seen(at(0.0), since_last_s).with_sight_s == 2.0 + counted_s
    assert spent.unseen(since_last_s).without_sight_s == 3.0 + counted_s


def test_the_time_without_sight_is_forgiven_by_five_unbroken_seconds_and_by_no_less() -> None:
    assert SIGHT_HOLDS_S == 5.0
    blind = Spent(without_sight_s=7.0)
    assert replace(blind, with_sight_s=4.5).seen(at(0.0), 0.25).without_sight_s == 7.0
    assert replace(blind, with_sight_s=4.5).seen(at(0.0), 0.5).without_sight_s == 0.0
    assert replace(blind, with_sight_s=8.0).seen(at(0.0), 0.5).without_sight_s == 0.0
    assert replace(blind, with_sight_s=4.5).unseen(0.25).with_sight_s == 0.0, "a loss begins them again"


def test_losses_and_height_lost_without_sight_add_up_and_climbing_gives_nothing_back() -> None:
    assert Spent().lost().lost().losses == 2
    assert Spent().descended(0.25).descended(0.5).blind_descent_m == 0.75
    assert Spent().descended(0.25).descended(-3.0).blind_descent_m == 0.25


def test_the_last_leg_is_begun_once_in_a_try() -> None:
    assert Spent().descends(at(2.0)).descends(at(9.0)).descending == at(2.0)


@pytest.mark.parametrize(
    ("allowed", "used_up", "now_s", "why"),
    [
        (Spent(began=at(1.0)), Spent(began=at(0.999)), 1.0 + LIMITS.try_s, "no landing within 120 s"),
        (
            Spent(descending=at(1.0)),
            Spent(descending=at(0.999)),
            1.0 + LIMITS.descend_s,
            "no landing within 45 s of descent",
        ),
        (
            Spent(losses=LIMITS.losses_max),
            Spent(losses=LIMITS.losses_max + 1),
            0.0,
            "the pad was lost 9 times in one descent",
        ),
        (Spent(blind_descent_m=0.5), Spent(blind_descent_m=0.51), 0.0, "0.51 m lower without sight of the pad"),
    ],
    ids=["time", "time of the last leg", "losses", "height"],
)
def test_each_limit_may_be_reached_and_not_passed(allowed: Spent, used_up: Spent, now_s: float, why: str) -> None:
    assert allowed.exhausted(PLAN, at(now_s)) is None
    assert used_up.exhausted(PLAN, at(now_s)) == why
