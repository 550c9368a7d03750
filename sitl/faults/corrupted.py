"""Corrupted signals, which know nothing of failures: a sensor is wrong in one of a few ways while it goes on reporting.

Any error of the table may fall on any signal, on one axis or all. `sitl.faults.drawn` draws them by a seed; a scenario may list
them as any other fault.
"""

import math
from collections import deque
from typing import Annotated, Literal, NamedTuple, get_args

import numpy as np

from estimator.contracts.geometry import wrap_pi
from estimator.contracts.keys import choice, number
from estimator.contracts.time import MonoNs, after
from sitl.faults.acts import OnFrame, Passage, Stream
from sitl.faults.fault import Fault, FaultTimer

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


_OF_STREAM: dict[Stream, Signal] = {"frames": "frames", "navdata": "samples", "commands": "commands"}
"""The signal whose packets a stream carries."""


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

    def on_stream(self, stream: Stream) -> Passage | None:
        if self.signal != _OF_STREAM[stream]:
            return None
        late_s = self.size if self.error == "late" else 0.0
        return Passage(late_s, doubled=float(self.error == "doubled"), by_chance=False)

    def on_frame(self, frame: OnFrame) -> None:
        frame.frozen |= self.signal == "frames" and self.error == "frozen"

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
