"""A filter that turns the errors of a flight's residuals into white ones of unit variance.

The residuals of a view are six: the pad's orientation in `ned` by gyro and camera, and the reported attitude against the gyro.
Their errors are correlated in time: the gyro's angle walks, the reported attitude and the deck wander. What a Kalman filter of
these errors cannot predict is white, and the same filter applied to the derivatives by the parameters gives the least squares of
the whole flight.

Source: Bryson and Ho, Applied Optimal Control, 1975, section 13 (whitening by innovations).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64

STATES = 9
"""Errors of the gyro's angle, of the reported attitude and of the deck, each (3,) rad in `ned`."""
_START_RAD = 0.3
"""Standard deviation of the gyro's first attitude."""
_ATTITUDE_WHITE_RAD = 1e-4
_H = np.block([[-np.eye(3), np.zeros((3, 3)), np.eye(3)], [np.eye(3), np.eye(3), np.zeros((3, 3))]])


class Noise(NamedTuple):
    """The sizes of the errors."""

    gyro_rad_sqrt_s: float = 0.003
    """Random walk of the integrated gyro: its change within 1 s."""
    tilt_rad: float = math.radians(0.4)
    """Wandering error of the reported roll and pitch."""
    heading_rad: float = math.radians(2.0)
    deck_rad: float = math.radians(0.02)
    """Turning of the deck itself."""
    view: float = 1.0
    """Standard deviation of a view over what it claims."""
    tilt_s: float = 1.0
    """Time constants of the wandering."""
    heading_s: float = 5.0
    deck_s: float = 2.0


class Whitened(NamedTuple):
    """Residuals and derivatives after the filter, for each of B noises."""

    rows: F64
    """(B, N, 6, C): for every column of the input."""
    log_det: F64
    """(B,), sum of the logarithms of the innovations' determinants."""


def whiten(t: F64, columns: F64, cov_view: F64, used: NDArray[np.bool_], noises: Sequence[Noise]) -> Whitened:
    """Filter the columns of a flight, under several noises at once.

    Args:
        t: (N,) s, ascending.
        columns: (N, 6, C): residuals and their derivatives.
        cov_view: (N, 3, 3) rad^2, of the pad's orientation in `ned` as the camera claims it.
        used: (N,) whether the view counts; of others only the attitude is used.
    """
    n, _, c = columns.shape
    b = len(noises)
    wander = np.array([_wander(noise) for noise in noises])
    walk = np.array([noise.gyro_rad_sqrt_s for noise in noises]) ** 2
    view = np.array([noise.view for noise in noises])[:, None, None] ** 2
    rate = np.array([_rates(noise) for noise in noises])
    x = np.zeros((b, STATES, c))
    P = np.zeros((b, STATES, STATES))
    _diagonal(P)[:] = np.concatenate([np.full((b, 3), _START_RAD**2), wander**2], axis=1)
    R = np.zeros((b, 6, 6))
    R[:, 3:, 3:] = _ATTITUDE_WHITE_RAD**2 * np.eye(3)
    stationary = np.concatenate([np.zeros((b, 3)), wander**2], axis=1)
    walked = np.concatenate([np.repeat(walk[:, None], 3, axis=1), np.zeros((b, STATES - 3))], axis=1)
    rows, log_det, last = np.zeros((b, n, 6, c)), np.zeros(b), float(t[0])
    for i in range(n):
        dt, last = float(t[i]) - last, float(t[i])
        f = np.exp(-dt * rate)
        x *= f[:, :, None]
        P *= f[:, :, None] * f[:, None, :]
        _diagonal(P)[:] += stationary * (1.0 - f * f) + walked * dt
        R[:, :3, :3] = view * cov_view[i]
        part = slice(0 if used[i] else 3, 6)
        PH = P @ _H[part].T
        L = np.linalg.cholesky(_H[part] @ PH + R[:, part, part])
        both = np.linalg.solve(L, np.concatenate([columns[i, part] - _H[part] @ x, np.swapaxes(PH, 1, 2)], axis=2))
        white, K = both[:, :, :c], both[:, :, c:]
        Kt = np.swapaxes(K, 1, 2)
        x += Kt @ white
        P -= Kt @ K
        rows[:, i, part] = white
        log_det += 2.0 * np.log(_diagonal(L)).sum(axis=1)
    return Whitened(rows, log_det)


def _diagonal(matrices: F64) -> F64:
    """Return a view of the diagonals of (B, n, n) contiguous matrices, (B, n)."""
    diagonal: F64 = np.einsum("bii->bi", matrices)
    return diagonal


def _wander(noise: Noise) -> F64:
    return np.array([noise.tilt_rad, noise.tilt_rad, noise.heading_rad, *(noise.deck_rad,) * 3])


def _rates(noise: Noise) -> F64:
    """Return how fast the errors forget, (9,) 1/s."""
    return 1.0 / np.array([*(math.inf,) * 3, noise.tilt_s, noise.tilt_s, noise.heading_s, *(noise.deck_s,) * 3])
