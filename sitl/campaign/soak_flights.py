"""Grade the flights of a soak, and tell failures from flights that the machine was too slow for."""

import shlex
import sys
import tempfile
import weakref
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from enum import Enum
from typing import Any, Generic, TypeVar

import msgspec

from companion.base.mission import REFUSALS, FlightOutcome
from estimator.contracts.estimates import Verdict
from sitl.flight.ending import Ending, Load
from sitl.flight.grade import AtEnd, Grade, grade

T = TypeVar("T")
STARVED_MAX = 0.5
"""Share of the flights that may go unjudged before the run itself means nothing."""


class Class(Enum):
    """The outcome of a flight in a soak."""

    ON_PAD = Grade.ON_PAD.value
    REFUSED_RIGHTLY = Grade.REFUSED_RIGHTLY.value
    FAILED = Grade.FAILED.value
    STARVED = "not judged: the machine was too slow"


@dataclass(frozen=True, slots=True)
class Flown:
    """One flight."""

    at_s: float
    """Wall time from the beginning of the soak to the end of the flight."""
    seed: int
    title: str
    """The scenario's title, with its fault behind a semicolon."""
    worth: Class
    because: str
    duration_s: float

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {**asdict(self), "worth": self.worth.value}


def virtual(at_s: float, title: str, ending: Ending) -> Flown:
    """Return the result of a flight in virtual time, for which no machine is too slow."""
    assert ending.judged is not None
    return Flown(at_s, ending.seed, title, Class(ending.judged.grade), ending.judged.because, ending.duration_s)


def real(
    at_s: float,
    said: dict[str, Any],
    outcome: FlightOutcome | None,
    frames: Counter[Verdict],
    guidance_late_s: float | None = None,
) -> Flown:
    """Return the result of a flight in real time.

    Args:
        said: the line of `sitl.emulators.ardrone.serve` about it.
        outcome: the pilot's outcome when the flight had ended.
        frames: what the daemon made of its frames.
        guidance_late_s: median of what guidance cycles came late at the end of the flight, seconds.
    """
    if said["ended"] == "time is up" and outcome not in REFUSALS:
        outcome = None  # the simulator switched the drone off in the air, which the pilot takes for an emergency
    landed_m = said["lateral_m"] if said["on_pad"] else None
    worth, because = grade(outcome, landed_m, said["unsafe"], said["expect"], AtEnd(left_alone=said["left_alone"]))
    load = Load(said["duration_s"], said["frames_sent"], said["stood_still_s"], frames, guidance_late_s)
    kind = Class(worth.value)
    if kind is Class.FAILED and (slow := load.starved()) is not None:
        kind, because = Class.STARVED, f"{slow} ({because})"
    return Flown(at_s, said["seed"], said["title"], kind, because, said["duration_s"])


class Records(Generic[T]):
    """Records in the order in which they came, in a temporary file.

    What the run remembers of itself must not look like growth of what it watches: a day of flights is thousands of records of
    half a kilobyte, some per cent of the process' memory. If the temporary folder is full, later records are kept in memory, and
    stderr says so once.

    Args:
        kind: the type of the records, a dataclass.
    """

    def __init__(self, kind: type[T]) -> None:
        self._encoder, self._decoder = msgspec.json.Encoder(), msgspec.json.Decoder(kind)
        self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - it lives as long as the records
        weakref.finalize(self, self._file.close)
        self._written = 0
        self._rest: list[T] = []

    def append(self, record: T) -> None:
        """Add a record."""
        if not self._rest:
            try:
                whole = self._encoder.encode(record) + b"\n"
                if self._file.write(whole) == len(whole):
                    self._written += 1
                    return
                why = "no space left"
            except OSError as error:
                why = error.strerror or str(error)
            sys.stderr.write(f"{tempfile.gettempdir()}: {why}; the run keeps its further records in memory\n")
        self._rest.append(record)

    def __len__(self) -> int:
        return self._written + len(self._rest)

    def __iter__(self) -> Iterator[T]:
        # A place of its own in the file, so that records may come while one reads.
        with open(f"/proc/self/fd/{self._file.fileno()}", "rb") as lines:
            for _, line in zip(range(self._written), lines, strict=False):
                yield self._decoder.decode(line)
        yield from self._rest


@dataclass(slots=True)
class Outcomes:
    """All flights of a soak."""

    flights: list[Flown] | Records[Flown] = field(default_factory=list)

    def count(self, worth: Class) -> int:
        """Return the number of flights of one class."""
        return sum(flight.worth is worth for flight in self.flights)

    def faults(self, failed_max: int) -> list[str]:
        """Return why the flights make the run fail; empty if they do not."""
        output = []
        failed, starved = self.count(Class.FAILED), self.count(Class.STARVED)
        if failed > failed_max:
            output.append(f"{failed} of {len(self.flights)} flights failed" + (f", more than {failed_max}" if failed_max else ""))
        if starved > STARVED_MAX * len(self.flights):
            output.append(f"this machine was too slow for {starved} of {len(self.flights)} flights, so the run shows nothing")
        return output

    def as_json(self) -> dict[str, Any]:
        """Return the counts by class, and every flight."""
        counts = {worth.name.lower(): self.count(worth) for worth in Class}
        return {"classes": counts, "outcomes": [flight.as_json() for flight in self.flights]}

    def in_words(self, scenario: str, options: Sequence[str] = ()) -> list[str]:
        """Return a line of counts, and a line for each flight that failed or was not judged.

        Args:
            scenario: the name of the scenario.
            options: the options, beside fault and seed, that the first failed one needs to fail again.
        """
        counts = ", ".join(f"{n} {worth.value}" for worth in Class if (n := self.count(worth)))
        lines = [f"outcomes   {counts or 'none'}"]
        for flight in self.flights:
            if flight.worth in (Class.FAILED, Class.STARVED):
                lines.append(f"  seed {flight.seed}, {fault_of(flight.title)}: {flight.worth.value}: {flight.because}")
        failed = next((flight for flight in self.flights if flight.worth is Class.FAILED and "; " in flight.title), None)
        if failed is not None:
            words = ["decklander", "campaign", scenario, "--soak", "--virtual", "--runs", "1", "--seed", str(failed.seed)]
            again = shlex.join([*words, "--fault", fault_of(failed.title), *options])
            lines.append(f"  to fly the first failed one again: {again}")
        return lines


def fault_of(title: str) -> str:
    """Return the fault of a flight, which its scenario's title names last."""
    return title.rpartition("; ")[2]


def by_fault(flights: Sequence[Flown]) -> dict[str, Counter[Class]]:
    """Return the number of flights of each class, by fault."""
    out: dict[str, Counter[Class]] = {}
    for flight in flights:
        out.setdefault(fault_of(flight.title), Counter())[flight.worth] += 1
    return out
