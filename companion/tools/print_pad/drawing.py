"""The printed shapes in millimetres: x right, y down from the drawing's top-left corner, painted in order."""

from dataclasses import dataclass

import numpy as np

from companion.tools.calibrate.board import Board
from estimator.contracts.geometry import F64
from estimator.vision.lamp import places_of
from estimator.vision.pad import Pad
from estimator.vision.regions import PaintedDisc, outlines_of

Rgb = tuple[int, int, int]
BLACK: Rgb = (0, 0, 0)
_DARK: Rgb = (40, 40, 40)
_SURROUND, _PAPER = 1.25, 225
"""Half of the side of what is printed around a pad, in its radii, and the least channel of a paint that paper has."""
_MARK_MM = 1.5
"""Radius of the mark at a lamp's middle."""
_RING_POINTS = 720
"""Corners of a printed circle of a ring: at a radius of a metre they stand out by a hundredth of a millimetre."""


@dataclass(frozen=True, slots=True, eq=False)
class Polygon:
    """A filled polygon, (N, 2) mm."""

    points_mm: F64
    fill: Rgb


@dataclass(frozen=True, slots=True)
class Disc:
    """A filled disc."""

    x_mm: float
    y_mm: float
    radius_mm: float
    fill: Rgb


Shape = Polygon | Disc


@dataclass(frozen=True, slots=True)
class Drawing:
    """A drawing to print at 1:1."""

    name: str
    width_mm: float
    height_mm: float
    shapes: tuple[Shape, ...]


def pad_drawing(pad: Pad) -> Drawing:
    """Return the pad with its arrow up, seen from above, and a mark where each lamp is mounted."""
    panel = pad.markings.panel
    lamps = np.abs(places_of(pad.lamps)).max(axis=0, initial=0.0) * 1000 + _MARK_MM
    around = _around(pad)
    reach_mm = 1000 * pad.disc_radius_m * (_SURROUND if around is not None else 1.0)
    high = max(reach_mm if panel is None else 500 * panel.length_m, float(lamps[0]))
    wide = max(reach_mm if panel is None else 500 * panel.width_m, float(lamps[1]))

    def paper(p_pad: F64) -> F64:
        """Convert (N, 2) m in `pad` to (N, 2) mm: starboard is right, the arrow is up."""
        return np.stack([wide + 1000 * p_pad[:, 1], high - 1000 * p_pad[:, 0]], axis=1)

    shapes: list[Shape] = []
    if around is not None:
        sheet = np.array([(0.0, 0.0), (2 * wide, 0.0), (2 * wide, 2 * high), (0.0, 2 * high)])
        shapes.append(Polygon(sheet, around))
    for region in pad.regions:
        if isinstance(region, PaintedDisc):
            shapes.append(Disc(wide, high, 1000 * region.radius_m, pad.rgb(region)))
        else:
            shapes += [Polygon(paper(line), pad.rgb(region)) for line in outlines_of(region, _RING_POINTS)]
    shapes += [Disc(x, y, _MARK_MM, BLACK) for x, y in paper(places_of(pad.lamps)).tolist()]
    return Drawing(f"pad {pad.name}", 2 * wide, 2 * high, tuple(shapes))


def _around(pad: Pad) -> Rgb | None:
    """Return what is printed around a pad without a disc or a panel; None where the paper's white will do."""
    marks = pad.markings
    if marks.has_ground:
        return None
    if pad.ground:
        ground = dict(pad.paints)[pad.ground]
        return None if min(ground) > _PAPER else ground
    return _DARK if marks.is_bright else None


def board_drawing(board: Board) -> Drawing:
    """Return the calibration board; the paper's margin is its white rim."""
    shapes = tuple(Polygon(1000 * black, BLACK) for black in board.black_m())
    name = f"{board.kind} {board.columns}x{board.rows}, squares {1000 * board.square_m:g} mm"
    if board.kind != "chessboard":
        name += f", markers {1000 * board.marker_m:g} mm"
    width, height = (1000 * side_m for side_m in board.outline_m)
    return Drawing(name, width, height, shapes)


def touches(shape: Shape, left: float, top: float, right: float, bottom: float) -> bool:
    """Return whether a shape may paint anything inside a window (exact for discs, by bounding box for polygons)."""
    if isinstance(shape, Disc):
        x, y = min(max(shape.x_mm, left), right), min(max(shape.y_mm, top), bottom)
        return bool(np.hypot(x - shape.x_mm, y - shape.y_mm) < shape.radius_mm)
    low, high = shape.points_mm.min(axis=0), shape.points_mm.max(axis=0)
    return bool(low[0] < right and high[0] > left and low[1] < bottom and high[1] > top)
