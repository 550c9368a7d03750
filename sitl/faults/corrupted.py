"""Corrupted signals: what one sensor says is wrong, in one of a few ways, on one axis, while it goes on saying something.

Where the other kinds of faults say what a known failure does, this one knows nothing of failures: any error of the table may
fall on any signal. `draw` draws them by a seed; a scenario may list them as any other fault.
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, get_args

import numpy as np

from estimator.contracts.geometry import wrap_pi
from estimator.contracts.keys import choice, number
from estimator.contracts.time import MonoNs, after
from sitl.faults.fault import Fault
from sitl.faults.timer import FaultTimer

Signal = Literal[
    "accelerometer", "gyro", "attitude", "heading", "velocity", "range", "barometer", "gnss", "samples", "sample_stamps",
    "frames", "frame_stamps", "sighting", "ship_velocity", "ship_heading", "ship_place", "commands",
]  # fmt: skip
SignalError = Literal["frozen", "scaled", "biased", "drifting", "spiking", "late", "doubled", "swapped", "sign"]
SIGNALS: tuple[Signal, ...] = get_args(Signal)
ERRORS: tuple[SignalError, ...] = get_args(SignalError)
PACKETS = frozenset({"samples", "frames"})
"""Signals whose whole packets are late or doubled, and not their values; commands have both."""
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


Rng = np.random.Generator
_T = TypeVar("_T")
_STREAM = 0x4A1D
_PAIRS = 0.5
"""Fraction of the flights with two faults."""
_LATEST_S = 20.0
"""Latest beginning at an instant: most landings are over by then."""
_BEGINS = ("at_s", "at_s", "below_height_m", "in_phase")
_PHASES = ("intercept", "descend", "gate", "commit", "press")
_FOR_GOOD = 0.25
_LENGTHS_S = (0.05, 30.0)
_FACTORS = (0.2, 5.0)
_FACTOR_LEAST = 0.03
"""Least change by a factor."""
_COMMAND_S = 0.5
"""Longest time in which commands do something else than they say. Nothing on board can fly a vehicle that turns right for left;
the requirement is that it gets over it."""


class Sizes(NamedTuple):
    """Least and largest size of an error, by its magnitude: bias, drift a second, spike."""

    biased: tuple[float, float]
    drifting: tuple[float, float]
    spiking: tuple[float, float]


_STAMPS = Sizes((0.01, 5.0), (0.002, 0.5), (0.02, 5.0))
_PLACES = Sizes((0.5, 300.0), (0.05, 10.0), (1.0, 300.0))
SIZES: dict[Signal, Sizes] = {
    "accelerometer": Sizes((0.2, 20.0), (0.05, 5.0), (2.0, 400.0)),
    "gyro": Sizes((0.5, 100.0), (0.2, 20.0), (10.0, 2000.0)),
    "attitude": Sizes((0.5, 25.0), (0.1, 10.0), (1.0, 45.0)),
    "heading": Sizes((2.0, 180.0), (0.5, 45.0), (5.0, 180.0)),
    "velocity": Sizes((0.1, 5.0), (0.02, 2.0), (0.3, 10.0)),
    "range": Sizes((0.05, 5.0), (0.02, 1.0), (0.1, 6.0)),
    "barometer": Sizes((2.0, 500.0), (0.5, 50.0), (5.0, 1000.0)),
    "gnss": _PLACES,
    "sample_stamps": _STAMPS,
    "frame_stamps": _STAMPS,
    "sighting": Sizes((0.03, 3.0), (0.01, 0.5), (0.1, 5.0)),
    "ship_velocity": Sizes((0.1, 10.0), (0.02, 2.0), (0.3, 20.0)),
    "ship_heading": Sizes((2.0, 180.0), (0.5, 45.0), (5.0, 180.0)),
    "ship_place": _PLACES,
    "commands": Sizes((0.02, 0.3), (0.005, 0.1), (0.1, 1.0)),
}
"""Fault sizes in the units of a scenario file."""


def draw(seed: int, signals: Sequence[Signal], heights_m: tuple[float, float]) -> tuple[Corrupted, ...]:
    """Return the faults of a seed, one or two.

    Args:
        signals: those that the flight has.
        heights_m: lowest and highest height at which a fault may begin on the way down.
    """
    rng = np.random.default_rng([seed, _STREAM])
    return tuple(_one(rng, signals, heights_m) for _ in range(2 if rng.random() < _PAIRS else 1))


def _one(rng: Rng, signals: Sequence[Signal], heights_m: tuple[float, float]) -> Corrupted:
    signal = _pick(rng, signals)
    error = _pick(rng, errors_of(signal))
    more: dict[str, Any] = {}
    axes = FACTS[signal].axes
    if axes > 1 and rng.random() < 0.7:
        more["axis"] = "xyz"[int(rng.integers(axes))]
    if error not in UNSIZED:
        more["size"] = _size(rng, signal, error)
    begins = _pick(rng, _BEGINS)
    if begins == "at_s":
        more["at_s"] = _short(rng.uniform(0.0, _LATEST_S))
    elif begins == "below_height_m":
        more["below_height_m"] = _short(_between(rng, *heights_m))
    else:
        more["in_phase"] = _pick(rng, _PHASES)
    length_s = None if rng.random() < _FOR_GOOD else _short(_between(rng, *_LENGTHS_S))
    if signal == "commands" and error in ("frozen", "swapped", "sign"):
        length_s = min(_COMMAND_S, length_s or _COMMAND_S)
    return Corrupted(signal=signal, error=error, for_s=length_s, **more)


def _size(rng: Rng, signal: Signal, error: SignalError) -> float:
    """Return a size, evenly over its orders of magnitude."""
    if error == "late":
        return _short(_between(rng, 0.02, LATE_MAX_S))
    if error == "scaled":
        factor = _between(rng, *_FACTORS)
        return _short(factor if abs(factor - 1.0) >= _FACTOR_LEAST else 1.0 + _FACTOR_LEAST)
    low, high = getattr(SIZES[signal], error)
    return _short(_between(rng, low, high) * (1.0 if rng.random() < 0.5 else -1.0))


def _between(rng: Rng, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _short(value: float) -> float:
    """Return the value with the digits that a scenario file shows, so that the file flies the same."""
    return float(f"{value:.3g}")


def _pick(rng: Rng, among: Sequence[_T]) -> _T:
    return among[int(rng.integers(len(among)))]
