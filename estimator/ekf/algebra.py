"""The filter's linear algebra: covariance propagation, and the Kalman correction in Joseph form."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64


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


class Algebra:
    """Linear algebra for error states of one size.

    Source: Labbe, Kalman and Bayesian Filters in Python, 2020, ch. 11; Joseph form: Bar-Shalom, Li, Kirubarajan, Estimation
    with Applications to Tracking and Navigation, 2001, eq. 5.2.3-18.
    """

    def __init__(self, n: int) -> None:
        self._identity = np.eye(n)
        self._identity.setflags(write=False)

    def predict(self, P: F64, F: F64, Q: F64) -> F64:
        """Return the symmetric part of `F P F' + Q`; all matrices are (n, n)."""
        moved = F.dot(P).dot(F.T) + Q
        return np.asarray(0.5 * (moved + moved.T))

    def correct(self, P: F64, innov: F64, H: F64, R: F64) -> Correction | None:
        """Return the Kalman correction, or None if S cannot be inverted.

        Args:
            P: (n, n) covariance before the correction.
            innov: (m,) innovation.
            H: (m, n) Jacobian of the measurement.
            R: (m, m) covariance of the measurement noise.
        """
        # Units and variances differ by many orders of magnitude: rows scaled to unit innovation variance keep S well conditioned.
        var = np.einsum("ij,ij->i", H.dot(P), H) + R.diagonal()
        if not all(0.0 < v < math.inf for v in var.tolist()):
            return None
        scale = 1.0 / np.sqrt(var)
        both = scale[:, None] * scale
        y, H, R = innov * scale, H * scale[:, None], R * both
        cross = P.dot(H.T)
        S = H.dot(cross) + R
        try:
            inverse = np.linalg.inv(S)
        except np.linalg.LinAlgError:
            return None
        K = cross.dot(inverse)
        dx = K.dot(y)
        nis = float(y.dot(inverse).dot(y))
        if not (math.isfinite(nis) and nis >= 0.0 and math.isfinite(float(dx.dot(dx)))):
            return None
        kept = self._identity - K.dot(H)
        after = kept.dot(P).dot(kept.T) + K.dot(R).dot(K.T)
        return Correction(dx, 0.5 * (after + after.T), S / both, nis)
