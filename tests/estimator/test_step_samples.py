"""Samples that are handed over together give what the same samples give one after the other: memory, verdicts and innovations."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.estimates import PathName, Verdict
from estimator.contracts.fusion import FusionResult
from estimator.contracts.geodesy import GeoPoint
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import (
    UNKNOWN_VAR,
    Attitude,
    Baro,
    BodyVelocity,
    GeoFix,
    Imu,
    Range,
    Sample,
    VehicleStatus,
    VesselReport,
)
from estimator.contracts.time import MonoNs, Stamp
from estimator.options import EstimatorOptions
from estimator.paths import Event
from estimator.pipeline import RelativeEstimator
from tests.make import same_bits, sighting, stamp, stamp_at

MS = 1_000_000
PATHS: tuple[PathName, ...] = ("ekf", "dead_reckoning", "median_mean")
LATE_MS, LEAP_MS = (0, 0, 0, 0, 4, 30, 400), (0, 0, 0, 0, 0, 0, 1500, -1500)
SPIKE = (1.0, 1.0, 1.0, 1.0, 1.0, 90.0)


def made(kind: str, at: Stamp, scale: float, rng: np.random.Generator) -> Sample:
    """Return a reading as of a vehicle that hovers, `scale` times as large as it should be."""
    noise = rng.normal(0.0, 0.01, 3)
    match kind:
        case "imu":
            return Imu(at, noise, scale * (np.array([0.0, 0.0, -9.8]) + noise))
        case "attitude":
            return Attitude(at, Rotation.from_rpy(scale * noise[0], noise[1], 0.4 * scale + noise[2]), 1e-5 * np.eye(3))
        case "velocity":
            return BodyVelocity(at, scale * noise, np.diag([0.01, 0.01, UNKNOWN_VAR]))
        case "range":
            return Range(at, scale * (2.0 + abs(noise[0])), 0.02)
        case "baro":
            return Baro(at, 30.0 * scale + noise[0], 0.5)
        case "report":
            return VesselReport(at, scale * noise, 0.01 * np.eye(3), 0.4, 0.05)
        case "fix":
            return GeoFix(at, "vehicle", GeoPoint(0.9, 0.1, 2.0), 2.0)
    return VehicleStatus(at, scale == 1.0, "flying", 0.9, False, True)


KINDS = ("imu", "attitude", "velocity", "range", "baro", "imu", "attitude", "velocity", "report", "fix", "status")
DATAGRAM = st.lists(
    st.tuples(st.sampled_from(KINDS), st.sampled_from(LATE_MS), st.sampled_from(LEAP_MS), st.sampled_from(SPIKE)), max_size=7
)


def flown(datagrams: Sequence[Sequence[Sample]], seen: Sequence[int], *, together: bool) -> tuple[Any, list[FusionResult]]:
    """Return guard, attitudes and beliefs after the datagrams, with a sighting every 40 ms, and all results."""
    memory = RelativeEstimator(EstimatorOptions(path="ekf"), shadows=PATHS[1:])
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
    newest = MonoNs(seen[-1] * MS)
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
            datagram.append(made(kind, at, scale, rng))
        datagrams.append(datagram)
    together, one_by_one = (flown(datagrams, times, together=how) for how in (True, False))
    assert [r.verdict for r in together[1]] == [r.verdict for r in one_by_one[1]]
    assert same_bits(together, one_by_one)


def test_every_sample_of_a_hand_over_has_its_own_results() -> None:
    rng = np.random.default_rng(1)
    memory = RelativeEstimator(EstimatorOptions(path="ekf"), shadows=("median_mean",))
    kinds = (("attitude", 1.0), ("status", 1.0), ("imu", 90.0), ("imu", 1.0))
    samples = [made(kind, stamp(1.0), scale, rng) for kind, scale in kinds]
    results = memory.put(samples)
    assert [[(r.path, r.verdict) for r in of_one] for of_one in results] == [
        [("ekf", Verdict.FUSED)],
        [],
        [("ekf", Verdict.IMPOSSIBLE), ("median_mean", Verdict.IMPOSSIBLE)],
        [("ekf", Verdict.FUSED)],
    ]
    assert memory.put([]) == []
