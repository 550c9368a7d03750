"""The figures of a campaign: flights are tallied by scenario and varied values, and summary, tables and pages add the tallies up.

What is counted of a flight is in four tables: `COUNTS`, `VALUES`, `KINDS` and, for the comparison of two campaigns, `FIGURES`.
"""

import hashlib
import math
import re
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct, field

from estimator.contracts.geometry import F64
from sitl.campaign.plan import Point
from sitl.campaign.workers import ERROR, Flight, error_m, flight_hash, job_of

_Z95 = 1.959963984540054
"""Quantile of the standard normal distribution for 95 % between both tails."""
_HASH_BITS = 128
UNSAFE_MAX = 100
"""Number of unsafe flights that are named, and of others that failed; the rest is counted."""
WORST = 10
_PRINTED = 10
_CELLS = 8
"""Cells to a side of a map whose points lie on no grid."""
_RESAMPLES = 2000


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a probability, (0, 1) without trials.

    Source: E. B. Wilson, Probable inference, the law of succession, and statistical inference, JASA 22 (1927), 209-212.
    """
    if trials == 0:
        return 0.0, 1.0
    p, n, z2 = successes / trials, trials, _Z95**2
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = _Z95 * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n)) / (1 + z2 / n)
    # At the ends the interval touches them exactly, which rounding would miss.
    return (0.0 if successes == 0 else middle - half), (1.0 if successes == trials else middle + half)


_OVERRULED = ("strayed_m", "rose_m", "held_sank_m", "lands_late", "disobeyed_s", "unordered")
_HARD = ("into_deck_m_s", "along_deck_m_s", "contact_tilt_deg")


def _over(flight: Flight, *counts: str) -> bool:
    """Return whether the referee counted more of one of these than its limit."""
    counted = flight.get("referee") or {}
    return any(value > most for value, most in (counted[name] for name in counts if name in counted))


RULES: tuple[tuple[str, Callable[[Flight], bool]], ...] = (
    ("the flight raised an error", lambda f: f["outcome"] == ERROR),
    ("the service died in flight", lambda f: _over(f, "died")),
    ("in the water", lambda f: bool(f["in_water"])),
    ("came down without sight of the pad", lambda f: _over(f, "blind_m", "unreached_m")),
    (
        "struck the deck beside the pad, then landed on the pad",
        lambda f: bool(f["landed_on_pad"]) and any(not contact["on_pad"] for contact in f["contacts"]),
    ),
    ("a person was overruled", lambda f: _over(f, *_OVERRULED)),
    ("touched the pad harder than it bears", lambda f: _over(f, *_HARD) and any(c["surface"] == "pad" for c in f["contacts"])),
    ("landed beside the pad", lambda f: f["outcome"] == "landed" and f["touchdown"] is not None and not f["touchdown"]["on_pad"]),
    ("struck the deck beside the pad and did not land", lambda f: any(not contact["on_pad"] for contact in f["contacts"])),
    ("gave up, though it should land", lambda f: f["outcome"] == "gave up"),
    ("time ran out", lambda f: f["outcome"] == "time ran out"),
)
"""Name of the cause, and whether it fits a failed flight; in order of severity. The first rule that fits names the cause."""


def cause_of(flight: Flight) -> str:
    """Return the cause of a failed flight."""
    name = next((name for name, fits in RULES if fits(flight)), f"ended otherwise: {flight['outcome']}")
    return ": ".join((name, *_refusal(flight))) if name.startswith("gave up") else name


def severity(flight: Flight) -> int:
    """Return how bad a flight's end is: 0 for none, else the more the earlier its rule."""
    if flight["grade"] != "failed":
        return 0
    return next((len(RULES) - place + 1 for place, (_, fits) in enumerate(RULES) if fits(flight)), 1)


def _badness(flight: Flight) -> tuple[float, ...]:
    # In the order of what the report shows of a flight.
    touch = flight["touchdown"]
    off_m, speed_m_s = (0.0, 0.0) if touch is None else (error_m(flight), touch["vertical_speed_m_s"])
    return severity(flight), off_m, speed_m_s, flight["contacts_outside_commit"], flight["duration_s"], -flight["seed"]


def _landed(of: Callable[[Flight], float]) -> Callable[[Flight], float | None]:
    return lambda f: of(f) if f["landed_on_pad"] else None


def _touched(name: str) -> Callable[[Flight], float | None]:
    return lambda f: f["touchdown"][name] if _on_deck(f) else None


