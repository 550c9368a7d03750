"""Allocation of thrust and torque, weak rotors, ground effect."""

from __future__ import annotations

import math
from functools import cache

from sitl.vehicle.airframe import Airframe
from sitl.vehicle.rotors import Layout, rotors, rotors_of
from sitl.vessel.contact import DeckShape
from tests.sitl.oracle.algebra import Vec, clip, rotate, where
from tests.sitl.oracle.contact import Relative, coverage

Thrusts = tuple[float, ...]
"""One value for each rotor, in the order of `rotors`."""


@cache
def _squares(layout: Layout) -> tuple[float, float]:
    """Return the sums of the squared places ahead and aside, in arms."""
    each = rotors_of(layout)
    return sum(r.forward**2 for r in each), sum(r.right**2 for r in each)


def thrusts(airframe: Airframe, thrust_n: float, torque_n_m: Vec) -> Thrusts:
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


def delivered(airframe: Airframe, thrust_n: float, torque_n_m: Vec, shares: tuple[float, ...]) -> tuple[float, Vec]:
    """Return the thrust and torque that result when each rotor gives only its share of the requested thrust.

    No rotor is driven harder than to its part of `thrust_max_n`, and none pushes downwards.
    """
    f = airframe
    most = f.thrust_max_n / len(shares)
    given = tuple(h * clip(n, 0.0, most) for h, n in zip(shares, thrusts(f, thrust_n, torque_n_m), strict=True))
    if f.layout == "quad_x":
        a, b, c, d = given
        return a + b + c + d, (f.arm_m * (a - b - c + d), f.arm_m * (a + b - c - d), f.yaw_torque_per_thrust_m * (a - b + c - d))
    lift: float = 0.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    for rotor, t in zip(rotors(f), given, strict=True):
        lift, x, y, z = lift + t, x - rotor.right * t, y + rotor.forward * t, z + rotor.spin * t
    return lift, (f.arm_m * x, f.arm_m * y, f.yaw_torque_per_thrust_m * z)


def ground_effect(airframe: Airframe, height_m: float) -> float:
    """Return the factor of the ground effect on thrust when the body's origin is `height_m` over a surface.

    Source: Cheeseman & Bennett, The effect of the ground on a helicopter rotor in forward flight, ARC R&M 3021, 1955:
    T/T_free = 1 / (1 - (R/4z)^2); R is the radius of one disc with the area of all rotors. It overstates close to the ground:
    below z = 0.7 R the gain is held at 15 % (assumed).
    """
    radius = math.sqrt(len(rotors(airframe))) * airframe.rotor_radius_m
    ratio = 0.25 * radius / clip(height_m + airframe.rotors_above_m, 0.7 * radius, 1e9)
    return 1.0 / (1.0 - ratio * ratio)


def ground_effect_by_rotor(airframe: Airframe, shape: DeckShape, r: Relative, over_water_m: float) -> Thrusts:
    """Return the factor for each rotor by itself: the part of its disc over the deck feels the deck, the rest the water.

    So a vehicle that comes in over the deck's edge is lifted and tilted by degrees. The weighting by area is assumed.

    Args:
        r: the body relative to the deck.
        over_water_m: height of the body's origin over the water.
    """
    f = airframe
    water = ground_effect(f, over_water_m)
    out: list[float] = []
    for rotor in rotors(f):
        arm = rotate(r.R, (f.arm_m * rotor.forward, f.arm_m * rotor.right, 0.0))
        height = -(r.d[2] + arm[2])
        share = where(height > -f.rotors_above_m, coverage(shape, r.d[0] + arm[0], r.d[1] + arm[1], f.rotor_radius_m), 0.0)
        out.append(water + share * (ground_effect(f, height) - water))
    return tuple(out)
