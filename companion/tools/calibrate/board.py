"""The calibration board: its printed shapes, the detection of its corners, and the images that are useful to a calibration."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64

U8 = NDArray[np.uint8]
BoardKind = Literal["charuco", "chessboard", "aprilgrid"]
BOARDS: tuple[BoardKind, ...] = get_args(BoardKind)

_DICTIONARY = cv2.aruco.DICT_5X5_250
_MARKER_BITS = 5  # bits along a side of a ChArUco marker
_LEAST_CORNERS = 8
"""Fewest corners of a ChArUco board for a view: fewer add too little information to risk a wrong one."""
_TAGS = cv2.aruco.DICT_APRILTAG_36h11
_TAG_BITS = 6  # bits along a side of a tag
_TAG_BORDER = 2  # width of its border, in bits
_TAGS_MOST = 587  # tags of the family
_LEAST_TAGS = 4  # tags of a view at least
_TAG_CORNERS = np.array([(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)])
"""The corners of a tag as Kalibr counts them: from the lower left one, against the clock."""
MOST = 60
"""Largest number of views kept; more only cost time."""
_NEW = 0.06
"""Share of the image's diagonal that the board must have moved, shrunk or turned to be a new view."""
_STILL = 0.004
"""Share of the diagonal by which a board that is held still moves: from one frame of a video to the next, or in a burst."""
_TRIES = 8
"""Number of images without the board that are searched for a mirrored one, and for one with as many corners as squares given."""


@dataclass(frozen=True)
class Board:
    """A ChArUco board, a plain chessboard, or Kalibr's AprilGrid. Its corner (0, 0) is the top-left inner one; x right, y down.

    An AprilGrid has columns and rows of tags of the family 36h11 in borders two bits wide, numbered from the lower left one.
    `marker_m` is a tag's side, `square_m` the distance from one tag to the next. Kalibr's tagSpacing is the gap over the tag.

    Raises:
        BadInput: the squares or sizes do not make a board.
    """

    kind: BoardKind = "charuco"
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
        if self.kind == "aprilgrid":
            if not 0.5 * self.square_m <= self.marker_m <= 0.95 * self.square_m:
                raise BadInput(f"tags must be 0.5 to 0.95 of the distance between them, got {1e3 * self.marker_m:g} mm")
            if self.columns * self.rows > _TAGS_MOST:
                raise BadInput(f"a grid of {self.columns}x{self.rows} tags needs more than the {_TAGS_MOST} tags there are")

    @property
    def outline_m(self) -> tuple[float, float]:
        """Width and height of what is printed, m: an AprilGrid has a row of black corners more than of tags, each way."""
        more = self._gap_m if self.kind == "aprilgrid" else 0.0
        return self.columns * self.square_m + more, self.rows * self.square_m + more

    @property
    def _gap_m(self) -> float:
        return self.square_m - self.marker_m

    def _tags_m(self) -> F64:
        """Return the upper left corner of each tag, in the order of their numbers, (n, 2) m."""
        column, row = np.meshgrid(np.arange(self.columns), np.arange(self.rows)[::-1])
        return np.asarray(np.stack([column.ravel(), row.ravel()], axis=1) * self.square_m + self._gap_m, dtype=float)

    @property
    def corners_m(self) -> F64:
        """The inner corners row by row, from the board's outer top-left corner, ((rows - 1) * (columns - 1), 3) m, z = 0.

        An AprilGrid has the four corners of each tag, (4 * rows * columns, 3) m.
        """
        if self.kind == "aprilgrid":
            xy = (self._tags_m()[:, None, :] + _TAG_CORNERS * self.marker_m).reshape(-1, 2)
            return np.column_stack([xy, np.zeros(len(xy))])
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
        if self.kind == "aprilgrid":
            return self._black_of_grid()
        s = self.square_m
        black = [_rectangle(c * s, r * s, s) for r in range(self.rows) for c in range(self.columns) if (r + c) % 2 == 0]
        if self.kind == "chessboard":
            return black
        dictionary, cell = self._charuco.getDictionary(), self.marker_m / (_MARKER_BITS + 2)
        for number, outline in zip(np.ravel(self._charuco.getIds()), self._charuco.getObjPoints(), strict=True):
            x, y = (float(v) for v in outline[0][:2])
            black += _cells(dictionary.generateImageMarker(int(number), _MARKER_BITS + 2), x, y, cell)
        return black

    def _black_of_grid(self) -> list[F64]:
        dictionary, cells = cv2.aruco.getPredefinedDictionary(_TAGS), _TAG_BITS + 2 * _TAG_BORDER
        corners = [(c * self.square_m, r * self.square_m) for r in range(self.rows + 1) for c in range(self.columns + 1)]
        black = [_rectangle(x, y, self._gap_m) for x, y in corners]
        for number, (x, y) in enumerate(self._tags_m()):
            bits = dictionary.generateImageMarker(number, cells, borderBits=_TAG_BORDER)
            black += _cells(bits, float(x), float(y), self.marker_m / cells)
        return black

    def find(self, grey: U8) -> tuple[NDArray[np.int64], F64] | None:
        """Find the corners in an image: their (n,) indices into `corners_m` and (n, 2) px; None if too few are found."""
        if self.kind == "aprilgrid":
            return self._find_tags(grey)
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

    @cached_property
    def _tag_detector(self) -> cv2.aruco.ArucoDetector:
        how = cv2.aruco.DetectorParameters()
        how.markerBorderBits = _TAG_BORDER
        return cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(_TAGS), how)

    def _find_tags(self, grey: U8) -> tuple[NDArray[np.int64], F64] | None:
        outlines, ids, _ = self._tag_detector.detectMarkers(grey)
        seen = {} if ids is None else dict(zip(ids.ravel().tolist(), outlines, strict=True))
        numbers = np.array([number for number in seen if number < self.columns * self.rows], np.int64)
        if len(numbers) < _LEAST_TAGS:
            return None
        px = np.stack([seen[number].reshape(4, 2) for number in numbers]).astype(float)
        tags = self.corners_m.reshape(-1, 4, 3)[numbers, :, :2]
        # Where the grid lies says which corner of a tag is which, whatever a printer takes for a tag's upper side.
        H, _ = cv2.findHomography(tags.mean(axis=1), px.mean(axis=1))
        if H is None:
            return None
        expected = cv2.perspectiveTransform(tags.reshape(-1, 1, 2), H).reshape(-1, 4, 2)
        apart = np.linalg.norm(expected[:, :, None] - px[:, None], axis=3)
        nearest = apart.argmin(axis=2)
        sides = np.linalg.norm(px - np.roll(px, 1, axis=1), axis=2).min(axis=1)
        whole = (np.sort(nearest, axis=1) == np.arange(4)).all(axis=1) & (apart.min(axis=2).max(axis=1) < 0.4 * sides)
        if whole.sum() < _LEAST_TAGS:
            return None
        uv = np.take_along_axis(px, nearest[..., None], axis=1)[whole].reshape(-1, 2)
        half = int(np.clip(0.5 * self._gap_m / self.marker_m * sides[whole].min(), 2, 7))
        criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3)
        fine = cv2.cornerSubPix(grey, uv.reshape(-1, 1, 2).astype(np.float32), (half, half), (-1, -1), criteria)
        fine = np.asarray(fine, float).reshape(-1, 2)
        number = (4 * numbers[whole, None] + np.arange(4)).ravel()
        stayed = np.linalg.norm(fine - uv, axis=1) < half
        return (number[stayed], fine[stayed]) if stayed.sum() >= _LEAST_CORNERS else None

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


