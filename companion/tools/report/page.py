"""The report: one page that needs nothing else, from a flight's log."""

from html import escape
from pathlib import Path

from companion.base.mission import ENDED
from companion.recording.palette import FLIGHTS
from companion.tools.report import estimate_plots, page_parts, ship_plots, tables
from companion.tools.report.figures import all_series
from companion.tools.report.flight_log import FlightLog
from companion.tools.report.innovations import innovation_series
from companion.tools.report.page_data import events, marks, page_data, page_flight, tracks
from companion.tools.report.video import FilmFile, film_of
from estimator.contracts.errors import BadInput, fault_of
from estimator.contracts.time import seconds_between

PAGE = "index.html"


def write_report(log: FlightLog, folder: Path) -> Path:
    """Write `folder`/index.html, with the video drawn from the log's kept frames inside.

    Args:
        log: what the flight left behind; any part may be empty.
        folder: made if missing; a page of this name in it is replaced.

    Returns:
        The page's path.

    Raises:
        BadInput: the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as why:
        raise BadInput(f"{folder}: cannot make the report's folder: {fault_of(why)}") from why
    return write_page(folder / PAGE, render(log, film_of(log)))


def write_page(path: Path, text: str) -> Path:
    """Write a page and return its path. Raises BadInput if it cannot be written."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as why:
        raise BadInput(f"{path}: cannot write the report: {fault_of(why)}") from why
    return path


def render(log: FlightLog, film: FilmFile | None) -> str:
    """Return the page's text."""
    series, found = all_series(log), innovation_series(log)
    flight = page_flight(log, log.title, FLIGHTS[0], None if film is None else film.began)
    happened = events(log)
    place, ship, commands = estimate_plots.place(log, series), ship_plots.ship(log), ship_plots.commands(log)
    velocity, errors = estimate_plots.velocity(log), estimate_plots.errors(log, series)
    frames, times, innovations = estimate_plots.verdicts(log), ship_plots.delays(log), estimate_plots.innovations(log, found)
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
        f"<section><h2>Touchdown and trajectory</h2>{tables.contacts(log)}{ways}"
        '<p class="note">The pad with its own paints, to scale. A cross is a contact, its line points where the nose did. The '
        "dot is the drone at the cursor, seen from the pad, levelled.</p></section>",
    ]
    if series:
        body += [drawn(place, numbers), drawn(velocity, numbers), drawn(errors, numbers, tables.errors(log, series))]
    else:
        body.append('<h2>Place</h2><p class="note">Nothing was estimated.</p>')
    body += [
        drawn(ship, numbers, tables.deck_errors(log)),
        drawn(commands, numbers),
        drawn(frames, numbers, tables.verdicts(log)),
        drawn(innovations, numbers, tables.innovations(found)),
        drawn(times, numbers, tables.times(log)),
        settings(log),
        f'<p class="note">{page_parts.thinning(columns)}</p>',
    ]
    return page_parts.flight_page(log.title, "\n".join(body), data, [film])


def good(log: FlightLog) -> bool:
    """Whether the flight ended as it should."""
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
            ("lateral error at touchdown", tables.length(t.lateral_m)),
            ("vertical speed", tables.speed(t.vertical_speed_m_s)),
            ("lateral speed", tables.speed(t.lateral_speed_m_s)),
            ("stands on the pad", "yes" if t.on_pad else "no"),
            ("after", f"{seconds_between(log.started, t.at):.1f} s"),
        ]
    )


def _ended(log: FlightLog) -> str:
    """Return how the mission ended, and why."""
    ended = next((change for change in reversed(log.transitions) if change.target in ENDED), None)
    return "" if ended is None else f"<p><b>{escape(ended.target.value)}: {escape(ended.reason.text)}</b></p>"
