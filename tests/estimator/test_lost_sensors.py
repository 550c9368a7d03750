"""Half of an IMU lies in flight: the library alone names it, flies on without it, and takes it back (own truth)."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Imu
from estimator.options import EstimatorOptions
from estimator.pipeline import RelativeEstimator
from tests.support.estimator_truth import EPOCH_NS, Event, Setting, TruthFlight, events, ns

BEGIN_S, BEFORE_S, STEP_S = 8.0, 5.0, 0.05
STREAMS = {
    "sea": 4, "duration_s": 16.0, "imu_hz": 100.0, "attitude_hz": 25.0, "velocity_hz": 20.0, "range_hz": 10.0, "baro_hz": 25.0,
    "sighting_hz": 15.0,
}  # fmt: skip
Fault = Callable[[Imu], Imu]


@dataclass
class Flown:
    """Outputs of the estimator in a flight, every `STEP_S` from `BEFORE_S` on."""

    t: list[float] = field(default_factory=list)
    error_m: list[float] = field(default_factory=list)
    sigma_m: list[float] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)
    """NEES of position and velocity, over their six dimensions."""
    consistent: list[bool] = field(default_factory=list)
    named: dict[str, float] = field(default_factory=dict)
    """Instant from which a sensor is left out, by the sentence, s after the fault's beginning."""
    lost: tuple[str, ...] = ()
    restarts: int = 0

    def during(self, since: float, until: float) -> slice:
        return slice(*np.searchsorted(self.t, [since, until]))

    def deceived_s(self) -> float:
        """Return for how long it was wrong by more than it said and called itself consistent."""
        all_of = zip(self.error_m, self.sigma_m, self.consistent, strict=True)
        return STEP_S * sum(error > max(0.3, 4.0 * sigma) and consistent for error, sigma, consistent in all_of)

    def named_after_s(self, words: str) -> float:
        """Return the time from the fault's beginning until a sentence has these words; infinity if none has."""
        return min((t for text, t in self.named.items() if words in text), default=math.inf)


def fly_lying(setting: Setting, fault: Fault, lasts_s: float, blind: Callable[[Event], bool] = lambda e: False) -> Flown:
    """Fly with a fault of the IMU from `BEGIN_S` on.

    Args:
        blind: which events the estimator does not get.
    """
    flight, memory, out = TruthFlight(setting), RelativeEstimator(EstimatorOptions()), Flown()
    now = BEFORE_S
    for event in events(flight):
        while event.stamp.received_at >= ns(now):
            state, (d, v, _) = memory.at(ns(now)), (x[0] for x in flight.relative(np.array([now])))
            assert state is not None or memory.guard.restarts, f"nothing is believed at {now:.2f} s"
            if state is not None:
                off: F64 = np.concatenate([state.d_body_pad_level - d, state.v_pad_level - v])
                out.t.append(now)
                out.error_m.append(float(np.linalg.norm(off[:3])))
                out.sigma_m.append(math.sqrt(state.cov.diagonal()[:3].sum()))
                out.nees.append(float(off.dot(np.linalg.solve(state.cov[:6, :6], off))) / 6.0)
                out.consistent.append(state.consistent)
            now += STEP_S
        if blind(event):
            continue
        since_s = (event.stamp.measured_at - EPOCH_NS) * 1e-9 - BEGIN_S
        memory.put([fault(event) if isinstance(event, Imu) and 0.0 <= since_s < lasts_s else event])
        for text in memory.guard.lost:
            out.named.setdefault(text, since_s)
    out.restarts, out.lost = memory.guard.restarts, memory.guard.lost
    return out


def setting(seed: int, **fields: float) -> Setting:
    return Setting(seed=seed, **{**STREAMS, **fields})  # type: ignore[arg-type]


def frozen(half: str) -> Fault:
    first: list[F64] = []

    def spoil(imu: Imu) -> Imu:
        first.append(getattr(imu, half))
        return replace(imu, **{half: first[0]})

    return spoil


def changed(f: float = 1.0, f_by: F64 | None = None, w_by_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Fault:
    by = np.zeros(3) if f_by is None else f_by
    return lambda imu: replace(imu, f_body=f * imu.f_body + by, w_body=imu.w_body + np.radians(w_by_deg))


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
    assert math.dist(state.d_body_pad_level, d) < 0.3
    assert max(b - a for a, b in pairwise(fused_at)) < 3.0
