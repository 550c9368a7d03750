"""The rotors: where they are, the allocation of thrust and torque, the loss by a weak one, and the ground effect."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Literal

from sitl.airframe import Airframe
from sitl.algebra import MathBackend, Num, Vec, rotate
from sitl.contact import DeckShape, Relative

Thrusts = tuple[Num, ...]
"""One value for each rotor, in the order of `rotors`."""
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


@cache
def _squares(layout: str) -> tuple[float, float]:
    """Return the sums of the squared places ahead and aside, in arms."""
    each = _LAYOUTS[layout]
    return sum(r.forward**2 for r in each), sum(r.right**2 for r in each)


def thrusts(airframe: Airframe, thrust_n: Num, torque_n_m: Vec) -> Thrusts:
    """Return the thrust of each rotor, N; together they give this thrust and torque, with the least sum of squares."""
    f = airframe
    x, y, z = torque_n_m
    if f.layout == "quad_x":
        t = 0.25 * thrust_n
        x, y, z = x / (4.0 * f.arm_m), y / (4.0 * f.arm_m), z / (4.0 * f.yaw_torque_per_thrust_m)
        return (t + x + y + z, t - x + y - z, t - x - y + z, t + x - y - z)
    each, (ahead, aside) = rotors(f), _squares(f.layout)
    n = len(each)
    t = thrust_n / n
    x, y, z = x / (aside * f.arm_m), y / (ahead * f.arm_m), z / (n * f.yaw_torque_per_thrust_m)
    return tuple(t - r.right * x + r.forward * y + r.spin * z for r in each)


def delivered(m: MathBackend, airframe: Airframe, thrust_n: Num, torque_n_m: Vec, shares: tuple[Num, ...]) -> tuple[Num, Vec]:
    """Return the thrust and torque that result when each rotor gives only its share of the requested thrust.

    No rotor is driven harder than to its part of `thrust_max_n`, and none pushes downwards.
    """
    f = airframe
    most = f.thrust_max_n / len(shares)
    given = tuple(h * m.clip(n, 0.0, most) for h, n in zip(shares, thrusts(f, thrust_n, torque_n_m), strict=True))
    if f.layout == "quad_x":
        a, b, c, d = given
        return a + b + c + d, (f.arm_m * (a - b - c + d), f.arm_m * (a + b - c - d), f.yaw_torque_per_thrust_m * (a - b + c - d))
    lift: Num = 0.0
    x: Num = 0.0
    y: Num = 0.0
    z: Num = 0.0
    for rotor, t in zip(rotors(f), given, strict=True):
        lift, x, y, z = lift + t, x - rotor.right * t, y + rotor.forward * t, z + rotor.spin * t
    return lift, (f.arm_m * x, f.arm_m * y, f.yaw_torque_per_thrust_m * z)


def ground_effect(m: MathBackend, airframe: Airframe, height_m: Num) -> Num:
    """Return the factor of the ground effect on thrust when the body's origin is `height_m` over a surface.

    Source: Cheeseman & Bennett, The effect of the ground on a helicopter rotor in forward flight, ARC R&M 3021, 1955:
    T/T_free = 1 / (1 - (R/4z)^2); R is the radius of one disc with the area of all rotors. It overstates close to the ground:
    below z = 0.7 R the gain is held at 15 % (assumed).
    """
    radius = math.sqrt(len(rotors(airframe))) * airframe.rotor_radius_m
    ratio = 0.25 * radius / m.clip(height_m + airframe.rotors_above_m, 0.7 * radius, 1e9)
    return 1.0 / (1.0 - ratio * ratio)


def ground_effect_by_rotor(m: MathBackend, airframe: Airframe, shape: DeckShape, r: Relative, over_water_m: Num) -> Thrusts:
    """Return the factor for each rotor by itself: the part of its disc over the deck feels the deck, the rest the water.

    So a vehicle that comes in over the deck's edge is lifted and tilted by degrees. The weighting by area is assumed.

    Args:
        r: the body relative to the deck.
        over_water_m: height of the body's origin over the water.
    """
    f = airframe
    water = ground_effect(m, f, over_water_m)
    out: list[Num] = []
    for rotor in rotors(f):
        arm = rotate(r.R, (f.arm_m * rotor.forward, f.arm_m * rotor.right, 0.0))
        height = -(r.d[2] + arm[2])
        share = m.where(height > -f.rotors_above_m, shape.coverage(m, r.d[0] + arm[0], r.d[1] + arm[1], f.rotor_radius_m), 0.0)
        out.append(water + share * (ground_effect(m, f, height) - water))
    return tuple(out)
