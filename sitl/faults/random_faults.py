"""Faults drawn by a seed: which signal, which axis, what error, how much, when and for how long, alone or two at once.

Nothing here knows what the service looks for. Sizes run from what no check can see to far more than any limit.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from sitl.faults.corrupted import FACTS, LATE_MAX_S, UNSIZED, Corrupted, Signal, SignalError, errors_of

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
what is asked is that it gets over it."""


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
"""In the units of a scenario file."""


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
