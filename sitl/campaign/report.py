"""The pages of a campaign, which need nothing else: its report, and a map of wind, sea and vehicle."""

import itertools
import shlex
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import PurePath
from types import MappingProxyType
from typing import Any

from companion.tools.report.page_parts import cards, document, header, table
from estimator.contracts.errors import BadInput
from estimator.vision.pad.pad import Pad
from sitl.campaign.figures import (
    HEADINGS,
    PAIRS_LEAST,
    Tallies,
    Tally,
    added,
    by_scenario,
    cause_of,
    cells_of,
    differences_of,
    effects_of,
    map_of,
    name_of,
    tallies_of,
    wilson,
)
from sitl.campaign.plan import differing
from sitl.campaign.workers import Flight, error_m
from sitl.scenario.scenario import from_mapping, pad_model

REPORT, MAP = "report.html", "map.html"
WIND, SEA, VEHICLE = "weather.wind_m_s", "weather.sea_state", "vehicle.file"
AXES = (f"{WIND}=3:12:3", f"{SEA}=2,3,4,5", f"{VEHICLE}=ardrone2,quad_1_5kg,hexa_7kg")
"""Varied values of `campaign --map` unless `--vary` names others."""
_MAPS_MAX, _ROWS_MAX = 10, 20
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
td:first-child, th:first-child { text-align: left; white-space: normal; }
.each { font-size: .85rem; } .each th { white-space: normal; vertical-align: bottom; }
.each :is(td, th):is(:nth-child(-n+3), :last-child) { text-align: left; white-space: normal; }
.each th, .each td { padding: .3rem .5rem; } .each td:last-child { min-width: 12rem; }
.map td:not(:first-child) { padding: 0; text-align: center; min-width: 6.5rem; line-height: 1.25; color: #111; }
.map td:empty { background: #ddd; } .map td div { padding: .35rem .5rem; }
.map td small { display: block; font-size: .72rem; } .map td b.unsafe { color: #a00; }
"""


def render_report(
    manifest: Mapping[str, Any],
    flights: Sequence[Flight] | Iterable[Flight],
    wall_s: float,
    against: tuple[str, Mapping[str, Any], list[Flight]] | None = None,
    changed: str = "",
) -> str:
    """Return the page of a campaign.

    Args:
        against: the name, manifest and flights of an earlier campaign to compare with.
        changed: what has changed since it was flown, so that its flights are not flown again; empty without.

    Raises:
        BadInput: there are no flights.
    """
    kept = list(flights) if against is not None else flights
    tallies = tallies_of(kept)
    if not tallies:
        raise BadInput("the campaign has no flights yet, so there is nothing to report")
    whole = added(tallies.values())
    scenario = from_mapping(dict(manifest["scenario"]), "the campaign's scenario")
    parts = [
        _head(manifest, whole, wall_s),
        _cards(whole),
        _outcomes(whole, pad_model(scenario)),
        _distributions(whole, None if against is None else added(tallies_of(against[2]).values())),
        _varied(tallies),
        _scenarios(manifest, tallies),
        _causes(whole),
        _unsafe(whole),
        _worst(manifest, whole.worst, changed),
        "" if against is None else _comparison(manifest, kept, *against),
        _made_with(manifest),
    ]
    return document(f"Campaign {manifest['name']}", "\n".join(parts), _STYLE)


def _note(text: str) -> str:
    return f'<p class="note">{text}</p>'


def _plots(title: str, drawn: Iterable[tuple[str, str]], note: str = "") -> str:
    """Return a section of figures, each with its caption; empty without any."""
    figures = "".join(
        f"<figure>{svg}{f'<figcaption>{caption}</figcaption>' if caption else ''}</figure>" for svg, caption in drawn
    )
    return f'<h2>{title}</h2><div class="plots">{figures}</div>{_note(note) if note else ""}' if figures else ""


def _head(manifest: Mapping[str, Any], whole: Tally, wall_s: float) -> str:
    runs, on_pad = whole.counts["runs"], whole.counts["on_pad"]
    facts = [
        ("scenario", str(manifest["scenario"]["title"])),
        ("perception", str(manifest["perception"])),
        ("flights", f"{runs:,}"),
        ("flown", f"{whole.flown_s / 3600:.2f} h"),
        ("CPU", f"{whole.cpu_s / runs:.2f} s a flight"),
        ("wall", f"{wall_s:.0f} s"),
        ("hash", whole.hash),
    ]
    return header(f"Campaign {manifest['name']}", f"{on_pad:,} of {runs:,} on the pad", whole.counts["failed"] == 0, facts)


def _cards(whole: Tally) -> str:
    def cm(name: str, q: float) -> str:
        value = whole.quantile(name, q)
        return "-" if value is None else f"{100 * value:.1f} cm"

    c = whole.counts
    low, high = wilson(c["on_pad"], c["runs"])
    return cards(
        [
            (f"on the pad (95 % interval {100 * low:.1f} to {100 * high:.1f} %)", f"{100 * c['on_pad'] / c['runs']:.1f} %"),
            ("standing error, median", cm("standing_m", 0.5)),
            ("standing error, 95 %", cm("standing_m", 0.95)),
            ("at the contact, median", cm("lateral_m", 0.5)),
            ("contacts outside commit", f"{c['contacts_outside_commit']:,}"),
            ("flights in the water", f"{c['in_water']:,}"),
            ("unsafe flights", f"{c['unsafe']:,}"),
        ]
    )


def _outcomes(whole: Tally, pad: Pad) -> str:
    from sitl.campaign import plots

    colours = {"on pad": "#0a9d76", "refused rightly": "#e69f00", "failed": "#d55e00"}
    counts = (whole.counts[name] for name in ("on_pad", "refused", "failed"))
    rows = [(name, count, colour) for (name, colour), count in zip(colours.items(), counts, strict=True)]
    drawn = [(plots.outcomes(rows, whole.counts["runs"]), "Outcomes, with Wilson's 95 % intervals.")]
    if whole.place_m:
        caption = "Where each flight stands on the pad, from above. Blue dots: good flights; orange crosses: failed ones."
        drawn.append((plots.touchdowns(pad, whole.place_m), caption))
    return _plots("Outcomes and touchdowns", drawn, "" if whole.place_m else "No flight touched the deck.")


def _distributions(whole: Tally, other: Tally | None) -> str:
    from sitl.campaign import plots

    labels = {
        "standing_m": "standing error, m",
        "vertical_m_s": "speed into the deck, m/s",
        "sliding_m_s": "speed along the deck, m/s",
        "duration_s": "duration of the flight, s",
    }
    drawn = [
        (plots.distribution(name, whole.values[name], label, other.values[name] if other else ()), "")
        for name, label in labels.items()
        if whole.values[name]
    ]
    note = (
        "Share of the flights that stay below a value; orange: median and 95 %. Error and time are of flights that landed on the "
        "pad."
    )
    return _plots("Distributions", drawn, note + (" Pale: the earlier campaign." if other else ""))


def _varied(tallies: Tallies) -> str:
    from sitl.campaign import plots

    effects = effects_of(tallies)
    pairs = list(itertools.combinations(effects, 2))
    left = f" {len(pairs) - _MAPS_MAX} further pairs are not drawn." if len(pairs) > _MAPS_MAX else ""
    one = _plots(
        "One factor",
        [(plots.effect(key, rows), "") for key, rows in effects.items()],
        "Good flights (on the pad or refused rightly) with Wilson's 95 % interval, and the median standing error; over all "
        "values of the other keys.",
    )
    two = _plots(
        "Two factors",
        [(plots.success_map(map_of(tallies, x, y)), "") for x, y in pairs[:_MAPS_MAX]],
        f"Per cent of flights that landed on the pad or refused rightly.{left}",
    )
    return one + two


def _scenarios(manifest: Mapping[str, Any], tallies: Tallies) -> str:
    """Return the table of a set's scenarios."""
    if "members" not in manifest:
        return ""
    rows = ([escape(cell) for cell in cells_of(row)] for row in by_scenario(manifest["members"], tallies))
    return f'<h2>Each scenario</h2><div class="each">{table(HEADINGS, rows)}</div>'


def _causes(whole: Tally) -> str:
    if not (causes := whole.kinds["causes"]):
        return f"<h2>Causes</h2>{_note('No flight failed.')}"
    rows = ((escape(name), f"{n:,}", f"{100 * n / whole.counts['runs']:.2f} %") for name, n in causes.most_common())
    return f"<h2>Why flights failed</h2>{table(('cause', 'flights', 'of all'), rows)}"


def _unsafe(whole: Tally) -> str:
    """Return the list of unsafe flights."""
    named = whole.named["unsafe"]
    if not named:
        return f"<h2>Unsafe flights</h2>{_note('None.')}"
    items = "".join(f"<li>{escape(name_of(one))}: <b>{escape('; '.join(one['unsafe']))}</b></li>" for one in named)
    left = whole.counts["unsafe"] - len(named)
    more = _note(f"{left:,} more are not listed.") if left else ""
    return f'<h2>Unsafe flights</h2>{_note(_UNSAFE)}<ul class="flights">{items}</ul>{more}'


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
    varied = [f"{key}={str(x).lower() if isinstance(x, bool) else x}" for key, x in flight.get("varied", {}).items()]
    folder = "-".join(["flight", PurePath(name).stem, str(flight["seed"]), *(text.replace("/", "-") for text in varied)])
    return shlex.join([*words, *(word for text in varied for word in ("--set", text)), "--report", folder])


def _worst(manifest: Mapping[str, Any], worst: Sequence[Flight], changed: str) -> str:
    items = []
    for flight in worst:
        good = flight["grade"] != "failed"
        output = flight["grade"] if good else cause_of(flight)
        touch = flight["touchdown"]
        where = "" if touch is None else f", {100 * error_m(flight):.1f} cm off, {touch['vertical_speed_m_s']:.2f} m/s into it"
        command = escape(fly_again(flight, manifest.get("options", []), manifest.get("places", {})))
        named = escape(name_of(flight))
        items.append(f'<li>{named}: <b class="{"good" if good else ""}">{escape(output)}</b>{where}<code>{command}</code></li>')
    pictures = "Flights by rendered frames have pictures in it."
    if blind := sorted({flight["perception"] for flight in worst} - {"pixels"}):
        pictures += f" Those by {' and '.join(blind)} render none; by pixels the same seed is another flight on the same sea."
    same = f"may fly another flight now: {escape(changed)}. It" if changed else "flies the same flight again, to the bit, and"
    note = _note(f"The command {same} writes its report. {pictures}")
    return f'<h2>The worst {len(items)} flights</h2>{note}<ul class="flights">{"".join(items)}</ul>'


def _comparison(
    manifest: Mapping[str, Any], flights: Iterable[Flight], name: str, other: Mapping[str, Any], theirs: Sequence[Flight]
) -> str:
    heads = ("mean of", "pairs", "earlier", "this", "difference", "95 % interval", "")
    rows = (
        (
            f"{escape(r.name)}{f', {r.unit}' if r.unit else ''}",
            *(f"{r.pairs:,}", f"{r.other:.4g}", f"{r.ours:.4g}", f"{r.mean:+.4g}", f"{r.low:+.4g} to {r.high:+.4g}"),
            "clear" if r.clear else "too few pairs" if r.pairs < PAIRS_LEAST else "may be chance",
        )
        for r in differences_of(flights, theirs)
    )
    note = "Paired by seed; the interval of the mean difference is a bootstrap of the pairs, and too narrow for fewer than 20."
    differs = [[escape(str(x)) for x in row] for row in differing(_flown_with(other), _flown_with(manifest))]
    more = f" {len(differs) - _ROWS_MAX} more keys differ." if len(differs) > _ROWS_MAX else ""
    what = f"Keys of scenario and settings are written as for --set.{more}" if differs else "They differ in their seeds alone."
    shown = table(("what differs", "earlier", "this"), differs[:_ROWS_MAX]) if differs else ""
    return f"<h2>Against {escape(name)}</h2>{shown}{_note(what)}{table(heads, rows)}{_note(note)}"


def _flown_with(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return what makes the flights of a campaign, each key under the name that `--set` has for it."""
    own: dict[str, Any] = {name: manifest[name] for name in ("name", "perception", "perception_model", "files", "code")}
    if "members" in manifest:
        return {**own, **manifest["members"]}
    return {**own, **manifest["scenario"], "settings": manifest["settings"], "varied": manifest["design"].get("axes", [])}


def _made_with(manifest: Mapping[str, Any]) -> str:
    items = {**manifest["code"], **{f"digest of the {name}": digest for name, digest in manifest["files"].items()}}
    items |= {"options": shlex.join(manifest.get("options", ())) or "none"}
    if manifest["design"]:
        items |= {"design": manifest["design"]["kind"], "varied": ", ".join(manifest["design"]["axes"])}
    listed = "".join(f"<li>{escape(str(name))} <b>{escape(str(value))}</b></li>" for name, value in items.items())
    return f'<h2>Flown with</h2><ul class="facts">{listed}</ul>'


def render_map(name: str, perception: str, flights: Iterable[Flight]) -> str:
    """Return the page: a table for each vehicle, sea states downwards and winds across.

    Args:
        name: of the campaign's scenario.
        perception: how the flights perceived the pad.

    Raises:
        BadInput: no flight varies all three.
    """
    cells: dict[tuple[str, Any, Any], Tally] = {}
    for (_, point), tally in tallies_of(flights).items():
        if {WIND, SEA, VEHICLE} <= (varied := dict(point)).keys():
            cells.setdefault((PurePath(str(varied[VEHICLE])).stem, varied[SEA], varied[WIND]), Tally()).add(tally)
    if not cells:
        raise BadInput(f"a map needs flights that vary {WIND}, {SEA} and {VEHICLE}")
    vehicles, seas, winds = (sorted({key[n] for key in cells}) for n in range(3))
    runs = sum(cell.counts["runs"] for cell in cells.values())
    note = (
        f"{runs:,} flights ({escape(perception)}). Each cell: landed on the pad of flown; median and 95 % of the distance from "
        "the centre at which the vehicle stands 5 s after its contact; why others were refused. Wind 10 m over the water; waves "
        "of the state as that wind's own or as a swell."
    )
    parts = [f"<header><h1>What lands: {escape(name)}</h1></header>", _note(note)]
    for vehicle in vehicles:
        rows = ([f"sea state {sea:g}", *(_map_cell(cells.get((vehicle, sea, wind))) for wind in winds)] for sea in seas)
        heads = ("sea and wind", *(f"{wind:g} m/s" for wind in winds))
        parts.append(f'<h2>{escape(vehicle)}</h2><div class="map">{table(heads, rows)}</div>')
    return document(f"What lands: {name}", "\n".join(parts), _STYLE)


def _map_cell(cell: Tally | None) -> str:
    """Return what lands at one wind and sea: the share by the cell's colour, how well, and why the others are refused."""
    if cell is None:
        return ""
    landed, runs = len(cell.values["standing_m"]), cell.counts["runs"]
    lines = [f"{landed}/{runs}"]
    if landed:
        median, p95 = (100.0 * (cell.quantile("standing_m", q) or 0.0) for q in (0.5, 0.95))
        lines.append(f"{median:.1f}, {p95:.1f} cm")
    lines += [f"<small>{n} refused: {escape(reason)}</small>" for reason, n in cell.kinds["refusals"].most_common(2)]
    if cell.counts["unsafe"]:
        lines.append(f'<b class="unsafe">{cell.counts["unsafe"]} unsafe</b>')
    return f'<div style="background: hsl({120.0 * landed / runs:.0f} 45% 78%)">{"<br>".join(lines)}</div>'
