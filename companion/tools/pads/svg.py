"""Read what an SVG drawing paints: outlines with their colours, from the lowest to the topmost, in its user units.

Shapes, paths, groups, transforms and colours of files that drawing programs write are read; text, pictures and gradients are not,
and are refused with what to do. Source of the forms: W3C, Scalable Vector Graphics (SVG) 1.1, chapters 7 to 11.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from xml.etree import ElementTree

import numpy as np

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.vision.markings import Rgb

_LARGEST_BYTES = 2_000_000
_CURVE = 24
"""Straight pieces of a curve, or of a quarter of a circle."""
_MM = {"mm": 1.0, "cm": 10.0, "in": 25.4, "pt": 25.4 / 72.0, "pc": 25.4 / 6.0, "m": 1000.0}
_NAMED: Mapping[str, Rgb] = {
    "black": (0, 0, 0), "white": (255, 255, 255), "red": (255, 0, 0), "green": (0, 128, 0), "blue": (0, 0, 255),
    "yellow": (255, 255, 0), "orange": (255, 165, 0), "gray": (128, 128, 128), "grey": (128, 128, 128), "navy": (0, 0, 128),
    "lime": (0, 255, 0), "cyan": (0, 255, 255), "magenta": (255, 0, 255), "silver": (192, 192, 192), "maroon": (128, 0, 0),
    "purple": (128, 0, 128), "teal": (0, 128, 128), "olive": (128, 128, 0), "brown": (165, 42, 42), "pink": (255, 192, 203),
    "darkgreen": (0, 100, 0), "gold": (255, 215, 0),
}  # fmt: skip
_INHERITED = ("fill", "stroke", "stroke-width", "display", "visibility")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_REFUSED = {
    "text": "text: convert it to paths in the drawing program", "image": "a picture: trace it, or import the picture itself",
}  # fmt: skip
_TAKES = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}


@dataclass(frozen=True, slots=True)
class PaintedLines:
    """Closed lines that are filled with a colour, or lines that are drawn with it."""

    lines: tuple[F64, ...]
    """(N, 2) each, user units, y down."""
    rgb: Rgb
    width: float = 0.0
    """Width of the lines, user units; 0 if what lies within is filled, where an odd number of lines is around it."""
    closed: bool = True


@dataclass(frozen=True, slots=True)
class SvgDrawing:
    """A drawing's sheet and what is painted on it."""

    left: float
    top: float
    width: float
    height: float
    """The sheet, user units."""
    unit_mm: float | None
    """Millimetres in a user unit; None if the file does not say it."""
    painted: tuple[PaintedLines, ...]


@dataclass(frozen=True, slots=True)
class _Reader:
    where: str
    classes: Mapping[str, Mapping[str, str]]
    painted: list[PaintedLines] = field(default_factory=list)


def read_svg(text: str, where: str) -> SvgDrawing:
    """Return what a drawing paints.

    Raises:
        BadInput: it is no SVG, it is too large, or it holds what is not read.
    """
    if len(text) > _LARGEST_BYTES or "<!ENTITY" in text:
        raise BadInput(f"{where}: a drawing has at most {_LARGEST_BYTES} bytes and no entities: save it as plain SVG")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as why:
        raise BadInput(f"{where}: no SVG drawing: {why}") from why
    if _tag(root) != "svg":
        raise BadInput(f"{where}: no SVG drawing: its root is <{_tag(root)}>")
    reader = _Reader(where, _classes(root))
    width, height = (_length(root.get(key, ""), None) for key in ("width", "height"))
    box = [float(v) for v in re.findall(_NUMBER, root.get("viewBox", ""))]
    if len(box) != 4:
        box = [0.0, 0.0, _plain(root.get("width", "")), _plain(root.get("height", ""))]
    if not (box[2] > 0.0 and box[3] > 0.0 and all(math.isfinite(v) for v in box)):
        raise BadInput(f"{where}: the drawing has no size: give it a viewBox")
    unit_mm = width / box[2] if width is not None else height / box[3] if height is not None else None
    _walk(root, np.eye(3), {"fill": "black", "stroke": "none", "stroke-width": "1"}, reader)
    if not reader.painted:
        raise BadInput(f"{where}: the drawing paints nothing")
    return SvgDrawing(box[0], box[1], box[2], box[3], unit_mm, tuple(reader.painted))


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def _plain(text: str) -> float:
    found = re.match(_NUMBER, text.strip())
    return float(found[0]) if found else 0.0


