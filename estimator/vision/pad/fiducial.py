"""A fiducial marker of OpenCV's aruco module as a painted region: its dark cells, drawn from the dictionary's bits."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.geometry import F64

if TYPE_CHECKING:
    import cv2

Cells = NDArray[np.bool_]
QUIET_CELLS = 1.0
"""Width of the light border that a detector needs around a fiducial, in cells."""


class PaintedFiducial(Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="fiducial"):
    """The dark cells of an ArUco or AprilTag marker. Its light cells are what it is painted on."""

    paint: str
    dictionary: str
    """A name of OpenCV's aruco module: `DICT_4X4_50`, `DICT_APRILTAG_36h11`, ..."""
    id: int
    size_m: float
    """Side of the dark square, without the light border around it."""
    at_m: tuple[float, float] = (0.0, 0.0)
    """Place of its middle."""
    turn_deg: float = 0.0
    """Turn clockwise seen from above, 0, 90, 180 or 270: at 0 the marker's upper side is towards +x."""

    @property
    def cell_m(self) -> float:
        """Side of a cell."""
        return self.size_m / len(self.cells())

    def cells(self) -> Cells:
        """Return which of its (n, n) cells are painted: rows from +x to -x, columns from port to starboard."""
        return turned(marker_cells(self.dictionary, self.id), round(self.turn_deg / 90.0))

    def square(self, margin_m: float = 0.0) -> F64:
        """Return the limits x0, x1, y0, y1 of the dark square, m, moved out by a margin."""
        (x, y), half = self.at_m, 0.5 * self.size_m + margin_m
        return np.array([x - half, x + half, y - half, y + half])

    def corners(self) -> F64:
        """Return (4, 2) m: the dark square's corners, clockwise seen from above, from the fore port one."""
        x0, x1, y0, y1 = self.square().tolist()
        return np.array([(x1, y0), (x1, y1), (x0, y1), (x0, y0)])

    def corners_read(self) -> F64:
        """Return (4, 2) m: the corners in the order in which the detector gives them, from the marker's own upper left one."""
        return np.roll(self.corners(), -round(self.turn_deg / 90.0), axis=0)

    def borders(self) -> tuple[F64, ...]:
        """Return the closed lines (N, 2) m around its dark cells, clockwise seen from above; around light ones reversed."""
        cells = self.cells()
        return self._placed(_outlines(cells[::-1].tobytes(), len(cells)))

    def outlines(self) -> tuple[F64, ...]:
        """Return closed lines (N, 2) m whose insides together are its dark cells; cuts to light cells go within the paint."""
        cells = self.cells()
        return self._placed(_joined(cells[::-1].tobytes(), len(cells)))

    def _placed(self, lines: tuple[F64, ...]) -> tuple[F64, ...]:
        """Return lines on the lattice of cells, which is read from -x on, as places on the pad."""
        corner = np.array(self.at_m) - 0.5 * self.size_m
        # Rounded, sides that lie in one line have the same number.
        return tuple((corner + self.cell_m * line).round(9) for line in lines)

    def covers(self, xy_m: F64) -> Cells:
        """Return whether points (N, 2) m lie on its paint."""
        cells, (x, y), half = self.cells(), self.at_m, 0.5 * self.size_m
        n = len(cells)
        row = np.floor((x + half - xy_m[:, 0]) / self.cell_m).astype(np.intp)
        column = np.floor((xy_m[:, 1] - y + half) / self.cell_m).astype(np.intp)
        inside = (row >= 0) & (row < n) & (column >= 0) & (column < n)
        out = np.zeros(len(xy_m), bool)
        out[inside] = cells[row[inside], column[inside]]
        return out


@lru_cache(maxsize=1)
def dictionary_names() -> tuple[str, ...]:
    """Return the names of the dictionaries that OpenCV's aruco module has."""
    import cv2  # settings are checked without OpenCV unless their pad has fiducials

    return tuple(name for name in dir(cv2.aruco) if name.startswith("DICT_"))


def dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """Return a dictionary by one of `dictionary_names`."""
    import cv2

    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


@lru_cache(maxsize=64)
def marker_cells(dictionary: str, number: int) -> Cells:
    """Return which of the (n, n) cells of a marker are dark, its border of one cell included: rows from its upper side down."""
    of = dictionary_of(dictionary)
    side = of.markerSize + 2
    cells = np.asarray(of.generateImageMarker(number, side)) < 128
    cells.setflags(write=False)
    return cells


