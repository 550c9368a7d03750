"""The tables of the report, as HTML: contacts, errors against truth, verdicts, innovations and times."""

import math
from html import escape

from companion.tools.report.figures import Series, deck_rows, error_rows, timing_rows
from companion.tools.report.flight_log import FlightLog
from companion.tools.report.innovations import InnovationSeries
from companion.tools.report.page_parts import swatch, table
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import seconds_between

_FEW = 20
"""Hundredths are no statistic below this many samples."""


def contacts(log: FlightLog, zero_s: float = 0.0) -> str:
    """Return every contact: when, with what, where and how fast; times count from `zero_s` after the log's start."""
    if not log.contacts:
        return '<p class="note">No touchdown was recorded.</p>'
    rows = []
    for k, c in enumerate(log.contacts, 1):
        after_s = seconds_between(log.started, c.at) - zero_s
        where = f'<button type="button" data-t="{after_s:.3f}">{after_s:.2f} s</button>'
        along, starboard = (length(x) for x in c.p_pad_m)
        surface = c.surface or ("pad" if c.on_pad else "not the pad")
        rows.append(
            [
                str(k), where, escape(surface), length(c.lateral_m), along, starboard, degrees(c.yaw_rad),
                speed(c.vertical_speed_m_s), speed(c.lateral_speed_m_s), escape(c.phase or "-"),
            ]
        )  # fmt: skip
    heads = [
        "contact", "after", "with", "off centre", "along<br>the arrow", "to<br>starboard", "heading", "down", "sideways",
        "guidance",
    ]  # fmt: skip
    return table(heads, rows)


def errors(log: FlightLog, series: list[Series]) -> str:
    """Return each series' errors against truth."""
    if not log.truth or not series:
        return ""
    rows = []
    for r in error_rows(log, series):
        turns = ("-" if math.isnan(v) else f"{math.degrees(v):.2f}&deg;" for v in (r.yaw_median_rad, r.yaw_p95_rad))
        rows.append(
            [
                f"{swatch(r.name)} {escape(r.name.replace('_', ' '))}",
                str(r.count),
                "-" if r.fraction is None else f"{100 * r.fraction:.1f} %",
                *(length(v) for v in (r.lateral_median_m, r.lateral_p95_m, r.down_bias_m, r.down_p95_m)),
                *turns,
                number(r.nees),
            ]
        )
    heads = ["method or path", "estimates", "of frames", "lateral<br>median", "lateral<br>95 %", "down<br>bias"]
    return (
        table([*heads, "down<br>95 %", "heading<br>median", "heading<br>95 %", "NEES<br>mean"], rows)
        + '<p class="note">NEES: the square of a path\'s error in place, velocity and heading by its covariance, over its '
        "components; 1 when the covariance is honest, more when it is too small.</p>"
    )


def deck_errors(log: FlightLog) -> str:
    """Return how the deck's forecast tilt differs from truth."""
    rows = [
        [
            f"{r.ahead_s:g} s ahead" if r.ahead_s else "now",
            str(r.count),
            *(f"{math.degrees(v):.2f}&deg;" for v in (r.tilt_median_rad, r.tilt_p95_rad)),
            number(r.nees),
        ]
        for r in deck_rows(log)
        if r.count
    ]
    return table(["the deck", "forecasts", "tilt<br>median", "tilt<br>95 %", "NEES<br>mean"], rows) if rows else ""


def verdicts(log: FlightLog) -> str:
    """Return how many frames ended in each verdict."""
    total = sum(log.verdicts.values())
    if not total:
        return '<p class="note">No frames were counted.</p>'
    rows = [
        [escape(v.value.replace("_", " ")), str(n), f"{100 * n / total:.1f} %"]
        for v, n in sorted(log.verdicts.items(), key=lambda kv: -kv[1])
    ]
    return f'{table(["verdict", "frames", "share"], rows)}<p class="note">{total} frames, each with exactly one verdict.</p>'


def innovations(found: list[InnovationSeries]) -> str:
    """Return what became of the measurements of every path."""
    if not found:
        return ""
    rows = []
    for s in found:
        total, fused = s.verdicts.total(), s.verdicts[Verdict.FUSED]
        refused = ", ".join(f"{n} {v.value.replace('_', ' ')}" for v, n in s.verdicts.most_common() if v is not Verdict.FUSED)
        figures = number(s.nis_mean), number(s.test_ratio_p95)
        rows.append([escape(s.name), str(total), str(fused), str(total - fused), refused or "-", *figures])
    heads = ["path and source", "measurements", "fused", "refused", "of which", "NIS mean", "test ratio<br>95 %"]
    return (
        table(heads, rows)
        + '<p class="note">NIS mean: of what was fused, over the number of components; 1 when the covariance is honest. '
        "Test ratio: NIS over the gate's limit; above 1 is refused. Samples of the IMU count where they were refused.</p>"
    )


def times(log: FlightLog) -> str:
    """Return how long each stage took."""
    rows = []
    for r in timing_rows(log):
        tail = [r.p95_s, r.p99_s] if r.count >= _FEW else [math.nan, math.nan]
        rows.append([escape(r.name), str(r.count), *(_duration(v) for v in (r.median_s, *tail, r.max_s))])
    if not rows:
        return '<p class="note">No times were measured.</p>'
    return table(["stage", "samples", "median", "95 %", "99 %", "longest"], rows)


def number(x: float) -> str:
    """Return a plain number as text."""
    return f"{x:.2f}" if math.isfinite(x) else "-"


def length(metres: float) -> str:
    """Return a length as text, in cm below a metre, as the terminal does."""
    if not math.isfinite(metres):
        return "-"
    return f"{100 * metres:.1f} cm" if abs(metres) < 1.0 else f"{metres:.2f} m"


def speed(metres_s: float) -> str:
    """Return a speed as text."""
    return f"{metres_s:.2f} m/s" if math.isfinite(metres_s) else "-"


def degrees(radians: float) -> str:
    """Return an angle as text, HTML."""
    return f"{math.degrees(radians):.1f}&deg;" if math.isfinite(radians) else "-"


def _duration(seconds: float) -> str:
    return "-" if not math.isfinite(seconds) else f"{1e3 * seconds:.2f} ms"
