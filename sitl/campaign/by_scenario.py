"""The outcomes of a set of scenarios, one line for each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from sitl.campaign.causes import cause_of
from sitl.campaign.columns import columns
from sitl.campaign.task import Flight


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
