import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from msgspec import Struct

from drivers.clock_map import ClockMap, ClockMapOptions
from drivers.mavlink.boot_clock import BootClock, boot_ms, boot_us
from drivers.mavlink.dialect import TimeSyncV2
from drivers.mavlink.timesync import TimeSync, answer_to
from estimator.contracts.time import MonoNs, Stamp

S = 1_000_000_000
FLOOR_S = 0.002


class Received(Struct):
    """Simulated messages: when messages were stamped on our clock, the remote counter in them, when they were received."""

    true_ns: np.ndarray
    remote_ns: np.ndarray
    received_at_ns: np.ndarray


def simulate(seed: int, *, rate_hz: float, drift_ppm: float, jitter_s: float, wrap_ns: int | None, stalls: int = 4) -> Received:
    rng = np.random.default_rng(seed)
    n = int(40 * rate_hz)
    true_s = np.arange(n) / rate_hz
    delay_s = FLOOR_S + rng.exponential(jitter_s, n)
    for start in rng.integers(int(rate_hz), n, stalls):  # the radio falls silent, then all comes at once
        late = slice(start, min(n, start + int(0.5 * rate_hz)))
        delay_s[late] += np.linspace(0.5, 0.0, int(0.5 * rate_hz))[: late.stop - late.start]
    received_at_s = np.maximum.accumulate(true_s + delay_s)
    remote_ns = np.round((2030.0 + true_s * (1 + drift_ppm * 1e-6)) * S).astype(np.int64)
    to_ns = lambda s: np.round((s + 100.0) * S).astype(np.int64)  # noqa: E731
    return Received(to_ns(true_s), remote_ns % wrap_ns if wrap_ns else remote_ns, to_ns(received_at_s))


