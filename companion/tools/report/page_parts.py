"""The parts and tables that every page of a flight is made of, as HTML. They need nothing from outside the page."""

import base64
import math
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files

from companion.recording.palette import colour
from companion.tools.report.figures import InnovationSeries, Series, deck_rows, error_rows, timing_rows
from companion.tools.report.flight_log import FlightLog
from companion.tools.report.page_data import FlightEvent, PageFlight
from companion.tools.report.plots import Columns, Plot, Section
from companion.tools.report.video import FilmFile
from drivers.pyav import has_pyav
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import seconds_between

_SCRIPTS = ("numbers", "clock", "video", "plot", "gestures", "view", "report")
"""The parts of the page's script, in order: they share one scope, since a page opened as a file may import no modules."""
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; media-src blob:; img-src data:"
"""The page requests nothing, and a browser refuses it if it did."""


def document(title: str, body: str, more_style: str = "", head: str = "") -> str:
    """Return a whole page with the style of our reports. `body` and `head` are HTML, `more_style` is CSS."""
    style = files("companion.tools.report").joinpath("style.css").read_text("utf-8")
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<meta name="generator" content="decklander">\n{head}'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{style}{more_style}</style>\n</head>\n<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def flight_page(title: str, body: str, data: str, films: Sequence[FilmFile | None]) -> str:
    """Return a page with its data, its films and its script.

    Args:
        body: HTML.
        data: JSON for the script.
        films: the film of each flight, None without one.
    """
    static = files("companion.tools.report") / "static"
    script = "\n".join((static / f"{name}.js").read_text("utf-8") for name in _SCRIPTS)
    stored = "\n".join(
        f'<script type="text/plain" id="film-{k}">{base64.b64encode(film.data).decode()}</script>'
        for k, film in enumerate(films)
        if film is not None and film.frames
    )
    without = '<noscript><p class="note">The plots and the video need JavaScript; the tables do not.</p></noscript>'
    return document(
        title,
        f'{without}\n{body}\n{stored}\n<script type="application/json" id="data">{data}</script>\n'
        f'<script>\n"use strict";\n(() => {{\n{script}\n}})();\n</script>',
        (static / "report.css").read_text("utf-8"),
        f'<meta http-equiv="Content-Security-Policy" content="{escape(_POLICY, quote=True)}">\n',
    )


def header(title: str, outcome: str, good: bool, facts: Iterable[tuple[str, str]]) -> str:
    """Return the head of a page: its title, how the flight ended, and the facts."""
    items = "".join(f"<li>{escape(k)} <b>{escape(v)}</b></li>" for k, v in facts)
    reported = f'<ul class="facts">{items}</ul>' if items else ""
    ink = "outcome good" if good else "outcome"
    return f'<header><h1>{escape(title)}</h1><span class="{ink}">{escape(outcome)}</span></header>\n{reported}'