def turned(cells: Cells, quarters: int) -> Cells:
    """Return the cells turned clockwise by quarter turns."""
    return np.rot90(cells, -quarters)


def cells_apart(a: Cells, b: Cells, turns: tuple[int, ...] = (0, 1, 2, 3)) -> int:
    """Return the least number of cells in which two markers of one size differ at these quarter turns of the second."""
    return min(int(np.count_nonzero(a != turned(b, quarters))) for quarters in turns)


@lru_cache(maxsize=64)
def _outlines(cells: bytes, n: int) -> tuple[F64, ...]:
    """Return the outlines of the set cells of an (n, n) lattice in units of cells: closed lines, the set cells to their left."""
    grid = np.pad(np.frombuffer(cells, np.bool_).reshape(n, n), 1)
    ways: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for i, j in np.argwhere(grid).tolist():
        for outside, start, end in (
            ((i, j - 1), (i, j), (i + 1, j)),
            ((i + 1, j), (i + 1, j), (i + 1, j + 1)),
            ((i, j + 1), (i + 1, j + 1), (i, j + 1)),
            ((i - 1, j), (i, j + 1), (i, j)),
        ):
            if not grid[outside]:
                ways.setdefault(start, []).append(end)
    lines = []
    while ways:
        lines.append(_straightened(_followed(ways)))
    return tuple(lines)


@lru_cache(maxsize=64)
def _joined(cells: bytes, n: int) -> tuple[F64, ...]:
    """Return the outlines with each line around unset cells joined to the next line before it by a cut through set cells."""
    lines = list(_outlines(cells, n))
    while True:
        hole = next((k for k, line in enumerate(lines) if signed_area(line) < 0.0), None)
        if hole is None:
            return tuple(lines)
        inner = lines.pop(hole)
        # The side farthest towards -y, and the place at which the cut begins: half a cell from its end.
        ends = np.roll(inner, -1, axis=0)
        side = int(np.argmin(np.where(inner[:, 1] == ends[:, 1], inner[:, 1], np.inf)))
        at = inner[side] + 0.5 * np.sign(ends[side] - inner[side])
        k, i, hit = _next_before(lines, at)
        around = np.vstack([at, np.roll(inner, -side - 1, axis=0), at])
        lines[k] = np.vstack([lines[k][: i + 1], hit, around, hit, lines[k][i + 1 :]])


def _next_before(lines: list[F64], at: F64) -> tuple[int, int, F64]:
    """Return the line, its side and the place there that a way from a place towards -y meets first."""
    met: list[tuple[float, int, int]] = []
    for k, line in enumerate(lines):
        a, b = line, np.roll(line, -1, axis=0)
        crossed = (np.minimum(a[:, 0], b[:, 0]) < at[0]) & (np.maximum(a[:, 0], b[:, 0]) > at[0]) & (a[:, 1] < at[1])
        met += [(float(a[i, 1]), k, int(i)) for i in np.flatnonzero(crossed & (a[:, 1] == b[:, 1]))]
    y, k, i = max(met)
    return k, i, np.array([at[0], y])


def signed_area(line: F64) -> float:
    """Return the signed area inside a closed line (N, 2): positive if it has its inside to the left as y points up.

    In the pad's frame, whose z points into the deck, that is clockwise seen from above.
    """
    x, y = line.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _followed(ways: dict[tuple[int, int], list[tuple[int, int]]]) -> list[tuple[int, int]]:
    """Take one closed line out of the sides of cells. Where two cells meet at a corner alone, it stays with the one it is at."""
    first = next(iter(ways))
    line, at, before = [first], ways[first][0], first
    _take(ways, first, at)
    while at != first:
        line.append(at)
        ahead = (at[0] - before[0], at[1] - before[1])
        left = (at[0] - ahead[1], at[1] + ahead[0])
        after = left if left in ways[at] else ways[at][0]
        _take(ways, at, after)
        before, at = at, after
    return line


def _take(ways: dict[tuple[int, int], list[tuple[int, int]]], start: tuple[int, int], end: tuple[int, int]) -> None:
    ways[start].remove(end)
    if not ways[start]:
        del ways[start]


def _straightened(line: list[tuple[int, int]]) -> F64:
    """Return the corners of a closed line on the lattice of the padded grid."""
    points = np.array(line, dtype=float)
    came, goes = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    return np.asarray(points[np.any(came != goes, axis=1)] - 1.0)
