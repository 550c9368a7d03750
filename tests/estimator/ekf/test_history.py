"""Late is as good as in order; what is too late, too new, or nothing at all is said to be so."""

import sys
import threading
import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimator.contracts.estimates import RelativeState, Sighting, Verdict
from estimator.contracts.samples import Baro, Imu, VehicleStatus
from estimator.contracts.time import MonoNs, Stamp
from estimator.ekf import Ekf, EkfOptions, at, start, step
from tests.support.estimator_truth import EPOCH_NS, Setting, TruthFlight, events, ns

SETTING = Setting(seed=4, sea=4, duration_s=5.0, pose6=True, range_hz=20.0, baro_hz=10.0, imu_hz=100.0, outliers=0.05)


def run(what: list[Any], options: EkfOptions | None = None) -> tuple[Ekf, list[Verdict]]:
    ekf = start(options or EkfOptions())
    verdicts = []
    for event in what:
        ekf, outcomes = step(ekf, event)
        assert len(outcomes) == 1
        verdicts.append(outcomes[0].verdict)
    return ekf, verdicts


def same(one: RelativeState | None, two: RelativeState | None) -> float:
    assert one is not None
    assert two is not None
    assert one.sighted == two.sighted
    return max(
        float(np.abs(one.d_body_pad_level - two.d_body_pad_level).max()),
        float(np.abs(one.v_pad_level - two.v_pad_level).max()),
        float(np.abs(one.cov - two.cov).max()),
        abs((one.yaw_rad or 0.0) - (two.yaw_rad or 0.0)),
        max(abs(a[1] - b[1]) for a, b in zip(one.details, two.details, strict=True)),
    )


def test_late_and_shuffled_equals_in_order() -> None:
    received_at = events(TruthFlight(SETTING))
    in_order = sorted(received_at, key=lambda e: (e.stamp.measured_at, isinstance(e, Sighting)))
    assert sum(a is not b for a, b in zip(received_at, in_order, strict=True)) > 100
    rng = np.random.default_rng(0)
    jumbled = sorted(received_at, key=lambda e: e.stamp.received_at + rng.uniform(0.0, 0.25e9))
    options = EkfOptions(max_ahead_s=0.5)
    reference, _ = run(in_order, options)
    for order in (received_at, jumbled):
        late, verdicts = run(order, options)
        assert Verdict.TOO_OLD not in verdicts
        for t in (4.6, 4.9, 5.1):
            assert same(at(late, ns(t)), at(reference, ns(t))) < 1e-9


def test_an_older_memory_is_not_touched() -> None:
    received_at = events(TruthFlight(SETTING))
    half, _ = run(received_at[:600])
    before = at(half, ns(3.0))
    for event in received_at[600:900]:
        step(half, event)
    assert same(before, at(half, ns(3.0))) == 0.0


