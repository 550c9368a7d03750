"""Half of an IMU lies in flight: the library alone names it, flies on without it, and takes it back (own truth)."""

import math
from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.samples import Imu
from estimator.options import EstimatorOptions
from estimator.pipeline import RelativeEstimator
from tests.support.estimator_truth import EPOCH_NS, Event, TruthFlight, events, ns
from tests.support.lying_imu import BEGIN_S, changed, fly_lying, frozen, setting


@pytest.mark.parametrize(("half", "word", "seed"), [("f_body", "accelerometer", 0), ("w_body", "gyro", 1)])
def test_half_of_an_imu_frozen_for_five_seconds_is_named_at_once_and_costs_centimetres(half: str, word: str, seed: int) -> None:
    out = fly_lying(setting(seed), frozen(half), 5.0)
    assert out.named_after_s(f"the {word} repeats its readings") < 0.2
    assert max(out.error_m) < 0.3, "asked: below half a metre"
    assert 0.4 < float(np.mean(out.nees[out.during(BEGIN_S, BEGIN_S + 5.0)])) < 1.5, "sigma is honest"
    assert not out.lost, "well again"
    assert float(np.mean(out.nees[out.during(BEGIN_S + 5.5, 16.0)])) < 1.5
    assert all(out.consistent[out.during(BEGIN_S + 0.2, BEGIN_S + 5.0)]), "the rest suffices"
    assert out.restarts == 0


@pytest.mark.parametrize(
    ("fault", "words", "within_s"),
    [
        (changed(f=1.3), "% too much", 3.0),
        (changed(f_by=np.array([3.5, 0.0, 0.0])), "m/s^2 across the vertical", 3.0),
        (lambda imu: replace(imu, f_body=imu.f_body[[2, 0, 1]]), "accelerometer feels no thrust", 0.4),
        (lambda imu: replace(imu, w_body=imu.w_body * [-1.0, 1.0, 1.0]), "gyro turns the wrong way in roll", 2.5),
        (changed(w_by_deg=(5.0, 0.0, 0.0)), "deg/s too much in roll", 2.5),
        (changed(w_by_deg=(0.0, 0.0, -20.0)), "deg/s too little in yaw", 2.5),
    ],
)
def test_a_half_that_moves_and_lies_is_named_with_its_size_and_the_estimate_goes_on(fault, words, within_s):
    out = fly_lying(setting(3), fault, 4.0)
    named = out.named_after_s(words)
    assert named < within_s, out.named
    assert out.restarts == 1
    assert max(out.error_m[out.during(BEGIN_S + named + 1.0, 16.0)]) < 0.3
    assert not out.lost, "some seconds after it is well it counts again"
    assert out.deceived_s() < 0.6


def test_without_a_witness_on_the_ground_the_arbiter_keeps_a_lie_from_steering_and_the_filter_comes_back() -> None:
    def blind(event: Event) -> bool:
        return type(event).__name__ in ("Baro", "Range", "BodyVelocity")

    out = fly_lying(setting(1), changed(f=1.3), 4.0, blind)
    assert out.deceived_s() < 0.6
    assert max(out.error_m[out.during(BEGIN_S + 6.5, 16.0)]) < 0.3
    assert out.consistent[-1]


def test_a_clean_flight_in_a_high_sea_names_nobody() -> None:
    out = fly_lying(setting(5, sea=6), lambda imu: imu, 0.0)
    assert out.restarts == 0
    assert not out.named


def test_a_filter_that_refuses_sightings_that_agree_is_begun_again() -> None:
    """The belief has run away: by its own gate it would refuse the pad for as long as the pad is seen."""
    flight = TruthFlight(setting(2))
    memory, fused_at = RelativeEstimator(EstimatorOptions()), list[float]()
    for event in events(flight):
        t = (event.stamp.measured_at - EPOCH_NS) * 1e-9
        if isinstance(event, Imu) and 8.0 <= t < 8.4:
            # 40 m/s^2 for .4 s is below every limit of a sample, and too short for a window.
            event = replace(event, f_body=event.f_body + np.array([0.0, 0.0, -40.0]))
        (results,) = memory.put([event])
        if isinstance(event, Sighting) and results[0].verdict is Verdict.FUSED:
            fused_at.append(t)
    state, (d, _, _) = memory.at(ns(15.9)), (x[0] for x in flight.relative(np.array([15.9])))
    assert state is not None
    assert math.dist(state.d_body_pad_level, d) < 0.3
    assert max(b - a for a, b in pairwise(fused_at)) < 3.0
