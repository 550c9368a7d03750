"""Trace a picture of a pad into the regions of a pad file.

The picture has one paint a pixel. What is round about the centre becomes disc, rim or ring; all else becomes polygons, with holes
where what lies below shows, of as few corners as the registration measures.

svgelements reads the shapes, paths, groups, uses, transforms and style sheets of a drawing. Text, pictures and gradients are
refused with what to do.
"""

import io
import math
import re
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple
from xml.etree.ElementTree import ParseError, fromstring, tostring

import cv2
import msgspec
import numpy as np
import svgelements
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.errors import BadInput, refused
from estimator.contracts.geometry import F64
from estimator.vision.pad import SMALLEST_M, check_polygon, is_simple
from estimator.vision.pad_rules import SIDES_MOST, Rgb
from estimator.vision.regions import PaintedPolygon

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


_DAMAGED = (ParseError, ValueError, KeyError, TypeError, AttributeError, IndexError, ZeroDivisionError, OverflowError)
"""Errors that svgelements raises of text that is no drawing."""


def read_svg(text: str, where: str) -> SvgDrawing:
    """Return what a drawing paints.

    Raises:
        BadInput: it is no SVG, it is too large, or it holds what is not read.
    """
    if len(text) > _LARGEST_BYTES or "<!ENTITY" in text:
        raise BadInput(f"{where}: a drawing has at most {_LARGEST_BYTES} bytes and no entities: save it as plain SVG")
    with refused(f"{where}: no SVG drawing", *_DAMAGED):
        drawing = svgelements.SVG.parse(io.StringIO(_explicit(text)), reify=False, ppi=_PX_IN_INCH)
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


U8 = NDArray[np.uint8]
ACROSS_PX = 3000
"""Extent of what is drawn in a picture that is made of a drawing, px."""
_ROUND, _CONCENTRIC = 0.006, 0.01
"""Greatest scatter of a circle's radius, and distance of its centre from the pad's, over the radius."""
_THINNEST = 0.45
"""Least inner radius of a ring over its outer one: what is narrower within is a disc with a hole in it."""
_LEAST_AREA = 4e-4
"""Least area of a part over that of all that is painted: less is a speck."""
_CORNERS_MOST = 60
_CHANGE_MOST = 0.02
"""Greatest change of a part's area by leaving out corners, over the area."""
_PHOTO_PX = 700.0
"""Larger side of a rectified photograph, px."""
_SPECK_PX = 9
"""Width of what is not traced in a rectified photograph, px: it is less than a pixel from some metres away."""
_MARGIN = 0.4
"""Margin of the search around the rectangle of a photograph, in its larger side."""
_SHEET_MARGIN = -0.02
"""Margin of a sheet, all around: its curled edge and what lies beyond are not traced."""
_FIRST_OFF, _GROWS = 0.0012, 1.35
"""First deviation of a traced side over the pad's radius, and its growth until the sides are few enough."""


class Picture(Struct, frozen=True):
    """A pad as pixels: which paint each shows."""

    paint: U8
    """(H, W)."""
    paints: tuple[Rgb, ...]
    px_per_m: float
    ground: int
    """The paint around the pad."""
    thinnest_px: float = 3.0
    """Least width of what is traced."""


class _Part(NamedTuple):
    paint: int
    outline: F64
    """(N, 2) px."""
    holes: tuple[F64, ...]
    area: float
    """Area within the outline, px^2."""


class _Circle(NamedTuple):
    centre: F64
    radius: float


