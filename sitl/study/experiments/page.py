"""The page of the experiments as Markdown, and its figures as PNG, PDF and SVG files, each with what it shows as CSV.

Both set the thesis as printed beside its methods as they are here and our best estimate.
"""

import csv
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from companion.base.version import MARK
from companion.recording.palette import MARKERS, OTHER, colour
from estimator.contracts.geometry import wrap_pi
from sitl.study.experiments.chapter5 import (
    HEIGHTS_M,
    QUANTITIES,
    Chapter5,
    HoverFlights,
    Landed,
    Printed,
    Quantity,
    Spread,
    drifts,
    error_of,
    headings,
    hover_table,
    lags,
    printed,
    spread,
)
from sitl.study.experiments.flown import METHODS, ExperimentFlight
from sitl.study.experiments.photographs import Photographs

_TITLES = {
    "x": "Table 5.1, error of x, mm",
    "y": "Table 5.2, error of y, mm",
    "z": "Table 5.3, error of z, mm",
    "yaw": "Table 5.4, error of the heading, degrees",
}
_NONE = "-"


def page(chapter: Chapter5, photographs: Photographs | None, command: str) -> str:
    """Return the page.

    Args:
        photographs: None where there are none.
        command: the command that made it.
    """
    parts = [
        "# The thesis' experiments again",
        f"Made by `{command}`. The thesis (Sundvoll 2020, chapter 5) flew over a motionless ship in a simulator without wind; "
        "this is the same with the simulated AR.Drone. Where methods are compared it reports its attitude without error; a real "
        "one errs by half a degree: 9 mm of x and y for each metre of height. Registration allows for that and also weighs the "
        "tilt that it sees, which shifts it by centimetres at 10 m. Dead reckoning and the landings have all errors of "
        "a real one. Axes are the thesis': x ahead of the pad along the drone's nose, y to the left, z up. \"Here\" is the "
        'thesis\' method with its errors corrected, "best" the estimate of all methods together. Each frame counts once.',
        "## 5.1.2 Up and down",
        heights_table(chapter.up_and_down),
        "![Errors of every method between 0.2 and 5 m](experiments_up_and_down.png)",
        "## 5.1.3 Hovering at six heights",
        "Mean ± standard deviation of the error, and share of frames with an estimate. A dash or no row is no estimate; cells "
        "that cannot be read in the thesis are empty.",
        *(hovering(chapter.hover, quantity) for quantity in QUANTITIES),
        "![Mean and standard deviation of each method at six heights](experiments_hover.png)",
        "## 5.1.4 A step through the filter",
        _lags(chapter),
        "![Height during the step from 1 to 3 m](experiments_step.png)",
        "## 5.1.5 Dead reckoning around the ship",
        _drifts(chapter),
        "![Track around the ship, and the error over time](experiments_around.png)",
        "## 5.1.6 A full turn",
        _headings(chapter),
        "![Heading during a full turn](experiments_turn.png)",
        "## 5.1.7 and 5.1.8 Landing",
        _landings(chapter),
        "![Tracks of both landings from three sides](experiments_landing.png)",
        "## 5.2 The real pad",
        _photographs(photographs),
    ]
    return "\n\n".join(parts) + "\n"


class ChapterPage(NamedTuple):
    """The page of the experiments with its figures, as a notebook shows it."""

    chapter: Chapter5

    def _repr_html_(self) -> str:
        drawn = {}
        for name, (figure, _) in _figures(self.chapter).items():
            figure.savefig(svg := StringIO(), format="svg")
            drawn[f"experiments_{name}.png"] = svg.getvalue()
        return in_html(page(self.chapter, None, "decklander experiments"), drawn)


def in_html(text: str, drawn: Mapping[str, str]) -> str:
    """Return a page of this module as HTML; its figures are the drawings of their names."""
    out = []
    for part in text.strip().split("\n\n"):
        if part.startswith("|"):
            head, _, *rows = (line[1:-1].split("|") for line in part.splitlines())
            cells = [
                "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row)
                for tag, row in (("th", head), *(("td", r) for r in rows))
            ]
            out.append("<table>" + "".join(f"<tr>{row}</tr>" for row in cells) + "</table>")
        elif image := re.fullmatch(r"!\[.*\]\((.*)\)", part):
            out.append(drawn[image[1]])
        else:
            level = len(part) - len(part.lstrip("#"))
            plain = re.sub(
                r"\*\*(.*?)\*\*", r"<b>\1</b>", re.sub("`(.*?)`", r"<code>\1</code>", escape(part.lstrip("# "), quote=False))
            )
            out.append(f"<h{level}>{plain}</h{level}>" if level else f"<p>{plain}</p>")
    return "\n".join(out)


def _table(heads: str, rows: Iterable[Sequence[str]]) -> str:
    """Return a table of Markdown; the headings are separated by bars."""
    return "\n".join((f"| {heads} |", f"|{'---|' * (heads.count('|') + 1)}", *(f"| {' | '.join(row)} |" for row in rows)))


