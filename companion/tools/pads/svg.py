"""Read and render a drawing in SVG.

resvg draws what an SVG paints. What it would leave out, and what is not of plain colours, is refused with what to do.
"""

import re
from xml.etree.ElementTree import Element, ParseError, fromstring, tostring

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from companion.tools.pads import foreign
from drivers.confined import in_child
from estimator.contracts.errors import BadInput, refused

_PX = {"": 1.0, "px": 1.0, "in": 96.0, "cm": 96 / 2.54, "mm": 96 / 25.4, "q": 24 / 25.4, "pt": 96 / 72, "pc": 16.0}
"""Px of a unit of length."""
_SVG = "{http://www.w3.org/2000/svg}"
_TAGS = re.compile(
    "svg|g|defs|symbol|use|path|rect|circle|ellipse|line|polyline|polygon|title|desc|metadata|style|switch|a|view|clipPath|mask|"
    "marker|pattern|linearGradient|radialGradient|stop|filter|fe[A-Z].*"
)
_CURES = {"text": "convert it to paths in the drawing program", "image": "trace it, or import the picture itself"}
_UNREAD = {
    r"@(?!charset|namespace|font-face)[\w-]+": "the rule",
    r"[^{}]*(?::(?!hover|first-child)[\w-]+|[+~])[^{}]*(?=\{)": "the selector",
}
"""Parts of style sheets that resvg leaves out."""
_STYLES = r"(?<![\w-])(?:(?:c?[xy]|r[xy]?|d|width|height|translate|rotate|scale)\s*:|transform\s*:[^;]*\d(?:deg|px|turn|rad|%))"
_FUNCTIONS = r"\b(?:var|calc|path|circle|inset|ellipse|polygon|color|(?:ok)?l(?:ab|ch)|hwb)\("
"""Styles that resvg leaves out: sizes and places, turns with units, shapes and colours of CSS alone."""


class SvgDrawing(Struct, frozen=True):
    """A drawing that holds nothing but what is read."""

    markup: str
    """The drawing as an <svg> within another, px."""
    width: float
    height: float
    """The sheet from (0, 0), px."""
    px_mm: float | None
    """Millimetres in a px; None if the file does not say it."""
    where: str
    """The file, for errors."""

    def rendered(self, left: float, top: float, size_px: tuple[int, int], scale: float, *, crisp: bool) -> NDArray[np.uint8]:
        """Return a part of the sheet, (H, W, 4) BGRA, `scale` px to one of the sheet; a crisp one is blended at no border.

        Raises:
            BadInput: resvg cannot draw it, or not within the bounds of `in_child`.
        """
        w, h = size_px
        box = f"{left} {top} {w / scale} {h / scale}"
        around = f'<svg xmlns="{_SVG[1:-1]}" width="{w}" height="{h}" viewBox="{box}">{self.markup}</svg>'
        png = in_child(foreign.__name__, "crisp" if crisp else "blended", around.encode(), self.where)
        image = np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED), np.uint8)
        x, y, right, bottom = np.rint(scale * np.maximum(0.0, (-left, -top, self.width - left, self.height - top))).astype(int)
        image[:y], image[bottom:], image[:, :x], image[:, right:] = 0, 0, 0, 0
        return image


def read_svg(text: str, where: str) -> SvgDrawing:
    """Return a drawing.

    Raises:
        BadInput: it is no SVG, it is too large, or it holds what is not read.
    """
    if "<!ENTITY" in text:
        raise BadInput(f"{where}: a drawing has no entities: save it as plain SVG")
    with refused(f"{where}: no SVG drawing", ParseError, ValueError):
        root = fromstring(text)
    if root.tag not in ("svg", _SVG + "svg"):
        raise BadInput(f"{where}: no SVG drawing: its root is no <svg>")
    _check_elements(root, where)
    if "<?xml-stylesheet" in text:
        raise BadInput(f"{where}: the drawing has a style sheet in another file: save it as plain SVG")
    with refused(f"{where}: no SVG drawing: viewBox", ValueError):
        box = [float(v) for v in root.get("viewBox", "").replace(",", " ").split()]
    sizes = {key: _length_px(root.get(key, "")) for key in ("width", "height")}
    across, along = box[2:] if len(box) == 4 and min(box[2:]) > 0.0 else (0.0, 0.0)
    known = max((v / of for v, of in zip(sizes.values(), (across, along), strict=True) if v and of), default=1.0)
    width, height = sizes["width"] or known * across, sizes["height"] or known * along
    if not (0.0 < width < 1e6 and 0.0 < height < 1e6):
        raise BadInput(f"{where}: the drawing has no size: give it a viewBox")
    measured = any(re.search(r"(?i)\d(mm|cm|q|in|pt|pc)\s*$", root.get(key, "")) for key in sizes)
    # resvg would blend the last pixels of a sheet that ends between two, and takes as long for that as for the rest.
    root.attrib.update(width=f"{width}", height=f"{height}", x="0", y="0", overflow="visible")
    with refused(f"{where}: its groups are nested too deep", RecursionError):
        markup = tostring(root, encoding="unicode")
    return SvgDrawing(markup, width, height, 25.4 / foreign.PX_IN_INCH if measured else None, where)


def _length_px(text: str) -> float | None:
    found = re.fullmatch(r"\s*\+?([\d.]+(?:e[-+]?\d+)?)\s*([a-z]*)\s*", text.lower())
    return float(found[1]) * _PX[found[2]] if found and found[2] in _PX else None


def _check_elements(root: Element, where: str) -> None:
    """Check that all is read that a drawing holds, and put what has no name space into that of SVG.

    Raises:
        BadInput: it is not.
    """
    names = {element.get("id") for element in root.iter()}
    for element in root.iter():
        space, _, tag = str(element.tag).rpartition("}")
        element.tag = element.tag if space else _SVG + tag
        if space in ("", _SVG[:-1]) and not _TAGS.fullmatch(tag):
            of = next((name for name in _CURES if tag.startswith(name) or tag in ("tspan", "flowRoot")), tag)
            raise BadInput(f"{where}: the drawing has {of} (<{tag}>): {_CURES.get(of, 'take it out, or save it as plain SVG')}")
        sheet = re.sub(r"(?s)/\*.*?\*/", "", element.text or "") if tag == "style" else ""
        for unread, what in _UNREAD.items():
            if found := re.search(unread, sheet):
                raise BadInput(
                    f"{where}: its style sheet has {what} {found[0].strip()!r}: save it as plain SVG, without style sheets"
                )
        values = " ".join((sheet, *element.attrib.values()))
        written = f"{sheet};{element.get('style', '')}"
        if found := re.search(_FUNCTIONS, values) or re.search(_STYLES, written):
            raise BadInput(f"{where}: <{tag}> has {found[0]!r}: save it as plain SVG")
        links = [] if tag == "a" else [v for key, v in element.attrib.items() if key.rpartition("}")[2] == "href"]
        for link in [*links, *re.findall(r"url\(\s*['\"]?([^)'\"]*)", values)]:
            if not (link.startswith("#") and link[1:].strip() in names):
                raise BadInput(f"{where}: <{tag}> refers to {link!r}, which is not in the drawing: draw it in its place")
