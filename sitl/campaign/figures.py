"""The numbers that a campaign prints and its report shows, from its flights, alone or seed by seed beside another campaign."""

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from estimator.contracts.geometry import F64
from sitl.campaign.summary import CampaignTally, cause_of, severity, wilson
from sitl.campaign.task import Flight, error_m, job_of

WORST = 10
_CELLS = 8
"""Cells to a side of a map whose points lie on no grid."""


VariedPoint = tuple[dict[str, Any], bool, float]
"""Varied values of a flight, whether it was good, and its standing error in m (nan without a landing on the pad)."""


def varied_point(flight: Flight) -> VariedPoint:
    """Return what the figures of varied keys need of a flight."""
    stands_m = error_m(flight) if flight["landed_on_pad"] else float("nan")
    return flight["varied"], flight["grade"] != "failed", stands_m


@dataclass(slots=True)
class CampaignFigures:
    """Figures of a campaign's flights for a report."""

    tally: CampaignTally = field(default_factory=CampaignTally)
    causes: dict[str, int] = field(default_factory=dict)
    worst: list[Flight] = field(default_factory=list)
    """The worst flights, the worst first."""
    place_m: list[tuple[float, float, bool]] = field(default_factory=list)
    """Place of each flight that touched the deck: along the arrow, to starboard, and whether the flight was good."""
    lateral_m: list[float] = field(default_factory=list)
    vertical_m_s: list[float] = field(default_factory=list)
    sliding_m_s: list[float] = field(default_factory=list)
    duration_s: list[float] = field(default_factory=list)
    points: list[VariedPoint] = field(default_factory=list)

    def take(self, flight: Flight) -> None:
        """Add a flight."""
        self.tally.take(flight)
        good = flight["grade"] != "failed"
        if not good:
            cause = cause_of(flight)
            self.causes[cause] = self.causes.get(cause, 0) + 1
        touch = flight["touchdown"]
        if touch is not None and touch["surface"] != "water":
            if (place := (flight.get("standing") or touch).get("p_pad_m")) is not None:
                self.place_m.append((place[0], place[1], good))
            self.vertical_m_s.append(touch["vertical_speed_m_s"])
            self.sliding_m_s.append(touch["lateral_speed_m_s"])
        if flight["landed_on_pad"]:
            self.lateral_m.append(error_m(flight))
            self.duration_s.append(flight["duration_s"])
        if "varied" in flight:
            self.points.append(varied_point(flight))
        self.worst.append(flight)
        if len(self.worst) >= 20 * WORST:
            self.trim()

    def trim(self) -> None:
        """Keep the worst flights only."""
        self.worst = sorted(self.worst, key=_badness, reverse=True)[:WORST]


def figures_of(flights: Iterable[Flight]) -> CampaignFigures:
    """Return the figures of flights."""
    out = CampaignFigures()
    for flight in flights:
        out.take(flight)
    out.trim()
    return out


def _badness(flight: Flight) -> tuple[float, ...]:
    contacts = flight["contacts"]
    lateral_m = max((contact["lateral_m"] for contact in contacts), default=0.0)
    speed = max((contact["vertical_speed_m_s"] for contact in contacts), default=0.0)
    return severity(flight), flight["contacts_outside_commit"], lateral_m, speed, flight["duration_s"], -flight["seed"]


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """Success against one varied key."""

    key: str
    values: list[Any]
    counts: list[int]
    """Number of flights at each value."""
    shares: F64
    """The share of good flights at each value, with its 95 % interval from `low` to `high`."""
    low: F64
    high: F64
    lateral_m: F64
    """Median standing error at each value, nan where nothing landed."""


@dataclass(frozen=True, slots=True, eq=False)
class SuccessMap:
    """Success against two varied keys: `shares[j, i]` at the j-th value of `y_key` and the i-th of `x_key`."""

    x_key: str
    y_key: str
    x: list[str]
    y: list[str]
    shares: F64
    """The (len(y), len(x)) shares of good flights, nan without flights."""
    counts: F64


def effect_of(points: Sequence[VariedPoint], key: str) -> Effect:
    """Return how success depends on one key, over all values of the others."""
    labels, place = _cells([point[key] for point, _, _ in points])
    good = np.array([ok for _, ok, _ in points])
    lateral = np.array([m for _, _, m in points])
    counts = [int(np.sum(place == n)) for n in range(len(labels))]
    hits = [int(np.sum(good[place == n])) for n in range(len(labels))]
    bands = np.array([wilson(h, c) for h, c in zip(hits, counts, strict=True)])
    landed = [lateral[(place == n) & np.isfinite(lateral)] for n in range(len(labels))]
    medians = np.array([np.median(some) if len(some) else np.nan for some in landed])
    return Effect(key, labels, counts, np.array(hits) / np.maximum(1, counts), bands[:, 0], bands[:, 1], medians)


