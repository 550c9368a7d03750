"""Collect images of the board that differ enough to be useful to a calibration."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.tools.calibrate.board import Board
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64

U8 = NDArray[np.uint8]

MOST = 60
"""Largest number of views kept; more only cost time."""
_NEW = 0.06
"""Share of the image's diagonal that the board must have moved, shrunk or turned to be a new view."""
_STILL = 0.004
"""Share of the diagonal that the board may have moved since the previous frame of a video: more causes blur."""
_MIRROR_TRIES = 8
"""Number of images without the board that are searched for a mirrored one."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """One image of the board."""

    name: str
    ids: NDArray[np.int64]
    """Indices into `Board.corners_m`, (n,)."""
    uv_px: F64
    """Corners in the image, (n, 2) px."""


class Collection:
    """Views of one camera, collected image by image.

    With `moving` (video, live camera) an image is used only if the board is still in it and in a new pose.
    """

    def __init__(self, board: Board, moving: bool) -> None:
        self._board = board
        self._moving = moving
        self._before: BoardView | None = None
        self.size: tuple[int, int] | None = None
        """Size of the images, (width, height) px; None before the first."""
        self.views: list[BoardView] = []
        self.image_count = 0
        self.without: list[str] = []
        """Names of images in which the board was not found."""
        self.mirrored = 0
        """Number of the first images without the board that show it mirrored."""
        self.repeated = 0
        """Number of images that showed nothing new, or a moving board."""

    def add(self, name: str, px: U8) -> BoardView | None:
        """Search one (H, W) or (H, W, 3) image for the board; return the view if it is kept.

        Raises:
            BadInput: its size differs from that of the others.
        """
        size = (px.shape[1], px.shape[0])
        if self.size is None:
            self.size = size
        if size != self.size:
            raise BadInput(f"{name}: {size[0]}x{size[1]} px, but the images before it have {self.size[0]}x{self.size[1]} px")
        self.image_count += 1
        grey = np.asarray(cv2.cvtColor(px, cv2.COLOR_BGR2GRAY), np.uint8) if px.ndim == 3 else px
        found = self._board.find(grey)
        if found is None:
            self.without.append(name)
            if len(self.without) <= _MIRROR_TRIES and self._board.find(np.ascontiguousarray(grey[:, ::-1])) is not None:
                self.mirrored += 1
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
    """Return the largest displacement of a corner that both views show, px; None if they share too few."""
    _, ia, ib = np.intersect1d(a.ids, b.ids, return_indices=True)
    if len(ia) < 4:
        return None
    return float(np.linalg.norm(a.uv_px[ia] - b.uv_px[ib], axis=1).max())
