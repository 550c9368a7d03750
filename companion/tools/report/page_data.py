"""Data for the page's script: sections of plots, views of the pad, the figures beside the video, and the events."""

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec import Struct, field

from companion.recording.palette import colour
from companion.tools.report.figures import Series, body_over_pad
from companion.tools.report.flight_log import FlightLog
from companion.tools.report.plots import BAND, Columns, Section, steering_path, steering_states, thinned, times
from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between
from estimator.vision.pad.geometry import outlines_of
from estimator.vision.pad.pad import Pad

_NEAR = 1.35
"""The half width of the view of the pad, in radii of its disc."""
_NEAR_DRAWN_M = 0.3
"""Width at which a thing about the pad is drawn, whose own is not known."""


class FlightEvent(Struct, frozen=True):
    """One line of the list of events."""

    t_s: float
    text: str
    cause: str = ""
    level: str = "info"


class PadTrack(Struct, frozen=True, eq=False):
    """A way over the pad."""

    name: str
    colour: str
    t_s: F64
    p: F64
    """(n, 3) m along the arrow, to starboard, up."""
    wide: bool = False


class Mark(Struct, frozen=True):
    """A contact to draw on the pad, or a thing."""

    label: str
    p_pad_m: tuple[float, float]
    yaw_rad: float
    colour: str = "ink"
    size_m: float | None = None
    """Width of a thing; None for a contact."""


class PageFlight(Struct):
    """One flight of a page."""

    label: str
    colour: str
    video_from_s: float | None
    """The time of the video's first frame on the page's axis; None without a video."""
    phases: list[tuple[float, str]]
    figures: list[tuple[str, str, int, F64, F64]] = field(default_factory=list)
    """Figures beside the video: name, unit, digits, times and values."""
    kinds: list[tuple[str, list[tuple[float, str]]]] = field(default_factory=list)
    """Names, and the texts that hold from each time on."""


def events(log: FlightLog) -> list[FlightEvent]:
    """Return the changes of the mission's state, people's orders, things about the pad and contacts, in order of time."""
    out = []
    for change in log.transitions:
        text = f"{change.source.value} → {change.target.value}"
        out.append(FlightEvent(seconds_between(log.started, change.at), text, change.reason.text))
    if not log.transitions:
        out += [FlightEvent(seconds_between(log.started, change.at), change.phase) for change in log.phases]
    for order in log.orders:
        level = "info" if order.accepted else "warning"
        out.append(FlightEvent(seconds_between(log.started, order.at), str(order), "", level))
    for thing in log.things:
        lasted_s = seconds_between(thing.first, thing.last)
        out.append(
            FlightEvent(seconds_between(log.started, thing.first), thing.seen.words, f"known for {lasted_s:.1f} s", "warning")
        )
    for contact in log.contacts:
        where = f"contact with the {contact.surface or ('pad' if contact.on_pad else 'surface')}"
        how = f"{contact.vertical_speed_m_s:.2f} m/s down" if math.isfinite(contact.vertical_speed_m_s) else ""
        out.append(FlightEvent(seconds_between(log.started, contact.at), where, how, "info" if contact.on_pad else "fault"))
    return sorted(out, key=lambda event: event.t_s)


def page_flight(log: FlightLog, label: str, ink: str, video_from: MonoNs | None) -> PageFlight:
    """Return the figures of a flight at the page's cursor."""
    first = None if video_from is None else seconds_between(log.started, video_from)
    phases = [(seconds_between(log.started, change.at), change.phase) for change in log.phases]
    out = PageFlight(label, ink, first, phases)
    states = steering_states(log)
    if states:
        t = times(log, states)
        cov = np.array([np.diagonal(e.cov) for e in states])
        age = np.array([max(0.0, seconds_between(e.sighted, e.at)) for e in states])
        yaw = np.degrees([math.nan if e.yaw_rad is None else e.yaw_rad for e in states])
        d = np.array([e.d_body_pad_level for e in states])
        out.figures = [
            ("height", "m", 2, t, d[:, 2]),
            ("off centre", "m", 3, t, np.hypot(d[:, 0], d[:, 1])),
            ("heading", "°", 1, t, yaw),
            ("two sigma, sideways", "m", 3, t, BAND * np.sqrt(np.maximum(cov[:, 0], cov[:, 1]))),
            ("two sigma, height", "m", 3, t, BAND * np.sqrt(cov[:, 2])),
            ("last look", "s ago", 2, t, age),
        ]
    seen = sorted(log.frames, key=lambda f: f.exposed_at)
    reported = [(seconds_between(log.started, f.exposed_at), f.verdict.value.replace("_", " ")) for f in seen]
    out.kinds = [("state", phases), ("frame", reported)]
    return out