def cards(cells: Iterable[tuple[str, str]]) -> str:
    """Return a row of cards with a name and a value each."""
    return (
        '<div class="cards">'
        + "".join(f'<div class="card"><span>{escape(k)}</span><b>{escape(v)}</b></div>' for k, v in cells)
        + "</div>"
    )


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], of: str = "") -> str:
    """Return a table that scrolls by itself where it is too wide; cells are HTML, `of` tells it from another one of its kind."""
    head = "".join(f"<th>{name}</th>" for name in heads)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return (
        f'<div class="wide" tabindex="0" role="region" aria-label="table: {heads[0]} {escape(of)}"><table>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def films(flights: Sequence[PageFlight], have: Sequence[FilmFile | None]) -> str:
    """Return the videos, without controls of their own: the page's transport moves them."""
    parts = []
    for k, (flight, film) in enumerate(zip(flights, have, strict=True)):
        name = f"<h2>{escape(flight.label)}</h2>" if len(flights) > 1 else ""
        shown = '<p class="note">No frames were kept.</p>'
        if film is not None and not film.frames:
            shown = f'<img alt="from the drone\'s camera" src="data:image/jpeg;base64,{base64.b64encode(film.data).decode()}">'
            coming = "The video is being encoded: load the page again in a moment."
            shown += f'<p class="note">{coming if has_pyav() else "A video needs PyAV, the extra decklander[video]."}</p>'
        elif film is not None:
            words = f"video from the drone's camera, {film.frames} frames, moved by the slider below"
            shown = (
                f'<video muted playsinline preload="auto" data-flight="{k}" data-bytes="film-{k}" '
                f'aria-label="{escape(words, quote=True)}"></video>'
            )
        parts.append(f'<div class="film">{name}{shown}</div>')
    note = (
        '<p class="note">Yellow: the pad as the estimate has it. Other colours: what each method saw, in the colours of the '
        "plots.</p>"
    )
    many = " pair" if len(flights) > 1 else ""
    return f'<div><div class="films{many}">{"".join(parts)}</div>{note if any(have) else ""}</div>'


def beside(flights: Sequence[PageFlight], events: Sequence[Sequence[FlightEvent]]) -> str:
    """Return the figures at the cursor and the list of events of each flight."""
    parts = []
    for k, (flight, happened) in enumerate(zip(flights, events, strict=True)):
        names = [name for name, _ in flight.kinds] + [name for name, *_ in flight.figures]
        figures = "".join(f"<div><dt>{escape(name)}</dt><dd>&ndash;</dd></div>" for name in names)
        title = escape(flight.label) if len(flights) > 1 else "At the cursor"
        rows = "".join(map(_event, happened)) or '<li class="note">Nothing was recorded.</li>'
        label = f"events of {flight.label}" if len(flights) > 1 else "events; each moves the cursor"
        parts.append(
            f'<div class="beside"><h2>{title}</h2><dl class="figures" data-flight="{k}">{figures}</dl>'
            f'<h2>Events</h2><ol class="events" aria-label="{escape(label, quote=True)}">{rows}</ol></div>'
        )
    return "".join(parts) if len(parts) == 1 else f'<div class="beside">{"".join(parts)}</div>'


def _event(event: FlightEvent) -> str:
    cause = f"<small>{escape(event.cause)}</small>" if event.cause else ""
    return (
        f'<li class="{event.level}"><button type="button" data-t="{event.t_s:.3f}"><time>{event.t_s:.2f} s</time>'
        f"<span><b>{escape(event.text)}</b>{cause}</span></button></li>"
    )


def transport() -> str:
    """Return what moves the cursor and the span in sight."""
    return (
        '<div class="transport" role="group" aria-label="cursor and zoom">'
        '<button type="button" id="play" title="space">Play</button>'
        '<input type="range" id="slider" aria-label="cursor, seconds">'
        '<output id="time" for="slider"></output>'
        '<select id="rate" aria-label="speed"><option value="0.25">¼×</option><option value="0.5">½×</option>'
        '<option value="1" selected>1×</option><option value="2">2×</option><option value="4">4×</option></select>'
        '<button type="button" id="closer" aria-label="zoom in" title="+">+</button>'
        '<button type="button" id="wider" aria-label="zoom out" title="&minus;">&minus;</button>'
        '<button type="button" id="all" title="0">All</button></div>'
    )


def help_line() -> str:
    """Return one line on how the plots are used."""
    return (
        '<p class="note">Click a plot to move the cursor, drag over it to zoom, click twice to see all. The wheel zooms with '
        "Ctrl, or over a plot that was clicked; on a touch screen two fingers zoom. Keys: space plays, arrows step a frame (with "
        "Shift a second), + &minus; 0 zoom.</p>"
    )


def key(sections: Sequence[Section]) -> str:
    """Return a box for each series, which switches it off in every plot."""
    met: dict[str, tuple[str, bool, bool]] = {}
    for plot in (plot for section in sections for plot in section.plots):
        for layer in plot.layers:
            if layer.style != "level":
                met.setdefault(layer.name, (layer.colour, layer.style == "dots", layer.shown))
    labels = []
    for name, (ink, dotted, shown) in met.items():
        fill = "currentColor;opacity:.4" if ink == "ink" else ink
        labels.append(
            f'<label><input type="checkbox" value="{escape(name, quote=True)}"{" checked" if shown else ""}>'
            f'<span class="swatch{" dot" if dotted else ""}" style="background:{fill}"></span>'
            f"{escape(name.replace('_', ' '))}</label>"
        )
    return f'<div class="key" role="group" aria-label="series">{"".join(labels)}</div>' if labels else ""


def section(of: Section, numbers: dict[int, int], more: str = "") -> str:
    """Return a section's heading, its plots and its note; `numbers` are those of the plots in the page's data, by their ids."""
    drawn = "".join(_plot(plot, numbers[id(plot)]) for plot in of.plots)
    note = f'<p class="note">{escape(of.note)}</p>' if of.note else ""
    switches = key([of]) if of.plots else ""
    return f'<section><h2>{escape(of.title)}</h2>{switches}<div class="plots">{drawn}</div>{note}{more}</section>'


def _plot(plot: Plot, number: int) -> str:
    unit = f' <span class="unit">{escape(plot.unit)}</span>' if plot.unit else ""
    return (
        f'<figure class="plot" data-plot="{number}"><figcaption><span>{escape(plot.title)}{unit}</span>'
        '<span class="value"></span></figcaption><div class="area">'
        f'<canvas role="img" tabindex="-1" aria-label="{escape(plot.in_words(), quote=True)}"></canvas>'
        '<div class="selected" hidden></div><div class="cursor"></div></div></figure>'
    )


def views(words: str) -> str:
    """Return the four views of the pad; `words` say what is drawn."""
    titles = ("On the pad", "From above", "From starboard", "From behind")
    figures = "".join(
        f'<figure class="view" data-view="{k}"><figcaption>{title}</figcaption>'
        f'<canvas role="img" aria-label="{escape(f"{title}: {words}", quote=True)}"></canvas></figure>'
        for k, title in enumerate(titles)
    )
    return f'<div class="plots views">{figures}</div>'


def numbered(sections: Sequence[Section]) -> dict[int, int]:
    """Return the numbers of the plots in the page's data, by their ids."""
    return {id(plot): k for k, plot in enumerate(plot for one in sections for plot in one.plots)}


def thinning(columns: Columns) -> str:
    """Return whether every sample is drawn."""
    if columns.kept == columns.whole:
        return f"Every one of {columns.whole:,} values is drawn."
    return (
        f"{columns.kept:,} of {columns.whole:,} values are drawn: of longer series the least and the greatest of each of 1,500 "
        "spans of time."
    )


def swatch(name: str) -> str:
    """Return a dot in a series' colour, as HTML."""
    return f'<span class="swatch dot" style="background:{colour(name)}"></span>'


_FEW = 20
"""Hundredths are no statistic below this many samples."""


def contacts(log: FlightLog, of: str = "") -> str:
    """Return every contact: when, with what, where and how fast."""
    if not log.contacts:
        return '<p class="note">No touchdown was recorded.</p>'
    rows = []
    for k, c in enumerate(log.contacts, 1):
        after_s = seconds_between(log.started, c.at)
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
    return table(heads, rows, of)


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
                *(length(v) for v in (r.lateral_median_m, r.lateral_p95_m, r.down_median_m, r.down_p95_m)),
                *turns,
                number(r.nees),
            ]
        )
    heads = ["method or path", "estimates", "of frames", "lateral<br>median", "lateral<br>95 %", "down<br>median"]
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
