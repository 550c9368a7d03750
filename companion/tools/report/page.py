"""The report: one page that needs nothing else, from one flight's log or from two.

Two flights are compared by plots over the time since each landing began, and by what differs in outcome and settings.
"""

import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from companion.base.mission import ENDED, State
from companion.recording.palette import FLIGHTS
from companion.settings.load import write_whole
from companion.tools.report import page_parts, plots
from companion.tools.report.figures import all_series, error_rows, innovation_series, timing_rows
from companion.tools.report.flight_log import FlightLog
from companion.tools.report.page_data import Mark, PadTrack, events, marks, page_data, page_flight, tracks
from companion.tools.report.plots import Layer, Plot, Section, steering_path
from companion.tools.report.video import FilmFile, Watch, film_of, still_of, unwatched
from estimator.contracts.errors import refused
from estimator.contracts.time import MonoNs, seconds_between

PAGE = "index.html"


class Report(Struct, frozen=True):
    """The report of a flight as a notebook shows it."""

    log: FlightLog

    def _repr_html_(self) -> str:
        # The page's styles and script are those of a whole document, so it gets a frame of its own.
        page = escape(render(self.log, film_of(self.log, unwatched) or still_of(self.log)))
        return f'<iframe srcdoc="{page}" style="width: 100%; height: 45em; border: 0"></iframe>'


