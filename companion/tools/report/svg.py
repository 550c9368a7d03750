"""Drawings as SVG that takes its ink from the page, so that one drawing serves a light and a dark screen."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from estimator.vision.pad import Pad
from estimator.vision.regions import outlines_of, part_of

INK, FAINT = "#010203", "#040506"
"""Stand-ins for the page's own colours."""
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "decklander",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.grid": True,
    "grid.color": FAINT,
    "grid.alpha": 0.35,
    "grid.linewidth": 0.6,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
}


def draw_pad(ax: Axes, pad: Pad) -> None:
    """Draw the pad from above, the arrow upward."""
    ax.add_patch(Circle((0, 0), pad.disc_radius_m, color="#0a9d76", alpha=0.28, linewidth=0, zorder=0.5))
    for region in pad.regions:
        if (part := part_of(region)) in ("ring", "arrow", "letter", "fiducial"):
            ink = INK if part in ("letter", "fiducial") else "#e69f00"
            for line in outlines_of(region):
                ax.add_patch(Polygon(line[:, ::-1], color=ink, alpha=0.55, linewidth=0, zorder=0.6))


def svg(draw: Callable[[Figure], None], width_in: float, height_in: float, name: str) -> str:
    """Draw into a transparent figure and return the bare `<svg>` element, with ids made unique by `name`."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width_in, height_in), layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", transparent=True, dpi=144, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text)
    text = re.sub(r'<svg ([^>]*?)height="[\d.]+pt"([^>]*?)width="[\d.]+pt"', r"<svg \1\2", text, count=1)
    text = re.sub(r'<svg ([^>]*?)width="[\d.]+pt"([^>]*?)height="[\d.]+pt"', r"<svg \1\2", text, count=1)
    text = re.sub(r'\bid="series-(\w+)"', r'class="series series-\1"', text)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r'"#([^"]+)"', lambda m: m.group(0) if re.fullmatch(r"[0-9a-f]{3,8}", m[1]) else f'"#{name}-{m[1]}"', text)
    text = text.replace("url(#", f"url(#{name}-")
    return text.replace(INK, "currentColor").replace(FAINT, "var(--faint)")
