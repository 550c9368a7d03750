"""The plots of a campaign's report, each narrow, so that its letters can be read on a phone."""

import io
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import PercentFormatter

from estimator.contracts.geometry import F64
from estimator.vision.pad.geometry import outlines_of
from estimator.vision.pad.pad import Pad
from estimator.vision.pad.shapes import part_of
from sitl.campaign.figures import SuccessMap, unmoved, wilson

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


_WIDTH_IN = 4.8
_GOOD, _BAD, _BLUE, _ORANGE = "#0a9d76", "#d55e00", "#1f86c9", "#e69f00"
_DOTS_MAX = 3000
"""Dots of a scatter plot; of more flights a seeded choice is drawn."""
_STEPS_MAX = 300
_SUCCESS = LinearSegmentedColormap.from_list("success", ["#b3441e", "#e69f00", "#f0e442", "#56b4e9", "#0a9d76"])
"""Colours from failure to success; its ends differ in lightness too."""


def outcomes(counts: Sequence[tuple[str, int, str]], runs: int) -> str:
    """Draw the share of each outcome with Wilson's interval. `counts` holds the name, the number and the colour of each."""

    def draw(figure: Figure) -> None:
        ax = figure.subplots()
        for n, (name, count, colour) in enumerate(reversed(counts)):
            low, high = wilson(count, runs)
            ax.barh(n, count / runs, color=colour, height=0.55)
            ax.plot([low, high], [n, n], color=INK, linewidth=1.6)
            ax.plot([low, high], [n, n], "|", color=INK, markersize=9)
            ax.text(0.0, n + 0.36, f"{name}: {count}, {100 * low:.1f} to {100 * high:.1f} %", fontsize=8, va="bottom")
        ax.set(xlim=(0, 1.02), ylim=(-0.5, len(counts) - 0.1), yticks=[])
        ax.xaxis.set_major_formatter(PercentFormatter(1.0))
        ax.set_xlabel("of the flights; bars: 95 % interval")
        ax.spines["left"].set_visible(False)

    return svg(draw, _WIDTH_IN, 0.8 + 0.62 * len(counts), "outcomes")


def touchdowns(pad: Pad, places_m: Sequence[tuple[float, float, bool]]) -> str:
    """Draw where the flights came to stand, on the pad's drawing seen from above."""
    table = np.array(places_m, dtype=float).reshape(-1, 3)
    if len(table) > _DOTS_MAX:
        table = table[np.random.default_rng(0).choice(len(table), _DOTS_MAX, replace=False)]

    def draw(figure: Figure) -> None:
        ax = figure.subplots()
        draw_pad(ax, pad)
        for good, colour, marker in ((1.0, _BLUE, "o"), (0.0, _BAD, "X")):
            some = table[table[:, 2] == good]
            size = (3.2 if len(some) < 400 else 1.8) * (1.6 if marker == "X" else 1.0)
            ax.plot(some[:, 1], some[:, 0], marker, color=colour, markersize=size, alpha=0.7, markeredgewidth=0)
        reach = 1.15 * max(pad.disc_radius_m, min(3.0, float(np.max(np.abs(table[:, :2]), initial=0.0))))
        ax.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel="to starboard, m", ylabel="along the arrow, m")
        ax.set_aspect("equal", adjustable="box")

    return svg(draw, _WIDTH_IN, _WIDTH_IN, "touchdowns")


def distribution(name: str, values: Sequence[float], label: str, other: Sequence[float] = ()) -> str:
    """Draw the cumulative distribution of a figure, with its median and 95 % point; `other` is that of an earlier campaign."""

    def draw(figure: Figure) -> None:
        ax = figure.subplots()
        if len(other):
            _steps(ax, np.array(other), FAINT, 1.6)
        _steps(ax, np.array(values), _BLUE, 1.8)
        for share in (0.5, 0.95):
            at = float(np.quantile(values, share))
            ax.plot([at, at], [0, share], color=_ORANGE, linewidth=1.0, linestyle=(0, (4, 3)))
            ax.plot([at], [share], "o", color=_ORANGE, markersize=4)
            ax.annotate(f"{at:.3g}", (at, share), xytext=(-5, 3), textcoords="offset points", fontsize=8, ha="right")
        ax.set(ylim=(0, 1.09), xlabel=label)
        ax.set_xlim(left=min(0.0, float(np.min(values))))
        ax.yaxis.set_major_formatter(PercentFormatter(1.0))

    return svg(draw, _WIDTH_IN, 3.1, name)


def _steps(ax: Axes, values: F64, colour: str, width: float) -> None:
    ordered = np.sort(values)
    shares = np.arange(1, len(ordered) + 1) / len(ordered)
    if len(ordered) > _STEPS_MAX:
        shares = np.linspace(0.0, 1.0, _STEPS_MAX)
        ordered = np.quantile(ordered, shares)
    ax.step(np.r_[ordered[0], ordered], np.r_[0.0, shares], where="post", color=colour, linewidth=width)


def effect(key: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """Draw success and standing error against one varied key; the rows are those of `effect_of`."""
    values = [row["value"] for row in rows]
    low, high = np.array([row["good_interval"] for row in rows]).T
    error_m = np.array([row["standing_median_m"] for row in rows], dtype=float)

    def draw(figure: Figure) -> None:
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
        numeric = not any(isinstance(value, str | bool) for value in values)
        x = np.array(values, dtype=float) if numeric else np.arange(len(values), dtype=float)
        top.fill_between(x, low, high, color=_GOOD, alpha=0.22, linewidth=0)
        top.plot(x, [row["good"] for row in rows], "o-", color=_GOOD, markersize=4)
        top.set(ylim=(-0.02, 1.04), ylabel="good flights")
        top.set_title(unmoved(key, rows), fontsize="small", color=_BAD, wrap=True)
        top.yaxis.set_major_formatter(PercentFormatter(1.0))
        bottom.plot(x, 100.0 * error_m, "s-", color=_BLUE, markersize=4)
        bottom.set(ylabel="error, cm", xlabel=key)
        bottom.set_ylim(0.0, 115.0 * float(np.nanmax(error_m)) if np.isfinite(error_m).any() else 1.0)
        if not numeric:
            bottom.set_xticks(x, [str(value) for value in values])

    return svg(draw, _WIDTH_IN, 3.8, f"effect-{_id(key)}")


def success_map(of: SuccessMap) -> str:
    """Draw success against two varied keys as a heat map, with the share in each cell."""

    def draw(figure: Figure) -> None:
        ax = figure.subplots()
        ax.grid(visible=False)
        ax.imshow(of.shares, origin="lower", aspect="auto", cmap=_SUCCESS, vmin=0.0, vmax=1.0, interpolation="nearest")
        for (j, i), share in np.ndenumerate(of.shares):
            if np.isfinite(share):
                ax.text(i, j, f"{100 * share:.0f}", ha="center", va="center", fontsize=8, color="#000000")
        ax.set_xticks(range(len(of.x)), of.x, rotation=45 if len(of.x) > 6 else 0)
        ax.set_yticks(range(len(of.y)), of.y)
        ax.set(xlabel=of.x_key, ylabel=of.y_key)

    return svg(draw, _WIDTH_IN, min(5.5, max(2.6, 1.2 + 0.38 * len(of.y))), f"map-{_id(of.x_key)}-{_id(of.y_key)}")


def _id(key: str) -> str:
    return key.replace(".", "-")
