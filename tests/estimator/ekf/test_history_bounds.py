"""The filter's past at each of its edges: how late, how far ahead, how long kept, and when time has leapt."""

import numpy as np
import pytest

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range, VesselReport
from estimator.contracts.time import MonoNs, Stamp
from estimator.ekf.history import History, Leap, put
from estimator.ekf.options import EkfOptions
from estimator.ekf.packed_event import Event
from estimator.ekf.params import FilterParams

OPTIONS = EkfOptions()
TOOLS = FilterParams(OPTIONS)
MS = 1_000_000
T = 100_000 * MS


def stamp(measured_at: int, received_at: int | None = None) -> Stamp:
    return Stamp(MonoNs(measured_at), MonoNs(max(measured_at, measured_at if received_at is None else received_at)), 0.02, "sim")


def baro(measured_at: int, received_at: int | None = None) -> Baro:
    return Baro(Stamp(MonoNs(measured_at), MonoNs(measured_at if received_at is None else received_at), 0.02, "sim"), 1.0, 0.5)


def after(*events: Event) -> tuple[History, list[Verdict]]:
    """The filter ignores these events without a known vertical, so only the history is seen."""
    history, verdicts = History(), []
    for event in events:
        history, outcome = put(history, event, TOOLS)
        verdicts.append(outcome.verdict)
    return history, verdicts


def keys(history: History) -> list[tuple[int, int]]:
    return [(node.key[0] - T, node.key[1]) for node in history.nodes]


def test_a_new_past_is_empty_and_answers_nothing() -> None:
    assert History() == History(None, (), -1, -1, None)
    assert History().newest() is None
    assert History().before(T) is None


@pytest.mark.parametrize(("ahead", "too_new"), [(50 * MS, False), (50 * MS + 1, True)])
def test_a_measurement_may_lie_a_little_ahead_of_everything_received(ahead: int, too_new: bool) -> None:
    history, verdicts = after(baro(T), baro(T + ahead, T))
    assert (verdicts[1] is Verdict.TOO_NEW) is too_new
    assert (len(history.nodes), history.received_at) == (1 if too_new else 2, T)
    history, _ = after(baro(T), baro(T + 80 * MS, T + 10 * MS))
    assert history.received_at == T + 10 * MS, "heard all the same"


def test_the_past_is_kept_for_a_second_and_what_is_older_comes_too_late() -> None:
    history, _ = after(baro(T), baro(T + 1), baro(T + 1000 * MS))
    assert (len(history.nodes), history.forgotten, history.base) == (3, -1, None)
    history, _ = after(baro(T), baro(T + 1), baro(T + 2), baro(T + 1000 * MS + 2))
    assert (keys(history), history.forgotten) == ([(2, 4), (1000 * MS + 2, 4)], T + 1)
    for measured_at, verdict in ((T + 1, Verdict.TOO_OLD), (T, Verdict.TOO_OLD)):
        late, outcome = put(history, baro(measured_at, T + 1100 * MS), TOOLS)
        assert (outcome.verdict, keys(late), late.received_at) == (verdict, keys(history), T + 1100 * MS)
    assert put(history, baro(T + 2, T + 1100 * MS), TOOLS)[1].verdict is not Verdict.TOO_OLD


def test_events_lie_by_instant_and_kind_whatever_the_order_of_arrival() -> None:
    level = Attitude(stamp(T + 5), Rotation.identity(), np.eye(3))
    events = [baro(T + 9), baro(T + 5), Range(stamp(T + 5), 1.0, 0.1), baro(T), level]
    expected = [(0, 4), (5, 1), (5, 3), (5, 4), (9, 4)]
    for order in (events, events[::-1], [events[2], *events[:2], *events[3:]]):
        assert keys(after(*order)[0]) == expected


def test_samples_of_one_instant_lie_by_kind_and_those_of_one_kind_as_they_came() -> None:
    one, zero = stamp(T), np.zeros(3)
    kinds: list[Event] = [
        Imu(one, zero, zero),
        Attitude(one, Rotation.identity(), np.eye(3)),
        BodyVelocity(one, zero, np.eye(3)),
        Range(one, 1.0, 0.1),
        Baro(one, 1.0, 0.5),
        VesselReport(one, None, None, 0.1, 0.1),
        Sighting(one, 0, "fused", np.array([0.0, 0.0, 2.0]), 0.0, False, 1e-4 * np.eye(4), 0.9),
    ]
    for order in (kinds, kinds[::-1]):
        assert [node.event for node in after(*order)[0].nodes] == kinds
    first, second = baro(T), Baro(one, 2.0, 0.5)
    for pair in ([first, second], [second, first]):
        assert [node.event for node in after(*pair)[0].nodes] == pair
        between = baro(T + 5)
        assert [node.event for node in after(pair[0], between, pair[1])[0].nodes] == [*pair, between]


