"""A campaign whose flights each have faults that their seed draws: the flyer, the summary and the cases that fail.

A case is a scenario file with the fewest and weakest faults that were found to fail in the same way.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from msgspec.structs import replace

from companion.settings.model import Settings
from sitl.campaign.task import ERROR, Flight, fly_flight
from sitl.faults.corrupted import UNSIZED, Corrupted
from sitl.flight.one_flight import Perception
from sitl.scenario.scenario import Scenario
from sitl.scenario.with_fault import as_toml, with_corrupted, with_random_faults

WORST = 10
"""Number of flights that are named for each measure, and of cases that are written."""
_SHRINKING_FLIGHTS = 12
"""Largest number of flights in which a case is made smaller."""
_LENGTH_S, _SHORTEST_S = 16.0, 0.05
"""Length that is tried for a fault that lasts for good, and the shortest."""
Fails = Callable[[Sequence[Corrupted]], bool]


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


def _height(flight: Flight) -> float:
    return float(-math.inf if (height_m := flight.get("highest_m")) is None else height_m)


def _speed(flight: Flight) -> float:
    return float(max((c["lateral_speed_m_s"] for c in flight["contacts"]), default=-math.inf))


def _distance(flight: Flight) -> float:
    return float(max((c["lateral_m"] for c in flight["contacts"]), default=-math.inf))


MEASURES: Mapping[str, tuple[str, Callable[[Flight], float]]] = {
    "height": ("m over the pad", _height),
    "speed": ("m/s along the deck at a contact", _speed),
    "distance": ("m from the pad's centre at a contact", _distance),
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
        worst = {name: [{"value": measure(f), **_named(f)} for f in self._worst[name]] for name, (_, measure) in MEASURES.items()}
        return {"counts": self.counts, "worst": worst}

    def in_words(self) -> str:
        """Return the shares and the worst flights, in lines for people."""
        runs = max(1, sum(self.counts.values()))
        shares = ", ".join(f"{n} {verdict} ({100 * n / runs:.1f} %)" for verdict, n in self.counts.items())
        lines = [f"random faults: {shares}"]
        for name, (unit, measure) in MEASURES.items():
            lines.append(f"worst by {name}, {unit}:")
            lines += [f"  {measure(f):8.2f}  seed {f['seed']}, {verdict_of(f)}: {_faults(f)}" for f in self._worst[name]]
        return "\n".join(lines)


def _faults(flight: Flight) -> str:
    return ", ".join(f"{f['kind']} from {f['at_s']:.1f} s" for f in flight["faults"]) or "no fault began"


def _named(flight: Flight) -> dict[str, Any]:
    return {"seed": flight["seed"], "verdict": verdict_of(flight), "faults": flight["faults"], "unsafe": flight["unsafe"]}


@dataclass(frozen=True, slots=True)
class Cases:
    """Writes failing flights as scenario files.

    Args:
        name: the scenario, as the person wrote it.
        scenario: the same, without random faults.
        settings: those that are flown.
        options: further arguments of `decklander simulate` that fly a flight of the campaign.
    """

    name: str
    scenario: Scenario
    settings: Settings
    perception: Perception
    perception_model: str | None
    options: Sequence[str]

    def of(self, failing: Iterable[Flight]) -> Iterator[tuple[str, bytes]]:
        """Return the name and the content of a file for each of the first failing flights, unsafe ones first."""
        unsafe_first = sorted(failing, key=lambda f: (verdict_of(f) != "unsafe", f["seed"]))
        for flight in unsafe_first[:WORST]:
            yield f"{verdict_of(flight)}-{flight['seed']}.toml", self._file(flight).encode()

    def _file(self, flight: Flight) -> str:
        seed, verdict = flight["seed"], verdict_of(flight)
        newest = flight

        def fails(faults: Sequence[Corrupted]) -> bool:
            nonlocal newest
            again = self._fly(with_corrupted(self.scenario, faults), seed)
            if verdict_of(again) != verdict:
                return False
            newest = again
            return True

        drawn = with_random_faults(self.scenario, seed, self.perception).faults[len(self.scenario.faults) :]
        faults = shrunk([fault for fault in drawn if isinstance(fault, Corrupted)], fails)
        options = " ".join(option for option in self.options if option not in ("--faults", "random"))
        head = [
            f"{verdict}: {'; '.join(newest['unsafe']) or newest['because']}",
            f"drawn by seed {seed} of {self.name}; fly it with",
            f"decklander simulate FILE --seed {seed} {options}".rstrip(),
        ]
        return as_toml(self.name, with_corrupted(self.scenario, faults), faults, head)

    def _fly(self, scenario: Scenario, seed: int) -> Flight:
        return fly_flight(self.name, scenario, seed, self.settings, self.perception, self.perception_model)


def shrunk(faults: Sequence[Corrupted], fails: Fails, flights: int = _SHRINKING_FLIGHTS) -> tuple[Corrupted, ...]:
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
        for simpler in _simpler(smallest):
            if flights == 0:
                return smallest
            flights -= 1
            if fails(simpler):
                smallest, found = simpler, True
                break
    return smallest


def _simpler(faults: tuple[Corrupted, ...]) -> Iterator[tuple[Corrupted, ...]]:
    """Return scenarios that are simpler by one step: one fault less, half as long, half as much."""
    if len(faults) > 1:
        yield from (faults[:n] + faults[n + 1 :] for n in range(len(faults)))
    for n, fault in enumerate(faults):
        length_s = _LENGTH_S if fault.for_s is None else _short(0.5 * fault.for_s)
        if length_s >= _SHORTEST_S:
            yield (*faults[:n], replace(fault, for_s=length_s), *faults[n + 1 :])
        if fault.error not in UNSIZED:
            size = 1.0 + 0.5 * (fault.size - 1.0) if fault.error == "scaled" else 0.5 * fault.size
            yield (*faults[:n], replace(fault, size=_short(size)), *faults[n + 1 :])


def _short(value: float) -> float:
    return float(f"{value:.3g}")