def _on_deck(flight: Flight) -> bool:
    return flight["touchdown"] is not None and flight["touchdown"]["surface"] != "water"


def _named_sensors(flight: Flight) -> set[str]:
    return {one["text"].removeprefix("the ").split()[0] for one in flight.get("named", ())}


def _afterwards(flight: Flight) -> list[str]:
    later = flight.get("afterwards")
    return [] if later is None else ["in the water" if later["in_water"] else later["vehicle_phase"]]


def _refusal(flight: Flight) -> list[str]:
    """Return why it gave up, without what stands in brackets and the figures that differ from flight to flight."""
    if flight["landed_on_pad"] or not flight["refused"]:
        return []
    reason = flight["refused"].partition(";")[0]
    return [re.sub(r"\s*\([^)]*\)|\s(by|at|after|for|within) -?\d+(\.\d+)? \S+", "", reason)[:60]]


COUNTS: Mapping[str, Callable[[Flight], int]] = {
    "runs": lambda f: 1,
    "on_pad": lambda f: f["grade"] == "on pad",
    "refused": lambda f: f["grade"] == "refused rightly",
    "failed": lambda f: f["grade"] == "failed",
    "errors": lambda f: f["outcome"] == ERROR,
    "contacts_outside_commit": lambda f: f["contacts_outside_commit"],
    "in_water": lambda f: f["in_water"],
    "unsafe": lambda f: bool(f["unsafe"]),
    "naming": lambda f: bool(_named_sensors(f)),
}
VALUES: Mapping[str, Callable[[Flight], float | None]] = {
    "lateral_m": _landed(lambda f: f["touchdown"]["lateral_m"]),
    "standing_m": _landed(error_m),
    "slid_m": _landed(lambda f: (f.get("standing") or {}).get("slid_m", 0.0)),
    "duration_s": _landed(lambda f: f["duration_s"]),
    "vertical_m_s": _touched("vertical_speed_m_s"),
    "sliding_m_s": _touched("lateral_speed_m_s"),
}
"""The values whose quantiles and distributions are shown; None where a flight has none."""
KINDS: Mapping[str, Callable[[Flight], Iterable[str]]] = {
    "causes": lambda f: [cause_of(f)] if f["grade"] == "failed" else [],
    "after_refusal": _afterwards,
    "named_sensors": _named_sensors,
    "refusals": _refusal,
}
"""Things that are counted by their words."""


def _number(text: str) -> int:
    """Return a hash that can be added to others."""
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=_HASH_BITS // 8).digest())


