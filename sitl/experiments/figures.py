"""The figures of the thesis' chapter 5, drawn from the flights flown again, as PNG files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from companion.recording.palette import MARKERS, OTHER, colour
from estimator.contracts.geometry import wrap_pi
from sitl.experiments.chapter5 import QUANTITIES, Chapter5, Landed, error_of, headings
from sitl.experiments.flown import METHODS, ExperimentFlight
from sitl.experiments.printed import HEIGHTS_M, printed

_SHOWN = {"best": "fused"}
_UNIT = {"x": "mm", "y": "mm", "z": "mm", "yaw": "degrees"}
_PATHS = ("median_mean", "dead_reckoning", "ekf")
_DPI = 80
_MOST = {"x": 150.0, "y": 150.0, "z": 300.0, "yaw": 20.0}
"""Ends of the error axes; errors beyond them are drawn at the edge."""


def draw(chapter: Chapter5, folder: Path) -> list[str]:
    """Draw every figure into a folder and return the names of the files.

    Raises:
        OSError: the folder cannot be written.
    """
    figures = {
        "experiments_up_and_down.png": _up_and_down(chapter.up_and_down),
        "experiments_hover.png": _hover(chapter),
        "experiments_step.png": _step(chapter.step),
        "experiments_around.png": _around(chapter.around),
        "experiments_turn.png": _turn(chapter),
        "experiments_landing.png": _landings((chapter.landing, "PID and planner"), (chapter.external, "external controller")),
    }
    for name, figure in figures.items():
        figure.savefig(folder / name, dpi=_DPI, metadata={"Software": None})
    return list(figures)


def _figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = [figure.add_subplot(rows, columns, i + 1) for i in range(rows * columns)]
    for one in axes:
        one.grid(alpha=0.3)
        one.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _up_and_down(flown: ExperimentFlight) -> Figure:
    figure, axes = _figure(4, 1, (9.0, 10.0))
    times = [t for t, _, _ in flown.truth if t >= min((e.t_s for e in flown.sightings), default=0.0)]
    heights = [xyz[2] for t, xyz, _ in flown.truth if t >= times[0]]
    for ax, quantity in zip(axes, QUANTITIES, strict=True):
        for method in METHODS:
            rows = [(e.t_s, error) for e in flown.of(method) if (error := error_of(e, quantity)) is not None]
            if rows:
                t, errors = np.array(rows).T
                shown = np.clip(errors, -_MOST[quantity], _MOST[quantity])
                name = _SHOWN.get(method, method)
                ax.plot(t, shown, MARKERS.get(name, "."), ms=3, color=colour(name), label=method, alpha=0.8)
        ax.set_ylabel(f"error of {quantity}, {_UNIT[quantity]}")
        ax.set_ylim(-_MOST[quantity], _MOST[quantity])
        beside = ax.twinx()
        beside.plot(times, heights, color=OTHER, alpha=0.5)
        beside.set_ylabel("true height, m")
    axes[0].legend(loc="upper right", ncols=5, fontsize=8)
    axes[-1].set_xlabel("time, s")
    return figure


def _hover(chapter: Chapter5) -> Figure:
    figure, axes = _figure(2, 2, (10.0, 7.5))
    for ax, quantity in zip(axes, QUANTITIES, strict=True):
        table = chapter.hover.table(quantity)
        for i, method in enumerate(METHODS):
            heights = [h for h in HEIGHTS_M if (h, method) in table]
            name = _SHOWN.get(method, method)
            if heights:
                x = np.array(heights) * (1.0 + 0.03 * (i - 2))
                means, stds = [table[h, method].mean for h in heights], [table[h, method].std for h in heights]
                ax.errorbar(x, means, stds, fmt=MARKERS.get(name, "."), ms=5, color=colour(name), label=f"{method}, here")
            told = [(h, row) for h in HEIGHTS_M if (row := printed(quantity, h, method)) is not None]
            if told:
                x = np.array([h for h, _ in told]) * (1.0 + 0.03 * (i - 2) + 0.1)
                mean, std = [row.mean or 0.0 for _, row in told], [row.std or 0.0 for _, row in told]
                ax.errorbar(x, mean, std, fmt=MARKERS.get(name, "."), ms=5, color=colour(name), mfc="none", alpha=0.5)
        ax.set_xscale("log")
        ax.set_xticks(HEIGHTS_M, [f"{h:g}" for h in HEIGHTS_M])
        ax.set_yscale("symlog", linthresh=10.0 if quantity != "yaw" else 1.0)
        ax.set_xlabel("height, m")
        ax.set_ylabel(f"error of {quantity}, {_UNIT[quantity]}")
    axes[0].legend(fontsize=8)
    figure.suptitle("mean and one standard deviation while hovering; hollow: as the thesis printed it", fontsize=10)
    return figure


def _step(flown: ExperimentFlight) -> Figure:
    figure, axes = _figure(1, 1, (9.0, 4.5))
    _true(axes[0], flown, 2)
    for path in _PATHS:
        told = flown.of(path)
        axes[0].plot([e.t_s for e in told], [e.xyz_m[2] for e in told], color=colour(path), label=path)
    for method in METHODS[:3]:
        seen = flown.of(method)
        axes[0].plot([e.t_s for e in seen], [e.xyz_m[2] for e in seen], MARKERS[method], ms=3, color=colour(method), label=method)
    axes[0].set(xlabel="time, s", ylabel="height, m", ylim=(0.7, 3.5))
    axes[0].legend(fontsize=8)
    return figure


def _around(flown: ExperimentFlight) -> Figure:
    figure, axes = _figure(1, 2, (10.0, 4.5))
    true = np.array([xyz for _, xyz, _ in flown.truth])
    axes[0].plot(true[:, 0], true[:, 1], color="black", lw=1.0, label="truth")
    for path in ("dead_reckoning", "ekf"):
        told = flown.of(path)
        t = np.array([e.t_s for e in told])
        xyz = np.array([e.xyz_m for e in told])
        xyz[1:][np.diff(t) > 0.5] = np.nan  # no line over a time without a belief
        errors = np.hypot(*(xyz - np.array([e.true_xyz_m for e in told])).T[:2])
        axes[0].plot(xyz[:, 0], xyz[:, 1], color=colour(path), label=path)
        axes[1].plot(t, errors, color=colour(path), label=path)
    seen = flown.of("best")
    axes[1].plot([e.t_s for e in seen], np.zeros(len(seen)), "|", color=OTHER, label="pad in sight")
    axes[0].set(xlabel="x, m", ylabel="y, m", aspect="equal")
    axes[1].set(xlabel="time, s", ylabel="horizontal error, m")
    axes[1].legend(fontsize=8)
    return figure


def _turn(chapter: Chapter5) -> Figure:
    figure, axes = _figure(2, 1, (9.0, 6.0))
    flown = chapter.turn
    axes[0].plot([t for t, _, _ in flown.truth], [math.degrees(yaw) for _, _, yaw in flown.truth], color="black", lw=1.0)
    for method in METHODS:
        name = _SHOWN.get(method, method)
        rows = [(e.t_s, math.degrees(wrap_pi(e.yaw_rad))) for e in flown.of(method) if e.yaw_rad is not None]
        if rows:
            t, yaw = np.array(rows).T
            axes[0].plot(t, yaw, MARKERS.get(name, "."), ms=3, color=colour(name), label=method)
    for method, (t, errors) in headings(flown).items():
        name = _SHOWN.get(method, method)
        axes[1].plot(t, np.clip(errors, -5.0, 5.0), MARKERS.get(name, "."), ms=3, color=colour(name))
    axes[0].set_ylabel("heading, degrees")
    axes[0].legend(fontsize=8)
    axes[1].set(xlabel="time, s", ylabel="error, degrees (cut at 5)")
    return figure


def _landings(*landings: tuple[Landed, str]) -> Figure:
    figure, axes = _figure(len(landings), 3, (10.5, 3.6 * len(landings)))
    for row, (landed, title) in enumerate(landings):
        true = np.array([xyz for _, xyz, _ in landed.flown.truth])
        told = np.array([e.xyz_m for e in landed.flown.of("ekf")])
        for ax, (i, j) in zip(axes[3 * row : 3 * row + 3], ((0, 1), (0, 2), (1, 2)), strict=True):
            ax.plot(true[:, i], true[:, j], color="black", lw=1.0, label="truth")
            if len(told):
                ax.plot(told[:, i], told[:, j], color=colour("ekf"), lw=1.0, label="ekf")
            ax.set(xlabel=f"{'xyz'[i]}, m", ylabel=f"{'xyz'[j]}, m")
        axes[3 * row].set_title(title, fontsize=10)
        axes[3 * row].legend(fontsize=8)
    return figure


def _true(ax: Axes, flown: ExperimentFlight, i: int) -> None:
    rows: Sequence[tuple[float, float]] = [(t, float(xyz[i])) for t, xyz, _ in flown.truth]
    ax.plot([t for t, _ in rows], [v for _, v in rows], color="black", lw=1.0, label="truth")
