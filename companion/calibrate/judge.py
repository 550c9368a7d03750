"""Whether a set of views pins the camera down, and what it lacks, in words that say what to do next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from companion.calibrate.solve import Solution
from companion.calibrate.views import View

VIEWS = 10
CELLS = (6, 4)
"""Columns and rows that the picture is divided into to see where corners were."""
COVERED = 0.8
"""Share of the cells that must hold a corner."""
REACH = 0.7
"""How far towards each corner of the picture, from its centre, the board's corners must have come."""
TILT_DEG = 15.0
TILTED = 2
"""Views tilted at least `TILT_DEG` about each of the picture's axes."""
RMS_PX = 1.0
SIGMA_F = 0.004
"""One standard deviation of fx and fy as a share of them: a range error of this share."""
SIGMA_C = 0.004
"""One standard deviation of the principal point as a share of the picture's width."""
NAMES = (("top left", "top right"), ("bottom left", "bottom right"))


def coverage(views: Sequence[View], size: tuple[int, int]) -> NDArray[np.int64]:
    """(rows, columns) of `CELLS`: how many corners lay in each cell of the picture."""
    w, h = size
    counts = np.zeros((CELLS[1], CELLS[0]), dtype=np.int64)
    for view in views:
        u = np.clip(((view.uv_px[:, 0] + 0.5) / w * CELLS[0]).astype(int), 0, CELLS[0] - 1)
        v = np.clip(((view.uv_px[:, 1] + 0.5) / h * CELLS[1]).astype(int), 0, CELLS[1] - 1)
        np.add.at(counts, (v, u), 1)
    return counts


def missing_before(views: Sequence[View], size: tuple[int, int]) -> list[str]:
    """What can be said without solving: number of views and where in the picture they are."""
    lacks = []
    if len(views) < VIEWS:
        lacks.append(f"{VIEWS - len(views)} more views ({len(views)} of {VIEWS})")
    counts = coverage(views, size)
    if np.mean(counts > 0) < COVERED:
        lacks.append(f"the board in more of the picture ({np.mean(counts > 0):.0%} of it, {COVERED:.0%} needed)")
    uv = np.concatenate([v.uv_px for v in views]) if views else np.zeros((0, 2))
    centre = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2])
    toward = (uv - centre) / centre
    for down, row in ((-1, NAMES[0]), (1, NAMES[1])):
        for right, name in ((-1, row[0]), (1, row[1])):
            reach = np.minimum(toward[:, 0] * right, toward[:, 1] * down)
            if not len(reach) or reach.max() < REACH:
                lacks.append(f"the board closer into the {name} corner")
    return lacks


def missing(solution: Solution, size: tuple[int, int]) -> list[str]:
    """Everything the set lacks; empty for a good one."""
    lacks = missing_before([f.view for f in solution.fits], size)
    tilts = np.array([f.tilt_deg for f in solution.fits])
    for axis, way in ((0, "top edge towards or away from the camera"), (1, "left edge towards or away from the camera")):
        n = int(np.sum(np.abs(tilts[:, axis]) >= TILT_DEG))
        if n < TILTED:
            lacks.append(f"{TILTED - n} more views tilted by {TILT_DEG:g} degrees or more, {way}")
    if solution.rms_px > RMS_PX:
        lacks.append(f"sharper pictures or a flatter board (error {solution.rms_px:.2f} px, at most {RMS_PX:g})")
    camera, sigma = solution.camera, solution.sigma
    focal = float(max(sigma[0] / camera.fx, sigma[1] / camera.fy))
    if focal > SIGMA_F:
        lacks.append(f"more tilt and nearer views (focal length known to {focal:.2%}, {SIGMA_F:.1%} needed)")
    centre = float(max(sigma[2], sigma[3]) / size[0])
    if centre > SIGMA_C:
        lacks.append(f"tilt in more directions (principal point known to {centre:.2%} of the width, {SIGMA_C:.1%} needed)")
    if len(solution.left_out) > len(solution.fits) / 2:
        lacks.append(
            f"views that agree: {len(solution.left_out)} of {len(solution.left_out) + len(solution.fits)} contradict the rest"
        )
    return lacks
