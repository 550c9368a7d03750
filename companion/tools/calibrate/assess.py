"""Assess how well a set of views determines the camera, and say what to add."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from companion.tools.calibrate.board import BoardView
from companion.tools.calibrate.solve import Solution

VIEWS = 10
CELLS = (6, 4)
"""Columns and rows of cells that the image is divided into for measuring the coverage by corners."""
COVERED = 0.8
"""Share of the cells that must hold a corner."""
REACH = 0.7
"""Share of the way from the image's centre to each of its corners that the board's corners must reach."""
TILT_DEG = 15.0
TILTED = 2
"""Required number of views tilted at least `TILT_DEG`, about each of the image's axes."""
FLAT_DEG = 8.0
"""Tilt below which a view says nothing of the focal length: `TILTED` views must exceed it, or the set is flat."""
RMS_PX = 1.0
SIGMA_F = 0.004
"""Accepted standard deviation of fx and fy as a share of them; it causes a range error of the same share."""
SIGMA_C = 0.004
"""Accepted standard deviation of the principal point as a share of the image's width."""
NAMES = (("top left", "top right"), ("bottom left", "bottom right"))

Grade = Literal["good", "fair", "poor"]
GRADES: tuple[Grade, ...] = ("good", "fair", "poor")
"""The grades, from the best to the worst."""


class Assessment(Struct, frozen=True):
    """The deficiencies of a solution.

    It is `poor` if its numbers are too uncertain or contradict the views. It is `fair` if the numbers hold where the board
    was but are extrapolated elsewhere, at the edges of the image or in tilt. Otherwise it is `good`.
    """

    imprecise: tuple[str, ...]
    """Reasons why the numbers cannot be trusted."""
    uncovered: tuple[str, ...]
    """Uncovered regions, where the distortion is extrapolated."""

    @property
    def grade(self) -> Grade:
        """The worst grade that applies."""
        if self.imprecise:
            return "poor"
        return "fair" if self.uncovered else "good"

    @property
    def missing(self) -> list[str]:
        """Return everything that would improve the set, the most severe deficiency first."""
        return [*self.imprecise, *self.uncovered]


def coverage(views: Sequence[BoardView], size: tuple[int, int]) -> NDArray[np.int64]:
    """Return the number of corners in each cell of the image, (rows, columns) of `CELLS`."""
    w, h = size
    counts = np.zeros((CELLS[1], CELLS[0]), dtype=np.int64)
    for view in views:
        u = np.clip(((view.uv_px[:, 0] + 0.5) / w * CELLS[0]).astype(int), 0, CELLS[0] - 1)
        v = np.clip(((view.uv_px[:, 1] + 0.5) / h * CELLS[1]).astype(int), 0, CELLS[1] - 1)
        np.add.at(counts, (v, u), 1)
    return counts


def missing_before(views: Sequence[BoardView], size: tuple[int, int]) -> list[str]:
    """Return what is missing as far as it shows without solving: the number of views and their coverage of the image."""
    lacks = []
    if len(views) < VIEWS:
        lacks.append(f"{VIEWS - len(views)} more views ({len(views)} of {VIEWS})")
    counts = coverage(views, size)
    if np.mean(counts > 0) < COVERED:
        lacks.append(f"the board in more of the image ({np.mean(counts > 0):.0%} of it, {COVERED:.0%} needed)")
    uv = np.concatenate([v.uv_px for v in views]) if views else np.zeros((0, 2))
    centre = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2])
    toward = (uv - centre) / centre
    for down, row in ((-1, NAMES[0]), (1, NAMES[1])):
        for right, name in ((-1, row[0]), (1, row[1])):
            reach = np.minimum(toward[:, 0] * right, toward[:, 1] * down)
            if not len(reach) or reach.max() < REACH:
                lacks.append(f"the board closer into the {name} corner")
    return lacks


def assess(solution: Solution, size: tuple[int, int]) -> Assessment:
    """Grade a solution by its covariance, its residuals and where the board was."""
    uncovered = missing_before([f.view for f in solution.fits], size)
    tilts = np.array([f.tilt_deg for f in solution.fits])
    for axis, way in ((0, "top edge towards or away from the camera"), (1, "left edge towards or away from the camera")):
        n = int(np.sum(np.abs(tilts[:, axis]) >= TILT_DEG))
        if n < TILTED:
            uncovered.append(f"{TILTED - n} more views tilted by {TILT_DEG:g} degrees or more, {way}")
    imprecise = []
    if int(np.sum(np.hypot(*tilts.T) >= FLAT_DEG)) < TILTED:
        imprecise.append(
            f"views tilted by {FLAT_DEG:g} degrees or more: flat ones cannot tell the focal length from the distance"
        )
    if solution.rms_px > RMS_PX:
        imprecise.append(f"sharper images or a flatter board (error {solution.rms_px:.2f} px, at most {RMS_PX:g})")
    camera, sigma = solution.camera, solution.sigma
    focal = float(max(sigma[0] / camera.fx, sigma[1] / camera.fy))
    if focal > SIGMA_F:
        known = f"known to {focal:.2%}" if focal < 1.0 else "not known"
        imprecise.append(f"more tilt and nearer views (focal length {known}, {SIGMA_F:.1%} needed)")
    centre = float(max(sigma[2], sigma[3]) / size[0])
    if centre > SIGMA_C:
        known = f"known to {centre:.2%} of the width" if centre < 1.0 else "not known"
        imprecise.append(f"tilt in more directions (principal point {known}, {SIGMA_C:.1%} needed)")
    if len(solution.left_out) > len(solution.fits) / 2:
        imprecise.append(
            f"views that agree: {len(solution.left_out)} of {len(solution.left_out) + len(solution.fits)} contradict the rest"
        )
    return Assessment(tuple(imprecise), tuple(uncovered))