def heights_table(flown: ExperimentFlight) -> str:
    """Return the table of section 5.1.2."""
    rows = []
    by_thesis = {"ellipse": "1.0 m and up", "arrow": "0.5 to 1.2 m", "corners": "0.2 to 1.0 m"}
    for method in METHODS:
        heights = sorted(float(e.true_xyz_m[2]) for e in flown.of(method))
        here = (_NONE, "0 %", _NONE)
        if (found := spread(flown, method, "z")) is not None:
            here = (f"{heights[0]:.1f} to {heights[-1]:.1f} m", f"{100 * found.available:.0f} %", f"{found.std:.1f}")
        rows.append((method, by_thesis.get(method, ""), *here))
    return _table("method | heights with an estimate, thesis | here | frames | standard deviation of z, mm", rows)


def hovering(flights: HoverFlights, quantity: Quantity) -> str:
    """Return the table of a quantity of section 5.1.3."""
    found, rows = hover_table(flights, quantity), []
    for height_m in flights:
        for method in METHODS:
            was, now = printed(quantity, height_m, method), found.get((height_m, method))
            if quantity == "yaw" and method == "ellipse":
                continue
            if was is not None or now is not None:
                before = ("", "") if was is None else _cells(was, 1)
                rows.append((f"{height_m:g} m", method, *before, *_cells(now, 2 if quantity == "yaw" else 1)))
    return f"**{_TITLES[quantity]}**\n\n{_table('height | method | thesis | | here |', rows)}"


def _cells(found: Printed | Spread | None, digits: int) -> tuple[str, str]:
    if found is None:
        return _NONE, "0 %"
    return f"{found.mean:.{digits}f} ± {found.std:.{digits}f}", f"{100 * found.available:.0f} %"


def _lags(chapter: Chapter5) -> str:
    rows = [("thesis, as its text says", "0.6 s (0.1 vision, 0.5 filter; the filter's own delay is 0.2 s)", "")]
    rows += [(one.path, f"{1e3 * one.lag_s:.0f} ms", f"{one.error_after_mm:.1f} mm") for one in lags(chapter.step)]
    return _table("path | lag on the way up | height at rest, standard deviation", rows)


def _drifts(chapter: Chapter5) -> str:
    found = drifts(chapter.around)
    if not found:
        return "The pad never left the picture."
    rows = [
        (one.path, f"{one.held_s:.0f} s", f"{one.end_m:.2f} m", f"{one.sigma_m:.2f} m", f"{one.most_m:.2f} m") for one in found
    ]
    return f"The pad was out of view for {found[0].blind_s:.0f} s. The thesis printed no figure.\n\n" + _table(
        "path | held for | horizontal error then | claimed, one sigma of an axis | largest error", rows
    )


def _headings(chapter: Chapter5) -> str:
    rows = []
    for method, (_, errors) in headings(chapter.turn).items():
        share = 100 * len(errors) / max(1, chapter.turn.frames)
        rows.append((method, f"{share:.0f} %", f"{errors.mean():.2f} ± {errors.std():.2f}", f"{float(abs(errors).max()):.2f}"))
    return _table("method | frames with a heading | mean ± standard deviation, degrees | worst", rows) + (
        "\n\nThe corners of an H look the same after half a turn: their heading counts up to half a turn, here and in table 5.4."
    )


def _landings(chapter: Chapter5) -> str:
    rows = []
    for name, landed in (("PID and planner", chapter.landing), ("external controller", chapter.external)):
        words = "time ran out" if landed.outcome is None else landed.outcome.value
        where = _NONE if landed.lateral_m is None else f"{100 * landed.lateral_m:.1f} cm"
        rows.append((name, words, where, f"{landed.duration_s:.0f} s"))
    return (
        "From (1, 2, 3.5) m at -90 degrees. The thesis printed no figures; a proportional law stands for its external "
        "controller, which was not published.\n\n" + _table("controller | outcome | from the pad's centre | time", rows)
    )


def _photographs(photographs: Photographs | None) -> str:
    if photographs is None:
        return "No photographs were given (`--photos DIR`)."
    rows = []
    for method in METHODS:
        number, errors = photographs.found.get(method, 0), (_NONE, _NONE)
        if number:
            errors = f"{photographs.median_percent[method]:.2f} % of range", f"{photographs.p95_percent[method]:.2f} %"
        rows.append((method, f"{100 * number / max(1, photographs.number):.0f} %", *errors))
    return (
        f"The images of the outdoor flight were not published: these are {photographs.number} photographs of the printed pad, "
        "against poses by hand labels. The thesis' own code finds the pad in 81 % of them and errs by 32 % of the range in the "
        "median.\n\n" + _table("method | found | error, median | 95th percentile", rows)
    )


_SHOWN = {"best": "fused"}
_UNIT = {"x": "mm", "y": "mm", "z": "mm", "yaw": "degrees"}
_PATHS = ("median_mean", "dead_reckoning", "ekf")
_DPI = 80
_FORMATS = {"png": "Software", "pdf": "CreationDate", "svg": "Date"}
"""Endings of a figure's files, and what none of them says, so that a flight makes the same bytes again."""
_COLUMNS = ("flight", "t_s", "name", *(f"{w}{k}" for w in ("", "true_") for k in ("x_m", "y_m", "z_m", "yaw_deg")), "sigma_m")
_MOST = {"x": 150.0, "y": 150.0, "z": 300.0, "yaw": 20.0}
"""Ends of the error axes; errors beyond them are drawn at the edge."""


