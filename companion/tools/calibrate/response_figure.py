"""Draw what was asked of a vehicle, what it reported, and what the identified response makes of the first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from companion.guidance.response_fit import STEP_S, ClimbFit, Fitted, FlightCourse, TiltFit
from companion.tools.calibrate.flown_courses import FlownCourses
from estimator.contracts.errors import unusable

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
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=110, format="png")
    except OSError as why:
        raise unusable(f"--plot {path}", why) from why


def _panel(axes: Axes, course: FlightCourse, fitted: Fitted, k: int, name: str) -> None:
    t = STEP_S * np.arange(course.asked.shape[0])
    asked = np.where(course.asked[:, k] == course.reported[:, k], np.nan, course.asked[:, k])  # where nobody asked
    axes.step(t, asked, where="post", color=_ASKED, lw=0.9, label="asked")
    axes.plot(t, course.reported[:, k] - fitted.offset[:, k], color=_REPORTED, lw=1.8, label="reported less its offset")
    axes.plot(t, fitted.model[:, k], color=_MODEL, lw=1.0, label="model")
    axes.set_ylabel(name)
    axes.grid(alpha=0.25)
