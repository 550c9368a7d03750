"""Cues that agree are fused without false certainty, one that does not is left out, none moves the result by a step."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Method, Sighting
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.detection import fuse

NOW = Stamp(MonoNs(0), MonoNs(0), 0.001, "sim")
TRUTH = np.array([0.4, -0.3, 2.0])


def cue(
    method: Method, sigma_m: float, offset: tuple[float, float, float] = (0, 0, 0), yaw: float | None = 0.5,
    ambiguous: bool = False, sigma_yaw: float = 0.01, confidence: float = 0.9,
) -> Sighting:  # fmt: skip
    cov = np.diag([sigma_m**2, sigma_m**2, (2 * sigma_m) ** 2, UNKNOWN_YAW_VAR if yaw is None else sigma_yaw**2])
    return Sighting(NOW, 1, method, TRUTH + np.array(offset), yaw, ambiguous, cov, confidence)


def test_nothing_from_nothing_and_one_from_one() -> None:
    assert fuse([]) is None
    only = cue("arrow", 0.01)
    fused = fuse([only])
    assert fused is not None
    assert np.allclose(fused.sighting.d_body_pad_level, only.d_body_pad_level)
    assert np.allclose(fused.sighting.cov, only.cov)
    assert fused.sighting.yaw_rad == pytest.approx(only.yaw_rad)
    assert fused.sighting.method == "fused"


@settings(max_examples=100)
@given(sigmas=st.lists(st.floats(1e-4, 0.1), min_size=2, max_size=4), shared=st.floats(-2, 2), seed=st.integers(0, 10**6))
def test_the_covariance_holds_even_for_cues_that_err_together(sigmas: list[float], shared: float, seed: int) -> None:
    """Every cue errs by the same number of its own sigmas: the fused error must not exceed that number of the fused sigma."""
    methods: list[Method] = ["registration", "ellipse", "arrow", "corners"]
    fused = fuse([cue(m, s, (shared * s, 0, 0)) for m, s in zip(methods, sigmas, strict=False)])
    assert fused is not None
    assert fused.outliers == ()
    error = abs(fused.sighting.d_body_pad_level[0] - TRUTH[0])
    assert error <= abs(shared) * math.sqrt(fused.sighting.cov[0, 0]) + 1e-12
    assert fused.sighting.cov[0, 0] >= min(sigmas) ** 2 * (1 - 1e-9)
    assert np.linalg.eigvalsh(fused.sighting.cov).min() > 0


@pytest.mark.parametrize("wrong", ["registration", "ellipse", "arrow", "corners"])
def test_the_odd_one_out_is_left_out(wrong: str) -> None:
    methods: tuple[Method, ...] = ("registration", "ellipse", "arrow", "corners")
    cues = [cue(m, 0.01, (0.5, 0, 0) if m == wrong else (0, 0, 0)) for m in methods]
    fused = fuse(cues)
    assert fused is not None
    assert fused.outliers == (wrong,)
    assert np.allclose(fused.sighting.d_body_pad_level, TRUTH, atol=1e-9)
    assert fused.sighting.confidence < 0.9


@settings(max_examples=100)
@given(st.lists(st.floats(0.0005, 0.01), min_size=2, max_size=4), st.integers(0, 10**6))
def test_a_cue_that_comes_or_goes_moves_the_result_less_than_three_centimetres(sigmas: list[float], seed: int) -> None:
    rng = np.random.default_rng(seed)
    methods: list[Method] = ["registration", "ellipse", "arrow", "corners"]
    cues = [cue(m, s, tuple(rng.normal(0, s, 3).clip(-2 * s, 2 * s))) for m, s in zip(methods, sigmas, strict=False)]
    cues.sort(key=lambda c: float(c.cov[0, 0]))
    whole = fuse(cues)
    without = fuse(cues[:-1])
    assert whole is not None
    assert without is not None
    assert np.linalg.norm(whole.sighting.d_body_pad_level - without.sighting.d_body_pad_level) < 0.03


@settings(max_examples=100)
@given(yaw=st.floats(-math.pi, math.pi), flipped=st.booleans())
def test_an_ambiguous_heading_follows_the_sure_one(yaw: float, flipped: bool) -> None:
    other = math.remainder(yaw + (math.pi if flipped else 0.0), math.tau)
    alone = fuse([cue("corners", 0.002, yaw=other, ambiguous=True)])
    assert alone is not None
    assert alone.sighting.yaw_ambiguous
    both = fuse([cue("corners", 0.002, yaw=other, ambiguous=True), cue("arrow", 0.01, yaw=yaw)])
    assert both is not None
    assert both.outliers == ()
    assert not both.sighting.yaw_ambiguous
    assert both.sighting.yaw_rad is not None
    assert abs(math.remainder(both.sighting.yaw_rad - yaw, math.tau)) < 1e-6


def test_a_heading_nobody_tells_stays_unknown() -> None:
    fused = fuse([cue("ellipse", 0.01, yaw=None), cue("registration", 0.005, yaw=None)])
    assert fused is not None
    assert fused.sighting.yaw_rad is None
    assert fused.sighting.cov[3, 3] == UNKNOWN_YAW_VAR
    one = fuse([cue("ellipse", 0.01, yaw=None), cue("arrow", 0.02)])
    assert one is not None
    assert one.sighting.yaw_rad == pytest.approx(0.5)
