"""The report's plots as SVG that takes its ink from the page, so one drawing serves a light and a dark screen."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from companion.report.figures import Series, body_over_pad
from companion.report.flight_log import FlightLog
from companion.report.innovations import InnovationSeries
from companion.report.palette import MARKERS, OTHER, colour
from companion.report.svg import FAINT, INK, draw_pad, svg
from estimator.contracts.commands import CutMotors, Hover, Land, Lean, LeaveEmergency, TakeOff, Velocity
from estimator.contracts.geometry import F64
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import seconds_between

_MANY_POINTS = 400
"""More markers than this are drawn as one path of round dots: a browser is slow with many small shapes."""
_BINS = 300
"""Spans of time that a plot of many thousand points is thinned to; the extremes of each are kept."""
_FUSED, _REFUSED = "#1f86c9", "#d55e00"


def trajectory(log: FlightLog, series: Sequence[Series]) -> str:
    """Draw the body's path over the pad: from above, from port, from behind, and the last metre from above."""
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
                draw_pad(ax, log.pad)
            for name, p, style in tracks:
                ax.plot(p[:, i], p[:, j], gid=_gid(name), **style)
            if tracks:
                first = tracks[0][1][np.all(np.isfinite(tracks[0][1]), axis=1)]
                if len(first):
                    ax.plot(first[0, i], first[0, j], "o", color=INK, markersize=5)
                    ax.plot(first[-1, i], first[-1, j], "X", color=INK, markersize=7)
            ax.set_aspect("equal", adjustable="datalim")
        near = 1.3 * log.pad.disc_radius_m
        axes[1, 1].set_aspect("equal", adjustable="box")
        axes[1, 1].set(xlim=(-near, near), ylim=(-near, near))

    return svg(draw, 9.6, 8.0, "trajectory")


def against_truth(log: FlightLog, series: Sequence[Series]) -> str:
    """Draw the forward, right, down and heading of every method and path over time, with truth behind them."""
    t_true = np.array([seconds_between(log.started, s.at) for s in log.truth])
    d_true = np.array([s.d_body_pad_level for s in log.truth]).reshape(-1, 3)
    yaw_true = np.degrees([s.yaw_rad for s in log.truth])

    def draw(figure: Figure) -> None:
        axes = figure.subplots(4, 1, sharex=True)
        for k, name in enumerate(("forward, m", "right, m", "down, m", "heading, degrees")):
            ax = axes[k]
            truth = d_true[:, k] if k < 3 else _broken_at_wraps(yaw_true)
            if len(t_true):
                ax.plot(t_true, truth, color=INK, linewidth=3.0, alpha=0.35, gid=_gid("truth"))
            for s in series:
                y = s.d[:, k] if k < 3 else np.degrees(s.yaw_rad)
                _plot(ax, s, y, wraps=k == 3)
            ax.set_ylabel(name)
            _fit(ax, [truth] if len(t_true) else [s.d[:, k] if k < 3 else np.degrees(s.yaw_rad) for s in series])
        _phases(axes, log)
        axes[-1].set_xlabel("time, s")

    return svg(draw, 9.6, 9.0, "against")


def errors(log: FlightLog, series: Sequence[Series]) -> str:
    """Draw the magnitude of the error of every method and path over time, on a logarithmic scale."""

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

    return svg(draw, 9.6, 7.2, "errors")


