"""Detections drawn from the error model, and the true view of the camera that their draw depends on.

A draw decides whether the pad is found, and with which error in the camera's axes.
"""

import math
from bisect import bisect_right
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from sitl.perception.parameters import DetectionCell, DetectionModel, Factor

_POINTS = 61
"""Number of places on the disc that are tested for being in the image: the fraction is known to 2 %."""
_GOLDEN_RAD = math.pi * (3.0 - math.sqrt(5.0))


class View(NamedTuple):
    """The pad as the camera sees it, and what makes that hard or easy."""

    R_cam_pad: F64
    """(3, 3)."""
    t_cam_pad: F64
    """(3,) m, the pad's centre."""
    height_m: float
    """Distance of the lens from the pad's plane; negative on the far side of it."""
    shown: float
    """Fraction of the disc's area that lies within the image, 0..1."""
    tilt_rad: float
    """Angle between the optical axis and the pad's normal."""


class Viewer:
    """Makes views through one camera of one pad."""

    def __init__(self, camera: Camera, pad: Pad) -> None:
        self._camera = camera
        # Vogel's spiral covers a disc evenly.
        n = np.arange(_POINTS) + 0.5
        radius, angle = pad.disc_radius_m * np.sqrt(n / _POINTS), n * _GOLDEN_RAD
        self._disc = np.stack([radius * np.cos(angle), radius * np.sin(angle)])
        self._radius_m = pad.disc_radius_m
        self._R_cam_body = np.ascontiguousarray(camera.T_body_cam.R.matrix.T)
        self._p_cam_body = self._R_cam_body.dot(camera.T_body_cam.t)
        self._size = np.array([[camera.width - 0.5], [camera.height - 0.5]])

    def view(self, R_ned_body: F64, d_body_pad_ned: F64, R_ned_pad: F64) -> View:
        """Return the view of a camera on a body.

        Args:
            R_ned_body: (3, 3).
            d_body_pad_ned: (3,) m from the body's origin to the pad's centre.
            R_ned_pad: (3, 3).
        """
        R_cam_ned = self._R_cam_body.dot(R_ned_body.T)
        R = R_cam_ned.dot(R_ned_pad)
        t = R_cam_ned.dot(d_body_pad_ned) - self._p_cam_body
        normal = R[:, 2]
        return View(R, t, float(normal.dot(t)), self._shown(R, t), math.acos(max(-1.0, min(1.0, float(normal[2])))))

    def _shown(self, R: F64, t: F64) -> float:
        if self._wholly(*t.tolist()):
            return 1.0
        p = R[:, :2].dot(self._disc) + t[:, None]
        ahead = p[2] > 1e-3
        if not ahead.any():
            return 0.0
        camera = self._camera
        if camera.distorted:
            uv = camera.project(p.T).T
        else:
            z = np.where(ahead, p[2], 1.0)
            uv = np.array([camera.fx * p[0] / z + camera.cx, camera.fy * p[1] / z + camera.cy])
        inside = ((uv > -0.5) & (uv < self._size)).all(axis=0) & ahead
        return float(np.count_nonzero(inside)) / _POINTS

    def _wholly(self, x: float, y: float, z: float) -> bool:
        """Return whether a ball around the pad's centre, which holds the whole disc, lies within the image of a plain lens."""
        camera, r = self._camera, self._radius_m
        nearest = z - r
        if camera.distorted or nearest < 1e-2:
            return False
        return (
            camera.fx * (x - r) / nearest + camera.cx > -0.5
            and camera.fx * (x + r) / nearest + camera.cx < camera.width - 0.5
            and camera.fy * (y - r) / nearest + camera.cy > -0.5
            and camera.fy * (y + r) / nearest + camera.cy < camera.height - 0.5
        )


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
    """True if the heading is half a turn off."""


class _PreparedCell(NamedTuple):
    """A cell with its matrices prepared."""

    cell: DetectionCell
    bias: F64
    root: F64
    claimed: F64


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
        row = self._row(view).cell
        p = row.kept if found_before else row.regained
        odds = self._odds(view, light_stops) * p / max(1e-9, 1.0 - p)
        return odds / (1.0 + odds)

    def draw(self, view: View, light_stops: float, standard: F64, chance: Chance) -> DrawnDetection:
        """Return the detection of a view in which the pad is found.

        Args:
            standard: (7,) standard normal numbers with the correlation in time: of the error, then of its scale.
        """
        row, bias, root, claimed = self._row(view)
        own = math.exp(row.spread * float(standard[6]))
        k = own * self._ratio(view, light_stops)
        z = max(0.05, view.height_m)
        scale = np.array([z, z, z, 1.0, 1.0, 1.0])
        size = k * (row.outlier_ratio if chance.uniform[1] < row.outliers else 1.0)
        error = scale * (own * bias + size * root.dot(standard[:6]))
        cov = (k * k) * claimed * np.multiply.outer(scale, scale)
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
    return _PreparedCell(cell, np.array(cell.bias), root_of(symmetric(cell.error, _SCALES)), claimed)


def _nearest(cells: dict[tuple[int, int], _PreparedCell], i: int, j: int) -> _PreparedCell:
    """Return the row of a cell, or of the nearest one that was fitted. A bin of the fraction counts more than one of height."""
    return cells[min(cells, key=lambda c: (abs(c[0] - i) + 3 * abs(c[1] - j), c))]
