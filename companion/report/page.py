"""The report: one folder with one page that needs nothing else, from a flight's log."""

from __future__ import annotations

import math
from html import escape
from importlib.resources import files
from pathlib import Path

from companion.guidance.mission import ENDED
from companion.report.figures import ErrorRow, Series, TimingRow, all_series, error_rows, timing_rows
from companion.report.flight_log import FlightLog
from companion.report.innovations import InnovationSeries, innovation_series
from companion.report.palette import colour
from companion.report.video import video_from_log
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Verdict

PAGE = "index.html"
VIDEO = "flight.mp4"
_FEW = 20
"""Hundredths are no statistic below this many samples."""


def write_report(log: FlightLog, folder: Path, video: Path | None = None) -> Path:
    """Write `folder`/index.html and, unless given, draw the video from the log's kept frames.

    Args:
        log: what the flight left behind; any part may be empty.
        folder: made if missing; a page and a video of these names in it are replaced.
        video: an MP4 already written inside `folder` (see `FlightVideo`).

    Returns:
        The page's path.

    Raises:
        BadInput: the folder cannot be written, or `video` lies outside it or is missing.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as why:
        raise BadInput(f"{folder}: cannot make the report's folder: {why}") from why
    if video is None:
        target = folder / VIDEO
        target.unlink(missing_ok=True)
        video = target if video_from_log(log, target) else None
    elif not video.is_file() or not video.resolve().is_relative_to(folder.resolve()):
        raise BadInput(f"{video}: the report's video must be a file inside {folder}")
    name = None if video is None else video.resolve().relative_to(folder.resolve()).as_posix()
    page = folder / PAGE
    try:
        page.write_text(render(log, name), encoding="utf-8")
    except OSError as why:
        raise BadInput(f"{page}: cannot write the report: {why}") from why
    return page


def render(log: FlightLog, video: str | None) -> str:
    """The page's text. `video` is its address relative to the page."""
    series = all_series(log)
    here = files("companion.report")
    body = "\n".join(
        (
            _head(log),
            _touchdown(log),
            _mission(log),
            _video(video),
            _trajectory(log, series),
            _estimates(log, series),
            _frames(log),
            _innovations(log),
            _commands(log),
            _times(log),
        )
    )
    return document(log.title, f"{body}\n<script>\n{here.joinpath('toggle.js').read_text('utf-8')}</script>")


def document(title: str, body: str, more_style: str = "") -> str:
    """Return a whole page with the style of our reports. `body` is HTML, `more_style` is CSS."""
    style = files("companion.report").joinpath("style.css").read_text("utf-8")
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{style}{more_style}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n"
    )


def _head(log: FlightLog) -> str:
    good = "good" if log.outcome == "landed" and (log.touchdown is None or log.touchdown.on_pad) else ""
    facts = "".join(f"<li>{escape(k)} <b>{escape(v)}</b></li>" for k, v in log.facts)
    return (
        f'<header><h1>{escape(log.title)}</h1><span class="outcome {good}">{escape(log.outcome)}</span></header>\n'
        f'<ul class="facts">{facts}</ul>'
    )


def _touchdown(log: FlightLog) -> str:
    t = log.touchdown
    if t is None:
        return '<p class="note">No touchdown was recorded.</p>'
    after_s = (t.at - log.started) * 1e-9
    cells = [
        ("lateral error at touchdown", _length(t.lateral_m)),
        ("vertical speed", f"{t.vertical_speed_m_s:.2f} m/s"),
        ("lateral speed", f"{t.lateral_speed_m_s:.2f} m/s"),
        ("stands on the pad", "yes" if t.on_pad else "no"),
        ("after", f"{after_s:.1f} s"),
    ]
    cards = "".join(f'<div class="card"><span>{escape(k)}</span><b>{escape(v)}</b></div>' for k, v in cells)
    return f'<div class="cards">{cards}</div>'


