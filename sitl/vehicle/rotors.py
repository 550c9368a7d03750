"""The rotors: where they are and which way they turn."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from sitl.vehicle.airframe import Airframe

Layout = Literal["quad_x", "hexa_x"]


@dataclass(frozen=True, slots=True)
class Rotor:
    """One rotor: its axis, in arms of the airframe, and the torque that its drag puts on the body."""

    name: str
    forward: float
    right: float
    spin: float
    """1 pushes the nose clockwise seen from above, -1 the other way."""


def _on_circle(name: str, angle_deg: float, spin: float) -> Rotor:
    return Rotor(name, math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg)), spin)


_LAYOUTS: dict[str, tuple[Rotor, ...]] = {
    "quad_x": (
        Rotor("front_left", 1.0, -1.0, 1.0),
        Rotor("front_right", 1.0, 1.0, -1.0),
        Rotor("rear_right", -1.0, 1.0, 1.0),
        Rotor("rear_left", -1.0, -1.0, -1.0),
    ),
    "hexa_x": (
        _on_circle("front_left", -30.0, 1.0),
        _on_circle("front_right", 30.0, -1.0),
        _on_circle("right", 90.0, 1.0),
        _on_circle("rear_right", 150.0, -1.0),
        _on_circle("rear_left", 210.0, 1.0),
        _on_circle("left", 270.0, -1.0),
    ),
}
"""Clockwise from the front left. The arm of a quad X is measured ahead and aside, that of a hexacopter from the middle."""


def rotors(airframe: Airframe) -> tuple[Rotor, ...]:
    """Return the rotors of an airframe."""
    return rotors_of(airframe.layout)


def rotors_of(layout: Layout) -> tuple[Rotor, ...]:
    """Return the rotors of a layout."""
    return _LAYOUTS[layout]
