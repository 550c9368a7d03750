"""The report of a campaign: one page that needs nothing else."""

import itertools
import shlex
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from types import MappingProxyType
from typing import Any

from companion.tools.report.page_parts import document
from estimator.contracts.errors import BadInput
from estimator.vision.pad import Pad
from sitl.campaign.figures import CampaignFigures, PairedDifference, differences_of, effect_of, figures_of, map_of
from sitl.campaign.summary import cause_of, name_of, wilson
from sitl.campaign.tables import HEADINGS, by_scenario, row
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
