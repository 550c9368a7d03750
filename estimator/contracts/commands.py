"""The commands of guidance to a vehicle. Drivers turn them into bytes."""

import math

import numpy as np
from msgspec import Struct, structs

from estimator.contracts.geometry import F64, GeoPoint, own_array


class Velocity(Struct, frozen=True, eq=False):
    """Fly with this velocity against the surface below and turn at this rate.

    The driver of a vehicle whose velocities are over the ground adds the deck's own.
    """

    v_level: F64
    """(3,) m/s forward, right, down."""
    yaw_rate_rad_s: float
    """Clockwise from above positive."""

    def __post_init__(self) -> None:
        v = np.array(self.v_level, dtype=float)
        if v.shape != (3,) or not np.all(np.isfinite(v)) or not math.isfinite(self.yaw_rate_rad_s):
            raise ValueError(f"a velocity command needs finite numbers, got {self.v_level!r}, {self.yaw_rate_rad_s!r}")
        v.setflags(write=False)
        structs.force_setattr(self, "v_level", v)


class Lean(Struct, frozen=True, eq=False):
    """Lean so that the body accelerates, climb or descend at a rate, and turn at a rate.

    A vehicle that takes tilt flies `a_level + trim_level` as a tilt. One that takes velocities flies `v_level`, with `a_level` as
    what it is about to do: it cancels wind and drag by itself.
    """

    a_level: F64
    """Acceleration over the ground, (2,) m/s^2 forward and right."""
    trim_level: F64
    """Acceleration that cancels wind, drag and the error of the reported tilt, (2,) m/s^2 in addition."""
    v_level: F64
    """Velocity over the ground, (3,) m/s: forward and right as they go with the acceleration, down as it is to be flown."""
    yaw_rate_rad_s: float
    """Clockwise from above positive."""
    on_deck_turn_rad: float | None = None
    """On a deck that is felt, the turn that is left to the wanted heading, clockwise from above positive; None in flight. By it a
    vehicle that takes attitudes stands level."""

    def __post_init__(self) -> None:
        a, trim, v = own_array(self.a_level), own_array(self.trim_level), own_array(self.v_level)
        whole, turns = a.shape == trim.shape == (2,) and v.shape == (3,), (self.yaw_rate_rad_s, self.on_deck_turn_rad or 0.0)
        if not whole or not all(map(math.isfinite, [*a.tolist(), *trim.tolist(), *v.tolist(), *turns])):
            raise ValueError(
                "a lean command needs finite numbers of shapes (2,), (2,), (3,), (), "
                f"got {self.a_level!r}, {self.trim_level!r}, {self.v_level!r}, {self.yaw_rate_rad_s!r}"
            )
        structs.force_setattr(self, "a_level", a)
        structs.force_setattr(self, "trim_level", trim)
        structs.force_setattr(self, "v_level", v)


class LandingPlace(Struct, frozen=True):
    """A place on the Earth that does not move."""

    place: GeoPoint
    """Its height is the one above mean sea level at which the vehicle flies there, if it is not higher already."""
    range_max_m: float
    """Distance beyond which nobody flies to it."""


class Hover(Struct, frozen=True):
    """Hold the position with the vehicle's own means; never descend."""

    calls_off: bool = False
    """A person's order: it also ends a take-off."""
    returns: bool = False
    """True if a vehicle that knows the way flies back by itself, by its own rules; one that does not hovers."""
    elsewhere: LandingPlace | None = None
    """Place to which a vehicle that knows its own flies by itself, and lands there by its own rules; another one hovers."""


class TakeOff(Struct, frozen=True):
    """Leave the ground and hover."""


class Land(Struct, frozen=True):
    """Descend to the ground with the vehicle's own means and stop the motors there.

    Guidance repeats it in every cycle for as long as it wants to land; a driver treats its absence as the end of the landing.
    """

    here: bool = False
    """True for a landing where the vehicle is, and not on the target that leads an autopilot's own landing."""
    on_deck: bool = False
    """True if contact with the deck was felt: the vehicle is down, and its motors are to be stopped at once."""
    turn_rad: float = 0.0
    """Turn that is left to the wanted heading, clockwise from above positive, for a vehicle whose own landing takes one."""


class CutMotors(Struct, frozen=True):
    """Stop the motors at once, wherever the vehicle is. Only a person orders it."""


class LeaveEmergency(Struct, frozen=True):
    """Leave the state that `CutMotors` led to; the motors stay off until a take-off."""


Command = Velocity | Lean | Hover | TakeOff | Land | CutMotors | LeaveEmergency