def _length(text: str, otherwise: float | None) -> float | None:
    """Return a length with its unit, mm; `otherwise` if it has none that is one."""
    found = re.fullmatch(rf"\s*({_NUMBER})\s*([a-z]+)\s*", text)
    return float(found[1]) * _MM[found[2]] if found and found[2] in _MM else otherwise


def _classes(root: ElementTree.Element) -> dict[str, dict[str, str]]:
    """Return the declarations of classes in style sheets."""
    out: dict[str, dict[str, str]] = {}
    for sheet in (e for e in root.iter() if _tag(e) == "style"):
        for names, body in re.findall(r"([^{}]+)\{([^}]*)\}", sheet.text or ""):
            for name in re.findall(r"\.([\w-]+)", names):
                out.setdefault(name, {}).update(_declared(body))
    return out


def _declared(body: str) -> dict[str, str]:
    pairs = (declaration.split(":", 1) for declaration in body.split(";") if ":" in declaration)
    return {key.strip(): value.replace("!important", "").strip() for key, value in pairs}


def _walk(element: ElementTree.Element, M: F64, style: Mapping[str, str], reader: _Reader) -> None:
    tag = _tag(element)
    if tag in _REFUSED:
        raise BadInput(f"{reader.where}: the drawing has {_REFUSED[tag]}")
    if tag in ("defs", "clipPath", "mask", "symbol", "marker", "pattern", "metadata", "namedview", "style", "title", "desc", ""):
        return
    own = {key: element.get(key, "") for key in (*_INHERITED, "opacity", "fill-opacity") if element.get(key)}
    for name in element.get("class", "").split():
        own |= reader.classes.get(name, {})
    own |= _declared(element.get("style", ""))
    of = {**style, **own}
    if of.get("display") == "none" or own.get("opacity") in ("0", "0.0"):
        return
    M = M @ _transform(element.get("transform", ""))
    if tag in ("svg", "g", "a", "switch"):
        for child in element:
            _walk(child, M, {key: of[key] for key in _INHERITED if key in of}, reader)
        return
    lines = list(_lines(tag, element))
    if not lines or of.get("visibility") == "hidden":
        return
    moved = tuple(np.c_[line, np.ones(len(line))] @ M[:2].T for line, _ in lines)
    closed = all(is_closed for _, is_closed in lines)
    fill, stroke = (_rgb(of.get(key, "none"), reader.where) for key in ("fill", "stroke"))
    if fill is not None and tag != "line" and of.get("fill-opacity") not in ("0", "0.0"):
        reader.painted.append(PaintedLines(moved, fill))
    width = (_length(of.get("stroke-width", "1"), None) or _plain(of.get("stroke-width", "1"))) * math.sqrt(abs(np.linalg.det(M[:2, :2])))
    if stroke is not None and width > 0.0:
        reader.painted.append(PaintedLines(moved, stroke, float(width), closed))


