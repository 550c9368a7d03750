"""A map of wind, sea and vehicle: landings, their accuracy and refusals, drawn from the flights of a campaign."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from html import escape
from pathlib import PurePath
from typing import Any

import numpy as np

from companion.tools.report.page_parts import document
from estimator.contracts.errors import BadInput
from sitl.campaign.task import Flight, error_m

MAP = "map.html"
WIND, SEA, VEHICLE = "weather.wind_m_s", "weather.sea_state", "vehicle.file"
AXES = (f"{WIND}=3:12:3", f"{SEA}=2,3,4,5", f"{VEHICLE}=ardrone2,quad_1_5kg,hexa_7kg")
"""Varied values of `campaign --map` unless `--vary` names others."""
_STYLE = """
.map td { text-align: center; min-width: 6.5rem; line-height: 1.25; color: #111; }
.map td small { display: block; font-size: .72rem; }
.map td.none { background: #ddd; } .map td b.unsafe { color: #a00; }
"""


@dataclass(slots=True)
class MapCell:
    """The flights of one wind, sea and vehicle."""

    runs: int = 0
    on_pad: int = 0
    unsafe: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    """Number of refusals by reason, without figures."""
    standing_m: list[float] = field(default_factory=list)

    def take(self, flight: Flight) -> None:
        """Add a flight."""
        self.runs += 1
        self.unsafe += bool(flight["unsafe"])
        if flight["landed_on_pad"]:
            self.on_pad += 1
            self.standing_m.append(error_m(flight))
        elif flight["refused"]:
            self.refused[_reason(flight["refused"])] += 1

    def as_html(self) -> str:
        """Return the cell of a table: the share that lands by its colour, how well, and why the others are refused."""
        share = self.on_pad / self.runs
        lines = [f"{self.on_pad}/{self.runs}"]
        if self.standing_m:
            median, p95 = (100.0 * float(np.quantile(self.standing_m, q)) for q in (0.5, 0.95))
            lines.append(f"{median:.1f}, {p95:.1f} cm")
        lines += [f"<small>{n} refused: {escape(reason)}</small>" for reason, n in self.refused.most_common(2)]
        if self.unsafe:
            lines.append(f'<b class="unsafe">{self.unsafe} unsafe</b>')
        return f'<td style="background: hsl({120.0 * share:.0f} 45% 78%)">{"<br>".join(lines)}</td>'


def _reason(refused: str) -> str:
    """Return why it gave up, without the figures that differ from flight to flight."""
    output = refused.partition(";")[0]
    return re.sub(r"\s*\([^)]*\)|\s(by|at|after|for|within) -?\d+(\.\d+)? \S+", "", output)[:60]


def cells_of(flights: Iterable[Flight]) -> dict[tuple[str, Any, Any], MapCell]:
    """Return the cells by vehicle, sea state and wind.

    Raises:
        BadInput: no flight varies all three.
    """
    cells: dict[tuple[str, Any, Any], MapCell] = {}
    for flight in flights:
        varied: Mapping[str, Any] = flight.get("varied", {})
        if {WIND, SEA, VEHICLE} <= varied.keys():
            key = PurePath(varied[VEHICLE]).stem, varied[SEA], varied[WIND]
            cells.setdefault(key, MapCell()).take(flight)
    if not cells:
        raise BadInput(f"a map needs flights that vary {WIND}, {SEA} and {VEHICLE}")
    return cells


def render_map(name: str, perception: str, flights: Iterable[Flight]) -> str:
    """Return the page: a table for each vehicle, sea states downwards and winds across.

    Args:
        name: of the campaign's scenario.
        perception: how the flights perceived the pad.

    Raises:
        BadInput: as `cells_of`.
    """
    cells = cells_of(flights)
    vehicles, seas, winds = (sorted({key[n] for key in cells}) for n in range(3))
    parts = [
        f"<header><h1>What lands: {escape(name)}</h1></header>",
        f'<p class="note">{sum(cell.runs for cell in cells.values()):,} flights ({escape(perception)}). Each cell: landed on the '
        "pad of flown; median and 95 % of the distance from the centre at which the vehicle stands 5 s after its contact; "
        "why others were refused. Wind 10 m over the water; waves of the state as that wind's own or as a swell.</p>",
    ]
    for vehicle in vehicles:
        head = "".join(f"<th>{wind:g} m/s</th>" for wind in winds)
        rows = ""
        for sea in seas:
            drawn = (cells.get((vehicle, sea, wind)) for wind in winds)
            rows += f"<tr><th>sea state {sea:g}</th>" + "".join(
                '<td class="none"></td>' if cell is None else cell.as_html() for cell in drawn
            )
            rows += "</tr>"
        parts.append(
            f'<h2>{escape(vehicle)}</h2><div class="wide"><table class="map"><tr><th></th>{head}</tr>{rows}</table></div>'
        )
    return document(f"What lands: {name}", "\n".join(parts), _STYLE)
