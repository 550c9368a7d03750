"""Faults that a seed draws, one or two: corrupted signals, a service that is killed, a person's acts, and what wears or breaks.

Whatever is drawn can be written into a scenario file, and made simpler step by step (`simpler`).
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from msgspec.structs import replace

from sitl.faults.corrupted import FACTS, LATE_MAX_S, UNSIZED, Corrupted, Signal, SignalError, errors_of
from sitl.faults.fault import Fault
from sitl.faults.kinds import (
    AnyFault,
    CommandStream,
    Failsafe,
    FocalLength,
    Gust,
    LensCovered,
    LowBattery,
    OperatorActs,
    OtherPad,
    ServiceKilled,
    WeakRotor,
)

Rng = np.random.Generator
_T = TypeVar("_T")
_STREAM = 0x4A1D
_PAIRS = 0.5
"""Fraction of the flights with two faults, and of the pairs that begin together."""
_LATEST_S = 20.0
"""Latest beginning at an instant: most landings are over by then."""
_BEGINS = ("at_s", "below_height_m", "in_phase", "in_phase")
_PHASES = ("intercept", "descend", "gate", "gate", "commit", "commit", "press", "press")
"""Each counts as often as it stands here: close to the deck there is the least time."""
_FOR_GOOD = 0.25
_LENGTHS_S = (0.05, 30.0)
_FACTORS = (0.2, 5.0)
_FACTOR_LEAST = 0.03
"""Least change by a factor."""
_COMMAND_S = 0.5
"""Longest time in which commands do something else than they say. Nothing on board can fly a vehicle that turns right for left;
the requirement is that it gets over it."""
_COMMAND_LATE_S = 0.4
"""Largest delay of commands that lasts longer: one axis that is late by more than a second cannot be flown either."""


_KNOWN_S = 1.0
"""Time until an error of the sightings is a leap: before that nothing knows the pad's place."""
_CHARGE_LEAST = 0.04
"""Least charge that is left: the way down from the start, a person's time to read of it and a few seconds more take it."""


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
    "ship_heave": Sizes((0.1, 10.0), (0.02, 1.0), (0.3, 20.0)),
    "ship_tilt": Sizes((0.5, 25.0), (0.1, 10.0), (1.0, 45.0)),
    "ship_turn": Sizes((0.5, 60.0), (0.2, 10.0), (2.0, 200.0)),
    "ship_wind": Sizes((1.0, 20.0), (0.1, 2.0), (2.0, 40.0)),
}
"""Fault sizes in the units of a scenario file."""


class Drawable(NamedTuple):
    """The parts of a flight that faults may be drawn for."""

    signals: Sequence[Signal]
    heights_m: tuple[float, float]
    """Lowest and highest height at which a fault may begin on the way down."""
    rotors: Sequence[str] = ("front_left", "front_right", "rear_right", "rear_left")
    pad: str = "thesis"
    rendered: bool = False
    """Frames are rendered, so that another pad can be painted over the right one."""
    autopilot: bool = False
    """An autopilot flies it: a person may have a remote control, and it has failsafes."""


SHARES: Mapping[str, int] = {
    "corrupted": 8,
    "level": 4,
    "operator": 4,
    "landing": 3,
    "late_order": 2,
    "failsafe": 3,
    "commands": 3,
    "service_killed": 3,
    "weak_rotor": 2,
    "lens_covered": 2,
    "focal_length": 1,
    "pad_size": 1,
    "low_battery": 1,
    "gust": 1,
}
"""Weight of each kind in the draw."""
_LEVELS = frozenset(signal for signal in SIZES if not signal.endswith("_stamps") and signal != "commands")
"""Sensors whose level can be wrong."""
_LEVEL_MOST: Mapping[Signal, float] = {"sighting": 0.05}
"""Largest error of a level that nothing on board shows: a camera that sits elsewhere than its file says, by a ruler's error.
docs/limits.md says what more does."""
NEUTRAL: Mapping[type[Fault], Mapping[str, float]] = {
    CommandStream: {"dropped_fraction": 0.0, "delay_s": 0.0},
    WeakRotor: {"thrust_fraction": 1.0},
    FocalLength: {"scale": 1.0},
    OtherPad: {"size": 1.0},
    LowBattery: {"fraction": 0.2},
    Gust: {"speed_m_s": 0.0},
    OperatorActs: {"forward": 0.0, "right": 0.0, "climb": 0.0, "turn": 0.0, "late_s": 0.0},
}
"""The value of each key at which a fault does nothing."""


