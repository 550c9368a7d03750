"""The report's plots as SVG that takes its ink from the page, so one drawing serves a light and a dark screen."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from companion.report.figures import Series, body_over_pad
from companion.report.flight_log import FlightLog
from companion.report.palette import MARKERS, OTHER, colour
from estimator.contracts.commands import Hover, Land, TakeOff, Velocity
from estimator.contracts.geometry import F64
from estimator.contracts.time import seconds_between
from estimator.vision.pad import Pad

_INK, _FAINT = "#010203", "#040506"
"""Stand-ins for the page's own colours."""
_MANY_POINTS = 400
"""More markers than this are drawn as one path of round dots: a browser is slow with many small shapes."""
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "decklander",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": _FAINT,
    "axes.labelcolor": _INK,
    "axes.grid": True,
    "grid.color": _FAINT,
    "grid.alpha": 0.35,
    "grid.linewidth": 0.6,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "text.color": _INK,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
}


def trajectory(log: FlightLog, series: Sequence[Series]) -> str:
    """Where the body flew over the pad: from above, from port, from behind, and the last metre from above."""
    tracks = _tracks(log, series)

    def draw(figure: Figure) -> None:
        axes = figure.subplots(2, 2)
        views = [
            (axes[0, 0], 1, 0, "from above", "to starboard, m", "along the arrow, m"),
            (axes[0, 1], 0, 2, "from starboard", "along the arrow, m", "height, m"),
            (axes[1, 0], 1, 2, "from behind", "to starboard, m", "height, m"),
            (axes[1, 1], 1, 0, "from above, near the pad", "to starboard, m", "along the arrow, m"),
        ]
        for ax, i, j, title, x_name, y_name in views:
            ax.set_title(title, loc="left", fontsize=9)
            ax.set(xlabel=x_name, ylabel=y_name)
            if j == 2:
                r = log.pad.disc_radius_m
                ax.plot([-r, r], [0, 0], color="#0a9d76", linewidth=5, solid_capstyle="butt")
            else:
                _draw_pad(ax, log.pad)
            for name, p, style in tracks:
                ax.plot(p[:, i], p[:, j], gid=_gid(name), **style)
            if tracks:
                first = tracks[0][1][np.all(np.isfinite(tracks[0][1]), axis=1)]
                if len(first):
                    ax.plot(first[0, i], first[0, j], "o", color=_INK, markersize=5)
                    ax.plot(first[-1, i], first[-1, j], "X", color=_INK, markersize=7)
            ax.set_aspect("equal", adjustable="datalim")
        near = 1.3 * log.pad.disc_radius_m
        axes[1, 1].set_aspect("equal", adjustable="box")
        axes[1, 1].set(xlim=(-near, near), ylim=(-near, near))

    return _svg(draw, 9.6, 8.0, "trajectory")


def against_truth(log: FlightLog, series: Sequence[Series]) -> str:
    """Every method's and path's forward, right, down and heading over time, with truth behind them."""
    t_true = np.array([seconds_between(log.started, s.at) for s in log.truth])
    d_true = np.array([s.d_body_pad_level for s in log.truth]).reshape(-1, 3)
    yaw_true = np.degrees([s.yaw_rad for s in log.truth])

    def draw(figure: Figure) -> None:
        axes = figure.subplots(4, 1, sharex=True)
        for k, name in enumerate(("forward, m", "right, m", "down, m", "heading, degrees")):
            ax = axes[k]
            truth = d_true[:, k] if k < 3 else _broken_at_wraps(yaw_true)
            if len(t_true):
                ax.plot(t_true, truth, color=_INK, linewidth=3.0, alpha=0.35, gid=_gid("truth"))
            for s in series:
                y = s.d[:, k] if k < 3 else np.degrees(s.yaw_rad)
                _plot(ax, s, y, wraps=k == 3)
            ax.set_ylabel(name)
            _fit(ax, [truth] if len(t_true) else [s.d[:, k] if k < 3 else np.degrees(s.yaw_rad) for s in series])
        _phases(axes, log)
        axes[-1].set_xlabel("time, s")

    return _svg(draw, 9.6, 9.0, "against")