def test_what_is_no_measurement_is_named() -> None:
    with pytest.raises(TypeError, match="not str"):
        put(History(), "a picture", TOOLS)  # type: ignore[arg-type]


def test_a_late_one_is_taken_into_the_belief_before_it() -> None:
    """The attitude is missing in the state two before, so the event would be ignored there."""
    level = Attitude(stamp(T), Rotation.identity(), 1e-4 * np.eye(3))
    late = Sighting(stamp(T + 5), 0, "fused", np.array([0.0, 0.0, 2.0]), 0.0, False, 1e-4 * np.eye(4), 0.9)
    history, verdicts = after(baro(T - 1), level, baro(T + 9), late)
    assert verdicts == [Verdict.NO_ATTITUDE, Verdict.FUSED, Verdict.GATED, Verdict.FUSED]
    assert [node.after and node.after.sighted for node in history.nodes] == [None, -1, T + 5, T + 5]


def test_a_sample_received_in_the_first_instant_counts_as_received() -> None:
    assert after(baro(0), baro(LEAP + 1))[1][1] is Verdict.TOO_NEW


def test_sightings_of_one_instant_lie_by_number_and_method() -> None:
    def seen(seq: int, method: str) -> Sighting:
        return Sighting(stamp(T), seq, method, np.array([0.0, 0.0, 2.0]), 0.0, False, 1e-4 * np.eye(4), 0.9)  # type: ignore[arg-type]

    history, _ = after(seen(2, "fused"), seen(1, "selected"), seen(1, "fused"))
    assert [node.key for node in history.nodes] == [(T, 6, 1, "fused"), (T, 6, 1, "selected"), (T, 6, 2, "fused")]


def test_the_belief_before_an_instant_is_the_one_after_the_last_event_not_later() -> None:
    level = Attitude(stamp(T), Rotation.identity(), 1e-4 * np.eye(3))
    history, _ = after(level, baro(T + 10 * MS), baro(T + 20 * MS))
    a, b, c = (node.packed for node in history.nodes)
    assert [history.before(T + t * MS) for t in (10, 19, 20, 99)] == [b, b, c, c]
    assert history.before(T) is a
    assert history.before(T - 1) is None
    assert history.newest() is c.belief
    history, _ = put(history, baro(T + 1015 * MS), TOOLS)
    assert history.base is b
    assert history.base is not None
    assert history.before(history.base.t) is b
    assert history.before(history.base.t - 1) is None


LEAP = 2000 * MS


@pytest.mark.parametrize(
    ("received_at", "verdict"),
    [(T + LEAP, None), (T + LEAP + 1, Verdict.TOO_NEW), (T - LEAP, None), (T - LEAP - 1, Verdict.TOO_OLD)],
)
def test_an_arrival_may_be_a_leap_away(received_at: int, verdict: Verdict | None) -> None:
    history, verdicts = after(baro(T), baro(received_at))
    refused = history.leapt == Leap(received_at, 1)
    assert refused is (verdict is not None)
    assert not refused or (verdicts[1], history.received_at, len(history.nodes)) == (verdict, T, 1)


def test_five_in_a_row_are_time_that_leapt() -> None:
    forward = [baro(T + 2 * LEAP + i * MS) for i in range(5)]
    history, verdicts = after(baro(T), *forward)
    assert verdicts[1:5] == [Verdict.TOO_NEW] * 4
    assert (history.leapt, history.received_at) == (None, T + 2 * LEAP + 4 * MS)
    assert history.forgotten == T, "what was known goes on being known"
    back = [baro(T - 2 * LEAP + i * MS) for i in range(5)]
    history, verdicts = after(baro(T), *back)
    assert verdicts[1:5] == [Verdict.TOO_OLD] * 4
    assert (history.received_at, len(history.nodes), history.forgotten) == (T - 2 * LEAP + 4 * MS, 1, -1), "the past begins anew"


def test_a_row_is_broken_by_an_arrival_in_time_or_one_elsewhere() -> None:
    row = [baro(T + 2 * LEAP + i * MS) for i in range(4)]
    history, _ = after(baro(T), *row, baro(T + 1))
    assert history.leapt is None
    for apart, n in ((LEAP, 5), (LEAP + 1, 1)):
        history, verdicts = after(baro(T), *row, baro(T + 2 * LEAP + 3 * MS + apart))
        assert (history.leapt is None) is (n == 5)
        assert n == 5 or (history.leapt == Leap(T + 2 * LEAP + 3 * MS + apart, 1) and verdicts[-1] is Verdict.TOO_NEW)
