"""Records of the parts of a flight, into which each active fault writes what it does there."""

import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from msgspec import Struct, field

Vehicles = Literal["ardrone", "stand-in", "program", "own physics"]
"""Vehicles that carry faults: the AR.Drone, an autopilot in miniature, a program on our physics or on its own."""
Stream = Literal["frames", "navdata", "commands"]
STREAMS: tuple[Stream, ...] = ("frames", "navdata", "commands")


class OnVehicle(Struct):
    """A vehicle at a step."""

    thrust: dict[str, float]
    """Share of its thrust that each rotor gives, by its name."""
    battery_life_s: float
    """Time in which a full battery is used up."""
    wind_ned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Wind in addition to the scenario's, m/s."""
    tilt_max_rad: float = math.inf
    """Largest tilt, whatever the loops request."""
    charge_max: float = 1.0
    """Largest charge of the battery, 0 to 1."""
    flow_works: bool = True


class Passage(NamedTuple):
    """The passage of one packet, with the fractions of the packets that each thing happens to."""

    delay_s: float = 0.0
    lost: float = 0.0
    doubled: float = 0.0
    overtaken: float = 0.0
    by_chance: bool = True
    """True if the seed draws these packets, in each case; else a fraction is 0 or 1."""


class OnFrame(Struct):
    """A frame at its exposure."""

    chance: Callable[[], float]
    """Draws a number of 0 to 1."""
    covered: bool = False
    """Black."""
    frozen: bool = False
    """The image of the frame before."""
    stamp_s: float = 0.0
    """Error of its stamp."""
    forward_m: float = 0.0
    right_m: float = 0.0
    """Shift of all that it shows, along the pad's arrow and to starboard of it."""
    drawn: list[Any] = field(default_factory=list)
    """The faults that are drawn into its image."""
    pad_hidden: bool = False
    """The right pad is painted over."""


class OnSight(Struct):
    """A view of the pad that a detection is drawn from."""

    shown: float
    """Visible share of the pad."""
    focal: float
    """True focal length over that in the camera's file."""
    light_stops: float
