"""The core's linear algebra for numpy: covariance propagation, and the Kalman correction in Joseph form."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64
from estimator.core.abi import DL_N as ORDER_MAX
from estimator.core.abi import DL_ROWS_MAX as ROWS_MAX
from estimator.ekf.state import N
from tests.support.core_parts import PARTS, part


class Correction(NamedTuple):
    """The result of one Kalman correction, not yet applied to the belief."""

    dx: F64
    """(N,) error-state correction to add to the state."""
    P: F64
    """(N, N) covariance after the correction."""
    S: F64
    """(m, m) covariance of the innovation."""
    nis: float
    """Normalised innovation squared: `innov' inv(S) innov`."""


def nis_of(innov: Sequence[float] | F64, S: F64) -> float | None:
    """Return the normalised innovation squared, `innov' inv(S) innov`, or None if S is not positive definite.

    The function eliminates as Cholesky does, with Python floats: for the one to three components of a sensor's sample this takes
    a third of the time of a call to LAPACK.

    Args:
        innov: (m,) innovation.
        S: (m, m) covariance of the innovation.
    """
    rest, rows = list(innov), S.tolist()
    m = len(rest)
    nis = 0.0
    for i in range(m):
        row = rows[i]
        pivot = row[i]
        if not pivot > 0.0:
            return None
        nis += rest[i] * rest[i] / pivot
        for j in range(i + 1, m):
            factor = row[j] / pivot
            rest[j] -= factor * rest[i]
            for k in range(j, m):
                rows[j][k] -= factor * row[k]
    return nis if math.isfinite(nis) else None


_PREDICT, _CORRECT = part("kalman_predict"), part("kalman_correct")


class Algebra:
    """Linear algebra for error states of one size, done by the native core (estimator/core/base/kalman.c).

    Source: Labbe, Kalman and Bayesian Filters in Python, 2020, ch. 11; Joseph form: Bar-Shalom, Li, Kirubarajan, Estimation
    with Applications to Tracking and Navigation, 2001, eq. 5.2.3-18.

    Raises:
        ValueError: the core has no room for this many states.
    """

    def __init__(self, n: int) -> None:
        if not 0 < n <= ORDER_MAX:
            raise ValueError(f"the core takes 1 to {ORDER_MAX} states, not {n}")
        self._n = n

    def predict(self, P: F64, F: F64, Q: F64) -> F64:
        """Return the symmetric part of `F P F' + Q`; all matrices are (n, n), and P is symmetric.

        Raises:
            ValueError: a matrix has another shape.
        """
        self._check(P=P, F=F, Q=Q)
        P, F, Q = (np.ascontiguousarray(matrix) for matrix in (P, F, Q))
        after = np.empty_like(P)
        _PREDICT(self._n, P, F, Q, after)
        return after

    def correct(self, P: F64, innov: F64, H: F64, R: F64) -> Correction | None:
        """Return the Kalman correction, or None if S is not positive definite.

        Args:
            P: (n, n) covariance before the correction.
            innov: (m,) innovation; m is at most `ROWS_MAX`.
            H: (m, n) Jacobian of the measurement.
            R: (m, m) covariance of the measurement noise.

        Raises:
            ValueError: an argument has another shape, or there are too many rows.
        """
        n, m = self._n, innov.size
        self._check(P=P)
        if not 0 < m <= ROWS_MAX or H.shape != (m, n) or R.shape != (m, m):
            raise ValueError(f"a correction by {m} numbers with H {H.shape} and R {R.shape}; the core takes 1 to {ROWS_MAX} rows")
        P, innov, H, R = (np.ascontiguousarray(part, dtype=np.float64) for part in (P, innov, H, R))
        dx, after, S, nis = np.empty(n), np.empty((n, n)), np.empty((m, m)), np.empty(1)
        measured = PARTS.new("measured *", (m, *(PARTS.cast("double *", part.ctypes.data) for part in (innov, H, R))))
        if not _CORRECT(n, P, measured, dx, after, S, nis):
            return None
        return Correction(dx, after, S, nis.item())

    def _check(self, **matrices: F64) -> None:
        for name, matrix in matrices.items():
            if matrix.shape != (self._n, self._n):
                raise ValueError(f"{name} has shape {matrix.shape}, not {(self._n, self._n)}")


ALGEBRA = Algebra(N)
"""Algebra of the filter's error state."""
