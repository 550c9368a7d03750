"""The covariance of an identified response, as its file holds it: checked, and of one mind with the standard deviations."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from estimator.contracts.geometry import F64

_AGREE = 0.02
"""A standard deviation may differ from the covariance's by so much of itself: files round."""
_SYMMETRIC = 1e-3
_LEAST_SIZE = 1e-6
"""Least eigenvalue of the correlation matrix."""
_CURE = "write it as `decklander calibrate vehicle --out` does, or leave it out"


def checked(key: str, rows: Sequence[Sequence[float]], given: dict[str, float | None], largest: Sequence[float]) -> list[float]:
    """Return the standard deviations of a covariance, in the order of its rows.

    Args:
        key: the covariance's key in its table.
        rows: the covariance, square.
        given: standard deviations by their keys, in the order of the rows; None where the file gives none.
        largest: largest standard deviation of each.

    Raises:
        ValueError: it is no covariance, or contradicts a given standard deviation.
    """
    cov = np.array(rows, dtype=float)
    _check_numbers(key, cov)
    for k, (variance, most) in enumerate(zip(np.diagonal(cov).tolist(), largest, strict=True)):
        if not 0.0 < variance <= most * most:
            raise ValueError(
                f"{key}: the variance in row {k + 1} must be above 0 and at most {most * most:g}, got {variance:g}; {_CURE}"
            )
    sigma = np.sqrt(np.diagonal(cov))
    _check_correlation(key, cov, cov / np.outer(sigma, sigma))
    for k, (name, value) in enumerate(given.items()):
        if value is not None and abs(value - sigma[k]) > _AGREE * sigma[k]:
            raise ValueError(
                f"{name} is {value:g}, but {key} says {sigma[k]:.4g}, the root of {cov[k, k]:g} in row {k + 1}; leave one out"
            )
    return [float(one) for one in sigma]


def _check_numbers(key: str, cov: F64) -> None:
    for (row, column), value in np.ndenumerate(cov):
        if not math.isfinite(value):
            raise ValueError(f"{key}: row {row + 1}, column {column + 1} must be a finite number, got {value:g}; {_CURE}")


def _check_correlation(key: str, cov: F64, correlation: F64) -> None:
    row, column = (int(i) for i in np.unravel_index(np.abs(correlation - correlation.T).argmax(), cov.shape))
    if abs(correlation[row, column] - correlation[column, row]) > _SYMMETRIC:
        raise ValueError(
            f"{key} must be symmetric: row {row + 1}, column {column + 1} is {cov[row, column]:g} and row {column + 1}, column "
            f"{row + 1} is {cov[column, row]:g}; {_CURE}"
        )
    if float(np.linalg.eigvalsh(0.5 * (correlation + correlation.T)).min()) < _LEAST_SIZE:
        raise ValueError(
            f"{key} must be positive definite: its correlations contradict each other or reach 1, so that a sum of its values "
            f"would have a variance of 0 or less; {_CURE}"
        )
