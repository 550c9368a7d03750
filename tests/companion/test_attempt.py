"""Limits of one landing attempt: what it uses up, and when it has used too much."""

import pytest

from companion.base.reason import Reason, ReasonCause
from companion.guidance.mission.progress import Attempt
from companion.settings.mission import TryOptions
from tests.companion.mission_flights import ns

LIMITS = TryOptions(try_s=60.0, losses_max=3, blind_descent_max_m=0.5)


@pytest.mark.parametrize(("since_last_s", "counted_s"), [(0.05, 0.05), (1.0, 1.0), (7.0, 1.0), (-3.0, 0.0)])
def test_a_cycle_adds_its_time_but_never_more_than_a_second_nor_less_than_none(since_last_s: float, counted_s: float) -> None:
    before = Attempt(without_sight_s=2.0, with_sight_s=0.5, over_pad_s=4.0, in_descent_s=5.0, at_gate_s=3.0)
    assert before.seen(ns(1), since_last_s).with_sight_s == 0.5 + counted_s
    assert before.unseen(since_last_s).without_sight_s == 2.0 + counted_s
    assert before.at_gate(since_last_s).at_gate_s == 3.0 + counted_s
    assert before.over_pad(since_last_s).over_pad_s == 4.0 + counted_s
    assert before.in_descent(since_last_s).in_descent_s == 5.0 + counted_s


def test_unbroken_sight_gives_the_patience_back_and_nothing_less_does() -> None:
    one = Attempt().unseen(0.75)
    assert (one.without_sight_s, one.with_sight_s) == (0.75, 0.0)
    for k in range(5):
        assert one.without_sight_s == 0.75, k
        one = one.seen(ns(10 + k), 1.0)
    assert (one.without_sight_s, one.with_sight_s) == (0.0, 5.0)
    assert one.unseen(0.25).with_sight_s == 0.0


def test_an_attempt_begins_with_its_first_sight_and_the_next_one_inherits_the_time_without() -> None:
    one = Attempt().seen(ns(3), 0.1).seen(ns(4), 0.1)
    assert one.began == ns(3)
    one = one.unseen(0.5).lost().descended(0.3).at_gate(1.0).over_pad(1.0).in_descent(1.0)
    assert (one.losses, one.at_gate_s) == (1, 1.0)
    assert one.again() == Attempt(without_sight_s=0.5)


def test_climbing_gives_no_height_back() -> None:
    assert Attempt().descended(0.25).descended(-1.0).descended(0.125).blind_descent_m == 0.375


@pytest.mark.parametrize(
    ("used", "expected"),
    [
        (Attempt(began=ns(100)), None),
        (Attempt(began=ns(99)), Reason(ReasonCause.TRY_TIME, 61.0, 60.0)),
        (Attempt(losses=3), None),
        (Attempt(losses=3).lost(), Reason(ReasonCause.LOSSES, 4.0, 3.0)),
        (Attempt().cycle(0.25).cycle(1.0).cycle(1.0), None),
        (Attempt().cycle(1.0).cycle(1.5), Reason(ReasonCause.STARVED, 2.5, 2.0)),
        (Attempt(blind_descent_m=0.5), None),
        (Attempt(blind_descent_m=0.5).descended(0.25), Reason(ReasonCause.BLIND_DESCENT, 0.75, 0.5)),
    ],
)
def test_a_budget_is_used_up_beyond_its_limit(used: Attempt, expected: Reason | None) -> None:
    assert used.used_up(LIMITS, ns(160)) == expected