def innovations(log: FlightLog, of: InnovationSeries) -> str:
    """Draw each component of one source's innovations with the sigma that the filter claimed, and their NIS below them."""
    columns = min(3, len(of.components))
    rows = math.ceil(len(of.components) / columns)

    def draw(figure: Figure) -> None:
        grid = figure.add_gridspec(rows + 1, columns)
        for k, name in enumerate(of.components):
            ax = figure.add_subplot(grid[k // columns, k % columns])
            _innovation(ax, of, k)
            quantity, unit = _quantity_and_unit(name)
            ax.set_title(f"{quantity}, {unit}", loc="left", fontsize=9)
        _nis(figure.add_subplot(grid[rows, :]), of)
        for ax in figure.axes:
            low, high = float(of.t_s[0]), float(of.t_s[-1])
            ax.set_xlim(low - 0.01 * (high - low) - 0.1, high + 0.01 * (high - low) + 0.1)
        figure.axes[-1].set_xlabel("time, s")

    return svg(draw, 9.6, 2.0 * (rows + 1) + 0.2, f"innovations-{of.path}-{of.source}")


def _innovation(ax: Axes, of: InnovationSeries, k: int) -> None:
    y, sigma, fused = of.innovation[:, k], of.sigma[:, k], of.fused & np.isfinite(of.innovation[:, k])
    t_band, band = _thinned_median(of.t_s[fused], sigma[fused])
    for width, alpha in ((3.0, 0.12), (1.0, 0.22)):
        ax.fill_between(t_band, -width * band, width * band, color=_FUSED, alpha=alpha, linewidth=0)
    kept = _extremes(y[fused])
    _dots(ax, of.t_s[fused][kept], y[fused][kept], color=_FUSED)
    reach = (
        [np.quantile(np.abs(y[fused]), 0.995), 3.0 * np.median(sigma[fused])] if fused.any() else [float(np.nanmax(np.abs(y)))]
    )
    limit = 1.15 * max(float(max(reach)), 1e-9)
    refused = ~of.fused & np.isfinite(y)
    shown = np.clip(y[refused], -limit, limit)
    kept = _extremes(shown)
    _dots(ax, of.t_s[refused][kept], shown[kept], color=_REFUSED)
    ax.axhline(0.0, color=FAINT, linewidth=0.8)
    ax.set_ylim(-1.05 * limit, 1.05 * limit)


def _nis(ax: Axes, of: InnovationSeries) -> None:
    ax.set_yscale("log")
    gate = of.normalized_nis / of.test_ratio
    for chosen, ink in ((of.fused, _FUSED), (~of.fused, _REFUSED)):
        value = np.clip(of.normalized_nis[chosen], 1e-3, 1e3)
        kept = _extremes(value)
        _dots(ax, of.t_s[chosen][kept], value[kept], color=ink)
    t_gate, limit = _thinned_median(of.t_s, gate)
    ax.plot(t_gate, limit, color=_REFUSED, linewidth=1.2)
    ax.axhline(1.0, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
    ax.set_title("NIS over the number of components", loc="left", fontsize=9)


def _quantity_and_unit(component: str) -> tuple[str, str]:
    """Split the name of a component, as in x_m and down_m_s."""
    for ending, unit in (("_m_s", "m/s"), ("_rad", "rad"), ("_m", "m")):
        if component.endswith(ending):
            return component.removesuffix(ending).replace("_", " "), unit
    return component, ""


def _extremes(y: F64) -> NDArray[np.intp]:
    """Return the indices of the least and greatest value of each of `_BINS` spans of time, all indices where there are few."""
    if len(y) <= 2 * _BINS:
        return np.arange(len(y))
    kept: list[int] = []
    for part in np.array_split(np.arange(len(y)), _BINS):
        kept += sorted({int(part[np.argmin(y[part])]), int(part[np.argmax(y[part])])})
    return np.array(kept, dtype=np.intp)


def _thinned_median(t_s: F64, y: F64) -> tuple[F64, F64]:
    """Return at most `_BINS` times and the medians of the values around them."""
    parts = [part for part in np.array_split(np.arange(len(y)), min(_BINS, max(1, len(y)))) if len(part)]
    return np.array([np.mean(t_s[part]) for part in parts]), np.array([np.nanmedian(y[part]) for part in parts])


def _dots(ax: Axes, t_s: F64, y: F64, **ink: Any) -> None:
    """Draw many dots as one path of strokes that are too short to see: one of no length at all is left out of the drawing."""
    if not len(t_s):
        return
    dots = np.stack([np.repeat(t_s, 3), np.repeat(y, 3)])
    dots[0, 1::3] += 1e-4 * max(1.0, float(np.ptp(t_s)))
    dots[:, 2::3] = np.nan
    (line,) = ax.plot(*dots, linewidth=2.4, solid_capstyle="round", **ink)
    line.get_path().should_simplify = False


def commands(log: FlightLog) -> str:
    """Draw the commands to the vehicle: velocities, tilt and yaw rate as lines, hovering and landing as bands."""
    t = np.array([seconds_between(log.started, c.at) for c in log.commands])
    rows, leans = np.full((len(t), 4), np.nan), np.full((len(t), 2), np.nan)
    for i, record in enumerate(log.commands):
        if isinstance(record.command, Velocity | Lean):
            rows[i] = [*record.command.v_level, math.degrees(record.command.yaw_rate_rad_s)]
        if isinstance(record.command, Lean):
            leans[i] = np.degrees(np.arctan((record.command.a_level + record.command.trim_level) / G_M_S2))
    words = {Hover: "hover", Land: "land", TakeOff: "take off", CutMotors: "cut motors", LeaveEmergency: "leave emergency"}
    kinds = [words.get(type(c.command)) for c in log.commands]
    tilts = bool(np.isfinite(leans).any())

    def draw(figure: Figure) -> None:
        axes = figure.subplots(3 if tilts else 2, 1, sharex=True, height_ratios=[2, 2, 1] if tilts else [2, 1])
        inks = (("forward", "#1f86c9"), ("right", "#e69f00"), ("down", "#cc79a7"))
        for k, (name, ink) in enumerate(inks):
            axes[0].step(t, rows[:, k], where="post", color=ink, label=name)
        axes[0].set_ylabel("velocity, m/s")
        axes[0].legend(loc="upper right", ncols=3, fontsize=8)
        if tilts:
            for k, (name, ink) in enumerate(inks[:2]):
                axes[1].step(t, leans[:, k], where="post", color=ink, label=name)
            axes[1].set_ylabel("tilt, degrees")
        axes[-1].step(t, rows[:, 3], where="post", color=OTHER)
        axes[-1].set_ylabel("turn, degrees/s")
        axes[-1].set_xlabel("time, s")
        begin = 0
        for i in range(1, len(t) + 1):
            if i == len(t) or kinds[i] != kinds[begin]:
                if (word := kinds[begin]) is not None:
                    end = t[i] if i < len(t) else t[-1]
                    for ax in axes:
                        ax.axvspan(t[begin], end, color=FAINT, alpha=0.18, linewidth=0)
                    axes[0].text(t[begin], 1.01, word, transform=axes[0].get_xaxis_transform(), fontsize=7)
                begin = i

    return svg(draw, 9.6, 5.4 if tilts else 3.8, "commands")


def verdicts(log: FlightLog) -> str:
    """Draw the verdicts on the frames as bars."""
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

    return svg(draw, 9.6, 0.75 + 0.32 * len(ordered), "verdicts")


def stages(log: FlightLog) -> str:
    """Draw the durations of each stage as a histogram over a logarithmic axis."""
    named = [(name, np.maximum(values, 1e-6)) for name, values in log.stage_s.items() if values]

    def draw(figure: Figure) -> None:
        low, high = min(values.min() for _, values in named), max(values.max() for _, values in named)
        edges = np.geomspace(1e3 * low / 1.1, 1e3 * high * 1.1, 60)
        axes = figure.subplots(len(named), 1, sharex=True, squeeze=False)[:, 0]
        for ax, (name, values) in zip(axes, named, strict=True):
            ax.hist(1e3 * values, bins=edges, color=_FUSED)
            ax.axvline(1e3 * float(np.median(values)), color=INK, linewidth=0.8)
            ax.set_ylabel(name, rotation=0, horizontalalignment="right", verticalalignment="center")
            ax.set(xscale="log", yticks=[])
        axes[-1].set_xlabel("ms; the line is the median")

    return svg(draw, 9.6, 0.8 + 0.6 * len(named), "stages")


def _tracks(log: FlightLog, series: Sequence[Series]) -> list[tuple[str, F64, dict[str, object]]]:
    """Return (name, positions over the pad, line style) for truth first, then for every path that knew its heading."""
    out: list[tuple[str, F64, dict[str, object]]] = []
    if log.truth:
        d = np.array([s.d_body_pad_level for s in log.truth])
        yaw = np.array([s.yaw_rad for s in log.truth])
        out.append(("truth", body_over_pad(d, yaw), {"color": INK, "linewidth": 3.0, "alpha": 0.35}))
    for s in series:
        if s.is_path:
            out.append((s.name, body_over_pad(s.d, s.yaw_rad), {"color": colour(s.name), "linewidth": 1.3}))
    return out


def _plot(ax: Axes, s: Series, y: F64, wraps: bool) -> None:
    if s.is_path:
        ax.plot(s.t_s, _broken_at_wraps(y) if wraps else y, color=colour(s.name), gid=_gid(s.name))
        return
    ink: dict[str, Any] = {"color": colour(s.name), "alpha": 0.75, "gid": _gid(s.name)}
    if len(y) <= _MANY_POINTS:
        ax.plot(s.t_s, y, MARKERS.get(s.name, "."), markersize=2.6, markeredgewidth=0.6, **ink)
        return
    _dots(ax, s.t_s, y, **ink)


def _fit(ax: Axes, leading: Sequence[F64]) -> None:
    """Show the leading values with some room, so that one wild estimate does not flatten all the rest."""
    joined = np.concatenate([np.asarray(v, dtype=float).ravel() for v in leading]) if leading else np.zeros(0)
    joined = joined[np.isfinite(joined)]
    if len(joined):
        low, high = float(np.min(joined)), float(np.max(joined))
        room = max(0.15 * (high - low), 0.2)
        ax.set_ylim(low - room, high + room)


def _phases(axes: Sequence[Axes], log: FlightLog) -> None:
    """Draw a thin line where a phase begins, and its name above the top panel; of a crowd only the first is named."""
    low, high = axes[0].get_xlim()
    last = -math.inf
    for change in log.phases:
        t = seconds_between(log.started, change.at)
        for ax in axes:
            ax.axvline(t, color=FAINT, linewidth=0.9, linestyle=(0, (3, 2)))
        if t - last < 0.025 * (high - low):
            continue
        last = t
        name = change.phase.replace("_", " ")
        axes[0].text(t, 1.02, name, transform=axes[0].get_xaxis_transform(), fontsize=7, rotation=30, va="bottom")


def _broken_at_wraps(degrees: F64) -> F64:
    """Return the degrees over time with a gap where they jump from one end of the circle to the other."""
    out = np.array(degrees, dtype=float)
    out[1:][np.abs(np.diff(degrees)) > 180.0] = np.nan
    return out


def _gid(name: str) -> str:
    return f"series-{name}"