class Tally(Struct):
    """The figures of some flights. None depends on the order in which they come, and two tallies can be added."""

    counts: Counter[str] = field(default_factory=Counter)
    values: dict[str, "array[float]"] = field(default_factory=lambda: {name: array("d") for name in VALUES})
    kinds: dict[str, Counter[str]] = field(default_factory=lambda: {name: Counter() for name in KINDS})
    flown_s: float = 0.0
    cpu_s: float = 0.0
    place_m: list[tuple[float, float, bool]] = field(default_factory=list)
    """Place of each flight that touched the deck: along the arrow, to starboard, and whether the flight was good."""
    named: dict[str, list[dict[str, Any]]] = field(default_factory=lambda: {"unsafe": [], "because": []})
    """The first unsafe flights by scenario and seed with what was unsafe, and the first others that failed with why."""
    worst: list[Flight] = field(default_factory=list)
    """The worst flights, the worst first."""
    _hash: int = 0
    _results: int = 0

    def take(self, flight: Flight) -> None:
        """Count a flight."""
        for name, count in COUNTS.items():
            self.counts[name] += count(flight)
        for name, of in VALUES.items():
            if (value := of(flight)) is not None:
                self.values[name].append(value)
        for name, words in KINDS.items():
            self.kinds[name].update(words(flight))
        self.flown_s += flight["duration_s"]
        self.cpu_s += flight["cpu_s"]
        good = flight["grade"] != "failed"
        if _on_deck(flight) and (place := (flight.get("standing") or flight["touchdown"]).get("p_pad_m")) is not None:
            self.place_m.append((place[0], place[1], good))
        if flight["unsafe"] or not good:
            reason = "unsafe" if flight["unsafe"] else "because"
            keys = ("scenario", "seed", "varied", reason)
            self.named[reason].append({key: flight[key] for key in keys if key in flight})
        self.worst.append(flight)
        self._hash = (self._hash + _number(f"{job_of(flight).key} {flight['hash']}")) % 2**_HASH_BITS
        if "varied" in flight:
            self._results = (self._results + _number(flight_hash({**flight, "varied": {}}))) % 2**_HASH_BITS
        if len(self.worst) >= 20 * WORST:
            self.trim()

    def add(self, other: "Tally") -> None:
        """Add the flights of another tally."""
        self.counts.update(other.counts)
        for name in VALUES:
            self.values[name].extend(other.values[name])
        for name in KINDS:
            self.kinds[name].update(other.kinds[name])
        for reason, flights in other.named.items():
            self.named[reason] += flights
        self.flown_s, self.cpu_s = self.flown_s + other.flown_s, self.cpu_s + other.cpu_s
        self.place_m += other.place_m
        self.worst += other.worst
        self._hash = (self._hash + other._hash) % 2**_HASH_BITS
        self._results = (self._results + other._results) % 2**_HASH_BITS
        self.trim()

    def trim(self) -> None:
        """Keep the flights that are named, and the worst, only."""
        for flights in self.named.values():
            flights.sort(key=lambda f: (f["scenario"], f["seed"], str(f.get("varied", ""))))
            del flights[UNSAFE_MAX:]
        self.worst.sort(key=_badness, reverse=True)
        del self.worst[WORST:]

    @property
    def hash(self) -> str:
        """The hash of all flights, the same in whatever order and wherever they were flown."""
        return f"{self._hash:0{_HASH_BITS // 4}x}"

    @property
    def results_hash(self) -> str:
        """The same without the varied values: equal where every flight went the same."""
        return f"{self._results:0{_HASH_BITS // 4}x}"

    @property
    def good(self) -> int:
        """Number of flights that landed on the pad or refused rightly."""
        return self.counts["runs"] - self.counts["failed"]

    def quantile(self, name: str, q: float) -> float | None:
        """Return a quantile of one of `VALUES`; None without values."""
        return round(float(np.quantile(self.values[name], q)), 4) if self.values[name] else None

    def summary(self, scenario: str, perception: str, wall_s: float) -> dict[str, Any]:
        """Return the summary as plain values: lengths in m, times in s."""
        c = self.counts
        return {
            "scenario": scenario,
            "perception": perception,
            **{name: c[name] for name in ("runs", "on_pad", "refused", "failed", "errors")},
            "on_pad_interval": [round(x, 6) for x in wilson(c["on_pad"], c["runs"])],
            "lateral_median_m": self.quantile("lateral_m", 0.5),
            "lateral_p95_m": self.quantile("lateral_m", 0.95),
            "standing_median_m": self.quantile("standing_m", 0.5),
            "standing_p95_m": self.quantile("standing_m", 0.95),
            "standing_worst_m": self.quantile("standing_m", 1.0),
            "slid_p95_m": self.quantile("slid_m", 0.95),
            "after_refusal": dict(sorted(self.kinds["after_refusal"].items())),
            "flights_naming_a_sensor": c["naming"],
            "named_sensors": dict(sorted(self.kinds["named_sensors"].items())),
            **{name: c[name] for name in ("contacts_outside_commit", "in_water", "unsafe")},
            "unsafe_flights": self.named["unsafe"],
            "failed_flights": self.named["because"],
            "flown_s": round(self.flown_s, 1),
            "wall_s": round(wall_s, 2),
            "cpu_s": round(self.cpu_s, 2),
            "hash": self.hash,
        }


Tallies = Mapping[tuple[str, Point], Tally]
"""The tallies of a campaign by scenario and varied values."""


def tallies_of(flights: Iterable[Flight]) -> dict[tuple[str, Point], Tally]:
    """Return the tallies of flights."""
    out: dict[tuple[str, Point], Tally] = {}
    for flight in flights:
        out.setdefault((flight["scenario"], tuple(flight.get("varied", {}).items())), Tally()).take(flight)
    return out


def added(tallies: Iterable[Tally]) -> Tally:
    """Return the sum of tallies."""
    out = Tally()
    for tally in tallies:
        out.add(tally)
    return out


