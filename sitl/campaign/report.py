"""The pages of a campaign, which need nothing else: its report, and a map of wind, sea and vehicle."""

import itertools
import re
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import PurePath
from types import MappingProxyType
from typing import Any

import numpy as np

from companion.tools.report.page_parts import document
from estimator.contracts.errors import BadInput
from estimator.vision.pad import Pad
from sitl.campaign.figures import (
    HEADINGS,
    CampaignFigures,
    PairedDifference,
    by_scenario,
    differences_of,
    effect_of,
    figures_of,
    map_of,
    row,
)
from sitl.campaign.summary import cause_of, name_of, wilson
from sitl.campaign.task import Flight, error_m
from sitl.scenario.scenario import from_mapping, pad_model

REPORT = "report.html"
_MAPS_MAX = 10
_TEXTS = ("scenario", "expected", "by", "why")
"""Columns of the table of scenarios that hold text."""
_UNSAFE = (
    "Outside commit: contacts with turning motors while neither guidance intended to land nor a person commanded. Unsafe: "
    "flights with such a contact, one beside the pad or in water, a descent without sight, or a service that died."
)
_STYLE = """
.plots { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(26rem, 100%), 1fr)); gap: .8rem; align-items: start; }
code { font: .82rem/1.4 ui-monospace, "DejaVu Sans Mono", monospace; overflow-wrap: anywhere; }
.flights { padding: 0; list-style: none; display: grid; gap: .6rem; }
.flights li { background: var(--card); border: 1px solid var(--line); border-radius: .5rem; padding: .5rem .8rem; }
.flights b { color: var(--bad); font-weight: 600; } .flights b.good { color: var(--good); } .flights code { display: block; }
td.text, th.text { text-align: left; white-space: normal; }
.each { font-size: .85rem; } .each th { white-space: normal; vertical-align: bottom; }
.each th, .each td { padding: .3rem .5rem; } .each td:last-child { min-width: 12rem; }
"""


def render_report(
    manifest: Mapping[str, Any],
    flights: Sequence[Flight] | Iterable[Flight],
    wall_s: float,
    against: tuple[str, list[Flight]] | None = None,
) -> str:
    """Return the page of a campaign.

    Args:
        against: the name and the flights of an earlier campaign to compare with.

    Raises:
        BadInput: there are no flights, or none that both campaigns have flown.
    """
    kept = list(flights) if against is not None or "members" in manifest else flights
    figures = figures_of(kept)
    if figures.tally.runs == 0:
        raise BadInput("the campaign has no flights yet, so there is nothing to report")
    scenario = from_mapping(dict(manifest["scenario"]), "the campaign's scenario")
    parts = [
        _head(manifest, figures, wall_s),
        _cards(figures),
        _outcomes(figures, pad_model(scenario)),
        _distributions(figures, None if against is None else figures_of(against[1])),
        _varied(manifest, figures),
        _scenarios(manifest, kept),
        _causes(figures),
        _unsafe(figures),
        _worst(manifest, figures),
        "" if against is None else _comparison(against[0], differences_of(kept, against[1])),
        _made_with(manifest),
    ]
    return document(f"Campaign {manifest['name']}", "\n".join(parts), _STYLE)


def _head(manifest: Mapping[str, Any], figures: CampaignFigures, wall_s: float) -> str:
    t = figures.tally
    good = "good" if t.failed == 0 else ""
    facts = [
        ("scenario", str(manifest["scenario"]["title"])),
        ("perception", str(manifest["perception"])),
        ("flights", f"{t.runs:,}"),
        ("flown", f"{t.flown_s / 3600:.2f} h"),
        ("CPU", f"{t.cpu_s / t.runs:.2f} s a flight"),
        ("wall", f"{wall_s:.0f} s"),
        ("hash", t.hash),
    ]
    items = "".join(f"<li>{escape(name)} <b>{escape(value)}</b></li>" for name, value in facts)
    return (
        f"<header><h1>Campaign {escape(str(manifest['name']))}</h1>"
        f'<span class="outcome {good}">{t.on_pad:,} of {t.runs:,} on the pad</span></header>\n<ul class="facts">{items}</ul>'
    )


def _cards(figures: CampaignFigures) -> str:
    t = figures.tally
    output = t.summary("", "", 0.0)
    low, high = wilson(t.on_pad, t.runs)
    median, p95 = output["standing_median_m"], output["standing_p95_m"]
    touched = output["lateral_median_m"]
    cells = [
        (f"on the pad ({100 * low:.1f} to {100 * high:.1f} %)", f"{100 * t.on_pad / t.runs:.1f} %"),
        ("standing error, median", "-" if median is None else f"{100 * median:.1f} cm"),
        ("standing error, 95 %", "-" if p95 is None else f"{100 * p95:.1f} cm"),
        ("at the contact, median", "-" if touched is None else f"{100 * touched:.1f} cm"),
        ("contacts outside commit", f"{t.contacts_outside_commit:,}"),
        ("flights in the water", f"{t.in_water:,}"),
        ("unsafe flights", f"{t.unsafe:,}"),
    ]
    return '<div class="cards">' + "".join(f'<div class="card"><span>{k}</span><b>{v}</b></div>' for k, v in cells) + "</div>"


