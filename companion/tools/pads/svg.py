"""Read what an SVG drawing paints: outlines with their colours, from the lowest to the topmost, in CSS pixels.

svgelements reads shapes, paths, groups, uses, transforms and style sheets. Text, pictures and gradients are refused with what to
do.
"""

import io
import re
from collections.abc import Iterator
from xml.etree.ElementTree import ParseError, fromstring, tostring

import numpy as np
import svgelements
from msgspec import Struct

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.vision.markings import Rgb

_LARGEST_BYTES = 2_000_000
_CURVE = 24
"""Straight pieces of a curve, or of a quarter of a circle."""
_PX_IN_INCH = 96.0
_SIZES = {"rect": ("x", "y", "width", "height"), "circle": ("cx", "cy", "r"), "ellipse": ("cx", "cy", "rx", "ry")}


class PaintedLines(Struct, frozen=True):
    """Closed lines that are filled with a colour, or lines that are drawn with it."""

    lines: tuple[F64, ...]
    """(N, 2) each, px, y down."""
    rgb: Rgb
    width: float = 0.0
    """Width of the lines, px; 0 if what lies within is filled, where an odd number of lines is around it."""
    closed: bool = True


class SvgDrawing(Struct, frozen=True):
    """A drawing's sheet and what is painted on it."""

    width: float
    height: float
    """The sheet from (0, 0), px."""
    px_mm: float | None
    """Millimetres in a px; None if the file does not say it."""
    painted: tuple[PaintedLines, ...]


def read_svg(text: str, where: str) -> SvgDrawing:
    """Return what a drawing paints.

    Raises:
        BadInput: it is no SVG, it is too large, or it holds what is not read.
    """
    if len(text) > _LARGEST_BYTES or "<!ENTITY" in text:
        raise BadInput(f"{where}: a drawing has at most {_LARGEST_BYTES} bytes and no entities: save it as plain SVG")
    try:
        drawing = svgelements.SVG.parse(io.StringIO(_explicit(text)), reify=False, ppi=_PX_IN_INCH)
    except (ParseError, ValueError, KeyError, TypeError, AttributeError, IndexError, ZeroDivisionError, OverflowError) as why:
        raise BadInput(f"{where}: no SVG drawing: {why}") from why
    if not isinstance(drawing, svgelements.SVG) or drawing.values.get("tag") != "svg":
        raise BadInput(f"{where}: no SVG drawing: its root is no <svg>")
    width, height = (float(v) if v is not None else 0.0 for v in (drawing.width, drawing.height))
    if not (0.0 < width < np.inf and 0.0 < height < np.inf):
        raise BadInput(f"{where}: the drawing has no size: give it a viewBox")
    painted = tuple(one for element in drawing.elements() for one in _painted(element, where))
    if not painted:
        raise BadInput(f"{where}: the drawing paints nothing")
    sized = re.search(r"(mm|cm|in|pt|pc|m)\s*$", f"{drawing.values.get('width', '')}")
    return SvgDrawing(width, height, 25.4 / _PX_IN_INCH if sized else None, painted)


def _explicit(text: str) -> str:
    """Return a drawing whose shapes say all their sizes: svgelements takes those left out from a group around, or as 1."""
    root = fromstring(text)
    for of, other, i in (("width", "height", 2), ("height", "width", 3)):
        said = re.fullmatch(r"\s*([\d.]+)\s*([a-z]*)\s*", root.get(of, ""))
        if said is not None and "viewBox" in root.attrib and root.get(other, "auto") == "auto":
            box = [float(v) for v in re.split(r"[\s,]+", root.attrib["viewBox"].strip())]
            root.set(other, f"{float(said[1]) * box[5 - i] / box[i]}{said[2]}")
    for element in root.iter():
        space, _, tag = str(element.tag).rpartition("}")
        if tag in ("mask", "marker"):
            element.tag = f"{space}{_}defs"
        if sizes := _SIZES.get(tag):
            own = {key: v for key, v in element.items() if v != "auto" and (key != "r" or tag == "circle")}
            round_as = {a: own[b] for a, b in (("rx", "ry"), ("ry", "rx")) if b in own}
            element.attrib = dict.fromkeys(sizes, "0") | round_as | own
    return tostring(root, encoding="unicode")


def _painted(element: svgelements.SVGElement, where: str) -> Iterator[PaintedLines]:
    if isinstance(element, svgelements.Text):
        raise BadInput(f"{where}: the drawing has text: convert it to paths in the drawing program")
    if isinstance(element, svgelements.Image):
        raise BadInput(f"{where}: the drawing has a picture: trace it, or import the picture itself")
    if not isinstance(element, svgelements.Shape) or element.values.get("visibility") == "hidden":
        return
    if str(element.values.get("opacity")) in ("0", "0.0"):
        return
    found = [_line(part) for part in svgelements.Path(element.segments(transformed=False)).as_subpaths()]
    m = element.transform
    M = np.array([(m.a, m.b), (m.c, m.d)])
    lines = tuple(line @ M + (m.e, m.f) for line, _ in found if len(line) > 1)
    fill, stroke = (_rgb(element, key, where) for key in ("fill", "stroke"))
    if lines and fill is not None and not isinstance(element, svgelements.SimpleLine):
        yield PaintedLines(lines, fill)
    width = float(element.stroke_width or 0.0) * float(np.sqrt(abs(np.linalg.det(M))))
    if lines and stroke is not None and width > 0.0:
        yield PaintedLines(lines, stroke, width, all(closed for _, closed in found))


def _line(part: svgelements.Subpath) -> tuple[F64, bool]:
    """Return a part of a path, (N, 2) in its own units, and whether it is closed."""
    points: list[F64] = []
    closed = False
    for segment in part:
        if isinstance(segment, svgelements.Close):
            closed = True
        elif isinstance(segment, svgelements.Move | svgelements.Line):
            points.append(np.array([segment.end]))
        else:
            quarters = 4 if isinstance(segment, svgelements.Arc) else 1
            points.append(np.asarray(segment.npoint(np.linspace(0.0, 1.0, quarters * _CURVE + 1)[1:])))
    return (np.concatenate(points) if points else np.zeros((0, 2))), closed


def _rgb(element: svgelements.Shape, key: str, where: str) -> Rgb | None:
    written = str(element.values.get(key) or "").strip()
    colour = getattr(element, key)
    if written.startswith("url"):
        raise BadInput(
            f"{where}: the drawing has the colour {written!r}, and plain colours alone are read: take no gradients or patterns"
        )
    return None if colour.value is None or colour.alpha == 0 else (colour.red, colour.green, colour.blue)
