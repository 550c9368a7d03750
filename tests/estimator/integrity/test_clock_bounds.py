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


@pytest.mark.parametrize(
    ("after_ms", "confirmed"),
    [
        ([0, 50, 100, 150, 200], True),
        ([0, 50, 100, 150, 199.999999], False),
        ([0, 100, 200, 300], False),
        ([0, 1, 2, 3, 4, 5, 6], False),
        ([200, 150, 100, 50, 0], False),
    ],
)
def test_one_stream_confirms_a_time_by_five_over_a_fifth_of_a_second(after_ms: list[float], confirmed: bool) -> None:
    state, output = NOW, None
    for ms in after_ms:
        assert output is None or state.rival is not None
        state, output = arrive(state, "Imu", 200 * S + round(ms * MS))
    assert (output is None) is confirmed
    assert state.now == (200 * S + 200 * MS if confirmed else 100 * S)


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


def test_the_first_delays_are_averaged_and_the_later_ones_move_the_median_by_two_milliseconds() -> None:
    state, medians = settled(1, 100.0), []
    for ms in (200.0, 60.0, 121.5):
        state, _ = delay(state, ms)
        medians.append(state.delays["Imu"].median_s)
    assert medians == pytest.approx([0.150, 0.120, 0.1215])
    for n in (8, 9, 30):
        for ms, median_s in ((200.0, 0.127), (50.0, 0.123), (126.0, 0.126), (124.0, 0.124)):
            assert delay(settled(n), ms)[0].delays["Imu"].median_s == pytest.approx(median_s)
    assert delay(settled(7), 205.0)[0].delays["Imu"].median_s == pytest.approx(0.135), "the eighth is averaged"


def test_seven_delays_make_no_habit_and_eight_do() -> None:
    state, output = delay(settled(7), 400.0)
    assert (output, state.delays["Imu"].median_s, state.delays["Imu"].n) == (None, 0.4, 1)
    assert delay(settled(8), 400.0)[1] is Verdict.TOO_OLD


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