def map_of(points: Sequence[VariedPoint], x_key: str, y_key: str) -> SuccessMap:
    """Return how success depends on two keys, over all values of the others."""
    x, i = _cells([point[x_key] for point, _, _ in points])
    y, j = _cells([point[y_key] for point, _, _ in points])
    good = np.array([ok for _, ok, _ in points], dtype=float)
    counts, hits = np.zeros((len(y), len(x))), np.zeros((len(y), len(x)))
    np.add.at(counts, (j, i), 1.0)
    np.add.at(hits, (j, i), good)
    with np.errstate(invalid="ignore"):
        shares = hits / counts
    return SuccessMap(x_key, y_key, [_label(v) for v in x], [_label(v) for v in y], shares, counts)


def _cells(values: Sequence[Any]) -> tuple[list[Any], np.ndarray[Any, np.dtype[np.intp]]]:
    """Return the distinct values, or the middles of a few cells where there are many, and the place of each value among them."""
    distinct = sorted(set(values))
    if len(distinct) <= 2 * _CELLS or isinstance(distinct[0], str):
        places = {value: n for n, value in enumerate(distinct)}
        return distinct, np.array([places[value] for value in values])
    low, high = float(distinct[0]), float(distinct[-1])
    edges = np.linspace(low, high, _CELLS + 1)
    place = np.clip(np.searchsorted(edges, np.array(values, dtype=float), side="right") - 1, 0, _CELLS - 1)
    return [float(f"{m:.4g}") for m in 0.5 * (edges[:-1] + edges[1:])], place