def _mission(log: FlightLog) -> str:
    """Return what became of the mission: how it ended and why, and every change of state."""
    if not log.transitions:
        return ""
    ended = next((change for change in reversed(log.transitions) if change.target in ENDED), None)
    told = "" if ended is None else f"<p><b>{escape(ended.target.value)}: {escape(ended.reason.text)}</b></p>"
    rows = "".join(
        f"<tr><td>{(change.at - log.started) * 1e-9:.1f} s</td><td>{escape(change.source.value)}</td>"
        f"<td>{escape(change.target.value)}</td><td>{escape(change.reason.text)}</td></tr>"
        for change in log.transitions
    )
    table = f"<table><tr><th>after</th><th>from</th><th>to</th><th>because</th></tr>{rows}</table>"
    return f"<h2>Mission</h2>{told}<details><summary>{len(log.transitions)} changes of state</summary>{table}</details>"


def _video(video: str | None) -> str:
    if video is None:
        return '<h2>Video</h2><p class="note">No frames were kept.</p>'
    return (
        f'<h2>Video</h2><video controls muted playsinline preload="auto" src="{escape(video, quote=True)}"></video>'
        '<p class="note">Yellow: the pad as the estimate has it. Other colours: what each method saw, in the colours of the '
        "plots.</p>"
    )


def _trajectory(log: FlightLog, series: list[Series]) -> str:
    from companion.report import plots

    if not log.truth and not any(s.is_path for s in series):
        return '<h2>Trajectory</h2><p class="note">Neither truth nor an estimate was recorded.</p>'
    return (
        f"<h2>Trajectory over the pad</h2><figure>{plots.trajectory(log, series)}<figcaption>Position of the drone seen from "
        "the pad, levelled: &#9679; where the record begins, &#10006; where it ends. Thick and pale: truth.</figcaption></figure>"
    )


def _estimates(log: FlightLog, series: list[Series]) -> str:
    from companion.report import plots

    if not series:
        return '<h2>Estimates</h2><p class="note">Nothing was estimated.</p>'
    parts = [
        "<h2>Estimates</h2>",
        _key(log, series),
        f"<figure>{plots.against_truth(log, series)}<figcaption>The vector from the drone to the pad, levelled, nose first; "
        "and the heading against the arrow. Dots are single looks by one method, lines are filtered.</figcaption></figure>",
    ]
    if log.truth:
        parts.append(
            f"<h2>Error over time</h2><figure>{plots.errors(log, series)}<figcaption>Size of the difference to truth, "
            "logarithmic.</figcaption></figure>"
        )
        rows = "".join(map(_error_row, error_rows(log, series)))
        parts.append(
            '<div class="wide"><table><thead><tr><th>method or path</th><th>estimates</th><th>of frames</th>'
            "<th>lateral<br>median</th><th>lateral<br>95 %</th><th>down<br>bias</th><th>down<br>95 %</th>"
            f"<th>heading<br>median</th><th>heading<br>95 %</th></tr></thead><tbody>{rows}</tbody></table></div>"
        )
    else:
        parts.append('<p class="note">No truth was recorded, so there are no errors to show.</p>')
    return "\n".join(parts)


def _key(log: FlightLog, series: list[Series]) -> str:
    labels = []
    if log.truth:
        labels.append(
            '<label><input type="checkbox" value="truth" checked><span class="swatch" '
            'style="background:currentColor;opacity:.35"></span>truth</label>'
        )
    for s in series:
        checked = "" if s.name == "selected" and len(series) > 2 else " checked"
        dot = "" if s.is_path else " dot"
        labels.append(
            f'<label><input type="checkbox" value="{escape(s.name)}"{checked}><span class="swatch{dot}" '
            f'style="background:{colour(s.name)}"></span>{escape(s.name.replace("_", " "))}</label>'
        )
    return f'<div class="key">{"".join(labels)}</div>'


def _error_row(r: ErrorRow) -> str:
    degrees = [math.degrees(a) for a in (r.yaw_median_rad, r.yaw_p95_rad)]
    cells = [
        escape(r.name.replace("_", " ")),
        str(r.count),
        "-" if r.fraction is None else f"{100 * r.fraction:.1f} %",
        *(_length(v) for v in (r.lateral_median_m, r.lateral_p95_m, r.down_bias_m, r.down_p95_m)),
        *("-" if math.isnan(v) else f"{v:.2f}&deg;" for v in degrees),
    ]
    return "<tr>" + "".join(f"<td>{c}</td>" for c in cells) + "</tr>"


