"""The plots of a campaign's report. Each is narrow, so that its letters can be read on a phone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from companion.tools.report.svg import FAINT, INK, draw_pad, svg
from estimator.contracts.geometry import F64
from estimator.vision.pad import Pad
from sitl.campaign.figures import Effect, SuccessMap
from sitl.campaign.summary import wilson

_WIDTH_IN = 4.8
_GOOD, _BAD, _BLUE, _ORANGE = "#0a9d76", "#d55e00", "#1f86c9", "#e69f00"
_DOTS_MAX = 3000
"""Dots of a scatter plot; of more flights a seeded choice is drawn."""
_STEPS_MAX = 300
_SUCCESS = LinearSegmentedColormap.from_list("success", ["#b3441e", "#e69f00", "#f0e442", "#56b4e9", "#0a9d76"])
"""From failure to success; its ends differ in lightness too."""


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


def effect(of: Effect) -> str:
    """Draw success and touchdown error against one varied key."""

    def draw(figure: Figure) -> None:
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
        numeric = not any(isinstance(value, str | bool) for value in of.values)
        x = np.array(of.values, dtype=float) if numeric else np.arange(len(of.values), dtype=float)
        top.fill_between(x, of.low, of.high, color=_GOOD, alpha=0.22, linewidth=0)
        top.plot(x, of.shares, "o-", color=_GOOD, markersize=4)
        top.set(ylim=(-0.02, 1.04), ylabel="good flights")
        top.yaxis.set_major_formatter(PercentFormatter(1.0))
        bottom.plot(x, 100.0 * of.lateral_m, "s-", color=_BLUE, markersize=4)
        bottom.set(ylabel="error, cm", xlabel=of.key)
        bottom.set_ylim(0.0, 115.0 * float(np.nanmax(of.lateral_m)) if np.isfinite(of.lateral_m).any() else 1.0)
        if not numeric:
            bottom.set_xticks(x, [str(value) for value in of.values])

    return svg(draw, _WIDTH_IN, 3.8, f"effect-{_id(of.key)}")


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