def draw(seed: int, there: Drawable) -> tuple[AnyFault, ...]:
    """Return the faults of a seed: of one kind, or of two different ones. Half of the pairs begin together."""
    rng = np.random.default_rng([seed, _STREAM])
    possible = SHARES.keys() if there.autopilot else SHARES.keys() - {"failsafe"}
    bag = tuple(kind for kind, share in SHARES.items() if kind in possible for _ in range(share))
    kinds = [_pick(rng, bag)]
    while len(kinds) == 1 and rng.random() < _PAIRS:
        kinds.append(_pick(rng, bag))
    if kinds[0] == kinds[-1] != "corrupted":
        kinds[1:] = ["corrupted"] * (len(kinds) - 1)
    begins = _begins(rng, there)
    first = _of_kind(rng, kinds[0], there, begins)
    if len(kinds) == 1:
        return first
    return *first, *_of_kind(rng, kinds[1], there, begins if rng.random() < _PAIRS else _begins(rng, there))


def _begins(rng: Rng, there: Drawable) -> dict[str, Any]:
    """Return when a fault begins."""
    begins = _pick(rng, _BEGINS)
    if begins == "at_s":
        return {"at_s": _short(rng.uniform(0.0, _LATEST_S))}
    if begins == "below_height_m":
        return {"below_height_m": _short(_between(rng, *there.heights_m))}
    return {"in_phase": _pick(rng, _PHASES)}


def _of_kind(rng: Rng, kind: str, there: Drawable, begins: dict[str, Any]) -> tuple[AnyFault, ...]:
    """Return the faults of a kind with this beginning: one, or what people order one after the other."""
    match kind:
        case "landing":
            return _lands(rng, begins)
        case "late_order":
            return _ordered_late(rng, begins)
    return (_one(rng, kind, there, begins),)


def _one(rng: Rng, kind: str, there: Drawable, begins: dict[str, Any]) -> AnyFault:
    """Return a fault of a kind with this beginning."""
    match kind:
        case "operator":
            return _act(rng, begins, there)
        case "level":
            signals = [s for s in there.signals if s in _LEVELS]
            since = {"at_s": 0.0} if rng.random() < 0.5 else begins
            return _biased(rng, _pick(rng, signals), since)
        case "failsafe":
            takes: Any = _pick(rng, ("land", "hold"))
            return Failsafe(takes=takes, **begins)
        case "commands":
            if rng.random() < 1.0 / 3.0:
                return Corrupted(signal="commands", error="scaled", size=0.5, for_s=_for(rng, 1.0, 20.0), **begins)
            if rng.random() < 0.5:
                return CommandStream(dropped_fraction=_short(rng.uniform(0.1, 0.7)), for_s=_for(rng, 1.0, 30.0), **begins)
            return CommandStream(delay_s=_short(_between(rng, 0.03, _COMMAND_LATE_S)), for_s=_for(rng, 1.0, 30.0), **begins)
        case "service_killed":
            return ServiceKilled(for_s=_for(rng, 0.3, 8.0), **begins)
        case "weak_rotor":
            rotor: Any = _pick(rng, there.rotors)
            return WeakRotor(rotor=rotor, thrust_fraction=_short(rng.uniform(0.7, 0.95)), **begins)
        case "lens_covered":
            return LensCovered(for_s=_for(rng, 0.3, 20.0), **begins)
        case "focal_length":
            return FocalLength(scale=_short(1.0 + _some(rng, 0.01, 0.06)), **begins)
        case "pad_size":
            size = _short(1.0 + _some(rng, 0.01, 0.06))
            if there.rendered:
                return OtherPad(file=there.pad, size=size, instead=True, **begins)
            # Drawn detections of a larger pad are nearer by its factor, in all directions.
            return Corrupted(signal="sighting", error="scaled", size=_short(1.0 / size), **begins)
        case "low_battery":
            return LowBattery(fraction=max(_CHARGE_LEAST, _short(rng.uniform(0.02, 0.15))), **begins)
        case "gust":
            blows: dict[str, Any] = {"speed_m_s": _short(rng.uniform(3.0, 9.0)), "from_deg": float(rng.integers(360))}
            return Gust(for_s=_for(rng, 1.0, 5.0), **blows, **begins)
    return _corrupted(rng, there, begins)


def _act(rng: Rng, begins: dict[str, Any], there: Drawable) -> OperatorActs:
    """Return what a person does: he gives the vehicle back after a time, or it stays his."""
    by_remote = ("mode", "mode", "disarm") if there.autopilot else ()
    order: Any = _pick(rng, ("hold", "hold", "manual", "manual", "abort", "emergency", "begin", "stay", *by_remote))
    if order in ("hold", "manual", "mode"):
        for_good = rng.random() < _FOR_GOOD and order != "manual"  # nobody keeps his sticks where they are
        for_s = None if for_good else _for(rng, 0.3, 10.0)
        return OperatorActs(order=order, for_s=for_s, **_sticks(rng, order), **begins)
    return OperatorActs(order=order, **begins)


def _sticks(rng: Rng, order: str) -> dict[str, Any]:
    if order != "manual":
        return {}
    sticks = {name: _short(rng.uniform(-0.3, 0.3)) for name in ("forward", "right", "turn")}
    return {**sticks, "climb": _short(rng.uniform(-0.1, 0.4))}