def _rgb(text: str, where: str) -> Rgb | None:
    text = text.strip().lower()
    if text in ("none", "transparent", ""):
        return None
    if text in _NAMED:
        return _NAMED[text]
    if found := re.fullmatch(r"#([0-9a-f]{6})", text):
        r, g, b = (int(found[1][i : i + 2], 16) for i in (0, 2, 4))
        return r, g, b
    if found := re.fullmatch(r"#([0-9a-f]{3})", text):
        r, g, b = (17 * int(digit, 16) for digit in found[1])
        return r, g, b
    if found := re.fullmatch(r"rgba?\(([^)]*)\)", text):
        values = re.findall(rf"({_NUMBER})(%?)", found[1])[:3]
        if len(values) == 3:
            r, g, b = (max(0, min(255, round(float(v) * (2.55 if percent else 1.0)))) for v, percent in values)
            return r, g, b
    raise BadInput(f"{where}: the drawing has the colour {text!r}, and plain colours alone are read: take no gradients or patterns")


def _transform(text: str) -> F64:
    M = np.eye(3)
    for name, body in re.findall(r"(\w+)\s*\(([^)]*)\)", text):
        v = [float(n) for n in re.findall(_NUMBER, body)]
        T = np.eye(3)
        match name, len(v):
            case "matrix", 6:
                T[:2] = np.array(v).reshape(3, 2).T
            case "translate", 1 | 2:
                T[:2, 2] = v[0], v[1] if len(v) > 1 else 0.0
            case "scale", 1 | 2:
                T[0, 0], T[1, 1] = v[0], v[-1]
            case "rotate", 1 | 3:
                c, s = math.cos(math.radians(v[0])), math.sin(math.radians(v[0]))
                T[:2, :2] = [[c, -s], [s, c]]
                at = np.array(v[1:] or [0.0, 0.0])
                T[:2, 2] = at - T[:2, :2] @ at
            case "skewX", 1:
                T[0, 1] = math.tan(math.radians(v[0]))
            case "skewY", 1:
                T[1, 0] = math.tan(math.radians(v[0]))
            case _:
                pass
        M = M @ T
    return M