def in_words(summary: dict[str, Any]) -> str:
    """Return the summary in a few lines for people."""
    low, high = summary["on_pad_interval"]
    lines = [
        f"{summary['runs']} flights of {summary['scenario']} ({summary['perception']}): {summary['on_pad']} on the pad (95 % "
        f"interval {100 * low:.1f} to {100 * high:.1f} %), {summary['refused']} refused as expected, {summary['failed']} failed"
        + (f", {summary['errors']} of them by an error" if summary["errors"] else "")
    ]
    if summary["lateral_median_m"] is not None:
        median, p95, worst, contact, contact_p95, slid = (
            f"{100 * summary[key]:.1f}"
            for key in (
                *("standing_median_m", "standing_p95_m", "standing_worst_m"),
                *("lateral_median_m", "lateral_p95_m", "slid_p95_m"),
            )
        )
        lines.append(
            f"standing error {median} cm median, {p95} cm in 95 %, {worst} cm worst; at the contact {contact} and "
            f"{contact_p95} cm; slid {slid} cm in 95 %"
        )
    if summary["after_refusal"]:
        counts = ", ".join(f"{n} {what}" for what, n in summary["after_refusal"].items())
        lines.append(f"60 s after the refusal: {counts}")
    sensors = ", ".join(f"{sensor} in {n}" for sensor, n in summary["named_sensors"].items())
    lines.append(f"flights in which a sensor was named: {summary['flights_naming_a_sensor']}{f' ({sensors})' if sensors else ''}")
    lines.append(
        f"contacts outside commit {summary['contacts_outside_commit']}, flights in the water {summary['in_water']}, "
        f"unsafe flights {summary['unsafe']}"
    )
    named = summary["unsafe_flights"][:_PRINTED]
    lines += [f"UNSAFE {name_of(flight)}: {'; '.join(flight['unsafe'])}" for flight in named]
    if summary["unsafe"] > len(named):
        lines.append(f"and {summary['unsafe'] - len(named)} more unsafe flights; --json and the report name up to {UNSAFE_MAX}")
    named = summary["failed_flights"][:_PRINTED]
    lines += [f"FAILED {name_of(flight)}: {flight['because']}" for flight in named]
    if (more := summary["failed"] - summary["unsafe"] - len(named)) > 0:
        lines.append(f"and {more} more that failed; --json names up to {UNSAFE_MAX}")
    wall_s = max(1e-9, summary["wall_s"])
    lines.append(
        f"{summary['flown_s'] / 3600:.2f} h flown in {wall_s:.1f} s, {summary['cpu_s']:.1f} s of CPU, "
        f"{60 * summary['runs'] / wall_s:.1f} flights a minute"
    )
    lines.append(f"hash {summary['hash']}")
    return "\n".join(lines)


def name_of(flight: Mapping[str, Any]) -> str:
    """Return the words by which a flight of a campaign is found again."""
    varied = "".join(f", {key} {value}" for key, value in flight.get("varied", {}).items())
    return f"{flight['scenario']} seed {flight['seed']}{varied}"


def effect_of(tallies: Tallies, key: str) -> list[dict[str, Any]]:
    """Return how success depends on one varied key, over all values of the others: plain values for each value of the key.

    Shares of good flights are 0 to 1, with their 95 % interval; the median standing error is in m, None where nothing landed.
    """
    labels, place = _cells([dict(point)[key] for _, point in tallies])
    rows = []
    for n, value in enumerate(labels):
        cell = added(tally for tally, at in zip(tallies.values(), place, strict=True) if at == n)
        runs = cell.counts["runs"]
        rows.append(
            {
                "value": value,
                "runs": runs,
                "good": round(cell.good / max(1, runs), 6),
                "good_interval": [round(x, 6) for x in wilson(cell.good, runs)],
                "standing_median_m": cell.quantile("standing_m", 0.5),
                "hash": cell.results_hash,
            }
        )
    return rows


def effects_of(tallies: Tallies) -> dict[str, list[dict[str, Any]]]:
    """Return the effect of each varied key; empty where nothing is varied."""
    return {key: effect_of(tallies, key) for key, _ in next((point for _, point in tallies), ())}


class SuccessMap(NamedTuple):
    """Success against two varied keys: `shares[j, i]` at the j-th value of `y_key` and the i-th of `x_key`."""

    x_key: str
    y_key: str
    x: list[str]
    y: list[str]
    shares: F64
    """The (len(y), len(x)) shares of good flights, nan without flights."""


def map_of(tallies: Tallies, x_key: str, y_key: str) -> SuccessMap:
    """Return how success depends on two varied keys, over all values of the others."""
    x, i = _cells([dict(point)[x_key] for _, point in tallies])
    y, j = _cells([dict(point)[y_key] for _, point in tallies])
    counts, good = np.zeros((len(y), len(x))), np.zeros((len(y), len(x)))
    np.add.at(counts, (j, i), [tally.counts["runs"] for tally in tallies.values()])
    np.add.at(good, (j, i), [tally.good for tally in tallies.values()])
    with np.errstate(invalid="ignore"):
        return SuccessMap(x_key, y_key, list(map(_label, x)), list(map(_label, y)), good / counts)


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


