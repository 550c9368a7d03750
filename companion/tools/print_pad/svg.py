"""Write one sheet as an SVG whose unit is the millimetre."""

from __future__ import annotations

from xml.sax.saxutils import escape

from companion.tools.print_pad.drawing import Drawing, Polygon, Rgb, Shape, touches
from companion.tools.print_pad.sheets import Sheet


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
