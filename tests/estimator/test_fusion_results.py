"""Samples that are handed over together give what the same samples give one after the other; the figures of each result.

Why figures: a filter that is tuned wrong, or a sensor that drifts, shows in them long before it shows in a landing.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.estimates import COMPONENTS, POSE_COMPONENTS, FusionResult, PathName, Pose6, Sighting, Verdict, source_of
from estimator.contracts.geometry import F64, GeoPoint, Rotation
from estimator.contracts.samples import UNKNOWN_VAR, GeoFix, Sample, VesselMotion
from estimator.contracts.time import Stamp
from estimator.ekf.params import NIS_MAX
from estimator.options import EstimatorOptions
from estimator.paths import Event
from estimator.pipeline import RelativeEstimator
from tests.make import attitude, baro, imu, ns, range_down, same_bits, sighting, stamp, stamp_at, status, velocity, vessel

MS = 1_000_000
SHADOWS: tuple[PathName, ...] = ("median_mean", "dead_reckoning")
LATE_MS, LEAP_MS = (0, 0, 0, 0, 4, 30, 400), (0, 0, 0, 0, 0, 0, 1500, -1500)
SPIKE = (1.0, 1.0, 1.0, 1.0, 1.0, 90.0)
READINGS: dict[str, Callable[[Stamp, float, F64], Sample]] = {
    "imu": lambda at, k, n: imu(at, n, k * (np.array([0.0, 0.0, -9.8]) + n)),
    "attitude": lambda at, k, n: attitude(at, k * n[0], n[1], 0.4 * k + n[2], var=1e-5),
    "velocity": lambda at, k, n: velocity(at, k * n),
    "range": lambda at, k, n: range_down(at, k * (2.0 + abs(n[0]))),
    "baro": lambda at, k, n: baro(at, 30.0 * k + n[0]),
    "report": lambda at, k, n: vessel(at, k * n, 0.4),
    "fix": lambda at, k, n: GeoFix(at, "vehicle", GeoPoint(0.9, 0.1, 2.0), 2.0),
    "status": lambda at, k, n: status(at, k == 1.0),
    "motion": lambda at, k, n: VesselMotion(at, "IN PSXN", k * n[0], n[1], 1e-4, n[2], 0.01),
}
"""Readings as of a vehicle that hovers, by stamp, how many times too large they are, and noise."""
USUAL = ("imu", "attitude", "velocity", "range", "baro", "imu", "attitude", "velocity", "report", "fix", "status", "motion")
DATAGRAM = st.lists(
    st.tuples(st.sampled_from(USUAL), st.sampled_from(LATE_MS), st.sampled_from(LEAP_MS), st.sampled_from(SPIKE)), max_size=7
)


def put_all(datagrams: Sequence[Sequence[Sample]], seen: Sequence[int], *, together: bool) -> tuple[Any, list[FusionResult]]:
    """Return guard, attitudes and beliefs after the datagrams, with a sighting every 40 ms, and all results."""
    memory = RelativeEstimator(EstimatorOptions(path="ekf"), shadows=SHADOWS)
    results: list[FusionResult] = []
    for n, samples in enumerate(datagrams):
        if together:
            found = memory.put(samples)
            results += [result for of_sample in found for result in of_sample]
        else:
            for sample in samples:
                (of_one,) = memory.put([sample])
                results += of_one
        if n % 8 == 7:
            event: Event = sighting(stamp_at((seen[n] - 60) * MS, seen[n] * MS), (0.3, -0.2, 2.0), 0.3, yaw_var=1e-4, seq=seen[n])
            (of_one,) = memory.put([event])
            results += of_one
    newest = ns(seen[-1] * 1e-3)
    return (memory.guard, memory.all_at(newest), memory.motion(newest)), results


@settings(max_examples=25)
@given(drawn=st.lists(DATAGRAM, min_size=1, max_size=40), seed=st.integers(0, 9))
def test_samples_together_are_samples_one_by_one(drawn: list[list[tuple[str, int, int, float]]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    # A quarter of a second of hovering first, so that there is a belief and what follows is compared with it.
    hover = [[("imu", 0, 0, 1.0), ("attitude", 0, 0, 1.0), ("velocity", 0, 0, 1.0), ("range", 0, 0, 1.0)]] * 50
    datagrams, times = [], [5_000 + 5 * n for n in range(len(hover) + len(drawn))]
    for t_ms, readings in zip(times, [*hover, *drawn], strict=True):
        datagram = []
        for kind, late_ms, leap_ms, scale in readings:
            at = stamp_at((t_ms + leap_ms - late_ms) * MS, (t_ms + leap_ms) * MS)
            datagram.append(READINGS[kind](at, scale, rng.normal(0.0, 0.01, 3)))
        datagrams.append(datagram)
    together, one_by_one = (put_all(datagrams, times, together=how) for how in (True, False))
    assert [r.verdict for r in together[1]] == [r.verdict for r in one_by_one[1]]
    assert same_bits(together, one_by_one)


def test_every_sample_of_a_hand_over_has_its_own_results() -> None:
    rng = np.random.default_rng(1)
    memory = RelativeEstimator(EstimatorOptions(path="ekf"), shadows=("median_mean",))
    kinds = (("attitude", 1.0), ("status", 1.0), ("imu", 90.0), ("imu", 1.0))
    samples = [READINGS[kind](stamp(1.0), scale, rng.normal(0.0, 0.01, 3)) for kind, scale in kinds]
    results = memory.put(samples)
    assert [[(r.path, r.verdict) for r in of_one] for of_one in results] == [
        [("ekf", Verdict.FUSED)],
        [],
        [("ekf", Verdict.IMPOSSIBLE), ("median_mean", Verdict.IMPOSSIBLE)],
        [("ekf", Verdict.FUSED)],
    ]
    assert memory.put([]) == []


# Figures

D = np.array([0.1, -0.05, 2.0])
EVERY_PATH = EstimatorOptions(path="ekf")


def pad_seen(t_s: float, *, aside_m: float = 0.0, yaw_rad: float | None = 0.3, pose6: Pose6 | None = None) -> Sighting:
    d = D + np.array([0.0, aside_m, 0.0])
    at = stamp(t_s, 0.05)
    return sighting(at, d, yaw_rad, var=(1e-4, 1e-4, 4e-4), yaw_var=1e-4, seq=round(t_s * 30), pose6=pose6)


def sensed(i: int) -> list[Event]:
    """Return the samples of a body that hovers, with the noise that a sensor has."""
    rng, t = np.random.default_rng(i), i / 100
    return [
        imu(t, rng.normal(0, 1e-3, 3), rng.normal((0.0, 0.0, -9.80665), 0.02)),
        attitude(t, *rng.normal(0, 1e-3, 3)),
        velocity(t, rng.normal(0, 0.02, 3)),
    ]


def fused_flight() -> tuple[RelativeEstimator, list[FusionResult]]:
    """Return a second of flight, and every result of it."""
    memory, results = RelativeEstimator(EVERY_PATH, shadows=SHADOWS), list[FusionResult]()
    for i in range(101):
        events = sensed(i)
        if i % 5 == 4:
            events.append(pad_seen(i / 100 - 0.05))
        for event in events:
            (made,) = memory.put([event])
            results += made
    return memory, results


@pytest.fixture
def hovering() -> tuple[RelativeEstimator, list[FusionResult]]:
    return fused_flight()


def ekf_result(memory: RelativeEstimator, event: Event) -> FusionResult:
    (results,) = memory.put([event])
    return next(r for r in results if r.path == "ekf")


def test_every_comparison_carries_figures_that_agree_with_one_another(hovering):
    compared = [r for r in hovering[1] if r.path == "ekf" and r.source in ("sighting", "attitude", "velocity")]
    compared = [r for r in compared if r.innovation is not None]
    assert {r.source for r in compared} == {"sighting", "attitude", "velocity"}
    for r in compared:
        m = len(r.components)
        assert (r.innovation.shape, r.innovation_cov.shape) == ((m,), (m, m))
        assert r.nis == pytest.approx(float(r.innovation @ np.linalg.solve(r.innovation_cov, r.innovation)), rel=1e-6)
        assert r.test_ratio == pytest.approx(r.nis / NIS_MAX[m - 1])
        assert r.normalized_nis == pytest.approx(r.nis / m)
        assert (r.test_ratio > 1.0) == (r.verdict is Verdict.GATED)
        with pytest.raises(ValueError, match="read-only"):
            r.innovation[0] = 1.0
        with pytest.raises(ValueError, match="read-only"):
            r.innovation_cov[0, 0] = 1.0


def test_the_innovation_is_measured_minus_predicted_and_beyond_the_gate_it_is_refused() -> None:
    good, bad = (ekf_result(fused_flight()[0], pad_seen(1.0, aside_m=aside)) for aside in (0.01, 0.18))
    assert (good.verdict, bad.verdict) == (Verdict.FUSED, Verdict.GATED)
    assert (good.components, bad.components) == (("x_m", "y_m", "z_m", "yaw_rad"),) * 2
    np.testing.assert_allclose(bad.innovation - good.innovation, [0.0, 0.17, 0.0, 0.0], atol=2e-3)
    assert bad.test_ratio > 1.0 > good.test_ratio
    assert (bad.measured_at, bad.received_at) == (stamp(1.0).measured_at, stamp(1.0, 0.05).received_at)


@pytest.mark.parametrize(
    ("event", "components"),
    [
        (velocity(1.01, var=0.01), COMPONENTS["velocity"]),
        (velocity(1.01, var=(0.01, 0.01, UNKNOWN_VAR)), ("forward_m_s", "right_m_s")),
        (velocity(1.01, var=(UNKNOWN_VAR, UNKNOWN_VAR, 0.01)), ("down_m_s",)),
        (attitude(1.01), COMPONENTS["attitude"]),
        (range_down(1.01, 2.0, 0.05), COMPONENTS["range"]),
        (baro(1.01, 2.0, 0.3), COMPONENTS["baro"]),
        (vessel(1.01, np.zeros(3), 0.0, sigma_rad=0.1), COMPONENTS["vessel"][:3]),
        (vessel(1.01, turn_rad_s=0.0), ("turn_rad_s",)),
        (pad_seen(1.01, yaw_rad=None), ("x_m", "y_m", "z_m")),
        (pad_seen(1.01, pose6=Pose6(D, Rotation.from_rpy(0.0, 0.0, -0.3), 1e-4 * np.eye(6))), POSE_COMPONENTS),
    ],
)
def test_each_source_names_what_it_compared(hovering, event, components):
    result = ekf_result(hovering[0], event)
    assert (result.source, result.components) == (source_of(event), components)
    assert result.verdict is Verdict.FUSED
    assert math.isfinite(result.test_ratio)


def test_what_is_compared_with_nothing_has_a_verdict_alone(hovering: tuple[RelativeEstimator, list[FusionResult]]) -> None:
    memory, results = hovering
    inertial = [r for r in results if r.source == "imu"]
    other = [r for r in results if r.path in ("median_mean", "dead_reckoning")]
    early = ekf_result(RelativeEstimator(EVERY_PATH, shadows=SHADOWS), range_down(1.0, 2.0, 0.05))
    refused = memory.put([imu(1.01, f=(0.0, 0.0, -1e4))])[0]
    late = memory.put([pad_seen(-1.0)])[0]
    assert {(r.path, r.verdict) for r in refused} == {
        (path, Verdict.IMPOSSIBLE) for path in ("ekf", "median_mean", "dead_reckoning")
    }
    assert {r.source for r in other} == {"sighting"}
    for r in (*inertial, *other, early, *refused, *late):
        assert (r.innovation, r.innovation_cov, r.components) == (None, None, ())
        assert math.isnan(r.nis)
        assert math.isnan(r.test_ratio)
        assert math.isnan(r.normalized_nis)


def test_only_a_measurement_has_a_source() -> None:
    with pytest.raises(TypeError, match="not str"):
        source_of("a word")  # type: ignore[arg-type]