def _label(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


_RESAMPLES = 2000


@dataclass(frozen=True, slots=True)
class PairedDifference:
    """The mean of a figure in both campaigns, over the flights that have it in both, and the interval of the difference."""

    name: str
    unit: str
    pairs: int
    ours: float
    other: float
    low: float
    high: float

    @property
    def mean(self) -> float:
        """This campaign less the other."""
        return self.ours - self.other

    @property
    def clear(self) -> bool:
        """True if the interval leaves zero out."""
        return self.low > 0.0 or self.high < 0.0


def _touch(name: str) -> Callable[[Flight], float | None]:
    return lambda f: f["touchdown"][name] if f["landed_on_pad"] else None


FIGURES: tuple[tuple[str, str, Callable[[Flight], float | None]], ...] = (
    ("on the pad", "share", lambda f: float(f["grade"] == "on pad")),
    ("failed", "share", lambda f: float(f["grade"] == "failed")),
    ("standing error", "m", lambda f: error_m(f) if f["landed_on_pad"] else None),
    ("speed into the deck", "m/s", _touch("vertical_speed_m_s")),
    ("speed along the deck", "m/s", _touch("lateral_speed_m_s")),
    ("duration", "s", lambda f: f["duration_s"]),
    ("contacts outside commit", "", lambda f: float(f["contacts_outside_commit"])),
)


def differences_of(ours: Iterable[Flight], other: Iterable[Flight]) -> list[PairedDifference]:
    """Return the differences between two campaigns in all figures, over the seeds (and varied values) that both have flown."""
    theirs = {job_of(flight).key: flight for flight in other}
    pairs = [(flight, theirs[key]) for flight in ours if (key := job_of(flight).key) in theirs]
    out = []
    for name, unit, figure in FIGURES:
        both = [(a, b) for one, two in pairs if (a := figure(one)) is not None and (b := figure(two)) is not None]
        if both:
            table = np.array(both, dtype=float)
            low, high = bootstrap_interval(table[:, 0] - table[:, 1])
            out.append(PairedDifference(name, unit, len(both), float(table[:, 0].mean()), float(table[:, 1].mean()), low, high))
    return out


def bootstrap_interval(values: F64, seed: int = 0) -> tuple[float, float]:
    """Return the 95 % interval of the mean of (n,) values by the percentile bootstrap.

    Source: B. Efron, R. J. Tibshirani, An Introduction to the Bootstrap (1993), section 13.3.
    """
    rng = np.random.default_rng(seed)
    means = np.array([values[rng.integers(len(values), size=len(values))].mean() for _ in range(_RESAMPLES)])
    low, high = np.quantile(means, (0.025, 0.975))
    return float(low), float(high)


def columns(lines: Sequence[Sequence[str]], texts: Collection[int]) -> str:
    """Return lines of as many cells each, aligned.

    Args:
        lines: the cells; the first line has the headings.
        texts: numbers of the columns that are aligned on the left; the others are on the right.
    """
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(
            cell.ljust(w) if i in texts else cell.rjust(w) for i, (cell, w) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


@dataclass(slots=True)
class ScenarioTally:
    """The outcomes of one scenario of a set."""

    name: str
    expect: str
    perception: str
    runs: int = 0
    on_pad: int = 0
    refused: int = 0
    failed: int = 0
    contacts_outside_commit: int = 0
    in_water: int = 0
    unsafe: int = 0
    """Number of flights in which something was unsafe."""
    why: Counter[str] = field(default_factory=Counter)
    """Causes of the failures."""

    def take(self, flight: Flight) -> None:
        """Count a flight."""
        self.runs += 1
        self.on_pad += flight["grade"] == "on pad"
        self.refused += flight["grade"] == "refused rightly"
        self.contacts_outside_commit += flight["contacts_outside_commit"]
        self.in_water += flight["in_water"]
        self.unsafe += bool(flight["unsafe"])
        if flight["grade"] == "failed":
            self.failed += 1
            self.why[cause_of(flight)] += 1

    @property
    def causes(self) -> str:
        """The causes of the failures, the most frequent first; empty where none failed."""
        return "; ".join(f"{n} {cause}" if n > 1 else cause for cause, n in self.why.most_common())

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "scenario": self.name,
            "expect": self.expect,
            "perception": self.perception,
            "runs": self.runs,
            "on_pad": self.on_pad,
            "refused": self.refused,
            "failed": self.failed,
            "contacts_outside_commit": self.contacts_outside_commit,
            "in_water": self.in_water,
            "unsafe": self.unsafe,
            "causes": dict(self.why),
        }


HEADINGS = ("scenario", "expected", "by", "flights", "on pad", "refused", "failed", "outside commit", "water", "unsafe", "why")


def by_scenario(members: Mapping[str, Any], flights: Iterable[Flight]) -> list[ScenarioTally]:
    """Return the outcomes of each scenario of a set, in the order of the set.

    Args:
        members: of the campaign's manifest: the scenario and the perception of each, by name.
    """
    out = {name: ScenarioTally(name, m["scenario"].get("expect", "land"), m["perception"]) for name, m in members.items()}
    for flight in flights:
        out[flight["scenario"]].take(flight)
    return list(out.values())


def row(t: ScenarioTally) -> tuple[str, ...]:
    """Return the cells of a scenario's line, as `HEADINGS`."""
    counts = (t.runs, t.on_pad, t.refused, t.failed, t.contacts_outside_commit, t.in_water, t.unsafe)
    return (t.name, t.expect.replace("_", " "), t.perception, *map(str, counts), t.causes)


def in_columns(tallies: Iterable[ScenarioTally]) -> str:
    """Return a table for a terminal, a line for each scenario."""
    return columns([HEADINGS, *map(row, tallies)], texts=(0, 1, 2, len(HEADINGS) - 1))


def by_value(points: list[VariedPoint]) -> list[Effect]:
    """Return how success depends on each varied key, over all values of the others."""
    return [effect_of(points, key) for key in points[0][0]] if points else []


def as_json(effect: Effect) -> list[dict[str, Any]]:
    """Return plain values, an object for each value of the key: shares of good flights are 0 to 1, errors in m."""
    rows = zip(effect.values, effect.counts, effect.shares, effect.low, effect.high, effect.lateral_m, strict=True)
    return [
        {
            "value": value,
            "runs": runs,
            "good": round(float(share), 6),
            "good_interval": [round(float(low), 6), round(float(high), 6)],
            "lateral_median_m": None if math.isnan(error_m) else round(float(error_m), 4),
        }
        for value, runs, share, low, high, error_m in rows
    ]


def in_rows(effects: Iterable[Effect]) -> str:
    """Return a table for each key, a line for each value."""
    return "\n".join(
        columns([(effect.key, "flights", "good", "95 % interval", "error, median"), *_rows(effect)], ()) for effect in effects
    )


def _rows(effect: Effect) -> list[tuple[str, ...]]:
    return [
        (
            f"{row['value']:g}" if isinstance(row["value"], float) else str(row["value"]),
            str(row["runs"]),
            f"{100 * row['good']:.0f} %",
            "{:.0f} to {:.0f} %".format(*(100 * share for share in row["good_interval"])),
            "-" if row["lateral_median_m"] is None else f"{100 * row['lateral_median_m']:.1f} cm",
        )
        for row in as_json(effect)
    ]