def _lines(tag: str, element: ElementTree.Element) -> Iterator[tuple[F64, bool]]:
    """Yield the lines of a shape, (N, 2) each, and whether they are closed."""

    def of(*keys: str) -> list[float]:
        return [_plain(element.get(key, "0")) for key in keys]

    match tag:
        case "rect":
            x, y, w, h = of("x", "y", "width", "height")
            if w > 0.0 and h > 0.0:
                rx, ry = (_plain(element.get(a, element.get(b, "0"))) for a, b in (("rx", "ry"), ("ry", "rx")))
                yield _rounded(x, y, w, h, min(rx, 0.5 * w), min(ry, 0.5 * h)), True
        case "circle" | "ellipse":
            cx, cy, r, rx, ry = of("cx", "cy", "r", "rx", "ry")
            a = np.linspace(0.0, math.tau, 8 * _CURVE, endpoint=False)
            rx, ry = (r, r) if tag == "circle" else (rx or ry, ry or rx)
            if rx > 0.0 and ry > 0.0:
                yield np.stack([cx + rx * np.cos(a), cy + ry * np.sin(a)], axis=1), True
        case "line":
            yield np.array(of("x1", "y1", "x2", "y2")).reshape(2, 2), False
        case "polygon" | "polyline":
            v = [float(n) for n in re.findall(_NUMBER, element.get("points", ""))]
            if len(v) >= 4:
                yield np.array(v[: len(v) // 2 * 2]).reshape(-1, 2), tag == "polygon"
        case "path":
            yield from _path(element.get("d", ""))
        case _:
            return


def _rounded(x: float, y: float, w: float, h: float, rx: float, ry: float) -> F64:
    if rx <= 0.0 or ry <= 0.0:
        return np.array([(x, y), (x + w, y), (x + w, y + h), (x, y + h)])
    a = np.linspace(0.0, 0.5 * math.pi, _CURVE)
    corners = ((x + w - rx, y + ry, -90), (x + w - rx, y + h - ry, 0), (x + rx, y + h - ry, 90), (x + rx, y + ry, 180))
    quarters = [np.stack([cx + rx * np.cos(a + math.radians(d)), cy + ry * np.sin(a + math.radians(d))], 1) for cx, cy, d in corners]
    return np.concatenate(quarters)


def _path(d: str) -> Iterator[tuple[F64, bool]]:
    """Yield the lines of a path's data."""
    tokens = re.findall(rf"[A-Za-z]|{_NUMBER}", d)
    at, start, control, command, i = np.zeros(2), np.zeros(2), np.zeros(2), "", 0
    line: list[F64] = []
    while i < len(tokens):
        if tokens[i].isalpha():
            command, i = tokens[i], i + 1
        kind, count = command.upper(), _TAKES.get(command.upper(), -1)
        if count < 0 or i + count > len(tokens) or any(t.isalpha() for t in tokens[i : i + count]):
            return
        v, i = np.array([float(t) for t in tokens[i : i + count]]), i + count
        origin = at if command.islower() else np.zeros(2)
        if kind == "Z":
            if len(line) > 1:
                yield np.array(line), True
            at, line = start, []
            continue
        if kind == "M":
            if len(line) > 1:
                yield np.array(line), False
            at = start = origin + v
            line, command = [at], "l" if command.islower() else "L"
            continue
        line = line or [at]
        points, control = _piece(kind, v, at, origin, control)
        line += list(points)
        at = line[-1]
        control = control if kind in "CSQT" else at
    if len(line) > 1:
        yield np.array(line), False


def _piece(kind: str, v: F64, at: F64, origin: F64, control: F64) -> tuple[F64, F64]:
    """Return the points of one piece of a path behind its start, and its last control point."""
    s = np.linspace(0.0, 1.0, _CURVE + 1)[1:, None]
    match kind:
        case "H":
            return np.array([[v[0] + origin[0], at[1]]]), at
        case "V":
            return np.array([[at[0], v[0] + origin[1]]]), at
        case "A":
            return _arc(at, v, origin + v[5:7]), at
        case "C" | "S":
            of = v.reshape(-1, 2) + origin
            a, b, end = of if kind == "C" else (2.0 * at - control, *of)
            return (1 - s) ** 3 * at + 3 * (1 - s) ** 2 * s * a + 3 * (1 - s) * s**2 * b + s**3 * end, np.asarray(b)
        case "Q" | "T":
            of = v.reshape(-1, 2) + origin
            a, end = of if kind == "Q" else (2.0 * at - control, of[0])
            return (1 - s) ** 2 * at + 2 * (1 - s) * s * a + s**2 * end, np.asarray(a)
        case _:
            return (v + origin)[None], at


def _arc(at: F64, v: F64, end: F64) -> F64:
    """Return points of an elliptical arc; source: the same, appendix F.6.5."""
    rx, ry, turn, large, sweep = abs(float(v[0])), abs(float(v[1])), math.radians(float(v[2])), v[3] != 0.0, v[4] != 0.0
    if rx < 1e-12 or ry < 1e-12 or np.allclose(at, end):
        return end[None]
    R = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    x, y = (R @ (at - end) / 2.0).tolist()
    grown = math.sqrt(max(1.0, (x / rx) ** 2 + (y / ry) ** 2))
    rx, ry = rx * grown, ry * grown
    left = max(0.0, (rx * ry) ** 2 - (rx * y) ** 2 - (ry * x) ** 2) / ((rx * y) ** 2 + (ry * x) ** 2)
    centre = (-1.0 if large == sweep else 1.0) * math.sqrt(left) * np.array([rx * y / ry, -ry * x / rx])
    a0, a1 = (math.atan2((sy - centre[1]) / ry, (sx - centre[0]) / rx) for sx, sy in ((x, y), (-x, -y)))
    way = (a1 - a0) % math.tau if sweep else -((a0 - a1) % math.tau)
    a = a0 + way * np.linspace(0.0, 1.0, 4 * _CURVE + 1)[1:]
    return np.asarray((np.stack([rx * np.cos(a), ry * np.sin(a)], axis=1) + centre) @ R + (at + end) / 2.0)
