"""Late is as good as in order; what is too late, too new, or nothing at all is said to be so."""

import pickle
from typing import Any

import numpy as np
import pytest

from estimator.contracts.estimates import RelativeState, Sighting, Verdict
from estimator.contracts.samples import Baro, Imu, VehicleStatus
from estimator.contracts.time import MonoNs, Stamp
from estimator.ekf import EkfOptions, Filter
from tests.estimator.ekf.belief import belief_of, newest
from tests.support.estimator_truth import EPOCH_NS, Setting, TruthFlight, events, ns

SETTING = Setting(seed=4, sea=4, duration_s=5.0, pose6=True, range_hz=20.0, baro_hz=10.0, imu_hz=100.0, outliers=0.05)


def run(what: list[Any], options: EkfOptions | None = None) -> tuple[Filter, list[Verdict]]:
    ekf = Filter(options or EkfOptions())
    verdicts = []
    for event in what:
        outcomes = ekf.put([event])
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
            assert same(late.at(ns(t)), reference.at(ns(t))) < 1e-9


def test_events_together_are_one_after_the_other() -> None:
    received_at = events(TruthFlight(SETTING))
    one_by_one, verdicts = run(received_at)
    together, rng, at = Filter(), np.random.default_rng(0), 0
    found: list[Verdict] = []
    while at < len(received_at):
        n = int(rng.integers(1, 30))
        found += [result.verdict for result in together.put(received_at[at : at + n])]
        at += n
    assert found == verdicts
    assert together.save() == one_by_one.save()
    assert together.put([]) == []


def test_a_saved_filter_goes_on_as_the_first_does_and_apart_from_it() -> None:
    received_at = events(TruthFlight(SETTING))
    half, _ = run(received_at[:600])
    before, saved = half.at(ns(3.0)), pickle.loads(pickle.dumps(half))
    saved.put(received_at[600:900])
    assert same(before, half.at(ns(3.0))) == 0.0
    half.put(received_at[600:900])
    assert saved.save() == half.save()
    for cut in (0, 1, 40, len(half.save()) - 1):
        with pytest.raises(ValueError, match="saved"):
            Filter(saved=half.save()[:cut])


def test_too_old_and_too_new() -> None:
    ekf, _ = run([e for e in events(TruthFlight(SETTING)) if isinstance(e, Imu)])
    now = EPOCH_NS + 5_000_000_000
    old = Baro(Stamp(MonoNs(now - 2_000_000_000), MonoNs(now), 0.0, "sim"), 1.0, 0.1)
    new = Baro(Stamp(MonoNs(now + 300_000_000), MonoNs(now), 0.1, "sim"), 1.0, 0.1)
    before = newest(ekf)
    assert [result.verdict for result in ekf.put([old, new])] == [Verdict.TOO_OLD, Verdict.TOO_NEW]
    assert newest(ekf).t == before.t


def test_a_pause_of_all_streams_does_not_lock_out_what_follows() -> None:
    received_at = events(TruthFlight(SETTING))
    ekf, _ = run(received_at)
    later = [
        e for e in events(TruthFlight(Setting(seed=4, sea=4, duration_s=15.0, imu_hz=100.0))) if e.stamp.measured_at > ns(13.0)
    ]
    verdicts = []
    for event in later:
        outcomes = ekf.put([event])
        verdicts.append((type(event), outcomes[0].verdict))
    # The first few might be wrong stamps; when they agree with one another, time has passed.
    assert [v for _, v in verdicts].count(Verdict.TOO_NEW) == EkfOptions().leap_count - 1
    assert [v for kind, v in verdicts if kind is Sighting][-10:] == [Verdict.FUSED] * 10


def test_nothing_known_is_none_and_needs_an_attitude() -> None:
    ekf = Filter()
    assert ekf.at(ns(0.0)) is None
    sightings = [e for e in events(TruthFlight(SETTING)) if isinstance(e, Sighting)]
    outcomes = ekf.put([sightings[0]])
    assert outcomes[0].verdict is Verdict.NO_ATTITUDE
    assert ekf.at(ns(1.0)) is None


def test_history_is_bounded() -> None:
    ekf, _ = run(events(TruthFlight(SETTING)), EkfOptions(history_s=0.5))
    newest_at = newest(ekf).t
    assert belief_of(ekf, newest_at - 490_000_000) is not None
    assert belief_of(ekf, newest_at - 560_000_000) is None
    assert len(ekf.save()) < 6e6


def test_what_is_no_measurement_is_a_mistake_of_the_caller() -> None:
    status = VehicleStatus(Stamp(MonoNs(0), MonoNs(0), 0.0, "sim"), None, "landed", None, False, True)
    with pytest.raises(TypeError, match="VehicleStatus"):
        Filter().put([status])  # type: ignore[list-item]