def write_report(log: FlightLog, folder: Path, watch: Watch = unwatched) -> Path:
    """Write `folder`/index.html, with the video drawn from the log's kept frames inside.

    Args:
        log: what the flight left behind; any part may be empty.
        folder: made if missing; a page of this name in it is replaced.
        watch: see `write_flights`.

    Returns:
        The page's path.

    Raises:
        BadInput: the folder cannot be written.
    """
    with refused(f"{folder}: cannot make the report's folder", OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return write_flights(folder / PAGE, [log], watch)


def write_flights(path: Path, logs: Sequence[FlightLog], watch: Watch = unwatched) -> Path:
    """Write the page of one flight or two, at once with a frame of each in place of its video, then with the videos.

    Args:
        watch: shows the encoding of each video. From its first call on the page can be opened.
    """

    def page(films: Sequence[FilmFile | None]) -> str:
        return render(logs[0], films[0]) if len(logs) == 1 else render_comparison(logs, films)

    stills = [still_of(log) for log in logs]
    write_page(path, page(stills))
    films = [still and (film_of(log, watch) or still) for log, still in zip(logs, stills, strict=True)]
    return path if films == stills else write_page(path, page(films))


def write_page(path: Path, text: str) -> Path:
    """Write a page and return its path. Raises BadInput if it cannot be written."""
    with refused(f"{path}: cannot write the report", OSError):
        write_whole(path, text)
    return path


def render(log: FlightLog, film: FilmFile | None) -> str:
    """Return the page's text."""
    series, found = all_series(log), innovation_series(log)
    flight = page_flight(log, log.title, FLIGHTS[0], None if film is None else film.began)
    happened = events(log)
    place, ship, commands = plots.place(log, series), plots.ship(log), plots.commands(log)
    velocity, errors = plots.velocity(log), plots.errors(log, series)
    frames, times, innovations = plots.verdicts(log), plots.delays(log), plots.innovations(log, found)
    if not series:
        place.plots.clear()
        velocity.plots.clear()
    sections = [place, velocity, errors, ship, commands, frames, innovations, times]
    data, columns = page_data([flight], sections, log.pad, tracks(log, series), marks(log), span_of(log))
    numbers = page_parts.numbered(sections)
    drawn = page_parts.section
    ways = '<p class="note">Neither truth nor an estimate was recorded.</p>'
    if log.truth or series:
        ways = page_parts.views(f"the pad to scale, the way of the drone, {len(log.contacts)} contacts")
    body = [
        page_parts.header(log.title, log.outcome, good(log), log.facts),
        _cards(log),
        _ended(log),
        f'<div class="flight">{page_parts.films([flight], [film])}{page_parts.beside([flight], [happened])}</div>',
        page_parts.transport(),
        page_parts.help_line(),
        f"<section><h2>Touchdown and trajectory</h2>{page_parts.contacts(log)}{ways}"
        '<p class="note">The pad with its own paints, to scale. A cross is a contact, its line points where the nose did; a '
        "square is a thing that was seen. The dot is the drone at the cursor, seen from the pad, levelled.</p></section>",
    ]
    if series:
        body += [drawn(place, numbers), drawn(velocity, numbers), drawn(errors, numbers, page_parts.errors(log, series))]
    else:
        body.append('<h2>Place</h2><p class="note">Nothing was estimated.</p>')
    body += [
        drawn(ship, numbers, page_parts.deck_errors(log)),
        drawn(commands, numbers),
        drawn(frames, numbers, page_parts.verdicts(log)),
        drawn(innovations, numbers, page_parts.innovations(found)),
        drawn(times, numbers, page_parts.times(log)),
        settings(log),
        f'<p class="note">{page_parts.thinning(columns)}</p>',
    ]
    return page_parts.flight_page(log.title, "\n".join(body), data, [film])


def good(log: FlightLog) -> bool:
    """Return whether the flight ended as it should."""
    return log.outcome == "landed" and (log.touchdown is None or log.touchdown.on_pad)


def span_of(log: FlightLog) -> tuple[float, float]:
    """Return the times of the first and the last thing in the log, s since its start; at least a second."""
    instants = [
        *(s.at for s in log.truth[:: max(1, len(log.truth) - 1)]),
        *(e.at for e in log.estimates[:: max(1, len(log.estimates) - 1)]),
        *(f.exposed_at for f in log.frames[:: max(1, len(log.frames) - 1)]),
        *(p.at for p in log.phases),
        *(c.at for c in log.contacts),
        *(r.measured_at for r in log.results[:: max(1, len(log.results) - 1)]),
    ]
    known = [seconds_between(log.started, at) for at in instants]
    low = min(known, default=0.0)
    return low, max(max(known, default=1.0), low + 1.0)


def settings(log: FlightLog) -> str:
    """Return the settings of the flight, closed."""
    if not log.settings:
        return ""
    return f"<section><h2>Settings</h2><details><summary>every key</summary><pre>{escape(log.settings)}</pre></details></section>"


def _cards(log: FlightLog) -> str:
    t = log.touchdown
    if t is None:
        return '<p class="note">No touchdown was recorded.</p>'
    return page_parts.cards(
        [
            ("lateral error at touchdown", page_parts.length(t.lateral_m)),
            ("vertical speed", page_parts.speed(t.vertical_speed_m_s)),
            ("lateral speed", page_parts.speed(t.lateral_speed_m_s)),
            ("stands on the pad", "yes" if t.on_pad else "no"),
            ("after", f"{seconds_between(log.started, t.at):.1f} s"),
        ]
    )


def _ended(log: FlightLog) -> str:
    """Return how the mission ended, and why."""
    ended = next((one for one in reversed(log.transitions) if one.target in ENDED and one.source not in ENDED), None)
    return "" if ended is None else f"<p><b>{escape(ended.target.value)}: {escape(ended.reason.text)}</b></p>"


LETTERS = ("A", "B")


def landing_began(log: FlightLog) -> MonoNs:
    """Return when the drone first flew to the pad that it saw; the log's start where the mission does not say."""
    flown = (change.at for change in log.transitions if change.target in (State.INTERCEPT, State.DESCEND))
    return next(flown, log.started)


def render_comparison(recorded: Sequence[FlightLog], films: Sequence[FilmFile | None]) -> str:
    """Return the page of two flights. The pad that is drawn is the first flight's."""
    logs = [replace(log, started=landing_began(log)) for log in recorded]
    sections = _merged([_sections(log, k) for k, log in enumerate(logs)])
    flights, happened, ways, marked = [], [], list[PadTrack](), list[Mark]()
    for k, (log, film) in enumerate(zip(logs, films, strict=True)):
        began = None if film is None else film.began
        flights.append(page_flight(log, f"{LETTERS[k]}: {log.title}", FLIGHTS[k], began))
        happened.append(events(log))
        found = [way for way in tracks(log, all_series(log)) if way.name == steering_path(log)]
        ways += [replace(way, name=LETTERS[k], colour=FLIGHTS[k]) for way in found]
        marked += marks(log, FLIGHTS[k], LETTERS[k])
    spans = [span_of(log) for log in logs]
    span = (min(low for low, _ in spans), max(high for _, high in spans))
    data, columns = page_data(flights, sections, logs[0].pad, ways, marked, span)
    numbers = page_parts.numbered(sections)
    title = " and ".join(flight.label for flight in flights)
    ended = ", ".join(f"{letter} {log.outcome}" for letter, log in zip(LETTERS, logs, strict=True))
    body = [
        page_parts.header(title, ended, all(map(good, logs)), []),
        _outcomes(logs),
        '<p class="note">Times count from the instant at which the drone first flew to the pad that it saw.</p>',
        f'<div class="flight pair">{page_parts.films(flights, films)}{page_parts.beside(flights, happened)}</div>',
        page_parts.transport(),
        page_parts.help_line(),
        "<section><h2>Touchdown and trajectory</h2>",
        *(f"<h3>{escape(of.label)}</h3>{page_parts.contacts(log, of.label)}" for of, log in zip(flights, logs, strict=True)),
        page_parts.views("the pad to scale, the ways of both drones, and their contacts"),
        _pads(logs),
        "</section>",
        *(page_parts.section(section, numbers) for section in sections if section.plots),
        _settings(logs),
        f'<p class="note">{page_parts.thinning(columns)}</p>',
    ]
    return page_parts.flight_page(title, "\n".join(body), data, films)


def _sections(log: FlightLog, k: int) -> list[Section]:
    """Return the sections of one flight with what is compared: the path that steered, truth, and single quantities."""
    series, found = all_series(log), innovation_series(log)
    path, commands = steering_path(log), plots.commands(log)
    commands.plots[:] = [
        replace(plot, title=f"{plot.title} {layer.name}".replace("turn turn", "turn"), layers=[layer])
        for plot in commands.plots
        for layer in plot.layers
    ]
    sections = [plots.place(log, series), plots.velocity(log), plots.errors(log, series)]
    sections += [plots.ship(log), commands, plots.innovations(log, found), plots.delays(log)]
    alike = {path, "filter", "fused", "exposure to belief", "forward", "right", "down", "turn", "north", "east"}
    for section in sections:
        kept = []
        for plot in section.plots:
            layers = [_of_flight(layer, k) for layer in plot.layers if layer.name in alike]
            if "minus truth" not in plot.title and not any(layer.style != "band" for layer in layers):
                layers = [_of_flight(layer, k) for layer in plot.layers if layer.name == "truth"]
            if layers:
                title = plot.title.replace(f", {path} minus truth", ": estimate minus truth")
                kept.append(replace(plot, title=title, layers=layers))
        section.plots[:] = kept
    return sections


def _of_flight(layer: Layer, k: int) -> Layer:
    """Return a layer in the colour of its flight; two components of one plot stay apart by the name."""
    name = LETTERS[k] if layer.name not in ("north", "east") else f"{LETTERS[k]} {layer.name}"
    return replace(layer, name=name, colour=FLIGHTS[k], wide=False, fits=layer.style != "band", shown=True)


def _merged(both: Sequence[list[Section]]) -> list[Section]:
    """Return sections whose plots have the layers of both flights, by their titles."""
    out = []
    for pair in zip(*both, strict=True):
        plots: dict[str, Plot] = {}
        for section in pair:
            for plot in section.plots:
                known = plots.get(plot.title)
                plots[plot.title] = plot if known is None else replace(known, layers=[*known.layers, *plot.layers])
        note = "" if pair[0].title == "Place" else next((s.note for s in pair if s.plots), "")
        out.append(Section(pair[0].title, note, list(plots.values())))
    return out


def _outcomes(logs: Sequence[FlightLog]) -> str:
    """Return the table of what became of both, and by how much they differ."""
    rows = []
    numbers = [dict(_figures(log)) for log in logs]
    rows.append(["outcome", *(f"<b>{escape(log.outcome)}</b>" for log in logs), "-"])
    for name in numbers[0] | numbers[1]:
        values = [found.get(name, math.nan) for found in numbers]
        unit = name.partition(", ")[2]
        digits = _digits(values)
        cells = [f"{value:.{digits}f} {unit}".rstrip() if math.isfinite(value) else "-" for value in values]
        apart = values[1] - values[0]
        cells.append(f"{apart:+.{digits}f} {unit}".rstrip() if math.isfinite(apart) else "-")
        rows.append([escape(name.partition(", ")[0]), *cells])
    heads = ["figure", *(f"{LETTERS[k]}<br>{escape(log.title)}" for k, log in enumerate(logs)), "B minus A"]
    return page_parts.table(heads, rows)


def _digits(values: Sequence[float]) -> int:
    """Return as many decimals as give the larger value three figures; none for counts."""
    largest = max((abs(value) for value in values if math.isfinite(value)), default=0.0)
    if all(not math.isfinite(value) or value == int(value) for value in values) or not largest:
        return 0
    return max(0, min(4, 2 - math.floor(math.log10(largest))))


def _figures(log: FlightLog) -> Iterator[tuple[str, float]]:
    """Yield names with their units, and numbers."""
    t = log.touchdown
    if t is not None:
        yield "off centre at touchdown, cm", 100 * t.lateral_m
        yield "vertical speed at touchdown, m/s", t.vertical_speed_m_s
        yield "lateral speed at touchdown, m/s", t.lateral_speed_m_s
        yield "heading at touchdown, °", math.degrees(t.yaw_rad)
        yield "touchdown after the landing began, s", seconds_between(log.started, t.at)
    yield "contacts", float(len(log.contacts))
    yield "go-arounds", float(sum(change.target is State.GO_AROUND for change in log.transitions))
    total = sum(log.verdicts.values())
    if total:
        yield "frames fused, %", 100 * sum(n for v, n in log.verdicts.items() if v.value == "fused") / total
    path = steering_path(log)
    for row in error_rows(log, all_series(log)) if log.truth else []:
        if row.name == path:
            yield "lateral error median, cm", 100 * row.lateral_median_m
            yield "lateral error 95 %, cm", 100 * row.lateral_p95_m
            yield "height error 95 %, cm", 100 * row.down_p95_m
    for found in innovation_series(log):
        if (found.path, found.source) == (path, "sighting"):
            yield "NIS mean of sightings", found.nis_mean
    for timing in timing_rows(log):
        if timing.name == "exposure to belief":
            yield "exposure to belief median, ms", 1e3 * timing.median_s
            yield "exposure to belief 99 %, ms", 1e3 * timing.p99_s


def _pads(logs: Sequence[FlightLog]) -> str:
    if logs[0].pad == logs[1].pad:
        return ""
    names = [escape(log.pad.name) for log in logs]
    return f'<p class="note">The flights had different pads, {names[0]} and {names[1]}; the first is drawn.</p>'


def _settings(logs: Sequence[FlightLog]) -> str:
    """Return the keys that the flights had otherwise."""
    found = []
    for log in logs:
        try:
            found.append(dict(_flat(tomllib.loads(log.settings), "")))
        except tomllib.TOMLDecodeError:
            return '<section><h2>Settings</h2><p class="note">The settings of one flight cannot be read.</p></section>'
    names = sorted(name for name in found[0] | found[1] if found[0].get(name) != found[1].get(name))
    if not names:
        return '<section><h2>Settings</h2><p class="note">Both flights had the same settings.</p></section>'
    rows = [[escape(name), *(escape(str(settings.get(name, "-"))) for settings in found)] for name in names]
    return f"<section><h2>Settings that differ</h2>{page_parts.table(['key', *LETTERS], rows)}</section>"


def _flat(settings: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, value in settings.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