def _frames(log: FlightLog) -> str:
    from companion.report import plots

    total = sum(log.verdicts.values())
    if not total:
        return '<h2>Frames</h2><p class="note">No frames were counted.</p>'
    return (
        f"<h2>What became of the frames</h2><figure>{plots.verdicts(log)}<figcaption>{total} frames, each with exactly one "
        "verdict.</figcaption></figure>"
    )


def _innovations(log: FlightLog) -> str:
    from companion.report import plots

    series = innovation_series(log)
    if not series:
        return '<h2>Innovations</h2><p class="note">No results of the estimator were recorded.</p>'
    rows = "".join(map(_innovation_row, series))
    parts = [
        '<h2>What became of the measurements</h2><div class="wide"><table><thead><tr><th>path and source</th>'
        "<th>measurements</th><th>fused</th><th>refused</th><th>of which</th><th>NIS mean</th><th>test ratio<br>95 %</th></tr>"
        f"</thead><tbody>{rows}</tbody></table></div>"
        '<p class="note">NIS mean: of what was fused, over the number of components; 1 when the covariance is honest. '
        "Test ratio: NIS over the gate's limit; above 1 is refused. Samples of the IMU count where they were refused.</p>"
    ]
    for s in series:
        if len(s.t_s):
            parts.append(
                f"<h2>Innovations, {escape(s.name)}</h2><figure>{plots.innovations(log, s)}<figcaption>Measured minus predicted. "
                "Blue: fused; orange: refused, at the edge where it lies beyond. Bands: one and three sigma as the filter claims "
                "them. Below: NIS, expected at the dashed line, refused above the orange one.</figcaption></figure>"
            )
    return "\n".join(parts)


def _innovation_row(s: InnovationSeries) -> str:
    total, fused = s.verdicts.total(), s.verdicts[Verdict.FUSED]
    refused = ", ".join(f"{n} {v.value.replace('_', ' ')}" for v, n in s.verdicts.most_common() if v is not Verdict.FUSED)
    figures = ("-" if math.isnan(x) else f"{x:.2f}" for x in (s.nis_mean, s.test_ratio_p95))
    cells = [escape(s.name), str(total), str(fused), str(total - fused), refused or "-", *figures]
    return "<tr>" + "".join(f"<td>{c}</td>" for c in cells) + "</tr>"


def _commands(log: FlightLog) -> str:
    from companion.report import plots

    if not log.commands:
        return '<h2>Commands</h2><p class="note">No commands were recorded.</p>'
    return f"<h2>Commands</h2><figure>{plots.commands(log)}</figure>"


def _times(log: FlightLog) -> str:
    from companion.report import plots

    rows = "".join(map(_timing_row, timing_rows(log)))
    if not rows:
        return '<h2>Times</h2><p class="note">No times were measured.</p>'
    drawn = f"<figure>{plots.stages(log)}</figure>" if any(log.stage_s.values()) else ""
    return (
        f"<h2>Times</h2>{drawn}"
        '<div class="wide"><table><thead><tr><th>stage</th><th>samples</th><th>median</th><th>95 %</th>'
        f"<th>99 %</th><th>longest</th></tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _timing_row(r: TimingRow) -> str:
    tail = [r.p95_s, r.p99_s] if r.count >= _FEW else [math.nan, math.nan]
    cells = [escape(r.name), str(r.count), *(_duration(v) for v in (r.median_s, *tail, r.max_s))]
    return "<tr>" + "".join(f"<td>{c}</td>" for c in cells) + "</tr>"


def _length(metres: float) -> str:
    if not math.isfinite(metres):
        return "-"
    return f"{1e3 * metres:.1f} mm" if abs(metres) < 0.1 else f"{metres:.2f} m"


def _duration(seconds: float) -> str:
    return "-" if not math.isfinite(seconds) else f"{1e3 * seconds:.2f} ms"