def _figures(chapter: Chapter5) -> dict[str, tuple[Figure, dict[str, ExperimentFlight]]]:
    """Return each figure by its name, and the flights that it shows."""
    landings = (chapter.landing, "PID and planner"), (chapter.external, "external controller")
    return {
        "up_and_down": (_draw_up_and_down(chapter.up_and_down), {"up and down": chapter.up_and_down}),
        "hover": (_hover(chapter), {f"{height_m:g} m": flown for height_m, flown in chapter.hover.items()}),
        "step": (_step(chapter.step), {"step": chapter.step}),
        "around": (_around(chapter.around), {"around": chapter.around}),
        "turn": (_turn(chapter), {"turn": chapter.turn}),
        "landing": (_draw_landings(*landings), {title: landed.flown for landed, title in landings}),
    }


def draw(chapter: Chapter5, folder: Path) -> None:
    """Draw every figure into a folder, and write what it shows beside it.

    Raises:
        OSError: the folder cannot be written.
    """
    for name, (figure, flights) in _figures(chapter).items():
        for ending, unsaid in _FORMATS.items():
            figure.savefig(folder / f"experiments_{name}.{ending}", dpi=_DPI, metadata={unsaid: None, **MARK})
        with (folder / f"experiments_{name}.csv").open("w", newline="") as file:
            write = csv.writer(file)
            write.writerow(_COLUMNS)
            write.writerows(row for flight, flown in flights.items() for row in _rows(flight, flown))


def _rows(flight: str, flown: ExperimentFlight) -> Iterator[Sequence[object]]:
    """Yield every estimate of a flight beside the truth, and the truth at 50 Hz."""
    for e in (*flown.sightings, *flown.beliefs):
        yaw = "" if e.yaw_rad is None else math.degrees(e.yaw_rad)
        yield flight, e.t_s, e.name, *e.xyz_m, yaw, *e.true_xyz_m, math.degrees(e.true_yaw_rad), e.sigma_m
    for t_s, xyz_m, yaw_rad in flown.truth:
        yield flight, t_s, "truth", *xyz_m, math.degrees(yaw_rad), *xyz_m, math.degrees(yaw_rad), 0.0


def _figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = [figure.add_subplot(rows, columns, i + 1) for i in range(rows * columns)]
    for one in axes:
        one.grid(alpha=0.3)
        one.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _draw_up_and_down(flown: ExperimentFlight) -> Figure:
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
        table = hover_table(chapter.hover, quantity)
        for i, method in enumerate(METHODS):
            heights = [h for h in HEIGHTS_M if (h, method) in table]
            name = _SHOWN.get(method, method)
            if heights:
                x = np.array(heights) * (1.0 + 0.03 * (i - 2))
                means, stds = [table[h, method].mean for h in heights], [table[h, method].std for h in heights]
                ax.errorbar(x, means, stds, fmt=MARKERS.get(name, "."), ms=5, color=colour(name), label=f"{method}, here")
            reported = [(h, row) for h in HEIGHTS_M if (row := printed(quantity, h, method)) is not None]
            if reported:
                x = np.array([h for h, _ in reported]) * (1.0 + 0.03 * (i - 2) + 0.1)
                mean, std = [row.mean for _, row in reported], [row.std for _, row in reported]
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
    axes[0].plot([t for t, _, _ in flown.truth], [xyz[2] for _, xyz, _ in flown.truth], color="black", lw=1.0, label="truth")
    for path in _PATHS:
        reported = flown.of(path)
        axes[0].plot([e.t_s for e in reported], [e.xyz_m[2] for e in reported], color=colour(path), label=path)
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
        reported = flown.of(path)
        t = np.array([e.t_s for e in reported])
        xyz = np.array([e.xyz_m for e in reported])
        xyz[1:][np.diff(t) > 0.5] = np.nan  # no line over a time without a belief
        errors = np.hypot(*(xyz - np.array([e.true_xyz_m for e in reported])).T[:2])
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


def _draw_landings(*landings: tuple[Landed, str]) -> Figure:
    figure, axes = _figure(len(landings), 3, (10.5, 3.6 * len(landings)))
    for row, (landed, title) in enumerate(landings):
        true = np.array([xyz for _, xyz, _ in landed.flown.truth])
        reported = np.array([e.xyz_m for e in landed.flown.of("ekf")])
        for ax, (i, j) in zip(axes[3 * row : 3 * row + 3], ((0, 1), (0, 2), (1, 2)), strict=True):
            ax.plot(true[:, i], true[:, j], color="black", lw=1.0, label="truth")
            if len(reported):
                ax.plot(reported[:, i], reported[:, j], color=colour("ekf"), lw=1.0, label="ekf")
            ax.set(xlabel=f"{'xyz'[i]}, m", ylabel=f"{'xyz'[j]}, m")
        axes[3 * row].set_title(title, fontsize=10)
        axes[3 * row].legend(fontsize=8)
    return figure
