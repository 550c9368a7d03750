"""Fusion results of each measurement: innovation, its covariance, NIS, test ratio and verdict, by source.

Why: a filter that is tuned wrong, or a sensor that drifts, shows in these figures long before it shows in a landing.
"""

import math

import numpy as np
import pytest

from estimator.contracts.estimates import PathName, Pose6, Sighting, Verdict
from estimator.contracts.fusion import COMPONENTS, POSE_COMPONENTS, FusionResult, source_of
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, BodyVelocity, Imu
from estimator.ekf.options import EkfOptions
from estimator.ekf.params import nis_max
from estimator.options import EstimatorOptions
from estimator.paths import Event
from estimator.pipeline import RelativeEstimator
from tests.make import attitude, baro, imu, range_down, sighting, stamp, velocity, vessel

D = np.array([0.1, -0.05, 2.0])
EVERY_PATH = EstimatorOptions(path="ekf")
SHADOWS: tuple[PathName, ...] = ("median_mean", "dead_reckoning")


def pad_seen(t_s: float, *, aside_m: float = 0.0, yaw_rad: float | None = 0.3, pose6: Pose6 | None = None) -> Sighting:
    d = D + np.array([0.0, aside_m, 0.0])
    at = stamp(t_s, 0.05)
    return sighting(at, d, yaw_rad, var=(1e-4, 1e-4, 4e-4), yaw_var=1e-4, seq=round(t_s * 30), pose6=pose6)


def sensed(i: int) -> list[Event]:
    """Return the samples of a body that hovers, with the noise that a sensor has."""
    rng, t_s = np.random.default_rng(i), i / 100
    at = stamp(t_s)
    return [
        Imu(at, rng.normal(0, 1e-3, 3), np.array([0.0, 0.0, -9.80665]) + rng.normal(0, 0.02, 3)),
        Attitude(at, Rotation.from_rpy(*rng.normal(0, 1e-3, 3)), 1e-4 * np.eye(3)),
        BodyVelocity(at, rng.normal(0, 0.02, 3), np.diag([0.01, 0.01, UNKNOWN_VAR])),
    ]


def flown() -> tuple[RelativeEstimator, list[FusionResult]]:
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
    return flown()


def ekf_result(memory: RelativeEstimator, event: Event) -> FusionResult:
    (results,) = memory.put([event])
    return next(r for r in results if r.path == "ekf")


def test_every_comparison_carries_figures_that_agree_with_one_another(hovering):
    compared = [r for r in hovering[1] if r.path == "ekf" and r.source in ("sighting", "attitude", "velocity")]
    compared = [r for r in compared if r.innovation is not None]
    assert {r.source for r in compared} == {"sighting", "attitude", "velocity"}
    for r in compared:
        assert r.innovation is not None
        assert r.innovation_cov is not None
        m = len(r.components)
        assert (r.innovation.shape, r.innovation_cov.shape) == ((m,), (m, m))
        assert r.nis == pytest.approx(float(r.innovation @ np.linalg.solve(r.innovation_cov, r.innovation)), rel=1e-6)
        assert r.test_ratio == pytest.approx(r.nis / nis_max(EkfOptions().gate_probability, m))
        assert r.normalized_nis == pytest.approx(r.nis / m)
        assert (r.test_ratio > 1.0) == (r.verdict is Verdict.GATED)
        with pytest.raises(ValueError, match="read-only"):
            r.innovation[0] = 1.0
        with pytest.raises(ValueError, match="read-only"):
            r.innovation_cov[0, 0] = 1.0


def test_the_innovation_is_measured_minus_predicted_and_beyond_the_gate_it_is_refused() -> None:
    good, bad = (ekf_result(flown()[0], pad_seen(1.0, aside_m=aside)) for aside in (0.01, 0.18))
    assert (good.verdict, bad.verdict) == (Verdict.FUSED, Verdict.GATED)
    assert good.innovation is not None
    assert bad.innovation is not None
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
        (vessel(1.01, np.zeros(3), 0.0, sigma_rad=0.1), COMPONENTS["vessel"]),
        (vessel(1.01, None, -0.3, sigma_rad=0.1), ("heading_rad",)),
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
