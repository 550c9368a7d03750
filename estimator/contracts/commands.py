"""The commands of guidance to a vehicle. Drivers turn them into bytes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimator.contracts.geometry import F64


@dataclass(frozen=True, slots=True, eq=False)
class Velocity:
    """Fly with this velocity over the ground and turn at this rate."""

    v_level: F64
    """(3,) m/s forward, right, down."""
    yaw_rate_rad_s: float
    """Clockwise from above positive."""

    def __post_init__(self) -> None:
        v = np.array(self.v_level, dtype=float)
        if v.shape != (3,) or not np.all(np.isfinite(v)) or not math.isfinite(self.yaw_rate_rad_s):
            raise ValueError(f"a velocity command needs finite numbers, got {self.v_level!r}, {self.yaw_rate_rad_s!r}")
        v.setflags(write=False)
        object.__setattr__(self, "v_level", v)


@dataclass(frozen=True, slots=True)
class Hover:
    """Hold the position with the vehicle's own means; never descend."""

    calls_off: bool = False
    """A person's order: it also ends a landing that a person ordered."""


@dataclass(frozen=True, slots=True)
class TakeOff:
    """Leave the ground and hover."""


@dataclass(frozen=True, slots=True)
class Land:
    """Descend to the ground with the vehicle's own means and stop the motors there.

    Guidance repeats it in every cycle for as long as it wants to land; a driver treats its absence as the end of the landing.
    """

    persistent: bool = False
    """A person's order: it needs no repeating and holds until the vehicle is on the ground or told to take off."""


@dataclass(frozen=True, slots=True)
class CutMotors:
    """Stop the motors at once, wherever the vehicle is. Only a person orders it."""


@dataclass(frozen=True, slots=True)
class LeaveEmergency:
    """Leave the state that `CutMotors` led to; the motors stay off until a take-off."""


Command = Velocity | Hover | TakeOff | Land | CutMotors | LeaveEmergency