def errors(log: FlightLog, series: Sequence[Series]) -> str:
    """Size of the error of every method and path over time, on a logarithmic scale."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots(3, 1, sharex=True)
        rows: list[tuple[str, Callable[[Series], F64], float]] = [
            ("lateral, m", lambda s: s.lateral_error_m, 1e-3),
            ("height, m", lambda s: np.abs(s.error[:, 2]), 1e-3),
            ("heading, degrees", lambda s: np.abs(np.degrees(s.yaw_error)), 1e-2),
        ]
        for ax, (name, of, least) in zip(axes, rows, strict=True):
            ax.set_yscale("log")
            for s in series:
                _plot(ax, s, np.maximum(of(s), least), wraps=False)
            ax.set_ylabel(f"error, {name}")
            ax.set_ylim(bottom=0.8 * least)
        _phases(axes, log)
        axes[-1].set_xlabel("time, s")

    return _svg(draw, 9.6, 7.2, "errors")


def commands(log: FlightLog) -> str:
    """What the vehicle was told: velocities and turn rate; hovering and landing as bands."""
    t = np.array([seconds_between(log.started, c.at) for c in log.commands])
    rows = np.full((len(t), 4), np.nan)
    for i, record in enumerate(log.commands):
        if isinstance(record.command, Velocity):
            rows[i] = [*record.command.v_level, math.degrees(record.command.yaw_rate_rad_s)]
    words = {Hover: "hover", Land: "land", TakeOff: "take off"}
    kinds = [words.get(type(c.command)) for c in log.commands]

    def draw(figure: Figure) -> None:
        axes = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
        for k, (name, ink) in enumerate((("forward", "#1f86c9"), ("right", "#e69f00"), ("down", "#cc79a7"))):
            axes[0].step(t, rows[:, k], where="post", color=ink, label=name)
        axes[0].set_ylabel("velocity, m/s")
        axes[0].legend(loc="upper right", ncols=3, fontsize=8)
        axes[1].step(t, rows[:, 3], where="post", color=OTHER)
        axes[1].set_ylabel("turn, degrees/s")
        axes[1].set_xlabel("time, s")
        begin = 0
        for i in range(1, len(t) + 1):
            if i == len(t) or kinds[i] != kinds[begin]:
                if (word := kinds[begin]) is not None:
                    end = t[i] if i < len(t) else t[-1]
                    for ax in axes:
                        ax.axvspan(t[begin], end, color=_FAINT, alpha=0.18, linewidth=0)
                    axes[0].text(t[begin], 1.01, word, transform=axes[0].get_xaxis_transform(), fontsize=7)
                begin = i

    return _svg(draw, 9.6, 3.8, "commands")


def verdicts(log: FlightLog) -> str:
    """What became of the frames, as bars."""
    ordered = sorted(log.verdicts.items(), key=lambda kv: kv[1])
    total = sum(log.verdicts.values())

    def draw(figure: Figure) -> None:
        ax = figure.subplots()
        names = [v.value.replace("_", " ") for v, _ in ordered]
        counts = [n for _, n in ordered]
        bars = ax.barh(names, counts, color=["#0a9d76" if n == "fused" else "#e69f00" for n in names], height=0.65)
        ax.bar_label(bars, [f"{n}  ({100 * n / total:.1f} %)" for n in counts], padding=4, fontsize=9)
        ax.set_xlim(0, 1.2 * max(counts))
        ax.set_xlabel("frames")
        ax.grid(visible=False, axis="y")
        ax.set_axisbelow(True)

    return _svg(draw, 9.6, 0.75 + 0.32 * len(ordered), "verdicts")


def _tracks(log: FlightLog, series: Sequence[Series]) -> list[tuple[str, F64, dict[str, object]]]:
    """(name, positions over the pad, line style): truth first, then every path that knew its heading."""
    out: list[tuple[str, F64, dict[str, object]]] = []
    if log.truth:
        d = np.array([s.d_body_pad_level for s in log.truth])
        yaw = np.array([s.yaw_rad for s in log.truth])
        out.append(("truth", body_over_pad(d, yaw), {"color": _INK, "linewidth": 3.0, "alpha": 0.35}))
    for s in series:
        if s.is_path:
            out.append((s.name, body_over_pad(s.d, s.yaw_rad), {"color": colour(s.name), "linewidth": 1.3}))
    return out


def _draw_pad(ax: Axes, pad: Pad) -> None:
    ax.add_patch(Circle((0, 0), pad.disc_radius_m, color="#0a9d76", alpha=0.28, linewidth=0, zorder=0.5))
    ax.add_patch(Circle((0, 0), pad.ring_radius_m, fill=False, color="#e69f00", linewidth=1.2, zorder=0.6))
    for shape, ink in ((pad.arrowhead(), "#e69f00"), (pad.h_corners(), _INK)):
        ax.add_patch(Polygon(shape[:, [1, 0]], color=ink, alpha=0.55, linewidth=0, zorder=0.6))


def _plot(ax: Axes, s: Series, y: F64, wraps: bool) -> None:
    if s.is_path:
        ax.plot(s.t_s, _broken_at_wraps(y) if wraps else y, color=colour(s.name), gid=_gid(s.name))
        return
    ink: dict[str, Any] = {"color": colour(s.name), "alpha": 0.75, "gid": _gid(s.name)}
    if len(y) <= _MANY_POINTS:
        ax.plot(s.t_s, y, MARKERS.get(s.name, "."), markersize=2.6, markeredgewidth=0.6, **ink)
        return
    dots = np.stack([np.repeat(s.t_s, 3), np.repeat(y, 3)])
    # a dot is a stroke too short to see: one of no length at all is left out of the drawing
    dots[0, 1::3] += 1e-4 * max(1.0, float(np.ptp(s.t_s)))
    dots[:, 2::3] = np.nan
    (line,) = ax.plot(*dots, linewidth=2.4, solid_capstyle="round", **ink)
    line.get_path().should_simplify = False


def _fit(ax: Axes, leading: Sequence[F64]) -> None:
    """Show the leading values with some room, so that one wild estimate does not flatten all the rest."""
    joined = np.concatenate([np.asarray(v, dtype=float).ravel() for v in leading]) if leading else np.zeros(0)
    joined = joined[np.isfinite(joined)]
    if len(joined):
        low, high = float(np.min(joined)), float(np.max(joined))
        room = max(0.15 * (high - low), 0.2)
        ax.set_ylim(low - room, high + room)


def _phases(axes: Sequence[Axes], log: FlightLog) -> None:
    """Thin lines where a phase begins, its name above the uppermost panel; of a crowd only the first is named."""
    low, high = axes[0].get_xlim()
    last = -math.inf
    for change in log.phases:
        t = seconds_between(log.started, change.at)
        for ax in axes:
            ax.axvline(t, color=_FAINT, linewidth=0.9, linestyle=(0, (3, 2)))
        if t - last < 0.025 * (high - low):
            continue
        last = t
        name = change.phase.replace("_", " ")
        axes[0].text(t, 1.02, name, transform=axes[0].get_xaxis_transform(), fontsize=7, rotation=30, va="bottom")


def _broken_at_wraps(degrees: F64) -> F64:
    """Degrees over time with a gap where they jump from one end of the circle to the other."""
    out = np.array(degrees, dtype=float)
    out[1:][np.abs(np.diff(degrees)) > 180.0] = np.nan
    return out


def _gid(name: str) -> str:
    return f"series-{name}"


def _svg(draw: Callable[[Figure], None], width_in: float, height_in: float, name: str) -> str:
    """Draw into a transparent figure and give the bare `<svg>` element, ids made unique by `name`."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width_in, height_in), layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", transparent=True, dpi=144, metadata={"Date": None, "Creator": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", svg)
    svg = re.sub(r'<svg ([^>]*?)height="[\d.]+pt"([^>]*?)width="[\d.]+pt"', r"<svg \1\2", svg, count=1)
    svg = re.sub(r'<svg ([^>]*?)width="[\d.]+pt"([^>]*?)height="[\d.]+pt"', r"<svg \1\2", svg, count=1)
    svg = re.sub(r'\bid="series-(\w+)"', r'class="series series-\1"', svg)
    svg = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', svg)
    svg = re.sub(r'"#([^"]+)"', lambda m: m.group(0) if re.fullmatch(r"[0-9a-f]{3,8}", m[1]) else f'"#{name}-{m[1]}"', svg)
    svg = svg.replace("url(#", f"url(#{name}-")
    return svg.replace(_INK, "currentColor").replace(_FAINT, "var(--faint)")
