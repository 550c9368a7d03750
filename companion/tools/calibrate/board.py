"""The calibration board: its printed shapes, and the detection of its corners in an image."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64

U8 = NDArray[np.uint8]

_DICTIONARY = cv2.aruco.DICT_5X5_250
_MARKER_BITS = 5
_LEAST_CORNERS = 8
"""Fewest corners of a ChArUco board for a view: fewer add too little information to risk a wrong one."""


@dataclass(frozen=True)
class Board:
    """A ChArUco board or a plain chessboard. Its corner (0, 0) is the top-left inner one; x right, y down.

    Raises:
        BadInput: the squares or sizes do not make a board.
    """

    kind: Literal["charuco", "chessboard"] = "charuco"
    columns: int = 7
    rows: int = 10
    square_m: float = 0.025
    marker_m: float = 0.018

    def __post_init__(self) -> None:
        if not (3 <= self.columns <= 40 and 3 <= self.rows <= 40):
            raise BadInput(f"a board of {self.columns}x{self.rows} squares is out of range (3..40 each way)")
        if not 0.001 <= self.square_m <= 1.0:
            raise BadInput(f"a square of {1e3 * self.square_m:g} mm is out of range (1..1000)")
        if self.kind == "charuco":
            if not 0.3 * self.square_m <= self.marker_m <= 0.9 * self.square_m:
                raise BadInput(f"markers must be 0.3 to 0.9 of a square, got {1e3 * self.marker_m:g} mm")
            if self.columns * self.rows // 2 > 250:
                raise BadInput(f"a board of {self.columns}x{self.rows} squares needs more than the 250 markers there are")

    @property
    def corners_m(self) -> F64:
        """The inner corners row by row, from the board's outer top-left corner, ((rows - 1) * (columns - 1), 3) m, z = 0."""
        x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        return np.asarray(np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) * self.square_m, dtype=float)

    @cached_property
    def _charuco(self) -> cv2.aruco.CharucoBoard:
        dictionary = cv2.aruco.getPredefinedDictionary(_DICTIONARY)
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, dictionary)

    @cached_property
    def _detectors(self) -> tuple[cv2.aruco.CharucoDetector, ...]:
        """Detectors of the board as it is drawn now, and as OpenCV drew it before 4.6 where that differs: an even number of rows.

        The inner corners lie at the same places in both; markers and black squares have changed places.
        """
        old = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, self._charuco.getDictionary())
        old.setLegacyPattern(True)
        boards = (self._charuco, old) if self.rows % 2 == 0 else (self._charuco,)
        return tuple(cv2.aruco.CharucoDetector(board) for board in boards)

    def black_m(self) -> list[F64]:
        """Return each black rectangle as (4, 2) m, clockwise from its top-left corner, from the board's outer top-left corner."""
        s = self.square_m
        black = [_rectangle(c * s, r * s, s) for r in range(self.rows) for c in range(self.columns) if (r + c) % 2 == 0]
        if self.kind == "chessboard":
            return black
        dictionary, cell = self._charuco.getDictionary(), self.marker_m / (_MARKER_BITS + 2)
        for number, outline in zip(np.ravel(self._charuco.getIds()), self._charuco.getObjPoints(), strict=True):
            x, y = (float(v) for v in outline[0][:2])
            bits = dictionary.generateImageMarker(int(number), _MARKER_BITS + 2)
            for row, line in enumerate(bits):
                # Each run of cells makes one rectangle, so that no hairline shows between cells.
                edges = np.flatnonzero(np.diff(np.concatenate([[0], (line == 0).astype(np.int8), [0]])))
                for begin, end in edges.reshape(-1, 2):
                    black.append(_rectangle(x + begin * cell, y + row * cell, (end - begin) * cell, cell))
        return black

    def find(self, grey: U8) -> tuple[NDArray[np.int64], F64] | None:
        """Find the corners in an image: their (n,) indices into `corners_m` and (n, 2) px; None if too few are found."""
        if self.kind == "chessboard":
            pattern = (self.columns - 1, self.rows - 1)
            ok, corners = cv2.findChessboardCornersSB(grey, pattern, flags=cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY)
            return (np.arange(len(corners)), self._refined(grey, corners.reshape(-1, 2))) if ok else None
        found = ((corners, ids) for corners, ids, _, _ in (detector.detectBoard(grey) for detector in self._detectors))
        enough = next(((c, i) for c, i in found if i is not None and len(i) >= _LEAST_CORNERS), None)
        if enough is None:
            return None
        corners, ids = enough
        numbers = ids.ravel().astype(np.int64)
        across, along = numbers % (self.columns - 1), numbers // (self.columns - 1)
        if len(set(across)) < 2 or len(set(along)) < 2:
            return None
        return numbers, corners.reshape(-1, 2).astype(float)

    def _refined(self, grey: U8, uv: NDArray[np.generic]) -> F64:
        """Refine corners by the gradients around them: the chessboard finder alone has a bias that affects the focal length.

        Source: Foerstner and Guelch, A fast operator for detection and precise location of distinct points, 1987.
        """
        grid = np.asarray(uv, dtype=float).reshape(self.rows - 1, self.columns - 1, 2)
        least_px = min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min()) for axis in (0, 1))
        half = int(np.clip(0.3 * least_px, 2, 11))
        criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3)
        out = cv2.cornerSubPix(grey, grid.reshape(-1, 1, 2).astype(np.float32), (half, half), (-1, -1), criteria)
        return np.array(out, dtype=float).reshape(-1, 2)


def _rectangle(x: float, y: float, width: float, height: float | None = None) -> F64:
    h = width if height is None else height
    return np.array([(x, y), (x + width, y), (x + width, y + h), (x, y + h)])
