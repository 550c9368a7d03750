"""Draw a pad or a board in millimetres, and divide it over sheets that overlap, with marks for cutting; write SVG and PDF."""

import math
import zlib
from math import cos, pi, sin
from typing import Literal
from xml.sax.saxutils import escape

import numpy as np
from msgspec import Struct

from companion.tools.calibrate.board import Board
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.vision.pad.geometry import outlines_of
from estimator.vision.pad.lamps import places_of
from estimator.vision.pad.pad import Pad
from estimator.vision.pad.shapes import PaintedDisc

Rgb = tuple[int, int, int]
BLACK: Rgb = (0, 0, 0)
_DARK: Rgb = (40, 40, 40)
_SURROUND = 1.25  # half of the side of what is printed around a pad, in its radii
_PAPER = 225  # least channel of a paint that paper has
_MARK_MM = 1.5
"""Radius of the mark at a lamp's middle."""
_RING_POINTS = 720
"""Corners of a printed circle of a ring: at a radius of a metre they stand out by a hundredth of a millimetre."""
RULER_MM = 100.0
"""Length of the ruler that shows whether a print has its size."""
_PT = 72.0 / 25.4  # points of a millimetre
_EIGHTH = 4.0 / 3.0 * math.tan(math.pi / 16.0)
"""Length of a Bezier handle for an eighth of a circle of radius 1; the curve leaves the circle by 4e-6 of the radius."""


class Polygon(Struct, frozen=True, eq=False):
    """A filled polygon, (N, 2) mm."""

    points_mm: F64
    fill: Rgb


class Disc(Struct, frozen=True):
    """A filled disc."""

    x_mm: float
    y_mm: float
    radius_mm: float
    fill: Rgb


Shape = Polygon | Disc


class Drawing(Struct, frozen=True):
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


Paper = Literal["a4", "a3", "full"]
PAPERS: dict[str, tuple[float, float]] = {"a4": (210.0, 297.0), "a3": (297.0, 420.0)}
"""Width and height in mm (ISO 216), upright."""


class MarkLine(Struct, frozen=True):
    """A thin line, in mm from the sheet's top-left corner."""

    x0: float
    y0: float
    x1: float
    y1: float


class Label(Struct, frozen=True):
    """A line of text; x and y are its left end on the base line, mm."""

    x: float
    y: float
    text: str
    height_mm: float = 2.6


class Sheet(Struct, frozen=True):
    """One page: the window of the drawing it shows, and its marks."""

    row: int
    column: int
    width_mm: float
    height_mm: float
    left_mm: float
    """Left edge of the printed window on the paper, mm."""
    top_mm: float
    from_x_mm: float
    """Left edge of the window in the drawing, mm."""
    from_y_mm: float
    window_width_mm: float
    window_height_mm: float
    lines: tuple[MarkLine, ...]
    labels: tuple[Label, ...]


def sheets(drawing: Drawing, paper: Paper, margin_mm: float = 10.0, overlap_mm: float = 10.0) -> list[Sheet]:
    """Return the pages row by row, in portrait or landscape, whichever takes fewer. Empty pages are omitted.

    Raises:
        BadInput: the margins or the overlap leave no room.
    """
    if not (6.0 <= margin_mm <= 50.0 and 0.0 <= overlap_mm <= 50.0):
        raise BadInput(f"margin must lie in 6..50 mm and overlap in 0..50 mm, got {margin_mm:g} and {overlap_mm:g}")
    if paper == "full":
        size = (max(drawing.width_mm, RULER_MM + 20.0) + 2 * margin_mm, drawing.height_mm + 2 * margin_mm)
        return _spread(drawing, size, margin_mm, overlap_mm)
    w, h = PAPERS[paper]
    upright = _spread(drawing, (w, h), margin_mm, overlap_mm)
    lying = _spread(drawing, (h, w), margin_mm, overlap_mm)
    return lying if len(lying) < len(upright) else upright


