"""The model of the service's health: state and failures of each part, data rates, durations of the stages, verdicts of frames.

Every reporter (log, MQTT, Prometheus, MAVLink) reads the same `HealthSnapshot`.
"""

import math
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated

from msgspec import Meta, Struct, field, structs

from companion.base.mission import ENDED
from companion.base.observer import Decision, ResponseInUse
from estimator.contracts.errors import in_words
from estimator.contracts.estimates import FusionResult, PathName, Source, Verdict
from estimator.contracts.samples import Sample, VehicleStatus
from estimator.contracts.time import Clock, MonoNs, seconds_between

FARTHEST_NS = 1 << 62
"""Half the range of 64 bits, ns, so that the sum or difference of two instants fits as well."""
Count = Annotated[int, Meta(ge=0, le=FARTHEST_NS)]
NIS_WINDOW = 200
"""Number of comparisons in the mean NIS of one source: one second of attitude at 200 Hz, seven seconds of a camera."""
NORMALIZED_NIS_MAX = 20.0
"""Upper limit of one measurement's normalized NIS in that mean, so that a single outlier does not dominate it."""


SILENT_S = 2.0
"""An input that has not arrived for this long counts as missing; the slowest one, the vehicle's status, comes at 1 Hz."""
SHIP_PLACE = "ShipPlace"
"""The flow of the ship's places, where a source of them is set."""
SHIP_SILENT_S = 15.0
"""Its longest silence: AIS reports come every 10 s from a ship that lies still."""
GIMBAL = "GimbalAttitude"
"""The flow of the gimbal's attitudes, where a gimbal carries the camera."""
_NEEDED = {
    "VehicleStatus": "status from the vehicle",
    "Attitude": "attitude from the vehicle",
    "Frame": "frames from the camera",
    GIMBAL: "attitude from the gimbal",
}
"""Flows of `Health` without which no landing begins, with the words for the operator."""
EDGES_S = (
    0.0002, 0.0005, 0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.015, 0.02, 0.03, 0.05, 0.075, 0.1, 0.15, 0.25, 0.5, 1.0,
)  # fmt: skip
"""Upper edges of the histogram's buckets, s; longer durations lie above the last."""


class Delays(Struct):
    """The durations of one stage, seconds: counted by the edges of buckets, and the newest of them."""

    edges_s: tuple[float, ...] = EDGES_S
    count: int = 0
    """Number of durations since the start."""
    sum_s: float = 0.0
    """Sum of all of them."""
    worst_s: float = 0.0
    buckets: list[int] = field(default_factory=list)
    """Number of durations up to each edge and above the one before; the last is above all edges."""
    _newest: deque[float] = field(default_factory=lambda: deque(maxlen=600))

    def __post_init__(self) -> None:
        self.buckets = [0] * (len(self.edges_s) + 1)

    def add(self, seconds: float) -> None:
        self.count += 1
        self.sum_s += seconds
        self.worst_s = max(self.worst_s, seconds)
        self.buckets[bisect_left(self.edges_s, seconds)] += 1
        self._newest.append(seconds)

    def quantile(self, q: float) -> float:
        """Return the upper edge of the q-quantile's bucket, s, at most the worst; 0 before the first."""
        left = q * self.count
        for edge, n in zip(self.edges_s, self.buckets, strict=False):
            left -= n
            if left <= 0.0:
                return min(edge, self.worst_s)
        return self.worst_s

    def quantiles(self, *qs: float) -> list[float | None]:
        """Return several quantiles of the newest, seconds, of one sort; None before the first value."""
        ordered = sorted(self._newest)
        return [ordered[min(len(ordered) - 1, int(q * len(ordered)))] if ordered else None for q in qs]


class PartHealth(Struct):
    """One supervised part."""

    vital: bool = False
    """True if the flight needs it."""
    up: bool = False
    since: MonoNs | None = None
    restarts: int = 0
    last_error: str = ""


