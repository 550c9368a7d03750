"""Draw detections from the error model: whether the pad is found, and with which error in the camera's axes."""

from __future__ import annotations

import math
from bisect import bisect_right
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64
from sitl.perception.parameters import DetectionCell, DetectionModel, Factor
from sitl.perception.view import View

_SCALES = 6


class Chance(NamedTuple):
    """The random numbers of one exposure. Every exposure takes the same number of them, whatever becomes of the frame."""

    normal: F64
    """(7,) standard normal: the error, then its scale."""
    uniform: F64
    """(4,) 0..1: found, outlier, ambiguous, turned."""


class DrawnDetection(NamedTuple):
    """A detection that the model draws."""

    error: F64
    """(6,) m and rad in the camera's axes: of the position, then a small rotation of the pad."""
    cov: F64
    """(6, 6) claimed covariance of the same."""
    confidence: float
    ambiguous: bool
    turned: bool
    """Whether the heading is half a turn off."""


class _PreparedCell(NamedTuple):
    """A cell with its matrices prepared."""

    kept: float
    regained: float
    confidence: float
    ambiguous: float
    turned: float
    outliers: float
    outlier_ratio: float
    bias: F64
    root: F64
    claimed: F64
    spread: float


class DetectionTable:
    """The error model of detections, ready for use: the same view and random numbers give the same detection."""

    def __init__(self, model: DetectionModel) -> None:
        self.model = model
        cells = {(c.height, c.shown): _row(c) for c in model.cell}
        rows, columns = len(model.heights_m) + 1, len(model.shown) + 1
        self._rows = [[_nearest(cells, i, j) for j in range(columns)] for i in range(rows)]
        self._heights, self._shown = list(model.heights_m), list(model.shown)
        self._tilts = [math.radians(edge) for edge in model.tilt_deg.edges]

    def probability(self, view: View, light_stops: float, found_before: bool) -> float:
        """Return the probability that the pad is found."""
        if view.height_m <= 0.0 or view.shown <= 0.0:
            return 0.0
        row = self._row(view)
        p = row.kept if found_before else row.regained
        odds = self._odds(view, light_stops) * p / max(1e-9, 1.0 - p)
        return odds / (1.0 + odds)

    def draw(self, view: View, light_stops: float, standard: F64, chance: Chance) -> DrawnDetection:
        """Return the detection of a view in which the pad is found.

        Args:
            standard: (7,) standard normal numbers with the correlation in time: of the error, then of its scale.
        """
        row = self._row(view)
        own = math.exp(row.spread * float(standard[6]))
        k = own * self._ratio(view, light_stops)
        z = max(0.05, view.height_m)
        scale = np.array([z, z, z, 1.0, 1.0, 1.0])
        size = k * (row.outlier_ratio if chance.uniform[1] < row.outliers else 1.0)
        error = scale * (own * row.bias + size * row.root.dot(standard[:6]))
        cov = (k * k) * row.claimed * np.multiply.outer(scale, scale)
        ambiguous = bool(chance.uniform[2] < row.ambiguous)
        # A heading that is half a turn off is nearly always one that says so.
        return DrawnDetection(error, cov, row.confidence, ambiguous, bool(chance.uniform[3] < row.turned))

    def _row(self, view: View) -> _PreparedCell:
        return self._rows[bisect_right(self._heights, view.height_m)][bisect_right(self._shown, view.shown)]

    def _odds(self, view: View, light_stops: float) -> float:
        m = self.model
        return m.tilt_deg.odds[bisect_right(self._tilts, view.tilt_rad)] * _of(m.light_stops, light_stops, m.light_stops.odds)

    def _ratio(self, view: View, light_stops: float) -> float:
        m = self.model
        return m.tilt_deg.ratio[bisect_right(self._tilts, view.tilt_rad)] * _of(m.light_stops, light_stops, m.light_stops.ratio)


@lru_cache(maxsize=8)
def detection_table(model: DetectionModel) -> DetectionTable:
    """Return the table of a model; the flights of one process share it."""
    return DetectionTable(model)


def symmetric(lower: tuple[float, ...], n: int) -> F64:
    """Return the (n, n) symmetric matrix of a lower triangle, row by row."""
    out = np.zeros((n, n))
    out[np.tril_indices(n)] = lower
    return out + np.tril(out, -1).T


def root_of(cov: F64) -> F64:
    """Return L with L L' = `cov`, also of a matrix whose smallest eigenvalues rounding has made negative."""
    values, vectors = np.linalg.eigh(cov)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _of(factor: Factor, value: float, entries: tuple[float, ...]) -> float:
    return entries[bisect_right(factor.edges, value)]


def _row(cell: DetectionCell) -> _PreparedCell:
    claimed = symmetric(cell.claimed, _SCALES)
    # Five digits in a file may take a thin covariance below zero.
    claimed = claimed + np.diag(np.diag(claimed)) * 1e-4 + 1e-18 * np.eye(_SCALES)
    return _PreparedCell(
        cell.kept, cell.regained, cell.confidence, cell.ambiguous, cell.turned, cell.outliers, cell.outlier_ratio,
        np.array(cell.bias), root_of(symmetric(cell.error, _SCALES)), claimed, cell.spread,
    )  # fmt: skip


def _nearest(cells: dict[tuple[int, int], _PreparedCell], i: int, j: int) -> _PreparedCell:
    """Return the row of a cell, or of the nearest one that was fitted. A bin of the fraction counts more than one of height."""
    return cells[min(cells, key=lambda c: (abs(c[0] - i) + 3 * abs(c[1] - j), c))]
