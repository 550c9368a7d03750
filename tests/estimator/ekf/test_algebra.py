"""The filter's algebra against filterpy's, an independent implementation of the same equations."""

import math

import numpy as np
import pytest

from estimator.contracts.geometry import F64
from estimator.core.abi import DL_ROWS_MAX as ROWS_MAX
from tests.estimator.ekf.oracle.algebra import Algebra, nis_of

N = 22


def covariance(rng: np.random.Generator, n: int, spread: float) -> F64:
    root = rng.normal(size=(n, n)) * 10.0 ** rng.uniform(-spread, spread, n)
    return np.asarray(root.T @ root)


@pytest.mark.parametrize("seed", range(20))
def test_predict(seed: int) -> None:
    from filterpy.kalman import ExtendedKalmanFilter  # takes a second, as it loads scipy.stats

    rng = np.random.default_rng(seed)
    P, Q, F = covariance(rng, N, 1.5), covariance(rng, N, 1.0), rng.normal(size=(N, N))
    oracle = ExtendedKalmanFilter(dim_x=N, dim_z=1)
    oracle.P, oracle.F, oracle.Q = P, F, Q
    oracle.predict()
    np.testing.assert_allclose(Algebra(N).predict(P, F, Q), oracle.P, rtol=1e-12, atol=1e-12 * np.abs(oracle.P).max())


@pytest.mark.parametrize("m", [1, 2, 3, 4, 6, ROWS_MAX])
@pytest.mark.parametrize("seed", range(8))
def test_correct(seed: int, m: int) -> None:
    from filterpy.kalman import ExtendedKalmanFilter

    rng = np.random.default_rng([seed, m])
    P, H, R, innov = covariance(rng, N, 1.0), rng.normal(size=(m, N)), covariance(rng, m, 0.5), rng.normal(size=m)
    before = P.copy()
    oracle = ExtendedKalmanFilter(dim_x=N, dim_z=m)
    oracle.x, oracle.P = np.zeros(N), P
    oracle.update(innov, lambda _: H, lambda _: np.zeros(m), R)
    fix = Algebra(N).correct(P, innov, H, R)
    assert fix is not None
    np.testing.assert_array_equal(P, before)
    np.testing.assert_allclose(fix.dx, oracle.x, rtol=1e-8, atol=1e-8 * np.abs(oracle.x).max())
    np.testing.assert_allclose(fix.P, oracle.P, rtol=1e-8, atol=1e-9 * np.abs(P).max())
    np.testing.assert_allclose(fix.S, oracle.S, rtol=1e-12)
    np.testing.assert_array_equal(fix.P, fix.P.T)
    assert math.sqrt(fix.nis) == pytest.approx(oracle.mahalanobis, rel=1e-8)
    assert nis_of(innov, fix.S) == pytest.approx(fix.nis, rel=1e-8)


@pytest.mark.parametrize(("var", "innov"), [(1e300, 1e10), (1e-300, 1e200)])
def test_a_correction_beyond_all_numbers_is_refused(var: float, innov: float) -> None:
    """The first moves the unseen state too far, the second has an innovation too large."""
    P = np.diag([1.0, var])
    P[0, 1] = P[1, 0] = 0.9 * math.sqrt(var)
    if innov > 1e100:
        P *= 1e-300
    assert Algebra(2).correct(P, np.array([innov]), np.array([[1.0, 0.0]]), np.eye(1)) is None