def _spread(drawing: Drawing, size: tuple[float, float], margin: float, overlap: float) -> list[Sheet]:
    wide, high = size[0] - 2 * margin, size[1] - 2 * margin
    columns, rows = _count(drawing.width_mm, wide, overlap), _count(drawing.height_mm, high, overlap)
    # The drawing is centred on all sheets, so that the outer ones hold equal parts.
    x0 = -(columns * (wide - overlap) + overlap - drawing.width_mm) / 2
    y0 = -(rows * (high - overlap) + overlap - drawing.height_mm) / 2
    cells = []
    for row in range(rows):
        for column in range(columns):
            x, y = x0 + column * (wide - overlap), y0 + row * (high - overlap)
            if any(touches(s, x, y, x + wide, y + high) for s in drawing.shapes):
                cells.append((row, column, x, y))
    there = {(row, column) for row, column, _, _ in cells}
    out = []
    for number, (row, column, x, y) in enumerate(cells, 1):
        neighbours = {
            "left": (row, column - 1) in there, "right": (row, column + 1) in there,
            "top": (row - 1, column) in there, "bottom": (row + 1, column) in there,
        }  # fmt: skip
        lines = _marks(size, margin, overlap, neighbours)
        text = f"{drawing.name}   sheet {number} of {len(cells)}: row {row + 1}, column {column + 1}"
        labels = [Label(margin, margin - 3.4, text)]
        ruler, caption = _ruler(size, margin)
        out.append(Sheet(row, column, *size, margin, margin, x, y, wide, high, (*lines, *ruler), (*labels, caption)))
    return out


def _count(length: float, sheet: float, overlap: float) -> int:
    return max(1, math.ceil((length - overlap) / (sheet - overlap) - 1e-9))


def _marks(size: tuple[float, float], margin: float, overlap: float, neighbours: dict[str, bool]) -> list[MarkLine]:
    """Return marks in the margins at the middle of each overlap with a neighbour: cut there and butt the sheets."""
    w, h = size
    out = []
    for side, x in (("left", margin + overlap / 2), ("right", w - margin - overlap / 2)):
        if neighbours[side]:
            out += [MarkLine(x, margin - 2.5, x, margin), MarkLine(x, h - margin, x, h - margin + 2.5)]
    for side, y in (("top", margin + overlap / 2), ("bottom", h - margin - overlap / 2)):
        if neighbours[side]:
            out += [MarkLine(margin - 2.5, y, margin, y), MarkLine(w - margin, y, w - margin + 2.5, y)]
    return out


def _ruler(size: tuple[float, float], margin: float) -> tuple[list[MarkLine], Label]:
    x, y = margin + 12.0, size[1] - margin + 3.5
    ticks = [MarkLine(x + t, y - (1.2 if t % 50 else 2.0), x + t, y) for t in range(0, int(RULER_MM) + 1, 10)]
    text = "100 mm: print at 100 %, not fitted to the page"
    return [MarkLine(x, y, x + RULER_MM, y), *ticks], Label(x, y + 2.6, text, 2.2)


def svg(drawing: Drawing, sheet: Sheet) -> str:
    """Return the sheet with width and height in mm, so that it prints true to scale."""
    x, y, w, h = sheet.from_x_mm, sheet.from_y_mm, sheet.window_width_mm, sheet.window_height_mm
    wide, high = _n(sheet.width_mm), _n(sheet.height_mm)
    window = f'x="{_n(sheet.left_mm)}" y="{_n(sheet.top_mm)}" width="{_n(w)}" height="{_n(h)}"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{wide}mm" height="{high}mm" viewBox="0 0 {wide} {high}">',
        f"<title>{escape(drawing.name)}</title>",
        f'<clipPath id="window"><rect {window}/></clipPath>',
        f'<g clip-path="url(#window)"><g transform="translate({_n(sheet.left_mm - x)} {_n(sheet.top_mm - y)})">',
        *(_shape(s) for s in drawing.shapes if touches(s, x, y, x + w, y + h)),
        "</g></g>",
        '<g stroke="black" stroke-width="0.15">',
        *(f'<line x1="{_n(m.x0)}" y1="{_n(m.y0)}" x2="{_n(m.x1)}" y2="{_n(m.y1)}"/>' for m in sheet.lines),
        "</g>",
        *(
            f'<text x="{_n(t.x)}" y="{_n(t.y)}" font-family="Helvetica, Arial, sans-serif" font-size="{_n(t.height_mm)}">'
            f"{escape(t.text)}</text>"
            for t in sheet.labels
        ),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _shape(shape: Shape) -> str:
    if isinstance(shape, Polygon):
        points = " ".join(f"{_n(x)},{_n(y)}" for x, y in shape.points_mm.tolist())
        return f'<polygon points="{points}" fill="{_colour(shape.fill)}"/>'
    return f'<circle cx="{_n(shape.x_mm)}" cy="{_n(shape.y_mm)}" r="{_n(shape.radius_mm)}" fill="{_colour(shape.fill)}"/>'


