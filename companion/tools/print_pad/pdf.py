"""Write sheets as a vector PDF: exact to 0.001 mm, with nothing rasterised and no fonts embedded.

Source: ISO 32000-1, sections 7.5 (file), 8.5 (paths), 9.6.2.2 (the standard fonts).
"""

import math
import zlib
from math import cos, pi, sin

from companion.tools.print_pad.drawing import Disc, Drawing, Polygon, Rgb, Shape, touches
from companion.tools.print_pad.sheets import Sheet

_PT = 72.0 / 25.4
_EIGHTH = 4.0 / 3.0 * math.tan(math.pi / 16.0)
"""Length of a Bezier handle for an eighth of a circle of radius 1; the curve leaves the circle by 4e-6 of the radius."""


def pdf(drawing: Drawing, sheets: list[Sheet]) -> bytes:
    """Return the PDF, with one page for each sheet."""
    objects: list[bytes] = [b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>", b""]
    objects.append(b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>")
    kids = []
    for sheet in sheets:
        content = zlib.compress(_page(drawing, sheet).encode("cp1252", errors="replace"))
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


def _page(drawing: Drawing, sheet: Sheet) -> str:
    """Return the page's content, in mm from the top-left corner."""
    x, y, w, h = sheet.from_x_mm, sheet.from_y_mm, sheet.window_width_mm, sheet.window_height_mm
    lines = ["q", f"{_n(_PT)} 0 0 {_n(-_PT)} 0 {_n(sheet.height_mm * _PT)} cm", "q"]
    lines += [f"{_n(sheet.left_mm)} {_n(sheet.top_mm)} {_n(w)} {_n(h)} re W n"]
    lines += [f"1 0 0 1 {_n(sheet.left_mm - x)} {_n(sheet.top_mm - y)} cm"]
    lines += [_shape(s) for s in drawing.shapes if touches(s, x, y, x + w, y + h)]
    lines += ["Q", "0 G 0.15 w"]
    lines += [f"{_n(m.x0)} {_n(m.y0)} m {_n(m.x1)} {_n(m.y1)} l S" for m in sheet.lines]
    for label in sheet.labels:
        text = label.text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
        lines.append(f"BT 0 g /F {_n(label.height_mm)} Tf 1 0 0 -1 {_n(label.x)} {_n(label.y)} Tm ({text}) Tj ET")
    lines.append("Q")
    return "\n".join(lines)


def _shape(shape: Shape) -> str:
    if isinstance(shape, Polygon):
        (x0, y0), *rest = shape.points_mm.tolist()
        path = f"{_n(x0)} {_n(y0)} m " + " ".join(f"{_n(x)} {_n(y)} l" for x, y in rest) + " h f"
        return f"{_colour(shape.fill)} rg {path}"
    return f"{_colour(shape.fill)} rg {_circle(shape)}"


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


def _colour(rgb: Rgb) -> str:
    return " ".join(_n(c / 255) for c in rgb)


def _n(value: float) -> str:
    return f"{value:.5f}".rstrip("0").rstrip(".")
