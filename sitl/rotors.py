"""Four rotors in an X: the allocation of thrust and torque, the loss by a weak rotor, and the ground effect."""

from __future__ import annotations

from sitl.airframe import Airframe
from sitl.algebra import MathBackend, Num, Vec

Four = tuple[Num, Num, Num, Num]
"""One value each for the front left, front right, rear right and rear left rotor."""
HEALTHY = (1.0, 1.0, 1.0, 1.0)


def thrusts(airframe: Airframe, thrust_n: Num, torque_n_m: Vec) -> Four:
    """Return the thrust of each rotor, N; together they give this thrust and torque."""
    f = airframe
    t = 0.25 * thrust_n
    x, y, z = torque_n_m
    x, y, z = x / (4.0 * f.arm_m), y / (4.0 * f.arm_m), z / (4.0 * f.yaw_torque_per_thrust_m)
    return (t + x + y + z, t - x + y - z, t - x - y + z, t + x - y - z)


def delivered(airframe: Airframe, thrust_n: Num, torque_n_m: Vec, health: tuple[float, float, float, float]) -> tuple[Num, Vec]:
    """Return the thrust and torque that remain when each rotor gives only its share `health` of the requested thrust."""
    f = airframe
    a, b, c, d = (h * n for h, n in zip(health, thrusts(f, thrust_n, torque_n_m), strict=True))
    return a + b + c + d, (f.arm_m * (a - b - c + d), f.arm_m * (a + b - c - d), f.yaw_torque_per_thrust_m * (a - b + c - d))


def ground_effect(m: MathBackend, airframe: Airframe, height_m: Num) -> Num:
    """Return the factor of the ground effect on thrust when the body's origin is `height_m` over a surface.

    Source: Cheeseman & Bennett, The effect of the ground on a helicopter rotor in forward flight, ARC R&M 3021, 1955:
    T/T_free = 1 / (1 - (R/4z)^2); R is the radius of one disc with the four rotors' area. It overstates close to the ground:
    below z = 0.7 R the gain is held at 15 % (assumed).
    """
    radius = 2.0 * airframe.rotor_radius_m
    ratio = 0.25 * radius / m.clip(height_m + airframe.rotors_above_m, 0.7 * radius, 1e9)
    return 1.0 / (1.0 - ratio * ratio)