def _colour(rgb: Rgb) -> str:
    return "#" + "".join(f"{c:02x}" for c in rgb)


def _n(value: float) -> str:
    return f"{value:.5f}".rstrip("0").rstrip(".")


def pdf(drawing: Drawing, sheets: list[Sheet]) -> bytes:
    """Return the PDF, with one page for each sheet."""
    objects: list[bytes] = [b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>", b""]
    objects.append(b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>")
    kids = []
    for sheet in sheets:
        content = zlib.compress(_pdf_page(drawing, sheet).encode("cp1252", errors="replace"))
        objects.append(b"<< /Length %d /Filter /FlateDecode >>\nstream\n" % len(content) + content + b"\nendstream")
        box = f"[0 0 {_n(sheet.width_mm * _PT)} {_n(sheet.height_mm * _PT)}]"
        page = (
            f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents {len(objects)} 0 R /Resources << /Font << /F 3 0 R >> >> >>"
        )
        objects.append(page.encode())
        kids.append(f"{len(objects)} 0 R")
    objects[1] = f"<< /Type /Pages /Kids [{' '.join(kids)}] /Count {len(kids)} >>".encode()
    out = bytearray(b"%PDF-1.7\n%\xe2\xe3\xcf\xd3\n")
    places = []
    for number, body in enumerate(objects, 1):
        places.append(len(out))
        out += b"%d 0 obj\n" % number + body + b"\nendobj\n"
    table = len(out)
    out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1) + b"".join(b"%010d 00000 n \n" % p for p in places)
    out += b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, table)
    return bytes(out)


def _pdf_page(drawing: Drawing, sheet: Sheet) -> str:
    """Return the page's content, in mm from the top-left corner."""
    x, y, w, h = sheet.from_x_mm, sheet.from_y_mm, sheet.window_width_mm, sheet.window_height_mm
    lines = ["q", f"{_n(_PT)} 0 0 {_n(-_PT)} 0 {_n(sheet.height_mm * _PT)} cm", "q"]
    lines += [f"{_n(sheet.left_mm)} {_n(sheet.top_mm)} {_n(w)} {_n(h)} re W n"]
    lines += [f"1 0 0 1 {_n(sheet.left_mm - x)} {_n(sheet.top_mm - y)} cm"]
    lines += [_pdf_shape(s) for s in drawing.shapes if touches(s, x, y, x + w, y + h)]
    lines += ["Q", "0 G 0.15 w"]
    lines += [f"{_n(m.x0)} {_n(m.y0)} m {_n(m.x1)} {_n(m.y1)} l S" for m in sheet.lines]
    for label in sheet.labels:
        text = label.text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
        lines.append(f"BT 0 g /F {_n(label.height_mm)} Tf 1 0 0 -1 {_n(label.x)} {_n(label.y)} Tm ({text}) Tj ET")
    lines.append("Q")
    return "\n".join(lines)


def _pdf_shape(shape: Shape) -> str:
    if isinstance(shape, Polygon):
        (x0, y0), *rest = shape.points_mm.tolist()
        path = f"{_n(x0)} {_n(y0)} m " + " ".join(f"{_n(x)} {_n(y)} l" for x, y in rest) + " h f"
        return f"{_pdf_colour(shape.fill)} rg {path}"
    return f"{_pdf_colour(shape.fill)} rg {_circle(shape)}"


def _circle(disc: Disc) -> str:
    r, k, step = disc.radius_mm, _EIGHTH, pi / 4
    parts = [f"{_n(disc.x_mm + r)} {_n(disc.y_mm)} m"]
    for i in range(8):
        a, b = i * step, (i + 1) * step
        points = [
            (cos(a) - k * sin(a), sin(a) + k * cos(a)), (cos(b) + k * sin(b), sin(b) - k * cos(b)), (cos(b), sin(b)),
        ]  # fmt: skip
        parts.append(" ".join(f"{_n(disc.x_mm + r * px)} {_n(disc.y_mm + r * py)}" for px, py in points) + " c")
    return " ".join(parts) + " h f"


def _pdf_colour(rgb: Rgb) -> str:
    return " ".join(_n(c / 255) for c in rgb)
