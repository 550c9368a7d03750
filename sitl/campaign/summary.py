"""The figures of a campaign: outcomes with intervals, errors, speeds, causes of failure, and the hash of all its flights.

The first rule that fits a flight names the cause of its failure.
"""

import hashlib
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from sitl.campaign.task import ERROR, Flight, error_m, job_of

_Z95 = 1.959963984540054
"""Quantile of the standard normal distribution for 95 % between both tails."""
_HASH_BITS = 128
UNSAFE_MAX = 100
"""Number of unsafe flights that are named, and of others that failed; the rest is counted."""
_PRINTED = 10


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


class _Named:
    """The first flights of a kind by scenario and seed, in whatever order they come."""

    def __init__(self, reason: str) -> None:
        self._keys = ("scenario", "seed", "varied", reason)
        self._flights: list[dict[str, Any]] = []

    def take(self, flight: Flight) -> None:
        self._flights.append({key: flight[key] for key in self._keys if key in flight})
        if len(self._flights) >= 20 * UNSAFE_MAX:
            self._flights = self.first

    @property
    def first(self) -> list[dict[str, Any]]:
        return sorted(self._flights, key=lambda f: (f["scenario"], f["seed"], str(f.get("varied", ""))))[:UNSAFE_MAX]


class CampaignTally:
    """Counts flights as they come. The hash is a sum, so that it does not depend on their order."""

    def __init__(self) -> None:
        self.runs = self.on_pad = self.refused = self.failed = self.errors = 0
        self.contacts_outside_commit = self.in_water = self.unsafe = 0
        self.cpu_s = self.flown_s = 0.0
        self._lateral_m: list[float] = []
        self._standing_m: list[float] = []
        self._slid_m: list[float] = []
        self._after_refusal: Counter[str] = Counter()
        self._sensors: Counter[str] = Counter()
        self._naming = 0
        self._unsafe, self._failed = _Named("unsafe"), _Named("because")
        self._hash = 0

    def take(self, flight: Flight) -> None:
        """Count a flight."""
        self.runs += 1
        self.on_pad += flight["grade"] == "on pad"
        self.refused += flight["grade"] == "refused rightly"
        self.failed += flight["grade"] == "failed"
        self.errors += flight["outcome"] == ERROR
        self.contacts_outside_commit += flight["contacts_outside_commit"]
        self.in_water += flight["in_water"]
        if flight["unsafe"]:
            self.unsafe += 1
            self._unsafe.take(flight)
        elif flight["grade"] == "failed":
            self._failed.take(flight)
        self.cpu_s += flight["cpu_s"]
        self.flown_s += flight["duration_s"]
        if flight["landed_on_pad"]:
            self._lateral_m.append(flight["touchdown"]["lateral_m"])
            self._standing_m.append(error_m(flight))
            self._slid_m.append((flight.get("standing") or {}).get("slid_m", 0.0))
        if (later := flight.get("afterwards")) is not None:
            self._after_refusal["in the water" if later["in_water"] else later["vehicle_phase"]] += 1
        if said := {one["text"].removeprefix("the ").split()[0] for one in flight.get("named", ())}:
            self._naming += 1
            self._sensors.update(said)
        own = hashlib.blake2b(f"{job_of(flight).key} {flight['hash']}".encode(), digest_size=_HASH_BITS // 8).digest()
        self._hash = (self._hash + int.from_bytes(own)) % 2**_HASH_BITS

    @property
    def hash(self) -> str:
        """The hash of all flights, the same in whatever order and wherever they were flown."""
        return f"{self._hash:0{_HASH_BITS // 4}x}"

    @property
    def unsafe_flights(self) -> list[dict[str, Any]]:
        """The first unsafe flights by scenario and seed, at most `UNSAFE_MAX`, each with what was unsafe."""
        return self._unsafe.first

    @property
    def failed_flights(self) -> list[dict[str, Any]]:
        """The first flights that failed without being unsafe, each with why."""
        return self._failed.first

    def summary(self, scenario: str, perception: str, wall_s: float) -> dict[str, Any]:
        """Return the summary as plain values: lengths in m, times in s."""
        median, p95 = (_quantile(self._lateral_m, q) for q in (0.5, 0.95))
        return {
            "scenario": scenario,
            "perception": perception,
            "runs": self.runs,
            "on_pad": self.on_pad,
            "refused": self.refused,
            "failed": self.failed,
            "errors": self.errors,
            "on_pad_interval": [round(x, 6) for x in wilson(self.on_pad, self.runs)],
            "lateral_median_m": median,
            "lateral_p95_m": p95,
            "standing_median_m": _quantile(self._standing_m, 0.5),
            "standing_p95_m": _quantile(self._standing_m, 0.95),
            "standing_worst_m": _quantile(self._standing_m, 1.0),
            "slid_p95_m": _quantile(self._slid_m, 0.95),
            "after_refusal": dict(sorted(self._after_refusal.items())),
            "flights_naming_a_sensor": self._naming,
            "named_sensors": dict(sorted(self._sensors.items())),
            "contacts_outside_commit": self.contacts_outside_commit,
            "in_water": self.in_water,
            "unsafe": self.unsafe,
            "unsafe_flights": self.unsafe_flights,
            "failed_flights": self.failed_flights,
            "flown_s": round(self.flown_s, 1),
            "wall_s": round(wall_s, 2),
            "cpu_s": round(self.cpu_s, 2),
            "hash": self.hash,
        }


def tally(flights: Iterable[Flight]) -> CampaignTally:
    """Return the tally of flights."""
    counted = CampaignTally()
    for flight in flights:
        counted.take(flight)
    return counted


def in_words(summary: dict[str, Any]) -> str:
    """Return the summary in a few lines for people."""
    low, high = summary["on_pad_interval"]
    lines = [
        f"{summary['runs']} flights of {summary['scenario']} ({summary['perception']}): {summary['on_pad']} on the pad "
        f"({100 * low:.1f} to {100 * high:.1f} %), {summary['refused']} refused rightly, {summary['failed']} failed"
        + (f", {summary['errors']} of them by an error" if summary["errors"] else "")
    ]
    if summary["lateral_median_m"] is not None:
        lines.append(
            f"standing error {_cm(summary, 'standing_median_m')} cm median, {_cm(summary, 'standing_p95_m')} cm in 95 %, "
            f"{_cm(summary, 'standing_worst_m')} cm worst; at the contact {_cm(summary, 'lateral_median_m')} and "
            f"{_cm(summary, 'lateral_p95_m')} cm; slid {_cm(summary, 'slid_p95_m')} cm in 95 %"
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
    if summary["failed"] > summary["unsafe"] + len(named):
        more = summary["failed"] - summary["unsafe"] - len(named)
        lines.append(f"and {more} more that failed; --json names up to {UNSAFE_MAX}")
    wall_s = max(1e-9, summary["wall_s"])
    lines.append(
        f"{summary['flown_s'] / 3600:.2f} h flown in {wall_s:.1f} s, {summary['cpu_s']:.1f} s of CPU, "
        f"{60 * summary['runs'] / wall_s:.1f} flights a minute"
    )
    lines.append(f"hash {summary['hash']}")
    return "\n".join(lines)


def _cm(summary: Mapping[str, Any], key: str) -> str:
    return f"{100 * summary[key]:.1f}"


def name_of(flight: Mapping[str, Any]) -> str:
    """Return the words by which a flight of a campaign is found again."""
    varied = "".join(f", {key} {value}" for key, value in flight.get("varied", {}).items())
    return f"{flight['scenario']} seed {flight['seed']}{varied}"


def _quantile(values: list[float], q: float) -> float | None:
    return round(float(np.quantile(values, q)), 4) if values else None


def _unsafe(flight: Flight, *begins: str) -> bool:
    return any(line.startswith(begins) for line in flight["unsafe"])


def _rest(flight: Flight) -> str:
    """Return why the pilot gave up, without the figures that differ from flight to flight."""
    return re.sub(r" (at|after|for) -?\d+(\.\d+)? \w+", "", str(flight["refused"] or "").partition(";")[0])


RULES: tuple[tuple[str, Callable[[Flight], bool]], ...] = (
    ("the flight raised an error", lambda f: f["outcome"] == ERROR),
    ("the service died in flight", lambda f: _unsafe(f, "the service died")),
    ("in the water", lambda f: bool(f["in_water"])),
    ("came down without sight of the pad", lambda f: _unsafe(f, "came down")),
    (
        "struck the deck beside the pad, then landed on the pad",
        lambda f: bool(f["landed_on_pad"]) and any(not contact["on_pad"] for contact in f["contacts"]),
    ),
    ("a person was overruled", lambda f: _unsafe(f, "a person ordered", "nobody ordered it")),
    ("touched the pad harder than it bears", lambda f: _unsafe(f, "a foot struck the pad", "touched the pad")),
    ("landed beside the pad", lambda f: f["outcome"] == "landed" and f["touchdown"] is not None and not f["touchdown"]["on_pad"]),
    ("struck the deck beside the pad and did not land", lambda f: any(not contact["on_pad"] for contact in f["contacts"])),
    ("gave up, though it should land", lambda f: f["outcome"] == "gave up"),
    ("time ran out", lambda f: f["outcome"] == "time ran out"),
)
"""Name of the cause, and whether it fits a failed flight; in order of severity."""


def cause_of(flight: Flight) -> str:
    """Return the cause of a failed flight."""
    for name, fits in RULES:
        if fits(flight):
            reason = _rest(flight) if name.startswith("gave up") else ""
            return f"{name}: {reason}" if reason else name
    return f"ended otherwise: {flight['outcome']}"


def severity(flight: Flight) -> int:
    """Return how bad a flight's end is: 0 for none, else the more the earlier its rule."""
    if flight["grade"] != "failed":
        return 0
    for place, (_, fits) in enumerate(RULES):
        if fits(flight):
            return len(RULES) - place + 1
    return 1


def causes(flights: Iterable[Flight]) -> Counter[str]:
    """Return the number of failed flights by cause."""
    return Counter(cause_of(flight) for flight in flights if flight["grade"] == "failed")
