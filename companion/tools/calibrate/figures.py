"""Draw a calibration's figures: coverage by corners, residuals, a vehicle's response as reported and identified."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from companion.base.version import MARK
from companion.guidance.law.response_fit import STEP_S, ClimbFit, Fitted, FlightCourse, TiltFit
from companion.settings.load import whole
from companion.tools.calibrate.board import BoardView
from companion.tools.calibrate.flight_views import FlownCourses
from companion.tools.calibrate.guide import CELLS, coverage
from companion.tools.calibrate.solve import Solution
from estimator.contracts.errors import file_errors

_ASKED, _REPORTED, _MODEL = "#9a9a9a", "#1f86c9", "#d55e00"


def write_response(path: Path, title: str, courses: FlownCourses, tilt: TiltFit, climb: ClimbFit | None) -> None:
    """Write a PNG with a panel for each axis.

    Raises:
        BadInput: the file cannot be written.
    """
    with_climb = climb is not None and courses.climb is not None
    figure = Figure(figsize=(11.0, 8.4 if with_climb else 5.8), layout="constrained")
    FigureCanvasAgg(figure)
    panels = np.atleast_1d(figure.subplots(3 if with_climb else 2, 1))
    t = tilt.response
    figure.suptitle(
        f"{title}: tilt delay {1e3 * t.delay_s:.0f} ms (sigma {1e3 * (t.delay_sigma_s or 0.0):.0f}), "
        f"{t.frequency_rad_s:.2f} rad/s, damping {t.damping:.2f}",
        size=11,
    )
    for k, name in enumerate(("forward", "right")):
        assert courses.tilt is not None
        _panel(panels[k], courses.tilt, tilt.fitted, k, f"tilt {name}, m/s²")
    if climb is not None and courses.climb is not None:
        c = climb.response
        _panel(panels[2], courses.climb, climb.fitted, 0, "descent, m/s")
        panels[2].set_title(f"climb delay {1e3 * c.delay_s:.0f} ms, lag {1e3 * c.lag_s:.0f} ms", size=10, loc="left")
    panels[0].legend(loc="upper right", ncols=3, fontsize=8)
    panels[-1].set_xlabel("s")
    with file_errors(f"--plot {path}"):
        _save(figure, path)


def _panel(axes: Axes, course: FlightCourse, fitted: Fitted, k: int, name: str) -> None:
    t = STEP_S * np.arange(course.asked.shape[0])
    asked = np.where(course.asked[:, k] == course.reported[:, k], np.nan, course.asked[:, k])  # where no command was given
    axes.step(t, asked, where="post", color=_ASKED, lw=0.9, label="asked")
    axes.plot(t, course.reported[:, k] - fitted.offset[:, k], color=_REPORTED, lw=1.8, label="reported less its offset")
    axes.plot(t, fitted.model[:, k], color=_MODEL, lw=1.0, label="model")
    axes.set_ylabel(name)
    axes.grid(alpha=0.25)


def write_coverage(views: Sequence[BoardView], size: tuple[int, int], path: Path) -> None:
    """Write a PNG with every corner of every view, and the cells that hold none."""
    w, h = size
    figure, axes = _figure(7.2, 6.6 * h / w + 0.9)
    counts = coverage(views, size)
    for row in range(CELLS[1]):
        for column in range(CELLS[0]):
            empty = counts[row, column] == 0
            corner = (column * w / CELLS[0] - 0.5, row * h / CELLS[1] - 0.5)
            colour = "#f4c7c3" if empty else "#e3efe3"
            axes.add_patch(_patch(corner, w / CELLS[0], h / CELLS[1], colour))
            if empty:
                axes.text(
                    corner[0] + w / CELLS[0] / 2, corner[1] + h / CELLS[1] / 2, "no corner", ha="center", va="center", size=8
                )
    for view in views:
        axes.plot(view.uv_px[:, 0], view.uv_px[:, 1], ".", ms=5, color="#1f4e79", alpha=0.7, mew=0)
    _image_axes(axes, size)
    covered = np.mean(counts > 0)
    axes.set_title(f"{len(views)} views, {sum(len(v.ids) for v in views)} corners, {covered:.0%} of the image covered", size=10)
    _save(figure, path)


def write_residuals(solution: Solution, path: Path) -> None:
    """Write a PNG with the residuals as enlarged arrows over the image, and each view's error."""
    size = (solution.camera.width, solution.camera.height)
    figure = Figure(figsize=(11.0, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(1.6, 1.0))
    uv = np.concatenate([f.view.uv_px for f in solution.fits])
    residual = np.concatenate([f.residual_px for f in solution.fits])
    enlarged = 0.03 * size[0] / max(float(np.percentile(np.linalg.norm(residual, axis=1), 95)), 1e-6)
    left.quiver(
        uv[:, 0], uv[:, 1], residual[:, 0], residual[:, 1], angles="xy", scale_units="xy", scale=1 / enlarged, width=0.0016,
        color="#1f4e79",
    )  # fmt: skip
    left.plot(solution.camera.cx, solution.camera.cy, "+", color="#b03a2e", ms=12)
    _image_axes(left, size)
    left.set_title(f"residuals, {enlarged:.0f} times enlarged; + principal point", size=10)
    every = [(f, True) for f in solution.fits] + [(f, False) for f in solution.left_out]
    colours = ["#1f4e79" if used else "#b03a2e" for _, used in every]
    right.bar(range(len(every)), [f.rms_px for f, _ in every], color=colours)
    right.axhline(solution.rms_px, color="#444444", lw=1, ls="--")
    right.set_xlabel("view (red: left out)")
    right.set_ylabel("rms, px")
    right.set_ylim(0.0, 3.5 * max(f.rms_px for f in solution.fits))
    right.set_title(f"{solution.rms_px:.3f} px rms in all; distortion {solution.model}", size=10)
    _save(figure, path)


def _figure(width_in: float, height_in: float):  # type: ignore[no-untyped-def]
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots()


def _patch(corner: tuple[float, float], width: float, height: float, colour: str):  # type: ignore[no-untyped-def]
    from matplotlib.patches import Rectangle

    return Rectangle(corner, width, height, facecolor=colour, edgecolor="white")


def _image_axes(axes, size: tuple[int, int]) -> None:  # type: ignore[no-untyped-def]
    axes.set_xlim(-0.5, size[0] - 0.5)
    axes.set_ylim(size[1] - 0.5, -0.5)
    axes.set_aspect("equal")
    axes.set_xlabel("px")


def _save(figure: Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole(path) as beside:
        figure.savefig(beside, dpi=110, metadata=MARK)