def _outcomes(figures: CampaignFigures, pad: Pad) -> str:
    from sitl.campaign import plots

    t = figures.tally
    rows = [("on the pad", t.on_pad, "#0a9d76"), ("refused rightly", t.refused, "#e69f00"), ("failed", t.failed, "#d55e00")]
    drawn = f"<figure>{plots.outcomes(rows, t.runs)}<figcaption>Outcomes, with Wilson's 95 % intervals.</figcaption></figure>"
    if not figures.place_m:
        drawn += '<p class="note">No flight touched the deck.</p>'
    else:
        drawn += (
            f"<figure>{plots.touchdowns(pad, figures.place_m)}<figcaption>Where each flight stands on the pad, from "
            "above. Blue dots: good flights; orange crosses: failed ones.</figcaption></figure>"
        )
    return f'<h2>Outcomes and touchdowns</h2><div class="plots">{drawn}</div>'


def _distributions(figures: CampaignFigures, other: CampaignFigures | None) -> str:
    from sitl.campaign import plots

    rows = [
        ("error", "lateral_m", "standing error, m"),
        ("vertical", "vertical_m_s", "speed into the deck, m/s"),
        ("sliding", "sliding_m_s", "speed along the deck, m/s"),
        ("duration", "duration_s", "time to the landing, s"),
    ]
    drawn = [
        f"<figure>{plots.distribution(name, getattr(figures, at), label, getattr(other, at) if other else ())}</figure>"
        for name, at, label in rows
        if getattr(figures, at)
    ]
    if not drawn:
        return ""
    pale = " Pale: the earlier campaign." if other else ""
    return (
        f'<h2>Distributions</h2><div class="plots">{"".join(drawn)}</div><p class="note">Share of the flights that stay below a '
        f"value; orange: median and 95 %. Error and time are of flights that landed on the pad.{pale}</p>"
    )


def _varied(manifest: Mapping[str, Any], figures: CampaignFigures) -> str:
    from sitl.campaign import plots

    keys = manifest["design"].get("keys", [])
    if not keys or not figures.points:
        return ""
    one = "".join(f"<figure>{plots.effect(effect_of(figures.points, key))}</figure>" for key in keys)
    pairs = list(itertools.combinations(keys, 2))
    two = "".join(f"<figure>{plots.success_map(map_of(figures.points, x, y))}</figure>" for x, y in pairs[:_MAPS_MAX])
    left = f" {len(pairs) - _MAPS_MAX} further pairs are not drawn." if len(pairs) > _MAPS_MAX else ""
    maps = (
        f'<h2>Two factors</h2><div class="plots">{two}</div><p class="note">Per cent of flights that landed on the pad or '
        f"refused rightly.{left}</p>"
        if two
        else ""
    )
    return (
        f'<h2>One factor</h2><div class="plots">{one}</div><p class="note">Good flights (on the pad or refused rightly) with '
        f"Wilson's 95 % interval, and the median standing error; over all values of the other keys.</p>{maps}"
    )


def _causes(figures: CampaignFigures) -> str:
    if not figures.causes:
        return '<h2>Causes</h2><p class="note">No flight failed.</p>'
    rows = sorted(figures.causes.items(), key=lambda item: -item[1])
    cells = "".join(
        f'<tr><td class="text">{escape(name)}</td><td>{n:,}</td><td>{100 * n / figures.tally.runs:.2f} %</td></tr>'
        for name, n in rows
    )
    return (
        '<h2>Why flights failed</h2><div class="wide"><table><thead><tr><th class="text">cause</th><th>flights</th>'
        f"<th>of all</th></tr></thead><tbody>{cells}</tbody></table></div>"
    )


def _unsafe(figures: CampaignFigures) -> str:
    """Return the list of unsafe flights."""
    t = figures.tally
    if not t.unsafe:
        return '<h2>Unsafe flights</h2><p class="note">None.</p>'
    named = t.unsafe_flights
    items = "".join(f"<li>{escape(name_of(one))}: <b>{escape('; '.join(one['unsafe']))}</b></li>" for one in named)
    left = f'<p class="note">{t.unsafe - len(named):,} more are not listed.</p>' if t.unsafe > len(named) else ""
    return f'<h2>Unsafe flights</h2><p class="note">{_UNSAFE}</p><ul class="flights">{items}</ul>{left}'


