"""A campaign whose flights each have faults that their seed draws: the flyer, the summary and the cases that fail.

A case is a scenario file with the fewest and weakest faults that were found to fail in the same way.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from msgspec import Struct

from companion.settings.model import Settings
from sitl.campaign.figures import WORST, name_of
from sitl.campaign.workers import ERROR, Flight, Flyer, fly_flight
from sitl.faults.drawn import simpler
from sitl.faults.kinds import AnyFault
from sitl.flight.one_flight import Perception
from sitl.scenario.scenario import Scenario
from sitl.scenario.with_fault import as_toml, with_faults, with_random_faults

_SHRINKING_FLIGHTS = 12
"""Largest number of flights in which a case is made smaller."""
Fails = Callable[[Sequence[AnyFault]], bool]


def fly_with_random_faults(
    name: str, scenario: Scenario, seed: int, settings: Settings, perception: Perception, perception_model: str | None
) -> Flight:
    """Fly a scenario once with the faults that the seed draws."""
    return fly_flight(name, with_random_faults(scenario, seed, perception), seed, settings, perception, perception_model)


def verdict_of(flight: Flight) -> str:
    """Return what became of a flight: unsafe, landed, refused, undecided or error."""
    if flight["outcome"] == ERROR:
        return "error"
    if flight["unsafe"]:
        return "unsafe"
    return {"on pad": "landed", "refused rightly": "refused"}.get(flight["grade"], "undecided")


def _at_contacts(name: str) -> Callable[[Flight], float]:
    return lambda f: float(max((contact[name] for contact in f["contacts"]), default=-math.inf))


MEASURES: Mapping[str, tuple[str, Callable[[Flight], float]]] = {
    "height": ("m over the pad", lambda f: float(-math.inf if f.get("highest_m") is None else f["highest_m"])),
    "speed": ("m/s along the deck at a contact", _at_contacts("lateral_speed_m_s")),
    "distance": ("m from the pad's centre at a contact", _at_contacts("lateral_m")),
}
"""Measures for choosing the worst flights: the unit, and the measure of a flight."""


class FaultTally:
    """Counts flights with random faults by what became of them, and keeps the worst."""

    def __init__(self) -> None:
        self.counts = dict.fromkeys(("landed", "refused", "undecided", "unsafe", "error"), 0)
        self.failing: list[Flight] = []
        """The unsafe and the undecided flights, as they come."""
        self._worst: dict[str, list[Flight]] = {name: [] for name in MEASURES}

    def take(self, flight: Flight) -> None:
        """Count a flight."""
        verdict = verdict_of(flight)
        self.counts[verdict] += 1
        if verdict in ("unsafe", "undecided"):
            self.failing.append(flight)
        for name, (_, measure) in MEASURES.items():
            if math.isfinite(measure(flight)):
                worst = sorted([*self._worst[name], flight], key=lambda f: (-measure(f), f["seed"]))
                self._worst[name] = worst[:WORST]

    def as_json(self) -> dict[str, Any]:
        """Return plain values: the number of flights by verdict, and the worst flights by each measure."""
        keys = ("scenario", "seed", "faults", "unsafe")
        worst = {
            name: [{"value": of(f), "verdict": verdict_of(f), **{key: f[key] for key in keys}} for f in self._worst[name]]
            for name, (_, of) in MEASURES.items()
        }
        return {"counts": self.counts, "worst": worst}

    def in_words(self) -> str:
        """Return the shares and the worst flights, in lines for people."""
        runs = max(1, sum(self.counts.values()))
        shares = ", ".join(f"{n} {verdict} ({100 * n / runs:.1f} %)" for verdict, n in self.counts.items())
        lines = [f"random faults: {shares}"]
        for name, (unit, measure) in MEASURES.items():
            lines.append(f"worst by {name}, {unit}:")
            lines += [f"  {measure(f):8.2f}  {name_of(f)}, {verdict_of(f)}: {_faults(f)}" for f in self._worst[name]]
        return "\n".join(lines)


def _faults(flight: Flight) -> str:
    return ", ".join(f"{f['kind']} from {f['at_s']:.1f} s" for f in flight["faults"]) or "no fault began"


class Cases(Struct, frozen=True):
    """Writes failing flights as scenario files.

    Args:
        name: the scenario, as the person wrote it.
        scenario: the same, without random faults.
        settings: those that are flown.
        options: further arguments of `decklander simulate` that fly a flight of the campaign.
        flyer: flies one without random faults.
    """

    name: str
    scenario: Scenario
    settings: Settings
    perception: Perception
    perception_model: str | None
    options: Sequence[str]
    flyer: Flyer = fly_flight
    autopilot: bool = False
    """Flown by the stand-in of an autopilot."""

    def of(self, failing: Iterable[Flight]) -> Iterator[tuple[str, bytes]]:
        """Return the name and the content of a file for each of the first failing flights, unsafe ones first."""
        unsafe_first = sorted(failing, key=lambda f: (verdict_of(f) != "unsafe", f["seed"]))
        for flight in unsafe_first[:WORST]:
            of = f"{Path(self.name).stem}-" if flight.get("in_set") else ""
            yield f"{verdict_of(flight)}-{of}{flight['seed']}.toml", self._file(flight).encode()

    def _file(self, flight: Flight) -> str:
        seed, verdict = flight["seed"], verdict_of(flight)
        newest = flight

        def fails(faults: Sequence[AnyFault]) -> bool:
            nonlocal newest
            scenario = with_faults(self.scenario, faults)
            again = self.flyer(self.name, scenario, seed, self.settings, self.perception, self.perception_model)
            if verdict_of(again) != verdict:
                return False
            newest = again
            return True

        drawn = with_random_faults(self.scenario, seed, self.perception, autopilot=self.autopilot).faults[
            len(self.scenario.faults) :
        ]
        faults = shrunk(drawn, fails)
        options = " ".join(option for option in self.options if option not in ("--faults", "random"))
        if self.perception != "pixels" and "--perception" not in self.options:
            options = f"--perception {self.perception} {options}".rstrip()
        head = [
            f"{verdict}: {'; '.join(newest['unsafe']) or newest['because']}",
            f"drawn by seed {seed} of {self.name}; fly it with",
            f"decklander simulate FILE --seed {seed} {options}".rstrip(),
        ]
        return as_toml(self.name, with_faults(self.scenario, faults), faults, head)


def shrunk(faults: Sequence[AnyFault], fails: Fails, flights: int = _SHRINKING_FLIGHTS) -> tuple[AnyFault, ...]:
    """Return the fewest and weakest faults that still fail, found greedily.

    Args:
        faults: they fail.
        fails: whether a flight with these faults fails in the same way.
        flights: largest number of calls of `fails`.
    """
    smallest = tuple(faults)
    found = True
    while found:
        found = False
        for tried in simpler(smallest):
            if flights == 0:
                return smallest
            flights -= 1
            if fails(tried):
                smallest, found = tried, True
                break
    return smallest