def _lands(rng: Rng, begins: dict[str, Any]) -> tuple[OperatorActs, ...]:
    """Return a landing that a person orders, at once or where he has held or flown the vehicle before."""
    before: Any = _pick(rng, (None, "hold", "manual"))
    if before is None:
        return (OperatorActs(order="land", **begins),)
    later_s = _for(rng, 0.5, 8.0)
    first = OperatorActs(order=before, **_sticks(rng, before), **begins)
    return first, OperatorActs(order="land", drawn_within_s=later_s, **begins)


def _ordered_late(rng: Rng, begins: dict[str, Any]) -> tuple[OperatorActs, ...]:
    """Return what a person ends or takes, and an order that was given before that and arrives after it."""
    ends: Any = _pick(rng, ("hold", "abort", "manual"))
    late: Any = _pick(rng, ("begin", "stay", "land"))
    within_s = _for(rng, 0.3, 5.0)
    late_s = _short(within_s + _between(rng, 0.1, 20.0))
    return (
        OperatorActs(order=ends, **_sticks(rng, ends), **begins),
        OperatorActs(order=late, late_s=late_s, drawn_within_s=within_s, **begins),
    )


def _biased(rng: Rng, signal: Signal, begins: dict[str, Any]) -> Corrupted:
    """Return an error of a sensor's level that stays: it never leaps, so that no change of it can be noticed."""
    axes = FACTS[signal].axes
    more: dict[str, Any] = {"axis": "xyz"[int(rng.integers(axes))]} if axes > 1 and rng.random() < 0.7 else {}
    return Corrupted(signal=signal, error="biased", size=_as_level(signal, _size(rng, signal, "biased")), **more, **begins)


def _as_level(signal: Signal, size: float) -> float:
    most = _LEVEL_MOST.get(signal, math.inf)
    return max(-most, min(most, size))


def _corrupted(rng: Rng, there: Drawable, begins: dict[str, Any]) -> Corrupted:
    signal = _pick(rng, there.signals)
    error = _pick(rng, errors_of(signal))
    more: dict[str, Any] = {}
    axes = FACTS[signal].axes
    if axes > 1 and rng.random() < 0.7:
        more["axis"] = "xyz"[int(rng.integers(axes))]
    if error not in UNSIZED:
        more["size"] = _size(rng, signal, error)
    if error == "biased" and (begins.get("in_phase") == _PHASES[0] or begins.get("at_s", math.inf) < _KNOWN_S):
        more["size"] = _as_level(signal, more["size"])
    length_s = None if rng.random() < _FOR_GOOD else _for(rng, *_LENGTHS_S)
    late = error == "late" and more["size"] > _COMMAND_LATE_S
    if signal == "commands" and (late or error in ("frozen", "swapped", "sign")):
        length_s = min(_COMMAND_S, length_s or _COMMAND_S)
    if signal == "commands" and error == "drifting":
        # A full stick is flown by nothing on board: the drift ends as the largest level that a command may be off by.
        length_s = min(length_s or math.inf, _short(SIZES[signal].biased[1] / abs(more["size"])))
    return Corrupted(signal=signal, error=error, for_s=length_s, **more, **begins)


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


def _some(rng: Rng, low: float, high: float) -> float:
    """Return a size of either sign."""
    return rng.uniform(low, high) * (1.0 if rng.random() < 0.5 else -1.0)


def _for(rng: Rng, low_s: float, high_s: float) -> float:
    return _short(_between(rng, low_s, high_s))


def _short(value: float) -> float:
    """Return the value with the digits that a scenario file shows, so that the file flies the same."""
    return float(f"{value:.3g}")


def _pick(rng: Rng, among: Sequence[_T]) -> _T:
    return among[int(rng.integers(len(among)))]


_LENGTH_S, _SHORTEST_S = 16.0, 0.05
"""Length that is tried for a fault that lasts for good, and the shortest."""


def simpler(faults: Sequence[AnyFault]) -> Iterator[tuple[AnyFault, ...]]:
    """Return faults that are simpler by one step: one fault less, half as long, half as much."""
    if len(faults) > 1:
        yield from ((*faults[:n], *faults[n + 1 :]) for n in range(len(faults)))
    for n, fault in enumerate(faults):
        for change in _changes(fault):
            try:
                weaker = replace(fault, **change)
            except ValueError:
                continue  # a fault that would do nothing, or that has no length
            yield (*faults[:n], weaker, *faults[n + 1 :])


def _changes(fault: AnyFault) -> Iterator[dict[str, float]]:
    """Return a shorter length, and half of each size."""
    length_s = _LENGTH_S if fault.for_s is None else _short(0.5 * fault.for_s)
    if length_s >= _SHORTEST_S:
        yield {"for_s": length_s}
    neutral = NEUTRAL.get(type(fault), {})
    if isinstance(fault, Corrupted) and fault.error not in UNSIZED:
        neutral = {"size": 1.0 if fault.error == "scaled" else 0.0}
    for name, none in neutral.items():
        if (value := getattr(fault, name)) != none:
            yield {name: _short(none + 0.5 * (value - none))}