def _scenarios(manifest: Mapping[str, Any], flights: Iterable[Flight]) -> str:
    """Return the table of a set's scenarios."""
    if "members" not in manifest:
        return ""
    head = "".join(f'<th class="{"text" if name in _TEXTS else ""}">{name}</th>' for name in HEADINGS)
    rows = ""
    for one in by_scenario(manifest["members"], flights):
        cells = zip(HEADINGS, row(one), strict=True)
        rows += (
            "<tr>"
            + "".join(f'<td class="{"text" if name in _TEXTS else ""}">{escape(cell)}</td>' for name, cell in cells)
            + "</tr>"
        )
    table = f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody>"
    return f'<h2>Each scenario</h2><div class="wide"><table class="each">{table}</table></div>'


def fly_again(flight: Flight, options: Sequence[str], places: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return the command that flies a flight of a campaign again, to the bit, and writes its report.

    Args:
        options: further arguments of `decklander simulate`.
        places: path of each scenario that is not found by its name alone.
    """
    name = flight["scenario"]
    words = ["decklander", "simulate", places.get(name, name), "--seed", str(flight["seed"]), *options]
    if flight.get("in_set") and flight["perception"] != "pixels":
        words += ["--perception", flight["perception"]]
    for key, value in flight.get("varied", {}).items():
        words += ["--set", f"{key}={str(value).lower() if isinstance(value, bool) else value}"]
    return shlex.join([*words, "--report", f"flight-{flight['seed']}"])


def _worst(manifest: Mapping[str, Any], figures: CampaignFigures) -> str:
    items = []
    for flight in figures.worst:
        good = flight["grade"] != "failed"
        output = flight["grade"] if good else cause_of(flight)
        touch = flight["touchdown"]
        where = "" if touch is None else f", {100 * error_m(flight):.1f} cm off, {touch['vertical_speed_m_s']:.2f} m/s into it"
        command = escape(fly_again(flight, manifest.get("options", []), manifest.get("places", {})))
        named = escape(name_of(flight))
        items.append(f'<li>{named}: <b class="{"good" if good else ""}">{escape(output)}</b>{where}<code>{command}</code></li>')
    pictures = "Flights by rendered frames have pictures in it."
    if blind := sorted({flight["perception"] for flight in figures.worst} - {"pixels"}):
        pictures += f" Those by {' and '.join(blind)} render none; by pixels the same seed is another flight on the same sea."
    return (
        f'<h2>The worst {len(items)} flights</h2><p class="note">The command flies the same flight again, to the bit, and writes '
        f'its report. {pictures}</p><ul class="flights">{"".join(items)}</ul>'
    )


def _comparison(name: str, rows: Sequence[PairedDifference]) -> str:
    if not rows:
        raise BadInput(f"--against {name}: no seed was flown in both campaigns")
    cells = "".join(
        f'<tr><td class="text">{escape(r.name)}{f", {r.unit}" if r.unit else ""}</td><td>{r.pairs:,}</td><td>{r.other:.4g}</td>'
        f"<td>{r.ours:.4g}</td><td>{r.mean:+.4g}</td><td>{r.low:+.4g} to {r.high:+.4g}</td>"
        f"<td>{'clear' if r.clear else 'may be chance'}</td></tr>"
        for r in rows
    )
    return (
        f'<h2>Against {escape(name)}</h2><div class="wide"><table><thead><tr><th class="text">mean of</th><th>pairs</th>'
        "<th>earlier</th><th>this</th><th>difference</th><th>95 % interval</th><th></th></tr></thead>"
        f'<tbody>{cells}</tbody></table></div><p class="note">Paired by seed; the interval of the mean difference is a bootstrap '
        "of the pairs.</p>"
    )


def _made_with(manifest: Mapping[str, Any]) -> str:
    items = {**manifest["code"], **{f"digest of the {name}": digest for name, digest in manifest["files"].items()}}
    if manifest["design"]:
        items |= {"design": manifest["design"]["kind"], "varied": ", ".join(manifest["design"]["axes"])}
    listed = "".join(f"<li>{escape(str(name))} <b>{escape(str(value))}</b></li>" for name, value in items.items())
    return f'<h2>Flown with</h2><ul class="facts">{listed}</ul>'


MAP = "map.html"
WIND, SEA, VEHICLE = "weather.wind_m_s", "weather.sea_state", "vehicle.file"
AXES = (f"{WIND}=3:12:3", f"{SEA}=2,3,4,5", f"{VEHICLE}=ardrone2,quad_1_5kg,hexa_7kg")
"""Varied values of `campaign --map` unless `--vary` names others."""
_MAP_STYLE = """
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
    return document(f"What lands: {name}", "\n".join(parts), _MAP_STYLE)