def tracks(log: FlightLog, series: Sequence[Series]) -> list[PadTrack]:
    """Return truth, then every path that knew its heading, as ways over the pad."""
    out = []
    if log.truth:
        t = np.array([seconds_between(log.started, s.at) for s in log.truth])
        d, yaw = np.array([s.d_body_pad_level for s in log.truth]), np.array([s.yaw_rad for s in log.truth])
        out.append(PadTrack("truth", "ink", t, body_over_pad(d, yaw), wide=True))
    ordered = sorted((s for s in series if s.is_path), key=lambda s: s.name == steering_path(log))
    return out + [PadTrack(s.name, colour(s.name), s.t_s, body_over_pad(s.d, s.yaw_rad)) for s in ordered]


def marks(log: FlightLog, ink: str = "ink", label: str = "") -> list[Mark]:
    """Return the things, and the contacts whose place is known, numbered as in their table."""
    things = [
        Mark("", (seen.x_m, seen.y_m), math.nan, "bad", seen.width_m or _NEAR_DRAWN_M) for seen in (of.seen for of in log.things)
    ]
    return things + [
        Mark(f"{label}{k}", contact.p_pad_m, contact.yaw_rad, ink)
        for k, contact in enumerate(log.contacts, 1)
        if math.isfinite(contact.p_pad_m[0])
    ]


def _views(pad: Pad, ways: Sequence[PadTrack], marked: Sequence[Mark], columns: Columns) -> list[dict[str, Any]]:
    """Return the views for the page: near the pad, from above, from starboard and from behind."""
    radius = pad.disc_radius_m
    drawn = [
        {"fill": "rgb({},{},{})".format(*pad.rgb(region)), "points": np.round(line[:, ::-1], 4).tolist()}
        for region in pad.regions
        for line in outlines_of(region, 64)
    ]
    up, arrow, starboard = "height, m", "along the arrow, m", "to starboard, m"
    out = []
    for name, title, i, j, x_name, y_name in (
        ("near", "On the pad", 1, 0, starboard, arrow),
        ("above", "From above", 1, 0, starboard, arrow),
        ("side", "From starboard", 0, 2, arrow, up),
        ("behind", "From behind", 1, 2, starboard, up),
    ):
        layers = []
        for way in ways:
            kept = np.unique(np.concatenate([thinned(way.t_s, way.p[:, k]) for k in (i, j)]))
            numbers = {"t": columns.add(way.t_s[kept]), "x": columns.add(way.p[kept, i]), "y": columns.add(way.p[kept, j])}
            layers.append({"name": way.name, "colour": way.colour, "wide": way.wide, **numbers})
        out.append(
            {
                "id": name, "title": title, "xName": x_name, "yName": y_name, "radius": radius, "flat": j == 2,
                "span": _NEAR * radius if name == "near" else None, "regions": drawn if j != 2 else [], "layers": layers,
                "marks": [_mark(m) for m in marked] if j != 2 else [],
            }
        )  # fmt: skip
    return out


def _mark(mark: Mark) -> dict[str, Any]:
    along, starboard = mark.p_pad_m
    yaw = None if not math.isfinite(mark.yaw_rad) else round(mark.yaw_rad, 4)
    x, y = round(starboard, 4), round(along, 4)
    return {"label": mark.label, "x": x, "y": y, "yaw": yaw, "colour": mark.colour, "size": mark.size_m}


def page_data(
    flights: Sequence[PageFlight],
    sections: Sequence[Section],
    pad: Pad,
    ways: Sequence[PadTrack],
    marked: Sequence[Mark],
    span: tuple[float, float],
) -> tuple[str, Columns]:
    """Return the text of the page's data, and its columns with how much they were thinned.

    Args:
        span: the times that the page's axis begins and ends with, s.
    """
    columns = Columns()
    out: dict[str, Any] = {
        "span": [round(x, 4) for x in span],
        "flights": [_flight(flight, columns) for flight in flights],
        "plots": [plot.packed(columns) for section in sections for plot in section.plots],
        "views": _views(pad, ways, marked, columns),
    }
    out["columns"] = columns.encoded()
    # "</script" in a name would end the element that the text stands in.
    return json.dumps(out, separators=(",", ":"), allow_nan=False).replace("</", "<\\/"), columns


def _flight(flight: PageFlight, columns: Columns) -> dict[str, Any]:
    figures = []
    for name, unit, digits, t, y in flight.figures:
        kept = thinned(t, y)
        figures.append({"name": name, "unit": unit, "digits": digits, "t": columns.add(t[kept]), "y": columns.add(y[kept])})
    kinds = []
    for name, reported in flight.kinds:
        changed = [one for k, one in enumerate(reported) if not k or one[1] != reported[k - 1][1]]
        times_s = columns.add(np.array([t for t, _ in changed]))
        kinds.append({"name": name, "t": times_s, "texts": [text for _, text in changed]})
    phases = [[round(t, 3), text] for t, text in flight.phases]
    return {
        "label": flight.label, "colour": flight.colour, "video": flight.video_from_s, "phases": phases, "figures": figures,
        "kinds": kinds,
    }  # fmt: skip
