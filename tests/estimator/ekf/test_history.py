"""Late is as good as in order, together as good as one by one; what is too late or too new is refused; answers are kept."""

import pickle
from typing import Any

import numpy as np
import pytest

from estimator.contracts.estimates import RelativeState, Sighting, Verdict
from estimator.contracts.samples import Imu
from estimator.contracts.time import MonoNs
from estimator.ekf import EkfOptions, Filter
from estimator.ekf.params import FilterParams
from tests.estimator.ekf.core_state import MS, T, holding, known, newest, put, state_of
from tests.make import baro, imu, stamp_at, status, tuned
from tests.support.estimator_truth import EPOCH_NS, Setting, TruthFlight, events, ns

SETTING = Setting(seed=4, sea=4, duration_s=5.0, pose6=True, range_hz=20.0, baro_hz=10.0, imu_hz=100.0, outliers=0.05)


def put_all(what: list[Any], options: EkfOptions | None = None) -> tuple[Filter, list[Verdict]]:
    ekf = Filter(options or EkfOptions())
    return ekf, [put(ekf, event).verdict for event in what]


def apart(one: RelativeState | None, two: RelativeState | None) -> float:
    """Return the largest difference of two estimates."""
    assert one.sighted == two.sighted
    return max(
        float(np.abs(one.d_body_pad_level - two.d_body_pad_level).max()),
        float(np.abs(one.v_pad_level - two.v_pad_level).max()),
        float(np.abs(one.cov - two.cov).max()),
        abs((one.yaw_rad or 0.0) - (two.yaw_rad or 0.0)),
        max(abs(a[1] - b[1]) for a, b in zip(one.details, two.details, strict=True)),
    )


def test_late_and_shuffled_equals_in_order() -> None:
    received = events(TruthFlight(SETTING))
    in_order = sorted(received, key=lambda e: (e.stamp.measured_at, isinstance(e, Sighting)))
    assert sum(a is not b for a, b in zip(received, in_order, strict=True)) > 100
    rng = np.random.default_rng(0)
    jumbled = sorted(received, key=lambda e: e.stamp.received_at + rng.uniform(0.0, 0.25e9))
    options = tuned(EkfOptions, max_ahead_s=0.5)
    reference, _ = put_all(in_order, options)
    for order in (received, jumbled):
        late, verdicts = put_all(order, options)
        assert Verdict.TOO_OLD not in verdicts
        for t in (4.6, 4.9, 5.1):
            assert apart(late.at(ns(t)), reference.at(ns(t))) < 1e-9


def test_events_together_are_one_after_the_other() -> None:
    received = events(TruthFlight(SETTING))
    one_by_one, verdicts = put_all(received)
    together, rng, at = Filter(), np.random.default_rng(0), 0
    found: list[Verdict] = []
    while at < len(received):
        n = int(rng.integers(1, 30))
        found += [result.verdict for result in together.put(received[at : at + n])]
        at += n
    assert found == verdicts
    assert together.save() == one_by_one.save()


def test_a_saved_filter_goes_on_as_the_first_does_and_apart_from_it() -> None:
    received = events(TruthFlight(SETTING))
    half, _ = put_all(received[:600])
    before, saved = half.at(ns(3.0)), pickle.loads(pickle.dumps(half))
    saved.put(received[600:900])
    assert apart(before, half.at(ns(3.0))) == 0.0
    half.put(received[600:900])
    assert saved.save() == half.save()
    whole = half.save()
    for wrong in (b"", whole[:1], whole[:40], whole[:-1], whole + b"\0"):
        with pytest.raises(ValueError, match="saved"):
            Filter(saved=wrong)


def test_too_old_and_too_new() -> None:
    ekf, _ = put_all([e for e in events(TruthFlight(SETTING)) if isinstance(e, Imu)])
    now, before = EPOCH_NS + 5_000_000_000, newest(ekf)
    old, new = (baro(stamp_at(now + by_ms * MS, now, sigma_s=0.1)) for by_ms in (-2000, 300))
    assert [result.verdict for result in ekf.put([old, new])] == [Verdict.TOO_OLD, Verdict.TOO_NEW]
    assert newest(ekf).t == before.t


def test_a_pause_of_all_streams_does_not_lock_out_what_follows() -> None:
    ekf, _ = put_all(events(TruthFlight(SETTING)))
    later = [
        e for e in events(TruthFlight(Setting(seed=4, sea=4, duration_s=15.0, imu_hz=100.0))) if e.stamp.measured_at > ns(13.0)
    ]
    verdicts = [(type(event), put(ekf, event).verdict) for event in later]
    # The first few might be wrong stamps; when they agree with one another, time has passed.
    assert [v for _, v in verdicts].count(Verdict.TOO_NEW) == EkfOptions().leap_count - 1
    assert [v for kind, v in verdicts if kind is Sighting][-10:] == [Verdict.FUSED] * 10


def test_history_is_bounded() -> None:
    ekf, _ = put_all(events(TruthFlight(SETTING)), EkfOptions(history_s=0.5))
    newest_at = newest(ekf).t
    assert state_of(ekf, newest_at - 490 * MS) is not None
    assert state_of(ekf, newest_at - 560 * MS) is None
    assert len(ekf.save()) < 6e6


def test_what_is_no_measurement_is_a_mistake_of_the_caller() -> None:
    with pytest.raises(TypeError, match="VehicleStatus"):
        Filter().put([status(1.0)])  # type: ignore[list-item]


def test_an_answer_is_computed_once_until_an_event_changes_it() -> None:
    """Vision requests the estimate at an exposure, and the guard again when the sighting comes, after some more samples."""
    params = FilterParams(EkfOptions())
    ekf, now = holding(known(params), params), MonoNs(T + 3 * MS)
    ekf.put([imu(stamp_at(T + MS), (0.1, 0.0, 0.2))])
    first = ekf.at(now)
    assert first is not None
    for k in range(4):
        ekf.at(MonoNs(T + (10 + k) * MS))
    ekf.put([imu(stamp_at(T + 4 * MS), (0.1, 0.0, 0.2))])
    assert ekf.at(now) is first, "others requested instants of their own in between, and a sample came that is later"
    assert ekf.motion(now)[1] is ekf.motion(now)[1]
    ekf.put([imu(stamp_at(T + 2 * MS), (0.1, 0.0, 0.2))])
    other = ekf.at(now)
    assert other is not first
    assert not np.array_equal(other.d_body_pad_level, first.d_body_pad_level)
    figures = tuple(first.details)
    assert len(first.details) == len(figures) == len(dict(figures)) > 30
    assert first.details[-2:] == figures[-2:]


def test_a_forecast_is_of_as_many_instants_as_were_requested() -> None:
    params = FilterParams(EkfOptions())
    ekf, now = holding(known(params), params), MonoNs(T)
    for horizons_s in ([], [3.0, 0.0], np.linspace(0.0, 20.0, 30)):
        found = ekf.forecast(now, horizons_s)
        assert found.cov_d_level.shape == (len(horizons_s), 3, 3)
        assert np.all(found.sigma_roll_rad >= 0.0)
    with pytest.raises(ValueError, match="horizons"):
        ekf.forecast(now, [-1.0])