@settings(max_examples=25)
@example(seed=78962, rate_hz=15.0, drift_ppm=0.0, jitter_s=0.0078125, wrap_ns=None)  # sigma 2.15 ms: few samples, much jitter
@given(
    seed=st.integers(0, 10**6),
    rate_hz=st.sampled_from([15.0, 30.0, 100.0]),
    drift_ppm=st.floats(-90, 90),
    jitter_s=st.floats(1e-4, 8e-3),
    wrap_ns=st.sampled_from([None, 2048 * S]),
)
def test_simulated_jitter_drift_and_stalls(seed, rate_hz, drift_ppm, jitter_s, wrap_ns):
    """The clock wraps at 18 s.

    Times are in order, never after receipt, within the claimed sigma, and that within milliseconds.
    """
    clock = ClockMap(ClockMapOptions(wrap_ns=wrap_ns, floor_s=FLOOR_S, floor_sigma_s=0.0005))
    received = simulate(seed, rate_hz=rate_hz, drift_ppm=drift_ppm, jitter_s=jitter_s, wrap_ns=wrap_ns)
    stamps = [clock.stamp(int(r), MonoNs(int(h))) for r, h in zip(received.remote_ns, received.received_at_ns, strict=True)]
    measured_at = np.array([s.measured_at for s in stamps])
    sigma_s = np.array([s.sigma_s for s in stamps])
    error_s = (measured_at - received.true_ns) / S
    assert np.all(np.diff(measured_at) >= 0)
    assert np.all(measured_at <= received.received_at_ns)
    assert clock.restarts == 0
    assert np.mean(np.abs(error_s) < 2 * sigma_s) > 0.95
    assert np.all(np.abs(error_s) < 5 * sigma_s)
    settled = slice(len(measured_at) // 4, None)
    assert np.abs(error_s[settled]).max() < 0.4 * jitter_s + 1.2e-3
    assert np.median(sigma_s[settled]) < 2.5e-3


def steady(clock: ClockMap, start_remote_s: float, start_s: float, seconds: float, delay_s: float = 0.002) -> list[Stamp]:
    times = np.arange(0.0, seconds, 0.005)
    return [clock.stamp(round((start_remote_s + t) * S), MonoNs(round((start_s + t + delay_s) * S))) for t in times]


@pytest.mark.parametrize(("before_s", "after_s", "away_s"), [(500.0, 1.0, 20.0), (1900.0, 1.0, 20.0), (10.0, 900.0, 3.0)])
def test_a_clock_set_again_is_noticed_at_once(before_s: float, after_s: float, away_s: float) -> None:
    clock = ClockMap(ClockMapOptions(wrap_ns=2048 * S, floor_s=0.002, floor_sigma_s=0.0005))
    last = steady(clock, before_s, 50.0, 5.0)[-1]
    stamps = steady(clock, after_s, 55.0 + away_s, 2.0)
    assert clock.restarts == 1
    assert stamps[0].measured_at >= last.measured_at
    assert abs(stamps[0].measured_at - (55.0 + away_s) * S) < 5 * stamps[0].sigma_s * S
    assert abs(stamps[-1].measured_at - (55.0 + away_s + 1.995) * S) < 1e-3 * S


def test_a_wrap_after_a_long_silence_is_not_a_restart() -> None:
    clock = ClockMap(ClockMapOptions(wrap_ns=2048 * S))
    steady(clock, 1000.0, 0.0, 2.0)
    stamps = steady(clock, 1002.0 + 1500.0 - 2048.0, 1502.0, 1.0)
    assert clock.restarts == 0
    assert stamps[-1].sigma_s < 0.01


@pytest.mark.parametrize(("rate_hz", "step_s"), [(1.0, 3.0), (200.0, 0.4), (30.0, 0.1)])
def test_a_clock_that_is_set_back_by_less_than_a_jump_is_followed_within_seconds(rate_hz, step_s, caplog):
    clock = ClockMap(ClockMapOptions(floor_s=0.002, window_s=600.0, jump_s=5.0, name="the ship's receiver"))
    true_s = np.arange(0.0, 60.0, 1 / rate_hz)
    remote_s = 500.0 + true_s - np.where(true_s >= 20.0, step_s, 0.0)
    stamps = [clock.stamp(round(r * S), MonoNs(round((t + 0.002) * S))) for r, t in zip(remote_s, true_s, strict=True)]
    error_s = np.array([s.measured_at / S for s in stamps]) - true_s
    assert np.all(np.abs(error_s[true_s > 20.0 + 6.0]) < 0.01)
    assert clock.restarts == 1
    assert "the ship's receiver was set back" in caplog.text


@pytest.mark.parametrize("ahead_s", [0.3, -0.3])
def test_one_absurd_stamp_costs_itself_alone(ahead_s: float) -> None:
    clock = ClockMap(ClockMapOptions(floor_s=0.002, window_s=600.0))
    steady(clock, 500.0, 10.0, 5.0)
    clock.stamp(round((505.0 + ahead_s) * S), MonoNs(round(15.002 * S)))
    stamps = steady(clock, 505.005, 15.005, 10.0)
    late_s = [(s.measured_at - round((15.005 + 0.005 * k) * S)) / S for k, s in enumerate(stamps)]
    assert np.all(np.abs(late_s[500:]) < 1e-3)


def test_a_queue_that_fills_for_some_seconds_is_no_slow_clock() -> None:
    clock = ClockMap(ClockMapOptions(floor_s=0.002))
    true_s = np.arange(0.0, 40.0, 0.02)
    delay_s = 0.002 + np.interp(true_s, [10.0, 19.0, 21.0], [0.0, 0.4, 0.0])
    stamps = [clock.stamp(round(t * S), MonoNs(round((t + d) * S))) for t, d in zip(true_s, delay_s, strict=True)]
    assert {s.source for s in stamps} == {"synced"}
    assert np.abs(np.array([s.measured_at / S for s in stamps]) - true_s)[true_s < 19.0].max() < 0.01


@pytest.mark.parametrize("rate", [0.9, 0.97, 0.99, 0.998])
@pytest.mark.parametrize("answers", [True, False])
def test_a_simulated_autopilot_that_falls_behind_is_stamped_within_5_sigmas(rate: float, answers: bool) -> None:
    sync, rng = TimeSync(), np.random.default_rng(7)
    clock, wrong, count = BootClock(sync), 0, 0
    for now in range(10 * S, 70 * S, S // 50):
        for request in sync.due(MonoNs(now), (1, 1)) if answers else ():
            received = now + 400_000
            sync.on_message(TimeSyncV2(round(rate * (now + 200_000)), request.ts1), MonoNs(received))
        true_s, delay_s = now / S, 0.002 + rng.exponential(0.001)
        stamp = clock.stamp(boot_ms(int(1000 * rate * true_s)), MonoNs(round((true_s + delay_s) * S)))
        count += 1
        wrong += (
            abs(stamp.measured_at / S - true_s) > 0.005 + 0.5 * (1.0 - rate) + 5 * stamp.sigma_s
        )  # half a second shows no rate
    assert wrong <= 0.01 * count


@pytest.mark.parametrize("rate", [0.4, 0.98, 1.02, 2.5])
def test_a_clock_of_another_rate_is_left_for_the_arrival_and_accepted_again(rate, caplog):
    clock = ClockMap(ClockMapOptions(floor_s=0.002, name="camera mast"))
    rng = np.random.default_rng(5)
    true_s = np.arange(0.0, 120.0, 0.04)
    remote_s = np.where(true_s < 60.0, rate * true_s, rate * 60.0 + true_s - 60.0)
    arrived_s = np.maximum.accumulate(true_s + 0.002 + rng.exponential(0.003, true_s.size))
    stamps = [clock.stamp(round(r * S), MonoNs(round(h * S))) for r, h in zip(remote_s, arrived_s, strict=True)]
    error_s = np.abs(np.array([s.measured_at / S for s in stamps]) - true_s)
    sources = np.array([s.source for s in stamps])
    wrong = (true_s > 20.0) & (true_s < 60.0)
    assert set(sources[wrong]) == {"arrival"}
    assert error_s[wrong].max() < 0.05
    assert set(sources[true_s > 90.0]) == {"synced"}
    assert error_s[true_s > 90.0].max() < 0.01
    told = [record.args for record in caplog.records if "of ours: its" in record.msg]
    assert [name for name, _ in told] == ["camera mast"]
    assert told[0][1] == pytest.approx(rate, rel=3e-3)


@pytest.mark.parametrize(
    ("rates", "settled_s"),
    [((0.95,), 0.06), ((0.8,), 0.06), ((1.05,), 0.06), ((0.985,), 0.06), ((1.0,), 0.02), ((1.0, 0.8), 0.06), ((0.9, 1.0), 0.02)],
    ids=["fewer", "many-fewer", "more", "hardly-fewer", "true", "dusk", "dawn"],
)
def test_a_stated_rate_is_a_claim_until_arrivals_agree(rates: tuple[float, ...], settled_s: float) -> None:
    """A camera states 10 frames a second, and sends as many as its exposure allows: each sigma covers what its stamp is off."""
    clock = ClockMap(ClockMapOptions(floor_s=0.04, floor_sigma_s=0.005, unknown_s=0.008, claimed=True, name="camera mast"))
    rng = np.random.default_rng(11)
    stated_s = np.arange(0.0, 60.0 * len(rates), 0.1)
    true_s = np.cumsum(np.full(stated_s.size, 0.1) / np.repeat(rates, stated_s.size // len(rates)))
    arrived_s = np.maximum.accumulate(true_s + 0.04 + rng.exponential(0.003, true_s.size))
    stamps = [clock.stamp(round(r * S), MonoNs(round(h * S))) for r, h in zip(stated_s, arrived_s, strict=True)]
    error_s = np.abs(np.array([s.measured_at / S for s in stamps]) - true_s)
    sigma_s = np.array([s.sigma_s for s in stamps])
    assert np.mean(error_s < 3 * sigma_s) > 0.985  # the first second of a dusk shows nothing yet
    assert error_s[:40].max() < 0.03  # arrival decides at first
    assert error_s[-200:].max() < settled_s
    assert np.median(sigma_s[-200:]) < 0.015
    assert np.all(np.diff([s.measured_at for s in stamps]) >= 0)


def test_a_longer_way_is_accepted_after_the_window() -> None:
    clock = ClockMap(ClockMapOptions(window_s=2.0, floor_s=0.002))
    steady(clock, 0.0, 10.0, 3.0, delay_s=0.002)
    stamps = steady(clock, 3.0, 13.0, 5.0, delay_s=0.012)
    late_s = [(s.measured_at - round((13.0 + 0.005 * k) * S)) / S for k, s in enumerate(stamps)]
    assert late_s[10] == pytest.approx(0.0, abs=5e-4)
    assert late_s[-1] == pytest.approx(0.010, abs=5e-4)
    assert sorted(s.measured_at for s in stamps) == [s.measured_at for s in stamps]


def test_a_beginning_in_a_jam_is_not_claimed_to_be_exact() -> None:
    """The first messages are all late, less and less: nothing shows it but the fall itself."""
    clock = ClockMap(ClockMapOptions(floor_s=0.002, floor_sigma_s=0.0005))
    true_s = np.arange(0.0, 3.0, 0.01)
    delay_s = 0.002 + np.maximum(0.0, 0.4 - 0.8 * true_s)
    stamps = [clock.stamp(round(t * S), MonoNs(round((50.0 + t + d) * S))) for t, d in zip(true_s, delay_s, strict=True)]
    error_s = np.array([s.measured_at / S - 50.0 for s in stamps]) - true_s
    sigma_s = np.array([s.sigma_s for s in stamps])
    assert np.all(np.abs(error_s[10:]) < 5 * sigma_s[10:])
    assert abs(error_s[-1]) < 5e-4
    assert np.all(np.diff([s.measured_at for s in stamps]) >= 0)


@settings(max_examples=100)
@given(st.lists(st.tuples(st.integers(-(2**70), 2**70), st.integers(0, 2**50)), max_size=40), st.sampled_from([None, 2048 * S]))
def test_any_counter_gives_a_stamp_in_order_of_hearing(messages: list[tuple[int, int]], wrap_ns: int | None) -> None:
    clock = ClockMap(ClockMapOptions(wrap_ns=wrap_ns))
    for remote, received_at in messages:
        stamp = clock.stamp(remote, MonoNs(received_at))
        assert stamp.measured_at <= stamp.received_at
        assert 0 <= stamp.sigma_s < 1


MS = 1_000_000
TARGET = (7, 1)


def exchange(sync: TimeSync, count: int, *, offset_ns: int, at: int = 100 * S, ppm: float = 0.0, seed: int = 1) -> int:
    """Return requests answered with exponential delays on both ways (mean 3 ms above 0.3 ms); the time at the end."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        (request,) = sync.due(MonoNs(at), TARGET)
        out, back = (300_000 + rng.exponential(3 * MS) for _ in range(2))
        remote = round((at + out) * (1 + ppm * 1e-6)) + offset_ns
        received_at = MonoNs(round(at + out + back))
        sync.on_message(TimeSyncV2(remote, request.ts1, 1, 191), received_at)
        at = received_at + 1_100 * MS
    return at


def test_the_offset_is_found_within_its_sigma() -> None:
    for seed in range(20):
        sync = TimeSync()
        now = exchange(sync, 12, offset_ns=12_345 * MS, seed=seed)
        found = sync.offset_ns(MonoNs(now))
        assert abs(found[0] - 12_345 * MS) < 3 * found[1] * S
        assert found[1] < 0.003
        assert 0.0006 < sync.round_trip_s < 0.02


def test_slow_stray_and_impossible_answers_are_refused() -> None:
    sync = TimeSync()
    now = exchange(sync, 8, offset_ns=5 * MS)
    before = sync.offset_ns(MonoNs(now))
    sync.on_message(TimeSyncV2(now + 900 * MS, 12345), MonoNs(now))
    (request,) = sync.due(MonoNs(now), TARGET)
    sync.on_message(TimeSyncV2(now, request.ts1), MonoNs(now + S))
    (request,) = sync.due(MonoNs(now + 2 * S), TARGET)
    sync.on_message(TimeSyncV2(now + 90 * S, request.ts1), MonoNs(now + 2 * S + MS))
    assert sync.refused == 3
    assert sync.offset_ns(MonoNs(now)) == before


def test_a_clock_set_again_is_accepted_after_three() -> None:
    sync = TimeSync()
    now = exchange(sync, 8, offset_ns=5 * S)
    now = exchange(sync, 8, offset_ns=-3 * S, at=now)
    assert (sync.jumps, round(sync.jumped_s)) == (1, 8)
    found = sync.offset_ns(MonoNs(now))
    assert abs(found[0] + 3 * S) < 5 * MS


def test_our_answers_carry_our_clock_and_go_to_the_requester() -> None:
    us = (7, 191)
    answer = answer_to(TimeSyncV2(0, 777), MonoNs(4 * S), (7, 1), us)
    assert (answer.tc1, answer.ts1, answer.target_system, answer.target_component) == (4 * S, 777, 7, 1)
    assert answer_to(TimeSyncV2(5, 777), MonoNs(4 * S), (7, 1), us) is None
    assert answer_to(TimeSyncV2(0, 777, 7, 1), MonoNs(4 * S), (7, 1), us) is None


def test_stamps_meet_the_truth_once_locked_and_never_lie_after_they_were_received() -> None:
    sync = TimeSync()
    offset = 5 * S + 123_456
    now = exchange(sync, 30, offset_ns=offset)
    clock = BootClock(sync)
    rng = np.random.default_rng(3)
    errors = []
    for n in range(200):
        measured_at = now + n * 10 * MS
        received_at = MonoNs(round(measured_at + 0.2 * MS + rng.exponential(8 * MS)))
        stamp = clock.stamp(boot_ms((measured_at + offset) // MS), received_at)
        assert stamp.measured_at <= stamp.received_at
        assert stamp.sigma_s < 0.003
        errors.append((stamp.measured_at - measured_at) * 1e-9)
    assert np.abs(errors).max() < 0.002, "the delay of each message is not in its stamp"


def test_a_boot_is_noticed_and_the_offset_forgotten() -> None:
    sync = TimeSync()
    now = exchange(sync, 8, offset_ns=50 * S)
    clock = BootClock(sync)
    clock.stamp(boot_us((now + 50 * S) // 1000), MonoNs(now))
    clock.stamp(boot_us(2_000_000), MonoNs(now + 3 * S))
    assert clock.restarts == 1
    assert not sync.locked


def test_milliseconds_that_wrap_after_seven_weeks() -> None:
    sync = TimeSync()
    wrap_at = 2**32 * MS
    now = 100 * S
    offset = wrap_at - now - 20 * S
    now = exchange(sync, 8, offset_ns=offset, at=now)
    clock = BootClock(sync)
    for n in range(30):
        measured_at = now + n * S
        stamp = clock.stamp(boot_ms((measured_at + offset) // MS % 2**32), MonoNs(measured_at + MS))
        assert abs(stamp.measured_at - measured_at) < 2 * MS
    assert clock.restarts == 0
