"""Images that show the board, as many different ones as a calibration can use."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.calibrate.board import Board
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64

U8 = NDArray[np.uint8]

MOST = 60
"""Views kept; more only cost time."""
_NEW = 0.06
"""Share of the image's diagonal that the board must have moved, shrunk or turned to be a new view."""
_STILL = 0.004
"""Share of the diagonal that the board may have moved since the frame before, in a moving image: more is blur."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """One image of the board."""

    name: str
    ids: NDArray[np.int64]
    """(n,) into `Board.corners_m`."""
    uv_px: F64
    """(n, 2)."""


class Collection:
    """Views of one camera, gathered one image after the other.

    With `moving` (video, live camera) an image is taken only when the board stands still in it and shows something new.
    """

    def __init__(self, board: Board, moving: bool) -> None:
        self._board = board
        self._moving = moving
        self._before: BoardView | None = None
        self.size: tuple[int, int] | None = None
        """(width, height) px."""
        self.views: list[BoardView] = []
        self.looked = 0
        self.without: list[str] = []
        """Names of images in which the board was not found."""
        self.repeated = 0
        """Images that showed nothing new, or a moving board."""

    def add(self, name: str, px: U8) -> BoardView | None:
        """Look at one (H, W) or (H, W, 3) image; the view, when it was kept.

        Raises:
            BadInput: its size is not that of the others.
        """
        size = (px.shape[1], px.shape[0])
        if self.size is None:
            self.size = size
        if size != self.size:
            raise BadInput(f"{name}: {size[0]}x{size[1]} px, but the images before it have {self.size[0]}x{self.size[1]} px")
        self.looked += 1
        grey = np.asarray(cv2.cvtColor(px, cv2.COLOR_BGR2GRAY), np.uint8) if px.ndim == 3 else px
        found = self._board.find(grey)
        if found is None:
            self.without.append(name)
            self._before = None
            return None
        view = BoardView(name, *found)
        before, self._before = self._before, view
        diagonal_px = float(np.hypot(*size))
        if self._moving:
            moved = _moved(view, before) if before is not None else None
            new = all(d is None or d > _NEW * diagonal_px for d in (_moved(view, v) for v in self.views))
            if moved is None or moved > _STILL * diagonal_px or not new or len(self.views) >= MOST:
                self.repeated += 1
                return None
        self.views.append(view)
        return view


def _moved(a: BoardView, b: BoardView) -> float | None:
    """Largest way in px of a corner that both show, None when there are too few of them."""
    _, ia, ib = np.intersect1d(a.ids, b.ids, return_indices=True)
    if len(ia) < 4:
        return None
    return float(np.linalg.norm(a.uv_px[ia] - b.uv_px[ib], axis=1).max())