def _cells(bits: NDArray[np.generic], x: float, y: float, cell: float) -> list[F64]:
    """Return the black cells of a marker whose upper left corner is at (x, y) m, each run of cells in a row as one rectangle.

    So no hairline shows between cells.
    """
    black = []
    for row, line in enumerate(bits):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], (line == 0).astype(np.int8), [0]])))
        black += [_rectangle(x + a * cell, y + row * cell, (b - a) * cell, cell) for a, b in edges.reshape(-1, 2)]
    return black


def _rectangle(x: float, y: float, width: float, height: float | None = None) -> F64:
    h = width if height is None else height
    return np.array([(x, y), (x + width, y), (x + width, y + h), (x, y + h)])


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

    An image of a board that another view has in the same place is no second view: its errors are the other's, too. With `moving`
    (video, live camera) an image is used only if the board is still in it and in a clearly new pose.
    """

    def __init__(self, board: Board, moving: bool) -> None:
        self.given = self.board = board
        """The board that was named, and that of the images: many programs count a chessboard's inner corners, not its squares."""
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
        self.repeated: list[str] = []
        """Names of images that showed nothing new, or a moving board."""

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
        found, another_try = self.board.find(grey), len(self.without) < _TRIES
        if found is None and another_try and self.board.kind == "chessboard" and not self.views:
            more = replace(self.given, columns=self.given.columns + 1, rows=self.given.rows + 1)
            if (found := more.find(grey)) is not None:
                self.board = more
        if found is None:
            self.without.append(name)
            if another_try and self.board.find(np.ascontiguousarray(grey[:, ::-1])) is not None:
                self.mirrored += 1
            self._before = None
            return None
        view = BoardView(name, *found)
        before, self._before = self._before, view
        diagonal_px = float(np.hypot(*size))
        still = before is not None and _moved_px(view, before) <= _STILL * diagonal_px and len(self.views) < MOST
        least_px = (_NEW if self._moving else _STILL) * diagonal_px
        if (self._moving and not still) or any(_moved_px(view, v) <= least_px for v in self.views):
            self.repeated.append(name)
            return None
        self.views.append(view)
        return view


def _moved_px(a: BoardView, b: BoardView) -> float:
    """Return the largest displacement of a corner that both views show, px; inf if they share too few."""
    _, ia, ib = np.intersect1d(a.ids, b.ids, return_indices=True)
    return float(np.linalg.norm(a.uv_px[ia] - b.uv_px[ib], axis=1).max()) if len(ia) >= 4 else np.inf
