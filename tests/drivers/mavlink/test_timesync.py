"""Two clocks, and messages between them that take their time."""

import numpy as np

from drivers.mavlink.dialect import TimeSyncV2
from drivers.mavlink.timesync import BootClock, TimeSync, answer_to, boot_ms, boot_us
from estimator.contracts.time import MonoNs

S, MS = 1_000_000_000, 1_000_000
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
        assert found is not None
        assert abs(found[0] - 12_345 * MS) < 3 * found[1] * S
        assert found[1] < 0.003
        assert sync.round_trip_s is not None
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
    assert sync.jumps == 1
    found = sync.offset_ns(MonoNs(now))
    assert found is not None
    assert abs(found[0] + 3 * S) < 5 * MS


def test_our_answers_carry_our_clock_and_go_to_the_requester() -> None:
    us = (7, 191)
    answer = answer_to(TimeSyncV2(0, 777), MonoNs(4 * S), (7, 1), us)
    assert answer is not None
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
