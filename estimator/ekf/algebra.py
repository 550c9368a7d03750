"""The filter's algebra, by filterpy: `P = F P F' + Q`, gain, innovation covariance, Joseph form.

filterpy keeps its quantities in an object. Each call works on a shallow copy of an empty one, so calls from two threads do not
meet; the arrays in it are replaced and never written into.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from estimator.contracts.geometry import F64


class Correction(NamedTuple):
    """What an update would do; nothing has been changed yet."""

    dx: F64
    """(N,) to add to the state."""
    P: F64
    """(N, N) afterwards."""
    S: F64
    """(m, m) of the innovation."""
    nis: float


def nis_of(innov: F64, S: F64) -> float | None:
    """innov' inv(S) innov of (m,) and (m, m), by Cholesky's elimination in plain numbers; None where S is not positive.

    For the one to three numbers of a sensor's sample this takes a third of the time of a call to LAPACK.
    """
    rest, rows = innov.tolist(), S.tolist()
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
        # Importing filterpy costs most of a second, because it brings scipy.stats and matplotlib with it.
        from filterpy.kalman import ExtendedKalmanFilter

        self._kf: Any = ExtendedKalmanFilter(dim_x=n, dim_z=1)
        self._empty = vars(self._kf)
        self._zero = np.zeros(n)
        self._zero.setflags(write=False)

    def _fresh(self) -> Any:
        # What copy.copy does, without asking the object how it wants to be copied: a tenth of the time.
        kf = object.__new__(type(self._kf))
        vars(kf).update(self._empty)
        return kf

    def predict(self, P: F64, F: F64, Q: F64) -> F64:
        """(n, n): F P F' + Q, symmetric."""
        kf = self._fresh()
        kf.x, kf.P, kf.F, kf.Q = self._zero, P, F, Q
        kf.predict()
        moved: F64 = kf.P
        return np.asarray(0.5 * (moved + moved.T))

    def correct(self, P: F64, innov: F64, H: F64, R: F64) -> Correction | None:
        """Innovation (m,), its (m, n) Jacobian and (m, m) noise to a correction; None where S cannot be inverted."""
        kf = self._fresh()
        kf.x, kf.P = self._zero, P
        m = kf.dim_z = innov.size
        # Metres beside radians and certain beside unknown: rows scaled to unit innovation variance keep S well conditioned.
        var = np.einsum("ij,ij->i", H.dot(P), H) + R.diagonal()
        if not all(0.0 < v < math.inf for v in var.tolist()):
            return None
        scale = 1.0 / np.sqrt(var)
        both = scale[:, None] * scale
        zero = np.zeros(m)
        try:
            kf.update(innov * scale, lambda _: H * scale[:, None], lambda _: zero, R * both)
        except np.linalg.LinAlgError:
            return None
        nis = float(kf.y.dot(kf.SI).dot(kf.y))
        dx: F64 = kf.x
        after: F64 = kf.P
        if not (math.isfinite(nis) and nis >= 0.0 and math.isfinite(float(dx.dot(dx)))):
            return None
        return Correction(dx, 0.5 * (after + after.T), kf.S / both, nis)
