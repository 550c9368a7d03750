"""Stamps at each edge: an arrival's step, what confirms another time, and a delay's running median."""

import pytest

from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity.clock import ClockWatch, watch_arrival, watch_delay

S, MS = 1_000_000_000, 1_000_000
NOW = ClockWatch(100 * S)


def arrive(state: ClockWatch, kind: str, t: int) -> tuple[ClockWatch, Verdict | None]:
    return watch_arrival(state, kind, Stamp(MonoNs(t), MonoNs(t), 0.001, "sim"), 1.0)


@pytest.mark.parametrize(
    ("t", "verdict", "now"),
    [
        (101 * S, None, 101 * S),
        (101 * S + 1, Verdict.TOO_NEW, 100 * S),
        (99 * S, None, 100 * S),
        (99 * S - 1, Verdict.TOO_OLD, 100 * S),
    ],
)
def test_an_arrival_may_be_a_step_away_and_never_turns_the_time_back(t: int, verdict: Verdict | None, now: int) -> None:
    state, output = arrive(NOW, "Imu", t)
    assert (output, state.now, state.rival is None) == (verdict, now, verdict is None)


def test_two_looks_of_one_stream_confirm_nothing_and_of_two_streams_they_do() -> None:
    state, _ = arrive(NOW, "Imu", 200 * S)
    assert arrive(state, "Imu", 200 * S)[1] is Verdict.TOO_NEW
    confirmed, output = arrive(state, "Attitude", 200 * S - MS)
    assert output is None
    assert confirmed == ClockWatch(200 * S), "the newest of them is the time, and delays are learned again"


@pytest.mark.parametrize(("by", "joins"), [(S, True), (S + 1, False), (-S, True), (-S - 1, False)])
def test_what_lies_a_step_from_the_other_time_belongs_to_it(by: int, joins: bool) -> None:
    state, _ = arrive(NOW, "Imu", 200 * S)
    state, output = arrive(state, "Attitude", 200 * S + by)
    assert (output is None) is joins
    if not joins:
        assert state.rival is not None
        assert (state.rival.n, state.rival.first) == (1, 200 * S + by)


def test_the_known_time_ends_another_one() -> None:
    state, _ = arrive(NOW, "Imu", 200 * S)
    state, _ = arrive(state, "Imu", 100 * S)
    assert arrive(state, "Attitude", 200 * S)[1] is Verdict.TOO_NEW


def delay(state: ClockWatch, delay_ms: float, received_at: int = 100 * S, kind: str = "Imu") -> tuple[ClockWatch, Verdict | None]:
    stamp = Stamp(MonoNs(received_at - round(delay_ms * MS)), MonoNs(received_at), 0.001, "sim")
    return watch_delay(state, kind, stamp, 0.125, 1.0)


def settled(n: int, delay_ms: float = 125.0) -> ClockWatch:
    state = ClockWatch()
    for _ in range(n):
        state, _ = delay(state, delay_ms)
    return state


def test_a_delay_may_be_a_step_from_the_median() -> None:
    assert delay(settled(9), 250.0)[1] is delay(settled(9), 0.0)[1] is None
    assert delay(settled(9), 250.001)[1] is Verdict.TOO_OLD
    assert delay(settled(9, 150.0), 24.999)[1] is Verdict.TOO_NEW


def test_another_delay_is_the_streams_own_after_its_time_unbroken() -> None:
    state, output = delay(settled(9), 400.0, 101 * S)
    assert (output, state.off("Imu"), state.off("Baro")) == (Verdict.TOO_OLD, True, False)
    state, output = delay(state, 400.0, 102 * S - 1)
    assert output is Verdict.TOO_OLD
    lasting, output = delay(state, 400.0, 102 * S)
    assert (output, lasting.off("Imu"), lasting.delays["Imu"].median_s) == (None, False, 0.4)
    broken, _ = delay(state, 125.0, 102 * S - 1)
    assert not broken.off("Imu")
    assert delay(broken, 400.0, 102 * S)[1] is Verdict.TOO_OLD


def test_each_stream_has_a_delay_of_its_own() -> None:
    state = settled(9)
    for _ in range(9):
        state, output = delay(state, 400.0, kind="Baro")
        assert output is None
    assert (state.delays["Imu"].median_s, state.delays["Baro"].median_s) == (0.125, 0.4)
