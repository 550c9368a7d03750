"""Wrong sightings are refused and never capture the filter; a filter that is wrong itself finds back."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.samples import Imu, Range
from estimator.ekf import EkfOptions, Filter
from estimator.ekf.state import VEL_SCALE
from tests.estimator.ekf.belief import RejectionStreak, newest
from tests.estimator.ekf.oracle import gate
from tests.support.approach_settings import OPTIONS, setting
from tests.support.estimator_truth import EPOCH_NS, Setting, TruthFlight, events, ns, stamp

CALM = Setting(seed=1, sea=2, duration_s=9.0, imu_hz=100.0, sighting_hz=20.0, attitude_hz=20.0, velocity_hz=20.0)


def error_m(ekf: Filter, flight: TruthFlight, t: float) -> float:
    state = ekf.at(ns(t))
    assert state is not None
    return float(np.linalg.norm(state.d_body_pad_level - flight.relative(np.array([t]))[0][0]))


def shifted(s: Sighting, by: np.ndarray) -> Sighting:
    return structs.replace(s, d_body_pad_level=s.d_body_pad_level + by)


def level(flight: TruthFlight, t_s: float, ned: np.ndarray) -> np.ndarray:
    """Return a vector fixed to the world, in the axes that turn with the body."""
    R = flight.attitude(np.array([t_s]))[0]
    c, s = R[:2, 0] / np.hypot(*R[:2, 0])
    return np.array([c * ned[0] + s * ned[1], c * ned[1] - s * ned[0], ned[2]])


def test_five_percent_wrong_sightings_never_capture_it() -> None:
    flight = TruthFlight(replace(CALM, outliers=0.05, duration_s=12.0))
    ekf, gated, next_s, worst = Filter(), 0, 2.0, 0.0
    for event in events(flight):
        outcomes = ekf.put([event])
        gated += isinstance(event, Sighting) and outcomes[0].verdict is Verdict.GATED
        while event.stamp.received_at > ns(next_s):
            worst = max(worst, error_m(ekf, flight, next_s))
            next_s += 0.1
    assert 3 <= gated <= 25
    assert worst < 0.25


def test_a_false_pad_beside_the_true_one_is_refused_as_long_as_the_true_one_shows() -> None:
    flight = TruthFlight(CALM)
    ekf, refused = Filter(), []
    for event in events(flight):
        wrong = isinstance(event, Sighting) and event.stamp.measured_at > ns(3.0) and event.seq % 2 == 0
        if wrong:
            event = shifted(event, level(flight, (event.stamp.measured_at - EPOCH_NS) * 1e-9, np.array([0.6, 0.3, 0.0])))
        outcomes = ekf.put([event])
        if wrong:
            refused.append(outcomes[0].verdict is Verdict.GATED)
    assert all(refused)
    assert error_m(ekf, flight, 8.9) < 0.1


def test_a_pad_that_has_moved_for_good_is_accepted_after_a_while() -> None:
    """The way back: what was refused again and again, always alike, becomes the belief, and says so by `consistent`."""
    flight = TruthFlight(CALM)
    jump = np.array([0.8, -0.5, 0.2])
    ekf, verdicts, extended = Filter(), [], False
    for event in events(flight):
        moved = isinstance(event, Sighting) and event.stamp.measured_at > ns(4.0)
        t = (event.stamp.measured_at - EPOCH_NS) * 1e-9
        outcomes = ekf.put([shifted(event, level(flight, t, jump)) if moved else event])
        if moved:
            verdicts.append((event.stamp.measured_at, outcomes[0].verdict))
            state = ekf.at(event.stamp.received_at)
            assert state is not None
            extended = extended or not state.consistent
    fused_at = min(t for t, v in verdicts if v is Verdict.FUSED)
    assert 0.5 < (fused_at - ns(4.0)) * 1e-9 < 1.5
    assert [v for _, v in verdicts][-20:].count(Verdict.FUSED) >= 18
    assert extended
    state = ekf.at(ns(8.9))
    assert state is not None
    assert state.consistent
    truth = flight.relative(np.array([8.9]))[0][0] + level(flight, 8.9, jump)
    assert np.linalg.norm(state.d_body_pad_level - truth) < 0.12


def test_a_belief_that_drifts_away_from_what_is_seen_finds_back() -> None:
    """Waves not learned yet, the deck rises 1.5 m/s more than believed: refused sightings agree, though each is farther."""
    streak = RejectionStreak()
    for k in range(8):
        offset = np.array([0.0, 0.0, 0.3 + 1.5 * 0.1 * k])
        streak = gate.extended(streak, k * 100_000_000, offset, 0.01**2)
    assert streak.n == 8
    assert gate.should_reset(streak, 50, EkfOptions())
    far = gate.extended(streak, 8 * 100_000_000, np.array([1.5, 0.0, 1.4]), 0.01**2)
    assert far.n == 1, "two false pads do not agree"

    flight, ekf, last, longest = TruthFlight(setting(86)), Filter(OPTIONS), ns(2.0), 0.0
    for event in events(flight):
        outcomes = ekf.put([event])
        if isinstance(event, Sighting) and outcomes[0].verdict is Verdict.FUSED and event.stamp.measured_at > last:
            longest = max(longest, (event.stamp.measured_at - last) * 1e-9)
            last = event.stamp.measured_at
        if event.stamp.received_at > ns(10.0):
            break
    assert longest < 1.5


def test_a_slow_vessel_s_ground_is_not_taken_for_its_deck() -> None:
    """0.2 m/s under way, a sensor over the ground, and an accelerometer that errs by more than that within two seconds."""
    ekf = Filter(OPTIONS)
    for event in events(TruthFlight(setting(37))):
        ekf.put([event])
        if event.stamp.received_at > ns(10.0):
            break
    assert newest(ekf).over_pad < -1.0
    assert abs(newest(ekf).x[VEL_SCALE] / setting(37).velocity_scale - 1.0) < 0.05


def test_a_wrong_first_sighting_is_soon_overthrown() -> None:
    flight = TruthFlight(CALM)
    ekf, first = Filter(), True
    for event in events(flight):
        if isinstance(event, Sighting) and first:
            event, first = shifted(event, np.array([2.0, 2.0, 1.0])), False
        ekf.put([event])
        if event.stamp.received_at > ns(2.0):
            break
    assert error_m(ekf, flight, 2.0) < 0.25


def test_the_deck_edge_is_gated_and_not_accepted() -> None:
    flight = TruthFlight(replace(CALM, legs=((0.0, 0.1, 0.0, 2.0), (9.0, 0.1, 0.0, 2.0)), lively=0.2, range_hz=20.0))
    ekf, beyond = Filter(), []
    for event in events(flight):
        if isinstance(event, Range) and event.stamp.measured_at > ns(5.0):
            event = Range(event.stamp, event.range_m + 0.6, event.sigma_m)
            outcomes = ekf.put([event])
            beyond.append(outcomes[0].verdict)
        else:
            ekf.put([event])
    assert set(beyond) == {Verdict.GATED}
    assert error_m(ekf, flight, 8.9) < 0.1


def test_range_is_of_use_over_the_deck_and_refused_far_from_it() -> None:
    over = replace(CALM, legs=((0.0, 0.1, 0.0, 2.0), (9.0, 0.1, 0.0, 2.0)), lively=0.2, range_hz=20.0)
    beside = replace(CALM, legs=((0.0, 2.5, 0.0, 2.0), (9.0, 2.5, 0.0, 2.0)), lively=0.2, range_hz=20.0)
    for chosen, wanted in ((over, Verdict.FUSED), (beside, Verdict.GATED)):
        ekf, verdicts = Filter(), []
        for event in events(TruthFlight(chosen)):
            outcomes = ekf.put([event])
            if isinstance(event, Range) and event.stamp.measured_at > ns(4.0):
                verdicts.append(outcomes[0].verdict)
        assert verdicts.count(wanted) > 0.95 * len(verdicts)


@pytest.mark.parametrize("confidence", [0.0, 0.04])
def test_a_sighting_that_does_not_trust_itself_is_refused(confidence: float) -> None:
    ekf = Filter()
    for event in events(TruthFlight(CALM)):
        if event.stamp.received_at > ns(1.0):
            break
        ekf.put([event])
    cov = np.diag([0.01, 0.01, 0.01, 0.01])
    seen = Sighting(stamp(1.0), 999, "selected", np.array([0.0, 0.0, 2.0]), 0.0, False, cov, confidence)
    outcomes = ekf.put([seen])
    assert outcomes[0].verdict is Verdict.LOW_CONFIDENCE


def test_options_refuse_nonsense() -> None:
    with pytest.raises(ValueError, match="asd_gyro_rad_s"):
        EkfOptions(asd_gyro_rad_s=-1.0)
    with pytest.raises(ValueError, match="gate_probability"):
        EkfOptions(gate_probability=0.5)


def test_first_imu_alone_levels_the_body() -> None:
    ekf = Filter()
    f = np.array([0.5, -0.3, -9.78])
    for k in range(20):
        outcomes = ekf.put([Imu(stamp(0.01 * k), np.zeros(3), f + 1e-6 * (k % 2))])
    assert outcomes[0].verdict is Verdict.FUSED
    down = newest(ekf).R.T @ np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(down, -f / np.linalg.norm(f), atol=1e-3)
    assert newest(ekf).t == EPOCH_NS + 190_000_000


def test_an_offset_of_the_range_sensor_is_learned_and_not_accepted() -> None:
    """An AR.Drone's ultrasound sits 3.4 cm under what motion capture calls the drone."""
    flight = TruthFlight(replace(CALM, legs=((0.0, 0.1, 0.0, 2.0), (9.0, 0.1, 0.0, 2.0)), lively=0.2, range_hz=20.0))
    ekf = Filter()
    for event in events(flight):
        if isinstance(event, Range):
            event = Range(event.stamp, event.range_m - 0.06, event.sigma_m)
        ekf.put([event])
    state = ekf.at(ns(8.9))
    assert state is not None
    assert abs(dict(state.details)["range_offset_m"] + 0.06) < 0.02
    assert abs(state.d_body_pad_level[2] - flight.relative(np.array([8.9]))[0][0, 2]) < 0.02