class Flow(Struct):
    """The arrivals of one kind of data."""

    count: int = 0
    _recent: deque[MonoNs] = field(default_factory=lambda: deque(maxlen=50))

    def beat(self, at: MonoNs, n: int = 1) -> None:
        self.count += n
        if n == 1:
            self._recent.append(at)
        else:
            self._recent.extend([at] * n)

    def age_s(self, now: MonoNs) -> float | None:
        """Return the seconds since the last arrival; None before the first."""
        return seconds_between(self._recent[-1], now) if self._recent else None

    def rate_hz(self, now: MonoNs) -> float | None:
        """Return the rate of the newest arrivals; it falls when they stop. None before the second arrival."""
        if len(self._recent) < 2:
            return None
        return (len(self._recent) - 1) / max(1e-9, seconds_between(self._recent[0], now))


class FusionTally(Struct):
    """The results of one source on one path of the estimator."""

    verdicts: Counter[Verdict] = field(default_factory=Counter)
    newest: FusionResult | None = None
    test_ratio: float | None = None
    """The test ratio of the newest measurement that was compared with a prediction."""
    _normalized: deque[float] = field(default_factory=lambda: deque(maxlen=NIS_WINDOW))

    def add(self, result: FusionResult) -> None:
        ratio = result.test_ratio
        self.verdicts[result.verdict] += 1
        self.newest = result
        if math.isfinite(ratio):
            self.test_ratio = ratio
            normalized = result.normalized_nis
            self._normalized.append(NORMALIZED_NIS_MAX if normalized > NORMALIZED_NIS_MAX else normalized)

    @property
    def nis_mean(self) -> float | None:
        """The mean of NIS over the number of components for the newest `NIS_WINDOW` comparisons; None before the first."""
        return sum(self._normalized) / len(self._normalized) if self._normalized else None


class PartRecord(Struct, frozen=True):
    """State of one part of the service."""

    name: str
    up: bool
    age_s: float
    """Time since the part came up or went down, s."""
    restarts: Count
    last_error: str


class FlowRecord(Struct, frozen=True, omit_defaults=True):
    """Count, rate and age of the newest item of one flow."""

    name: str
    count: Count
    rate_hz: float | None = None
    age_s: float | None = None
    """Time since the last arrival, s; None before the first."""


class StageState(Struct, frozen=True):
    """The durations of a stage: of its newest runs, and of all."""

    count: int
    p50_s: float | None
    p99_s: float | None
    sum_s: float = 0.0
    """Sum of all durations."""
    buckets: tuple[int, ...] = ()
    """Number of durations by bucket of `EDGES_S`; the last lies above all edges."""


class FusionState(Struct, frozen=True):
    """Results of one source on one path of the estimator, at one instant."""

    path: str
    source: str
    verdicts: Mapping[str, int]
    """Measurements by verdict."""
    newest: FusionResult
    """The result of the newest measurement."""
    test_ratio: float | None
    """The test ratio of the newest measurement that was compared with a prediction; None before the first."""
    nis_mean: float | None
    """The recent mean of NIS over the number of components: 1 when the filter's covariance is honest; None before the first
    comparison."""


class MissionHealth(Struct, frozen=True):
    """The newest guidance cycle, and what became of the mission so far."""

    phase: str = ""
    height_m: float | None = None
    """Height over the pad by the steering estimate; None without one."""
    error_m: float | None = None
    """Horizontal distance from the pad's centre by the same estimate."""
    battery: float | None = None
    """Charge from 0 to 1; None if the vehicle does not report it."""
    transitions: Mapping[tuple[str, str, str, str], int] = field(default_factory=dict)
    """Number of changes of state by source, target, event and cause."""
    flights: Mapping[str, int] = field(default_factory=dict)
    """Number of ended flights by outcome."""
    response: ResponseInUse | None = None
    """The vehicle's response, once a flight has identified it."""


class HealthSnapshot(Struct, frozen=True):
    """Everything known of the service's health at one instant. Immutable."""

    at: MonoNs
    all_up: bool
    """True if every part of the service is up."""
    flight_up: bool
    """True if the parts that the flight needs are up, and its inputs arrive: status, attitude, frames."""
    parts: Mapping[str, PartRecord]
    flows: Mapping[str, FlowRecord]
    frames: Mapping[str, int]
    """Frames by verdict."""
    inputs: Mapping[str, Mapping[str, int]]
    """Other measurements by kind and verdict."""
    stages: Mapping[str, StageState]
    counters: Mapping[str, Mapping[str, float]]
    """Counters of the parts themselves, by part."""
    fusion: tuple[FusionState, ...] = ()
    """Results of the estimator's measurements, by path and source."""
    mission: MissionHealth = field(default_factory=MissionHealth)
    awaited: frozenset[str] = frozenset()
    """Flows that the settings request beside those of every flight."""
    vital: frozenset[str] = frozenset()
    """The parts that the flight needs."""
    too_slow: str | None = None
    """Sign that this computer does not keep up, with the cure; None while it does."""


