"""Stamps alone with their time are refused, and one of them never makes the others late."""

import math

from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity.sensors import ClockWatch, watch_arrival, watch_delay

HOUR_S = 3600.0


def stamp(received_at_s: float, delay_s: float = 0.01) -> Stamp:
    return Stamp(MonoNs(round((received_at_s - delay_s) * 1e9)), MonoNs(round(received_at_s * 1e9)), 0.001, "sim")


def run(kinds_and_times: list[tuple[str, float]]) -> list[Verdict | None]:
    state, out = ClockWatch(), []
    for kind, t in kinds_and_times:
        state, verdict = watch_arrival(state, kind, stamp(t), 1.0)
        out.append(verdict)
    return out


def test_one_sample_an_hour_ahead_is_refused_and_poisons_nothing() -> None:
    output = run([("Imu", 0.01 * i) for i in range(20)] + [("Imu", HOUR_S)] + [("Imu", 0.2 + 0.01 * i) for i in range(20)])
    assert output[20] is Verdict.TOO_NEW
    assert output[:20] == output[21:] == [None] * 20


def test_a_stream_that_alternates_between_now_and_an_hour_ahead_never_moves_the_time() -> None:
    output = run([("Imu", 0.01 * i + (HOUR_S if i % 2 else 0.0)) for i in range(200)])
    assert output[::2] == [None] * 100
    assert set(output[1::2]) == {Verdict.TOO_NEW}


def test_after_a_pause_two_streams_confirm_the_time_at_once_and_one_within_a_quarter_of_a_second() -> None:
    assert run([("Imu", 0.0), ("Imu", 60.0), ("Attitude", 60.01), ("Imu", 60.02)]) == [None, Verdict.TOO_NEW, None, None]
    alone = run([("Imu", 0.0), *(("Imu", 60.0 + 0.02 * i) for i in range(15))])
    assert None in alone[1:]
    assert alone[12:] == [None] * 4


def test_a_clock_that_was_misled_comes_back() -> None:
    output = run([("Imu", 0.0)] + [("Imu", HOUR_S + 0.05 * i) for i in range(10)] + [("Imu", 1.0 + 0.05 * i) for i in range(10)])
    assert output[-1] is None


def delays(values: list[float], keep_s: float = math.inf) -> list[Verdict | None]:
    state, out = ClockWatch(), []
    for i, d in enumerate(values):
        state, verdict = watch_delay(state, "Sighting", stamp(100.0 + i / 30.0, d), 0.15, 10.0, keep_s)
        out.append(verdict)
    return out


def test_a_delay_that_steps_is_refused_until_it_has_settled() -> None:
    output = delays([0.09] * 60 + [0.39] * 400)
    assert output[:60] == [None] * 60
    assert output[60:360] == [Verdict.TOO_OLD] * 300
    assert output[-1] is None
    assert delays([0.39] * 60 + [0.09])[-1] is Verdict.TOO_NEW


def test_a_delay_that_has_held_gives_way_to_no_other() -> None:
    output = delays([0.09] * 60 + [0.39] * 1_000, keep_s=3.0)
    assert output[60:360] == [Verdict.TOO_OLD] * 300
    assert set(output[360:]) == {None}, "two seconds are too short to be kept"
    output = delays([0.09] * 120 + [0.39] * 1_000 + [0.09], keep_s=3.0)
    assert output[120:-1] == [Verdict.TOO_OLD] * 1_000
    assert output[-1] is None


def test_a_delay_that_jitters_or_creeps_is_a_delay() -> None:
    assert set(delays([0.09 + 0.04 * (i % 3) for i in range(200)])) == {None}
    assert set(delays([0.09 + 0.001 * i for i in range(300)])) == {None}


def test_a_clock_that_stands_is_reported_by_the_arrivals_and_one_that_goes_on_is_taken_at_once() -> None:
    state, out = ClockWatch(), []
    times = [0.005 * i for i in range(200)]
    for t in times:
        stood = Stamp(MonoNs(round(min(t, 0.5) * 1e9)), MonoNs(round((t + 0.01) * 1e9)), 0.001, "sim")
        if t > 0.75:
            stood = stamp(t + 0.01)
        state, verdict = watch_delay(state, "Imu", stood, 0.5, 1.0)
        out.append((t, verdict, state.off("Imu")))
    refused = [t for t, verdict, _ in out if verdict is Verdict.TOO_OLD]
    assert 0.6 <= refused[0] < 0.61, "0.1 s after the newest stamp"
    assert refused[-1] == 0.75
    assert [off for t, _, off in out if t > 0.75] == [False] * sum(t > 0.75 for t in times)


def test_samples_that_come_twice_or_after_a_pause_have_a_clock_that_goes() -> None:
    state = ClockWatch()
    for t in (0.0, 0.01, 0.02, 0.9, 0.91, 1.9):
        for late in (0.0, 0.02):
            twice = Stamp(MonoNs(round(t * 1e9)), MonoNs(round((t + 0.01 + late) * 1e9)), 0.001, "sim")
            state, verdict = watch_delay(state, "Imu", twice, 0.5, 1.0)
            assert verdict is None


S, MS = 1_000_000_000, 1_000_000


NOW = ClockWatch(100 * S)


def arrive(state: ClockWatch, kind: str, t: int) -> tuple[ClockWatch, Verdict | None]:
    return watch_arrival(state, kind, Stamp(MonoNs(t), MonoNs(t), 0.001, "sim"), 1.0)


def test_two_looks_of_one_stream_confirm_nothing_and_of_two_streams_they_do() -> None:
    state, _ = arrive(NOW, "Imu", 200 * S)
    assert arrive(state, "Imu", 200 * S)[1] is Verdict.TOO_NEW
    confirmed, output = arrive(state, "Attitude", 200 * S - MS)
    assert output is None
    assert confirmed == ClockWatch(200 * S), "the newest of them is the time, and delays are learned again"


def delay(state: ClockWatch, delay_ms: float, received_at: int = 100 * S, kind: str = "Imu") -> tuple[ClockWatch, Verdict | None]:
    stamp = Stamp(MonoNs(received_at - round(delay_ms * MS)), MonoNs(received_at), 0.001, "sim")
    return watch_delay(state, kind, stamp, 0.125, 1.0)


def settled(n: int, delay_ms: float = 125.0) -> ClockWatch:
    state = ClockWatch()
    for _ in range(n):
        state, _ = delay(state, delay_ms)
    return state


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
