"""Guide a person who moves the board before a live camera: what is covered and missing, and how well the views agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.tools.calibrate.assess import CELLS, Grade, assess, coverage, missing_before
from companion.tools.calibrate.board import Board
from companion.tools.calibrate.solve import LEAST_VIEWS, Solution, solve
from companion.tools.calibrate.views import Collection
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import Transform

_GROWN = 1.1
"""A set of views is solved again when it has grown by this factor: solving costs more the more views there are."""


@dataclass(frozen=True, slots=True)
class GuideState:
    """How far a calibration is."""

    images: int
    views: int
    board_seen: bool
    """Whether the board was found in the newest image."""
    cells: tuple[tuple[int, ...], ...]
    """Corners of the board in each part of the image, rows of columns."""
    lacks: tuple[str, ...]
    """What is missing, the most severe first; empty if nothing is."""
    rms_px: float | None = None
    """Reprojection error of the newest solution; None before the first."""
    grade: Grade | None = None

    @property
    def complete(self) -> bool:
        """Whether nothing is missing."""
        return self.grade == "good"


class Guide:
    """Collects views of a live camera and solves for it as they come.

    Args:
        mount: `T_body_cam` of the camera; None means straight down with the nose at the top of the image.
    """

    def __init__(self, board: Board, mount: Transform | None = None) -> None:
        self._board = board
        self._mount = mount
        self._solved = 0
        self.collection = Collection(board, moving=True)
        self.solution: Solution | None = None
        """The newest solution; None before the first."""
        self.state = GuideState(0, 0, False, _cells(None), missing(self.collection))

    def add(self, name: str, px: NDArray[np.uint8]) -> GuideState:
        """Look for the board in one (H, W) or (H, W, 3) image and return how far the calibration is. It may take a second.

        Raises:
            BadInput: the image's size differs from that of the others.
        """
        found, without = self.collection, len(self.collection.without)
        found.add(name, px)
        views = len(found.views)
        if views >= LEAST_VIEWS and views > self._solved and views >= round(_GROWN * self._solved):
            self._solve()
        seen = len(found.without) == without
        lacks, rms_px, grade = missing(found), None, None
        if self.solution is not None and found.size is not None:
            judged = assess(self.solution, found.size)
            rms_px, grade = self.solution.rms_px, judged.grade
            lacks = tuple(judged.missing)
        self.state = GuideState(found.image_count, views, seen, _cells(found), lacks, rms_px, grade)
        return self.state

    def _solve(self) -> None:
        self._solved = len(self.collection.views)
        assert self.collection.size is not None
        try:
            self.solution = solve(self.collection.views, self._board, self.collection.size, self._mount)
        except BadInput:  # too few views agree yet
            self.solution = None


def missing(collection: Collection) -> tuple[str, ...]:
    """Return what is missing as far as it shows without solving."""
    return tuple(missing_before(collection.views, collection.size or (1, 1)))


def _cells(collection: Collection | None) -> tuple[tuple[int, ...], ...]:
    if collection is None or collection.size is None:
        return tuple((0,) * CELLS[0] for _ in range(CELLS[1]))
    return tuple(tuple(row) for row in coverage(collection.views, collection.size).tolist())
