"""Faults of a simulated flight: when one begins and how long it lasts, those of the vehicle's sensors, and which are active.

A fault has a `kind`, exactly one beginning (`at_s`, `below_height_m`, `above_height_m`, `in_phase` or `per_minute`) and a
duration `for_s`; without one it lasts for the rest of the flight. The seed may put the beginning off (`drawn_within_s`).

There is one kind a sensor, with what it does to the readings. A reading may be frozen, delayed, dropped, scaled, offset,
drifting, noisy or clipped, in this order when several are given. Offsets and the like carry the unit of the sensor in their name.

Where the other kinds say what a known failure does, corrupted signals know nothing of failures: what one sensor says is wrong, in
one of a few ways, on one axis, while it goes on saying something. Any error of their table may fall on any signal.
`sitl.faults.drawn` draws them by a seed; a scenario may list them as any other fault.
"""

import math
from collections import deque
from typing import Annotated, ClassVar, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from msgspec import Struct

from companion.base.mission import State
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.keys import choice, number, text
from estimator.contracts.time import MonoNs, after

PHASES = tuple(state.value for state in State)
"""The phases of guidance that a fault may begin in."""
_BEGINNINGS = ("at_s", "below_height_m", "above_height_m", "in_phase", "per_minute")


class Fault(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind"):
    """Something that goes wrong, and when."""

    at_s: Annotated[float, number("begins this long after the start of the flight", "s", 0.0, 36000.0)] | None = None
    below_height_m: (
        Annotated[float, number("begins when the vehicle first comes down to this height over the deck", "m", 0.05, 60.0)] | None
    ) = None
    above_height_m: (
        Annotated[float, number("begins when the vehicle is first higher than this over the deck", "m", 0.05, 60.0)] | None
    ) = None
    in_phase: (
        Annotated[str, text(f"begins when guidance first enters this phase: {', '.join(PHASES)}; in virtual time only", 40)]
        | None
    ) = None
    per_minute: (
        Annotated[float, number("average rate of a recurring fault, at times drawn by the seed", "per min", 0.01, 6000.0)] | None
    ) = None
    drawn_within_s: (
        Annotated[float, number("begins later by a time that the seed draws, up to this", "s", 0.001, 60.0)] | None
    ) = None
    for_s: Annotated[float, number("duration; without it, the rest of the flight", "s", 0.001, 36000.0)] | None = None

    def __post_init__(self) -> None:
        given = [name for name in _BEGINNINGS if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) if given else "none of them"
            raise ValueError(f"exactly one of {', '.join(_BEGINNINGS)} must say when it begins, found {found}")
        if self.in_phase is not None and self.in_phase not in PHASES:
            raise ValueError(f"in_phase must be one of {', '.join(PHASES)}, found {self.in_phase!r}")
        if self.per_minute is not None and self.for_s is None:
            raise ValueError("for_s must say how long the fault lasts each time")
        if self.per_minute is not None and self.drawn_within_s is not None:
            raise ValueError("drawn_within_s does not go with per_minute, whose times are drawn already")
        self.check()

    def check(self) -> None:
        """Refuse values that contradict each other; raises ValueError."""

    @property
    def kind(self) -> str:
        """The word that names this kind of fault in a scenario file."""
        return str(self.__struct_config__.tag)

    @property
    def words(self) -> str:
        """The fault in words, for people."""
        return self.kind


_OFFSET, _DRIFT = "added to the true value", "added for each second since the fault began"
_NOISE, _LIMIT = "standard deviation of added white noise", "largest magnitude that the sensor can tell"
_AXIS = "affected axis of the body: x forward, y right, z down"
Axis = Literal["x", "y", "z", "all"]
MOST_DELAY_S = 2.0


class ReadingErrors(NamedTuple):
    """Errors of a sensor's values, in SI units and radians."""

    offset: tuple[float, ...] = (0.0,)
    drift: tuple[float, ...] = (0.0,)
    noise: float = 0.0
    limit: float = math.inf
    axes: tuple[bool, ...] = (True,)
    """The values of the reading that noise, scale and limit act on."""


class SensorFault(Fault, frozen=True):
    """A fault of one sensor. The numbers of a kind have the names of `ERRORS`, with the kind's own unit."""

    ERRORS: ClassVar[tuple[str, ...]] = ("offset", "drift", "noise", "limit")
    UNIT: ClassVar[float] = 1.0
    """One such unit, in SI units or radians."""
    AXES: ClassVar[str] = ""
    """Names of the values of a reading that has several."""
    frozen: Annotated[bool, choice("whether the reading at the beginning is repeated")] = False
    delay_s: Annotated[float, number("time by which readings are older than they claim", "s", 0.0, MOST_DELAY_S)] = 0.0
    dropped_fraction: Annotated[
        float,
        number(
            "fraction of the readings that fail, drawn by the seed: no echo or field, else the one before again", "1", 0.0, 1.0
        ),
    ] = 0.0
    scale: Annotated[float, number("reported value over the true value", "1", -10.0, 10.0)] = 1.0

    @property
    def axes(self) -> tuple[bool, ...]:
        """The values of the reading that the fault acts on."""
        return tuple(getattr(self, "axis", "all") in (name, "all") for name in self.AXES) or (True,)

    @property
    def errors(self) -> ReadingErrors:
        """The numbers of this kind in SI units."""
        numbers = [(name.partition("_")[0], getattr(self, name)) for name in self.__struct_fields__]
        given = {name: self.UNIT * value for name, value in numbers if name in self.ERRORS and value is not None}
        offset, drift = (tuple(given[name] if on else 0.0 for on in self.axes) for name in ("offset", "drift"))
        return ReadingErrors(offset, drift, given["noise"], given.get("limit", math.inf), self.axes)

    def check(self) -> None:
        """Refuse a fault without an effect; raises ValueError."""
        e = self.errors
        values = (self.frozen, self.delay_s, self.dropped_fraction, self.scale - 1.0, *e.offset, *e.drift, e.noise)
        if not any(values) and math.isinf(e.limit):
            raise ValueError("nothing says what is wrong with the sensor: give frozen, delay_s, scale or another effect")


class Accelerometer(SensorFault, frozen=True, tag="accelerometer"):
    """The accelerometer; a spike where the fault lasts for milliseconds."""

    AXES = "xyz"
    axis: Annotated[Axis, choice(_AXIS)] = "all"
    offset_m_s2: Annotated[float, number(_OFFSET, "m/s^2", -1e6, 1e6)] = 0.0
    drift_m_s3: Annotated[float, number(_DRIFT, "m/s^3", -1e3, 1e3)] = 0.0
    noise_m_s2: Annotated[float, number(_NOISE, "m/s^2", 0.0, 1e3)] = 0.0
    limit_m_s2: Annotated[float, number(_LIMIT, "m/s^2", 0.0, 1e3)] | None = None


class Gyro(SensorFault, frozen=True, tag="gyro"):
    """The gyro."""

    UNIT = math.radians(1.0)
    AXES = "xyz"
    axis: Annotated[Axis, choice(_AXIS)] = "all"
    offset_deg_s: Annotated[float, number(_OFFSET, "deg/s", -1e5, 1e5)] = 0.0
    drift_deg_s2: Annotated[float, number(_DRIFT, "deg/s^2", -1e3, 1e3)] = 0.0
    noise_deg_s: Annotated[float, number(_NOISE, "deg/s", 0.0, 1e4)] = 0.0
    limit_deg_s: Annotated[float, number(_LIMIT, "deg/s", 0.0, 1e4)] | None = None


class AttitudeReading(SensorFault, frozen=True, tag="attitude"):
    """The reported roll and pitch; the vehicle's own loops go on with the right ones."""

    roll_deg: Annotated[float, number("added roll, right side down", "deg", -45.0, 45.0)] = 0.0
    pitch_deg: Annotated[float, number("added pitch, nose up", "deg", -45.0, 45.0)] = 0.0
    roll_drift_deg_s: Annotated[float, number("added roll for each second since the fault began", "deg/s", -30.0, 30.0)] = 0.0
    pitch_drift_deg_s: Annotated[float, number("added pitch for each second since the fault began", "deg/s", -30.0, 30.0)] = 0.0
    noise_deg: Annotated[float, number(_NOISE, "deg", 0.0, 45.0)] = 0.0
    limit_deg: Annotated[float, number(_LIMIT, "deg", 0.0, 90.0)] | None = None

    @property
    def errors(self) -> ReadingErrors:
        limit = math.inf if self.limit_deg is None else math.radians(self.limit_deg)
        offset = (math.radians(self.roll_deg), math.radians(self.pitch_deg), 0.0)
        drift = (math.radians(self.roll_drift_deg_s), math.radians(self.pitch_drift_deg_s), 0.0)
        return ReadingErrors(offset, drift, math.radians(self.noise_deg), limit, (True, True, False))


class HeadingReading(SensorFault, frozen=True, tag="heading"):
    """The reported heading; the magnetic field turns with an offset or a drift, as beside steel."""

    UNIT = math.radians(1.0)
    offset_deg: Annotated[float, number("added heading, clockwise", "deg", -180.0, 180.0)] = 0.0
    drift_deg_s: Annotated[float, number("added heading for each second since the fault began", "deg/s", -90.0, 90.0)] = 0.0
    noise_deg: Annotated[float, number(_NOISE, "deg", 0.0, 180.0)] = 0.0

    @property
    def axes(self) -> tuple[bool, ...]:
        return (False, False, True)


class VelocityReading(SensorFault, frozen=True, tag="velocity"):
    """The velocity that the vehicle reports; its own loops go on with the right one."""

    AXES = "xy"
    axis: Annotated[Literal["x", "y", "all"], choice("affected axis: x forward, y right")] = "all"
    offset_m_s: Annotated[float, number(_OFFSET, "m/s", -20.0, 20.0)] = 0.0
    drift_m_s2: Annotated[float, number(_DRIFT, "m/s^2", -10.0, 10.0)] = 0.0
    noise_m_s: Annotated[float, number(_NOISE, "m/s", 0.0, 20.0)] = 0.0
    limit_m_s: Annotated[float, number(_LIMIT, "m/s", 0.0, 20.0)] | None = None


class Ultrasound(SensorFault, frozen=True, tag="ultrasound"):
    """The ultrasound."""

    offset_m: Annotated[float, number(_OFFSET, "m", -6.0, 6.0)] = 0.0
    drift_m_s: Annotated[float, number(_DRIFT, "m/s", -2.0, 2.0)] = 0.0
    noise_m: Annotated[float, number(_NOISE, "m", 0.0, 6.0)] = 0.0
    limit_m: Annotated[float, number(_LIMIT, "m", 0.0, 20.0)] | None = None


class Barometer(SensorFault, frozen=True, tag="barometer"):
    """The barometer; 12 Pa more are one metre less of height."""

    offset_pa: Annotated[float, number(_OFFSET, "Pa", -2000.0, 2000.0)] = 0.0
    drift_pa_s: Annotated[float, number(_DRIFT, "Pa/s", -200.0, 200.0)] = 0.0
    noise_pa: Annotated[float, number(_NOISE, "Pa", 0.0, 2000.0)] = 0.0


class Magnetometer(SensorFault, frozen=True, tag="magnetometer"):
    """The magnetometer."""

    UNIT = 1e-6
    AXES = "xyz"
    axis: Annotated[Axis, choice(_AXIS)] = "all"
    offset_ut: Annotated[float, number(_OFFSET, "uT", -200.0, 200.0)] = 0.0
    drift_ut_s: Annotated[float, number(_DRIFT, "uT/s", -50.0, 50.0)] = 0.0
    noise_ut: Annotated[float, number(_NOISE, "uT", 0.0, 200.0)] = 0.0


_F = TypeVar("_F", bound=Fault)


class FaultTimer:
    """The active faults of a flight, and their begin.

    Args:
        faults: the scenario's faults, in any order.
        seed: seed of the times at which recurring faults begin.
    """

    def __init__(self, faults: tuple[Fault, ...], seed: int = 0) -> None:
        self._faults = faults
        self._began: list[float | None] = [None] * len(faults)
        self._was_above = [False] * len(faults)
        self._rngs = [np.random.default_rng([seed, 0xFA17, i]) for i in range(len(faults))]
        self._due_s = [self._rest_s(i, fault) for i, fault in enumerate(faults)]
        """Time at which each recurring fault begins next, or one that is put off begins, s."""
        self._on: list[tuple[Fault, float]] = []
        self.active_kinds: frozenset[str] = frozenset()
        """The kinds of all that is active now."""
        self._begun: list[tuple[Fault, float]] = []

    def __bool__(self) -> bool:
        """Return whether the scenario has any fault at all."""
        return bool(self._faults)

    def update(self, t_s: float, height_m: float, phase: str | None) -> list[Fault]:
        """Move on to an instant and return the faults that begin now.

        Args:
            t_s: seconds since the start of the flight.
            height_m: height of the vehicle over the deck's plane.
            phase: phase of guidance, None if not known.
        """
        begun = []
        for i, fault in enumerate(self._faults):
            began = self._began[i]
            if fault.per_minute is not None and began is not None and not _lasts(fault, t_s - began):
                self._began[i], self._due_s[i] = None, t_s + self._rest_s(i, fault)
            if self._began[i] is None and self._begins_by_now(i, fault, t_s, height_m, phase):
                self._began[i] = t_s
                begun.append(fault)
        self._begun += [(fault, t_s) for fault in begun]
        self._on = [
            (fault, t_s - began)
            for fault, began in zip(self._faults, self._began, strict=True)
            if began is not None and _lasts(fault, t_s - began)
        ]
        self.active_kinds = frozenset(fault.kind for fault, _ in self._on)
        return begun

    @property
    def delays(self) -> bool:
        """True if any sensor's readings are ever delayed, so that past readings are needed."""
        return any(isinstance(fault, SensorFault) and fault.delay_s > 0.0 for fault in self._faults)

    def active(self, kind: str) -> bool:
        """Return whether a fault of this kind is active now."""
        return kind in self.active_kinds

    def on(self, kind: type[_F]) -> list[tuple[_F, float]]:
        """Return the faults of one kind that are active now, each with the seconds since it began."""
        if not self._on:
            return []
        return [(fault, since_s) for fault, since_s in self._on if isinstance(fault, kind)]

    def listed(self, kind: type[_F]) -> list[_F]:
        """Return all faults of one kind that the scenario lists, whether they are active or not."""
        return [fault for fault in self._faults if isinstance(fault, kind)]

    @property
    def begun(self) -> tuple[tuple[Fault, float], ...]:
        """Every beginning so far, in order, and when in seconds after the start."""
        return tuple(self._begun)

    def _rest_s(self, i: int, fault: Fault) -> float:
        """Return the time until a recurring fault begins again: exponential, so that beginnings are a Poisson process."""
        return float(self._rngs[i].exponential(60.0 / fault.per_minute)) if fault.per_minute is not None else math.inf

    def _begins_by_now(self, i: int, fault: Fault, t_s: float, height_m: float, phase: str | None) -> bool:
        """Return whether a fault begins now, or was put off until now."""
        if fault.drawn_within_s is None:
            return self._begins(i, fault, t_s, height_m, phase)
        if math.isinf(self._due_s[i]) and self._begins(i, fault, t_s, height_m, phase):
            self._due_s[i] = t_s + float(self._rngs[i].uniform(0.0, fault.drawn_within_s))
        return t_s >= self._due_s[i]

    def _begins(self, i: int, fault: Fault, t_s: float, height_m: float, phase: str | None) -> bool:
        if fault.at_s is not None:
            return t_s >= fault.at_s - 1e-9
        if fault.below_height_m is not None:
            # Only a descent counts: a vehicle that takes off from the deck was low before it was ever up.
            self._was_above[i] = self._was_above[i] or height_m >= fault.below_height_m
            return self._was_above[i] and height_m < fault.below_height_m
        if fault.above_height_m is not None:
            return height_m > fault.above_height_m
        if fault.per_minute is not None:
            return t_s >= self._due_s[i]
        return phase is not None and phase == fault.in_phase


def _lasts(fault: Fault, since_s: float) -> bool:
    # A tolerance far below a step keeps "for 0.5 s" from ending a step late by the rounding of a sum.
    return since_s < (math.inf if fault.for_s is None else fault.for_s - 1e-9)


class RtkSolution(Fault, frozen=True, tag="rtk_solution"):
    """The receivers' solution is not what it should be."""

    solution: Annotated[
        Literal["silent", "float", "wrong"],
        choice("no solution; estimated ambiguities; or a wrong whole number of wavelengths, claimed as a right one"),
    ] = "silent"


Signal = Literal[
    "accelerometer", "gyro", "attitude", "heading", "velocity", "range", "barometer", "gnss", "samples", "sample_stamps",
    "frames", "frame_stamps", "sighting", "ship_velocity", "ship_heading", "ship_place", "commands",
    "ship_heave", "ship_tilt", "ship_turn", "ship_wind",
]  # fmt: skip
SignalError = Literal["frozen", "scaled", "biased", "drifting", "spiking", "late", "doubled", "swapped", "sign"]
SIGNALS: tuple[Signal, ...] = get_args(Signal)
ERRORS: tuple[SignalError, ...] = get_args(SignalError)
UNSIZED = frozenset({"frozen", "doubled", "swapped", "sign"})
"""Errors that have no size."""
LATE_MAX_S = 2.0
_SPIKED = 0.05
"""Fraction of the samples that a spike hits: some ten a second of an inertial sensor, one or two of a camera."""
Values = tuple[float, ...]


class SignalFacts(NamedTuple):
    """Properties of a signal."""

    axes: int
    """Number of its values; the first three are named x, y and z."""
    unit: str
    """Unit of a bias, a drift (a second) and a spike in a scenario file."""
    si: float = 1.0
    """Value of that unit in SI units and radians."""
    wraps: bool = False
    """True if it is an angle of a full circle."""


_DEG = math.pi / 180.0
FACTS: dict[Signal, SignalFacts] = {
    "accelerometer": SignalFacts(3, "m/s^2"),
    "gyro": SignalFacts(3, "deg/s", _DEG),
    "attitude": SignalFacts(2, "deg", _DEG),
    "heading": SignalFacts(1, "deg", _DEG, wraps=True),
    "velocity": SignalFacts(2, "m/s"),
    "range": SignalFacts(1, "m"),
    "barometer": SignalFacts(1, "Pa"),
    "gnss": SignalFacts(3, "m"),
    "samples": SignalFacts(0, "s"),
    "sample_stamps": SignalFacts(1, "s"),
    "frames": SignalFacts(0, "s"),
    "frame_stamps": SignalFacts(1, "s"),
    "sighting": SignalFacts(3, "m"),
    "ship_velocity": SignalFacts(3, "m/s"),
    "ship_heading": SignalFacts(1, "deg", _DEG, wraps=True),
    "ship_place": SignalFacts(3, "m"),
    "commands": SignalFacts(3, "full stick"),
    "ship_heave": SignalFacts(1, "m"),
    "ship_tilt": SignalFacts(2, "deg", _DEG),
    "ship_turn": SignalFacts(1, "deg/s", _DEG),
    "ship_wind": SignalFacts(1, "m/s"),
}


def errors_of(signal: Signal) -> tuple[SignalError, ...]:
    """Return the errors that a signal can have."""
    if signal == "samples":
        return ("late", "doubled")
    if signal == "frames":
        return ("frozen", "late", "doubled")
    if signal in ("sample_stamps", "frame_stamps"):
        return ("frozen", "biased", "drifting", "spiking", "late", "doubled")
    if signal in ("gnss", "ship_place"):
        return ("frozen", "biased", "drifting", "spiking", "late", "doubled")
    if FACTS[signal].axes == 1:
        return ("frozen", "scaled", "biased", "drifting", "spiking", "late", "doubled", "sign")
    return ERRORS


class Corrupted(Fault, frozen=True, tag="corrupted"):
    """A signal says something else than the sensor measured, on some of its axes."""

    signal: Annotated[Signal, choice("which signal; a sighting is the pad's place in camera axes, by perception model")]
    error: Annotated[
        SignalError,
        choice(
            "frozen at the first sample, times a factor, plus a constant, plus a growing error, hit by spikes; late, each sample "
            "twice, two axes swapped (the named one keeps its place), or with the opposite sign"
        ),
    ]
    axis: Annotated[Literal["x", "y", "z", "all"], choice("affected axis, in the signal's own axes")] = "all"
    size: Annotated[
        float,
        number("factor of scaled, seconds of late, else the error in the signal's unit, a second for drifting", "1", -1e6, 1e6),
    ] = 0.0

    def check(self) -> None:
        """Refuse what the signal cannot have; raises ValueError."""
        facts, possible = FACTS[self.signal], errors_of(self.signal)
        if self.error not in possible:
            raise ValueError(f"{self.signal} cannot be {self.error}; it can be {', '.join(possible)}")
        if self.axis != "all" and "xyz".index(self.axis) >= facts.axes:
            raise ValueError(f"{self.signal} has no axis {self.axis}")
        if self.error in UNSIZED:
            if self.size != 0.0:
                raise ValueError(f"size does not go with {self.error}")
        elif self.size == (1.0 if self.error == "scaled" else 0.0):
            raise ValueError(f"size says how much {self.error}; found {self.size:g}, which changes nothing")
        if self.error == "late" and not 0.0 < self.size <= LATE_MAX_S:
            raise ValueError(f"size is a delay of more than 0 s and at most {LATE_MAX_S:g} s, found {self.size:g}")

    @property
    def delay_s(self) -> float:
        """Delay of a packet, s."""
        return self.size if self.error == "late" else 0.0

    @property
    def words(self) -> str:
        """The fault in words."""
        axis = "" if self.axis == "all" else f" {self.axis}"
        unit = {"scaled": "times ", "late": ""}.get(self.error)
        if self.error in UNSIZED:
            return f"{self.signal}{axis} {self.error}"
        if unit is not None:
            return f"{self.signal}{axis} {self.error} {unit}{self.size:g}{' s' if self.error == 'late' else ''}"
        per_s = "/s" if self.error == "drifting" else ""
        return f"{self.signal}{axis} {self.error} {self.size:g} {FACTS[self.signal].unit}{per_s}"


class Corruptions:
    """Corrupts the samples of each signal while faults say so. One call for each sample, in order of time.

    Args:
        faults: which faults are active.
        seed: of the spikes.
    """

    def __init__(self, faults: FaultTimer, seed: int) -> None:
        self._faults, self._seed = faults, seed
        listed = faults.listed(Corrupted)
        self.signals = frozenset(fault.signal for fault in listed)
        """The signals that are ever corrupted."""
        self._past: dict[Signal, deque[tuple[MonoNs, Values]]] = {f.signal: deque() for f in listed if f.error == "late"}
        self._held: dict[Signal, dict[int, Values]] = {signal: {} for signal in self.signals}
        """Value that each frozen fault repeats, and each doubling one repeats next."""

    def active(self, signal: Signal) -> list[tuple[Corrupted, float]]:
        """Return the faults of a signal that are active now, each with the seconds since it began."""
        if signal not in self.signals:
            return []
        return [(fault, since_s) for fault, since_s in self._faults.on(Corrupted) if fault.signal == signal]

    def of(self, signal: Signal, true: Values, at: MonoNs) -> Values:
        """Return a sample as the corrupted signal says it; the same tuple where nothing is wrong.

        Args:
            true: in SI units and radians.
            at: instant of the sample, which orders them.
        """
        if signal not in self.signals:
            return true
        if (past := self._past.get(signal)) is not None:
            past.append((at, true))
            while past[0][0] < after(at, -LATE_MAX_S - 0.1):
                past.popleft()
        active = self.active(signal)
        if not active:
            self._held[signal].clear()
            return true
        values, facts = true, FACTS[signal]
        for fault, since_s in active:
            wrong = self._with(fault, since_s, values, at)
            values = tuple(w if fault.axis in (name, "all") else v for name, w, v in zip("xyz", wrong, values, strict=False))
            if fault.error == "swapped":
                values = wrong
        return tuple(map(wrap_pi, values)) if facts.wraps else values

    def _with(self, fault: Corrupted, since_s: float, values: Values, at: MonoNs) -> Values:
        """Return the values with one fault, on all axes."""
        by, held = fault.size * FACTS[fault.signal].si, self._held[fault.signal]
        match fault.error:
            case "frozen":
                return held.setdefault(id(fault), values)
            case "doubled":
                before = held.pop(id(fault), None)
                if before is None:
                    held[id(fault)] = values
                return values if before is None else before
            case "late":
                return self._late(fault, at)
            case "scaled":
                return tuple(fault.size * v for v in values)
            case "sign":
                return tuple(-v for v in values)
            case "swapped":
                return _swapped(values, fault.axis)
            case "biased":
                return tuple(v + by for v in values)
            case "drifting":
                return tuple(v + by * since_s for v in values)
            case "spiking":
                rng = np.random.default_rng([self._seed, 0x5B1C, SIGNALS.index(fault.signal), at // 1_000_000])
                hit, side = rng.random(2)
                return tuple(v + (by if side < 0.5 else -by) for v in values) if hit < _SPIKED else values

    def _late(self, fault: Corrupted, at: MonoNs) -> Values:
        past = self._past[fault.signal]
        asked = after(at, -fault.size)
        return next((values for when, values in reversed(past) if when <= asked), past[0][1])


def _swapped(values: Values, kept: str) -> Values:
    """Return the values with two axes swapped; of three those beside the kept one, or all in turn where none is named."""
    if len(values) == 2:
        return values[1], values[0]
    x, y, z = values
    return {"x": (x, z, y), "y": (z, y, x), "z": (y, x, z)}.get(kept, (y, z, x))