def drawn(drawing: SvgDrawing, size_m: float | None, where: str) -> Picture:
    """Return a drawing as a picture; `size_m` is the largest extent of what it paints.

    Raises:
        BadInput: neither the file nor the caller says the size.
    """
    lines = [line for one in drawing.painted for line in one.lines]
    left, top = (float(v) for v in np.maximum(np.min([line.min(axis=0) for line in lines], axis=0), 0.0))
    right, low = np.minimum(np.max([line.max(axis=0) for line in lines], axis=0), (drawing.width, drawing.height)).tolist()
    extent = max(right - left, low - top)
    if not extent > 0.0:
        raise BadInput(f"{where}: nothing is painted on the sheet")
    scale, margin = ACROSS_PX / extent, 20
    size = [math.ceil(v * scale) + 2 * margin for v in (low - top, right - left)]
    paints: list[Rgb] = [(255, 255, 255)]
    image = np.zeros(size, np.uint8)
    for one in drawing.painted:
        if one.rgb not in paints:
            paints.append(one.rgb)
        moved = [np.rint(16.0 * ((line - (left, top)) * scale + margin)).astype(np.int32) for line in one.lines]
        if one.width > 0.0:
            cv2.polylines(image, moved, one.closed, paints.index(one.rgb), max(1, round(one.width * scale)), cv2.LINE_8, 4)
        else:
            cv2.fillPoly(image, moved, paints.index(one.rgb), cv2.LINE_8, 4)
    ground = _border(image[margin : size[0] - margin, margin : size[1] - margin])
    image[:margin], image[-margin:], image[:, :margin], image[:, -margin:] = ground, ground, ground, ground
    if size_m is not None:
        rows, columns = np.nonzero(image != ground)
        return Picture(image, tuple(paints), float(max(np.ptp(rows), np.ptp(columns)) + 1) / size_m, ground)
    if drawing.px_mm is None:
        raise BadInput(f"{where}: the drawing has no size in mm or cm: give it with --size-mm, across all that it paints")
    return Picture(image, tuple(paints), 1000.0 * scale / drawing.px_mm, ground)


def fault_of(corners_px: F64) -> str | None:
    """Return what is wrong with four corners, (4, 2) px, that shall be a rectangle's; None if nothing is."""
    line, order = corners_px.astype(np.float32), "fore left, fore right, aft right, aft left"
    if not cv2.isContourConvex(line) or cv2.contourArea(line) < 400.0:
        return f"are not those of a rectangle: give {order}"
    if cv2.contourArea(line, oriented=True) < 0.0:
        return f"run against the clock, which would mirror the pad: give {order}"
    return None