class Health:
    """The service's health: every part writes it, and every reporter reads it."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._counters: dict[str, Callable[[], Mapping[str, float]]] = {}
        self.parts: dict[str, PartHealth] = {}
        self.frames: Counter[Verdict] = Counter()
        """Frames by verdict; every frame is counted exactly once."""
        self.inputs: dict[str, Counter[Verdict]] = {}
        """Verdicts of the other measurements, by kind."""
        self.tallies: dict[tuple[PathName, Source], FusionTally] = {}
        """Results of the estimator by path and source."""
        self.delays: dict[str, Delays] = {}
        self.flows: dict[str, Flow] = {}

        self.awaited: frozenset[str] = frozenset()
        """Flows that the settings ask for beside those of every flight."""
        self._decided: tuple[Decision, float | None] | None = None
        self._transitions: Counter[tuple[str, str, str, str]] = Counter()
        self._flights: Counter[str] = Counter()
        self._response: ResponseInUse | None = None
        self.too_slow: str | None = None
        self.contained: Counter[str] = Counter()
        """Failures of callees that the flight does not need, by callee."""
        self.failures: dict[str, tuple[int, str]] = {}
        """Failures of each of the vehicle's connections: their number, and the newest one's reason."""

    def now(self) -> MonoNs:
        """Return the time on the clock that all of health uses."""
        return self._clock.now()

    def vital(self, name: str) -> None:
        """Mark a part as needed by the flight; it counts as down until `up` is called."""
        self.parts.setdefault(name, PartHealth()).vital = True

    def up(self, name: str) -> None:
        part = self.parts.setdefault(name, PartHealth())
        part.up, part.since = True, self._clock.now()

    def down(self, name: str, why: BaseException) -> None:
        part = self.parts.setdefault(name, PartHealth())
        part.up, part.since = False, self._clock.now()
        part.restarts += 1
        part.last_error = in_words(why)

    def failed(self, connection: str, why: BaseException) -> None:
        """Count a failure of a connection of the vehicle's, which is opened again."""
        self.failures[connection] = self.failures.get(connection, (0, ""))[0] + 1, in_words(why)

    def contain(self, name: str) -> int:
        """Count a failure of something that the flight does not need; return how many there were so far."""
        self.contained[name] += 1
        return self.contained[name]

    def frame(self, verdict: Verdict) -> None:
        self.frames[verdict] += 1

    def fused(self, sample: Sample, results: Sequence[FusionResult]) -> None:
        """Count the results of one sample, path by path."""
        kind = type(sample).__name__
        for result in results:
            self.input(kind, result.verdict)
            self.fusion(result)

    def input(self, kind: str, verdict: Verdict) -> None:
        tally = self.inputs.get(kind)
        if tally is None:
            tally = self.inputs[kind] = Counter()
        tally[verdict] += 1

    def fusion(self, result: FusionResult) -> None:
        """Count the result of one measurement on one path of the estimator."""
        tally = self.tallies.get((result.path, result.source))
        if tally is None:
            tally = self.tallies[result.path, result.source] = FusionTally()
        tally.add(result)

    def fusion_states(self) -> tuple[FusionState, ...]:
        """Return the present results of each path and source, sorted by name."""
        return tuple(
            FusionState(
                path, source, {v.value: n for v, n in tally.verdicts.items()}, tally.newest, tally.test_ratio, tally.nis_mean
            )
            for (path, source), tally in sorted(self.tallies.items())
            if tally.newest is not None
        )

    def decision(self, decision: Decision, vehicle: VehicleStatus | None) -> None:
        """Note a guidance cycle and count its changes of state."""
        self._decided = decision, None if vehicle is None else vehicle.battery_fraction
        self._response = decision.response or self._response
        for change in decision.transitions:
            why = change.event.name.lower(), change.reason.cause.name.lower()
            self._transitions[change.source.value, change.target.value, *why] += 1
            if change.target in ENDED and change.source not in ENDED:
                self._flights[change.target.value] += 1

    def _mission(self) -> MissionHealth:
        if self._decided is None:
            return MissionHealth()
        decision, battery = self._decided
        belief = decision.belief
        height_m, error_m = (None, None) if belief is None else (belief.height_m, belief.lateral_m)
        return MissionHealth(
            decision.phase, height_m, error_m, battery, dict(self._transitions), dict(self._flights), self._response
        )

    def delay(self, stage: str, seconds: float) -> None:
        delays = self.delays.get(stage)
        if delays is None:
            delays = self.delays[stage] = Delays()
        delays.add(seconds)

    def beat(self, name: str, now: MonoNs | None = None, n: int = 1) -> None:
        """Count arrivals of a kind of data, at this instant if none is given."""
        flow = self.flows.get(name)
        if flow is None:
            flow = self.flows[name] = Flow()
        flow.beat(self._clock.now() if now is None else now, n)

    def counters(self, part: str, read: Callable[[], Mapping[str, float]]) -> None:
        """Register `read`, which each snapshot calls to get the part's counters."""
        self._counters[part] = read

    def fault(self, *, of_flight: bool = False) -> str | None:
        """Return the first part that is down (of those that the flight needs), and why; None while they are up."""
        for name, part in self.parts.items():
            if not part.up and (part.vital or not of_flight):
                return f"{name} is down: {part.last_error or 'not begun'}"
        return None

    def _counted(self) -> dict[str, Mapping[str, float]]:
        """Return the counters of the parts. A part whose `read` fails is left out, and the failure is counted."""
        counted: dict[str, Mapping[str, float]] = {}
        for part, read in self._counters.items():
            try:
                counted[part] = dict(read())
            except Exception:
                self.contained[f"{part}.counters"] += 1
        if self.contained:
            counted["contained"] = dict(self.contained)
        return counted

    def snapshot(self) -> HealthSnapshot:
        """Return the present health."""
        now = self._clock.now()
        stages = {}
        for name, delays in self.delays.items():
            p50, p99 = delays.quantiles(0.5, 0.99)
            stages[name] = StageState(delays.count, p50, p99, delays.sum_s, tuple(delays.buckets))
        made = HealthSnapshot(
            at=now,
            all_up=self.fault() is None,
            flight_up=self.fault(of_flight=True) is None,
            parts={
                name: PartRecord(name, p.up, 0.0 if p.since is None else seconds_between(p.since, now), p.restarts, p.last_error)
                for name, p in self.parts.items()
            },
            flows={name: FlowRecord(name, f.count, f.rate_hz(now), f.age_s(now)) for name, f in self.flows.items()},
            frames={verdict.value: n for verdict, n in self.frames.items()},
            inputs={kind: {v.value: n for v, n in tally.items()} for kind, tally in self.inputs.items()},
            stages=stages,
            counters=self._counted(),
            fusion=self.fusion_states(),
            mission=self._mission(),
            awaited=self.awaited,
            vital=frozenset(name for name, part in self.parts.items() if part.vital),
            too_slow=self.too_slow,
        )
        return structs.replace(made, flight_up=made.flight_up and not (made.vital and missing_inputs(made)))


def missing_inputs(health: HealthSnapshot) -> tuple[str, ...]:
    """Return what is missing, such as "no frames from the camera for 12 s"; empty if every input arrives."""
    out = []
    for flow, words in _NEEDED.items():
        if flow == GIMBAL and flow not in health.awaited:
            continue
        state = health.flows.get(flow)
        if state is None or state.age_s is None:
            out.append(f"no {words} yet")
        elif state.age_s > SILENT_S:
            out.append(f"no {words} for {state.age_s:.0f} s")
    place = health.flows.get(SHIP_PLACE)
    if place is None and SHIP_PLACE in health.awaited:
        out.append("no place from the ship yet")
    elif place is not None and place.age_s is not None and place.age_s > SHIP_SILENT_S:
        out.append(f"no place from the ship for {place.age_s:.0f} s")
    return tuple(out)