PAIRS_LEAST = 20
"""Pairs from which a bootstrap of them is wide enough to say that a difference is clear."""


class PairedDifference(Struct, frozen=True):
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
        """True if the interval leaves zero out, of enough pairs."""
        return self.pairs >= PAIRS_LEAST and (self.low > 0.0 or self.high < 0.0)


FIGURES: tuple[tuple[str, str, Callable[[Flight], float | None]], ...] = (
    ("on the pad", "share", COUNTS["on_pad"]),
    ("failed", "share", COUNTS["failed"]),
    ("standing error", "m", VALUES["standing_m"]),
    ("speed into the deck", "m/s", _landed(lambda f: f["touchdown"]["vertical_speed_m_s"])),
    ("speed along the deck", "m/s", _landed(lambda f: f["touchdown"]["lateral_speed_m_s"])),
    ("duration", "s", lambda f: f["duration_s"]),
    ("contacts outside commit", "", COUNTS["contacts_outside_commit"]),
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


def bootstrap_interval(values: F64) -> tuple[float, float]:
    """Return the 95 % interval of the mean of (n,) values by the percentile bootstrap.

    Source: B. Efron, R. J. Tibshirani, An Introduction to the Bootstrap (1993), section 13.3.
    """
    rng = np.random.default_rng(0)
    means = np.array([values[rng.integers(len(values), size=len(values))].mean() for _ in range(_RESAMPLES)])
    low, high = np.quantile(means, (0.025, 0.975))
    return float(low), float(high)


def by_scenario(members: Mapping[str, Any], tallies: Tallies) -> list[dict[str, Any]]:
    """Return the counts and the causes of failures of each scenario of a set as plain values, in the order of the set.

    Args:
        members: of the campaign's manifest: the scenario and the perception of each, by name.
    """
    rows = []
    for name, member in members.items():
        tally = added(tally for (scenario, _), tally in tallies.items() if scenario == name)
        counted = ("runs", "on_pad", "refused", "failed", "contacts_outside_commit", "in_water", "unsafe")
        rows.append(
            {
                "scenario": name,
                "expect": member["scenario"].get("expect", "land"),
                "perception": member["perception"],
                **{count: tally.counts[count] for count in counted},
                "causes": dict(tally.kinds["causes"]),
            }
        )
    return rows


HEADINGS = ("scenario", "expected", "by", "flights", "on pad", "refused", "failed", "outside commit", "water", "unsafe", "why")
TEXTS = (0, 1, 2, len(HEADINGS) - 1)
"""Numbers of the columns that hold text."""


def cells_of(row: Mapping[str, Any]) -> list[str]:
    """Return the cells of a scenario's line, as `HEADINGS`; the most frequent cause of failures is named first."""
    *cells, causes = {**row, "expect": row["expect"].replace("_", " ")}.values()
    why = "; ".join(f"{n} {cause}" if n > 1 else cause for cause, n in Counter(causes).most_common())
    return [*map(str, cells), why]


def in_columns(rows: Iterable[Mapping[str, Any]]) -> str:
    """Return a table for a terminal, a line for each scenario."""
    return columns([HEADINGS, *map(cells_of, rows)], TEXTS)


def in_rows(effects: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Return a table for each varied key, a line for each value, and a line below it where the key changed nothing."""
    out = []
    for key, rows in effects.items():
        out.append(columns([(key, "flights", "good", "95 % interval", "error, median"), *map(_effect_cells, rows)], ()))
        out += filter(None, [unmoved(key, rows)])
    return "\n".join(out)


def unmoved(key: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """Return in words that a varied key changed no flight; empty if it changed one."""
    same = len(rows) > 1 and len({row["hash"] for row in rows}) == 1
    return f"{key}: every flight is the same at all its values; it does not act here" if same else ""


def _effect_cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    error = row["standing_median_m"]
    return (
        _label(row["value"]),
        str(row["runs"]),
        f"{100 * row['good']:.0f} %",
        "{:.0f} to {:.0f} %".format(*(100 * share for share in row["good_interval"])),
        "-" if error is None else f"{100 * error:.1f} cm",
    )


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