def photographed(
    px: U8, corners_px: F64 | None, size_m: tuple[float, float], paints: int, where: str, *, sheet: bool = False
) -> Picture:
    """Return a photograph of a pad as a picture.

    Args:
        px: (H, W, 3) BGR.
        corners_px: (4, 2) the corners of a rectangle on the pad's plane: fore left, fore right, aft right, aft left; None for a
            photograph from straight above.
        size_m: the rectangle's width and length; without one the largest extent of what is painted.
        paints: how many paints there are, that of the ground among them.
        sheet: whether the rectangle is the sheet that the pad is printed on, and nothing beyond it is painted.

    Raises:
        BadInput: the corners are no rectangle that a camera sees.
    """
    if corners_px is not None:
        fault = fault_of(corners_px)
        if fault is not None:
            raise BadInput(f"{where}: --corners {fault}")
        scale = _PHOTO_PX / max(size_m)
        w, h = scale * size_m[0], scale * size_m[1]
        aside = (_SHEET_MARGIN if sheet else _MARGIN) * max(w, h)
        to = np.array([(0, 0), (w, 0), (w, h), (0, h)], np.float32) + np.float32(aside)
        H = cv2.getPerspectiveTransform(corners_px.astype(np.float32), to)
        size = round(w + 2 * aside), round(h + 2 * aside)
        px = np.asarray(cv2.warpPerspective(px, H, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.uint8)
    else:
        shrunk = _PHOTO_PX / max(px.shape[:2])
        px = np.asarray(cv2.resize(px, None, fx=shrunk, fy=shrunk, interpolation=cv2.INTER_AREA), np.uint8)
        scale = 0.0
    smooth = cv2.medianBlur(cv2.bilateralFilter(px, 9, 40.0, 5.0), 5)
    colours = smooth.reshape(-1, 3).astype(np.float32)
    cv2.setRNGSeed(47)
    some = colours[:: max(1, len(colours) // 40_000)]
    until = cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 0.2
    _, _, means = cv2.kmeans(some, paints, np.zeros((len(some), 1), np.int32), until, 6, cv2.KMEANS_PP_CENTERS)
    nearest = np.linalg.norm(colours[:, None] - means[None], axis=2).argmin(axis=1).astype(np.uint8).reshape(px.shape[:2])
    image = np.asarray(cv2.medianBlur(nearest, _SPECK_PX), np.uint8)
    rgb: list[Rgb] = [(round(r), round(g), round(b)) for b, g, r in means.tolist()]
    ground = _border(image)
    _clear_edges(image, ground)
    if scale == 0.0:
        rows, columns = np.nonzero(image != ground)
        scale = (max(np.ptp(rows), np.ptp(columns)) + 1) / max(size_m) if len(rows) else 1.0
    return Picture(image, tuple(rgb), scale, ground, _SPECK_PX)


def _clear_edges(image: U8, ground: int) -> None:
    """Paint what is cut by the picture's edge like the ground: it is no part of the pad."""
    h, w = image.shape
    for column, row in [(c, r) for c in range(w) for r in (0, h - 1)] + [(c, r) for r in range(h) for c in (0, w - 1)]:
        if image[row, column] != ground:
            cv2.floodFill(image, None, (column, row), ground)


def _border(image: U8) -> int:
    return int(np.bincount(np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])).argmax())


def traced(picture: Picture, name: str, where: str) -> dict[str, Any]:
    """Return a pad file's keys.

    Raises:
        BadInput: nothing is painted, or it is made of what a pad file cannot say.
    """
    parts = _parts(picture)
    if not parts:
        raise BadInput(f"{where}: nothing is painted: all of it has one colour")
    base = parts[0]
    circle = _circle(base.outline, 0.5)
    inside = [
        p for p in parts[1:] if cv2.pointPolygonTest(base.outline.astype(np.float32), tuple(p.outline[0].tolist()), False) >= 0
    ]
    if circle is not None and len(inside) == len(parts) - 1:
        centre = circle.centre
    else:
        circle = None
        low, high = (f(np.concatenate([p.outline for p in parts]), axis=0) for f in (np.min, np.max))
        centre = 0.5 * (low + high)
    m = 1.0 / picture.px_per_m
    radius_px = max(float(np.hypot(*(p.outline - centre).T).max()) for p in parts)
    regions, below, rest = list[dict[str, Any]](), picture.ground, parts
    if circle is not None:
        hole = next((c for line in base.holes if (c := _circle(line, -0.5)) and _within(c, circle)), None)
        rest = parts[1:]
        if hole is None:
            regions.append({"shape": "disc", "paint": base.paint, "radius_m": circle.radius * m})
            below = base.paint
        else:
            below = int(picture.paint[tuple(np.rint(centre + np.array([0.97 * hole.radius, 0.0])).astype(int)[::-1])])
            on_ground = below == picture.ground
            if not on_ground:
                regions.append({"shape": "disc", "paint": below, "radius_m": hole.radius * m})
            ring = {"shape": "ring", "paint": base.paint, "inner_m": hole.radius * m, "outer_m": circle.radius * m}
            regions.append(ring if on_ground else {**ring, "part": "rim"})
            rest = [p for p in rest if not (p.paint == below and _is_all_of(p, hole))]
            circle = hole if not on_ground else circle
        if not any(region["shape"] == "ring" and region.get("part") is None for region in regions):
            for i, part in enumerate(rest):
                outer = _circle(part.outline, 0.5)
                inner = next((c for line in part.holes if outer and (c := _circle(line, -0.5)) and _within(c, outer)), None)
                if outer and inner and part.paint != below and _within(outer, circle, 0.0):
                    regions.append(
                        {"shape": "ring", "paint": part.paint, "inner_m": inner.radius * m, "outer_m": outer.radius * m}
                    )
                    rest = [p for j, p in enumerate(rest) if j != i and not (p.paint == below and _is_all_of(p, inner))]
                    break
    regions += _lettering(rest, below, centre, m, radius_px, where)
    used = list(dict.fromkeys([region["paint"] for region in regions] + [picture.ground]))
    names = dict(zip(used, _names([picture.paints[i] for i in used]), strict=True))
    for region in regions:
        region |= {key: round(v, 5) for key, v in region.items() if isinstance(v, float)} | {"paint": names[region["paint"]]}
    return {
        "name": name, "ground": names[picture.ground], "paints": {names[i]: list(picture.paints[i]) for i in used},
        "regions": regions,
    }  # fmt: skip


def _names(colours: Sequence[Rgb]) -> list[str]:
    """Return a name for each colour."""
    out: list[str] = []
    for r, g, b in colours:
        high, low = max(r, g, b), min(r, g, b)
        if high - low < 40:
            name = "black" if high < 85 else "white" if low > 170 else "grey"
        else:
            hue = cv2.cvtColor(np.array([[[b, g, r]]], np.uint8), cv2.COLOR_BGR2HSV)[0, 0, 0]
            limits = {8: "red", 22: "orange", 35: "yellow", 85: "green", 130: "blue", 170: "violet", 181: "red"}
            name = next(n for limit, n in limits.items() if hue < limit)
        out.append(name if name not in out else f"{name}_{len(out)}")
    return out


def _parts(picture: Picture) -> list[_Part]:
    """Return what hangs together and is not ground, the largest outline first, and the ground that shows within it."""
    out: list[_Part] = []
    painted = int(np.count_nonzero(picture.paint != picture.ground))
    for paint in np.unique(picture.paint).tolist():
        contours, tree = cv2.findContours((picture.paint == paint).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        if paint == picture.ground or tree is None:
            continue
        least = max(4.0, _LEAST_AREA * painted)
        for i, contour in enumerate(contours):
            if tree[0][i][3] >= 0 or not _is_thick(contour, least, picture.thinnest_px):
                continue
            holes, child = [], int(tree[0][i][2])
            while child >= 0:
                if _is_thick(contours[child], least, picture.thinnest_px):
                    holes.append(contours[child].reshape(-1, 2).astype(float))
                child = int(tree[0][child][0])
            out.append(_Part(paint, contour.reshape(-1, 2).astype(float), tuple(holes), float(cv2.contourArea(contour))))
    return sorted(out, key=lambda part: -part.area)


def _is_thick(contour: NDArray[Any], least_px2: float, thinnest_px: float) -> bool:
    area = cv2.contourArea(contour)
    return area >= least_px2 and 2.0 * area >= thinnest_px * cv2.arcLength(contour, True)


def _circle(line: F64, beyond_px: float) -> _Circle | None:
    """Return the circle that a line of border pixels follows; None if it follows none."""
    if len(line) < 30:
        return None
    A = np.c_[2.0 * line, np.ones(len(line))]
    x, y, c = np.linalg.lstsq(A, np.sum(line**2, axis=1), rcond=None)[0].tolist()
    centre = np.array([x, y])
    radius = math.sqrt(max(0.0, c + x * x + y * y))
    away = np.hypot(*(line - centre).T)
    if radius < 8.0 or float(away.std()) > max(0.45, _ROUND * radius):
        return None
    # All of it has to be there: an arc has such a scatter, too.
    turns = np.histogram(np.arctan2(*(line - centre).T), bins=24, range=(-math.pi, math.pi))[0]
    return _Circle(centre, radius + beyond_px) if turns.min() > 0 else None


def _within(inner: _Circle, outer: _Circle, thinnest: float = _THINNEST) -> bool:
    """Return whether a circle lies about the same centre as a larger one, and is not far smaller."""
    near = float(np.hypot(*(inner.centre - outer.centre))) < max(2.0, _CONCENTRIC * outer.radius)
    return near and thinnest * outer.radius < inner.radius < outer.radius


def _is_all_of(part: _Part, circle: _Circle) -> bool:
    return abs(part.area / (math.pi * circle.radius**2) - 1.0) < 0.05


def _lettering(
    parts: Sequence[_Part], below: int, centre: F64, m: float, radius_px: float, where: str
) -> Iterator[dict[str, Any]]:
    """Yield the parts beside disc and rings as polygons: those of the paint with the largest area, then those of a second."""
    parts = [p for p in parts if p.paint != below]
    layers = sorted({p.paint for p in parts}, key=lambda paint: -sum(p.area for p in parts if p.paint == paint))
    if len(layers) > 2:
        raise BadInput(f"{where}: {len(layers)} paints lie on the ground or the disc, and at most two are measured: use fewer")
    for layer in layers:
        own = [p for p in parts if p.paint == layer]
        others = [p for p in parts if p.paint != layer]
        off = _FIRST_OFF * radius_px
        while True:
            made = [(_corners(p.outline, off), [_corners(h, off) for h in p.holes if not _is_filled(h, others)]) for p in own]
            sides = sum(len(line) + sum(map(len, holes)) for line, holes in made)
            longest = max(max([len(line), *map(len, holes)]) for line, holes in made)
            if sides <= SIDES_MOST and longest <= _CORNERS_MOST:
                break
            off *= _GROWS
            if off > 0.2 * radius_px:
                raise BadInput(f"{where}: the lettering has too many parts ({len(own)}): draw fewer or simpler ones")
        for line, holes in made:
            outline_m, *holes_m = (_on_pad(of, centre, m) for of in (line, *holes))
            fore, right = 1000.0 * np.mean(outline_m, axis=0)
            cure = f"draw the part {fore:.0f} mm fore and {right:.0f} mm right of the centre without what is finer than 1 mm"
            check_polygon(PaintedPolygon("", outline_m, tuple(holes_m)), f"{where}: {cure}: its region")
            region: dict[str, Any] = {"shape": "polygon", "paint": layer, "points_m": outline_m}
            yield region | ({"holes_m": holes_m} if holes else {})


def _is_filled(hole: F64, others: Sequence[_Part]) -> bool:
    """Return whether a hole is where another part lies on this one."""
    area = cv2.contourArea(hole.astype(np.float32))
    return any(
        abs(part.area / max(area, 1.0) - 1.0) < 0.1 and np.abs(part.outline.mean(0) - hole.mean(0)).max() < 3.0 for part in others
    )


def _corners(line: F64, off_px: float) -> F64:
    """Return the corners of an outline, (N, 2) px; a circle's are those of a polygon of its area."""
    circle = _circle(line, 0.0)
    if circle is not None:
        n = int(np.clip(math.pi / math.acos(max(0.5, 1.0 - min(0.5, off_px / circle.radius))), 6, 16))
        a = np.arange(n) * math.tau / n
        r = circle.radius * math.sqrt(math.tau / (n * math.sin(math.tau / n)))
        return np.asarray(circle.centre + r * np.stack([np.cos(a), np.sin(a)], axis=1))
    corners = np.asarray(cv2.approxPolyDP(line.astype(np.float32), off_px, True).reshape(-1, 2), float)
    # A side that nearly lies along an axis does so.
    for axis in (0, 1):
        for i in range(len(corners)):
            j = (i + 1) % len(corners)
            if abs(corners[i, axis] - corners[j, axis]) < 1.6 and abs(corners[i, 1 - axis] - corners[j, 1 - axis]) > 5.0:
                corners[i, axis] = corners[j, axis] = 0.5 * (corners[i, axis] + corners[j, axis])
    return corners


def _on_pad(line: F64, centre: F64, m: float) -> tuple[tuple[float, float], ...]:
    """Return px as places on the pad, up in the picture along the arrow, without corners that make the line touch itself."""
    drawn_at = at = np.round((centre - line)[:, ::-1] * (m, -m), 5) + 0.0
    while len(at) > 3 and not is_simple(at):
        side = np.roll(at, -1, axis=0) - at
        before = np.roll(side, 1, axis=0)
        changes = np.abs(before[:, 0] * side[:, 1] - before[:, 1] * side[:, 0])
        short = np.hypot(*side.T) < SMALLEST_M
        order = np.argsort(np.where(short | np.roll(short, 1) | ~short.any(), changes, np.inf)).tolist()
        at = np.delete(at, next((i for i in order if is_simple(np.delete(at, i, 0))), order[0]), 0)
    area, kept = (cv2.contourArea(of.astype(np.float32)) for of in (drawn_at, at))
    return tuple((x, y) for x, y in (at if abs(kept - area) <= _CHANGE_MOST * area else drawn_at).tolist())


def file_text(keys: dict[str, Any], comment: str) -> str:
    """Return a pad file's text."""
    lines = [
        f"# {comment}",
        f"name = {msgspec.json.encode(keys['name']).decode()}",
        f'ground = "{keys["ground"]}"',
        "",
        "[paints]",
    ]
    lines += [f"{name} = {rgb}" for name, rgb in keys["paints"].items()]
    for region in keys["regions"]:
        lines += ["", "[[regions]]", *(f"{key} = {msgspec.json.encode(value).decode()}" for key, value in region.items())]
    return "\n".join(lines) + "\n"