def test_reading_on_another_thread_changes_nothing() -> None:
    """The eyes ask where the pad is expected while the loop goes on stepping."""
    received_at = events(TruthFlight(replace(SETTING, duration_s=2.0)))
    alone, _ = run(received_at)
    half, _ = run(received_at[: len(received_at) // 2])
    done, read = threading.Event(), [0]

    def tracker() -> None:
        while not done.is_set():
            assert at(half, ns(1.1)) is not None
            read[0] += 1

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    thread = threading.Thread(target=tracker)
    thread.start()
    try:
        watched = half
        for event in received_at[len(received_at) // 2 :]:
            watched, _ = step(watched, event)
    finally:
        done.set()
        thread.join()
        sys.setswitchinterval(interval)
    assert read[0] > 20
    assert same(at(watched, ns(1.99)), at(alone, ns(1.99))) == 0.0


def test_too_old_and_too_new() -> None:
    ekf, _ = run([e for e in events(TruthFlight(SETTING)) if isinstance(e, Imu)])
    now = EPOCH_NS + 5_000_000_000
    old = Baro(Stamp(MonoNs(now - 2_000_000_000), MonoNs(now), 0.0, "sim"), 1.0, 0.1)
    new = Baro(Stamp(MonoNs(now + 300_000_000), MonoNs(now), 0.1, "sim"), 1.0, 0.1)
    after, outcomes = step(ekf, old)
    assert outcomes[0].verdict is Verdict.TOO_OLD
    assert after.belief is ekf.belief
    _, outcomes = step(ekf, new)
    assert outcomes[0].verdict is Verdict.TOO_NEW


def test_a_pause_of_all_streams_does_not_lock_out_what_follows() -> None:
    received_at = events(TruthFlight(SETTING))
    ekf, _ = run(received_at)
    later = [
        e for e in events(TruthFlight(Setting(seed=4, sea=4, duration_s=15.0, imu_hz=100.0))) if e.stamp.measured_at > ns(13.0)
    ]
    verdicts = []
    for event in later:
        ekf, outcomes = step(ekf, event)
        verdicts.append((type(event), outcomes[0].verdict))
    # The first few might be wrong stamps; when they agree with one another, time has passed.
    assert [v for _, v in verdicts].count(Verdict.TOO_NEW) == EkfOptions().leap_count - 1
    assert [v for kind, v in verdicts if kind is Sighting][-10:] == [Verdict.FUSED] * 10


def test_nothing_known_is_none_and_needs_an_attitude() -> None:
    ekf = start()
    assert at(ekf, ns(0.0)) is None
    sightings = [e for e in events(TruthFlight(SETTING)) if isinstance(e, Sighting)]
    ekf, outcomes = step(ekf, sightings[0])
    assert outcomes[0].verdict is Verdict.NO_ATTITUDE
    assert at(ekf, ns(1.0)) is None


def test_history_is_bounded() -> None:
    ekf, _ = run(events(TruthFlight(SETTING)), EkfOptions(history_s=0.5))
    times = [node.key[0] for node in ekf.history.nodes]
    assert times[-1] - times[0] <= 500_000_000
    assert len(times) < 200


def test_what_is_no_measurement_is_a_mistake_of_the_caller() -> None:
    status = VehicleStatus(Stamp(MonoNs(0), MonoNs(0), 0.0, "sim"), None, "landed", None, False, True)
    with pytest.raises(TypeError, match="VehicleStatus"):
        step(start(), status)  # type: ignore[arg-type]


def test_samples_that_are_all_late_do_not_keep_the_memory_of_what_came_after_each() -> None:
    flight = sorted(events(TruthFlight(SETTING)), key=lambda e: e.stamp.measured_at)
    known, late = flight[::2], flight[1::2]
    options = EkfOptions(max_ahead_s=5.0)
    ekf, _ = run(known, options)
    oldest = ekf.history.nodes[0].key[0]
    inserted = [event for event in late if event.stamp.measured_at > oldest]
    assert len(inserted) > 80
    in_order = [event for i, event in enumerate(flight) if i % 2 == 0 or event.stamp.measured_at > oldest]
    reference = at(run(in_order, options)[0], ns(5.1))
    tracemalloc.start()
    for event in inserted:
        ekf, _ = step(ekf, event)
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert same(at(ekf, ns(5.1)), reference) < 1e-9
    # Without it each event keeps some hundred beliefs: 100 MB.
    assert grown < 2 * sum(block.nbytes for block in blocks(ekf)) < 60e6


def blocks(ekf: Ekf) -> list[np.ndarray]:
    """Return every block of memory that the history's beliefs refer to."""
    packed = [node.packed for node in ekf.history.nodes if node.packed is not None]
    found = [block for p in packed for block in map(_whole, (p.numbers, p.P, p.sea.record))]
    return list({id(block): block for block in found}.values())


def _whole(array: np.ndarray) -> np.ndarray:
    return array if array.base is None else _whole(array.base)
