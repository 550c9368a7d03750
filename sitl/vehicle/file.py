"""A vehicle in a file: body, rotors, inner loops, feet and limits.

vehicle = load(path)               # of a shipped one: configs/vehicles/ardrone2.toml
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from companion.settings.load import read_toml
from companion.settings.refusal import explain
from estimator.contracts.errors import BadInput
from estimator.contracts.keys import choice, number, text
from sitl.vehicle.airframe import Airframe, Feet, Loops, StickLimits

_Three = tuple[float, float, float]


class LoopSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The inner loops that differ between vehicles; the rest are `sitl.vehicle.airframe.Loops`."""

    tilt_p: Annotated[float, number("square of the tilt response's natural frequency", "1/s^2", 1.0, 1000.0)]
    tilt_d: Annotated[float, number("twice the damping ratio times that frequency", "1/s", 0.5, 100.0)]
    tilt_max_deg: Annotated[float, number("largest tilt that any loop commands", "deg", 5.0, 60.0)]
    yaw_rate_p: Annotated[float, number("gain of the yaw rate", "1/s", 0.1, 20.0)] = 2.0


class FeetSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Four elastic feet."""

    half_base_m: Annotated[float, number("distance of each foot ahead or astern of the middle, and to its side", "m", 0.02, 2.0)]
    below_m: Annotated[float, number("distance of the feet below the body's origin", "m", 0.01, 1.0)]
    top_m: Annotated[float, number("height of the hull's top over the body's origin", "m", 0.01, 1.0)]
    stiffness_n_m: Annotated[float, number("stiffness of all four feet together", "N/m", 100.0, 200000.0)]
    friction: Annotated[float, number("Coulomb's coefficient of friction", "1", 0.05, 2.0)] = 0.6


class LimitSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """What a full stick asks for until the configuration says otherwise."""

    euler_angle_max_deg: Annotated[float, number("largest tilt", "deg", 1.0, 45.0)]
    vz_max_m_s: Annotated[float, number("largest climb and descent rate", "m/s", 0.1, 5.0)]
    yaw_rate_max_deg_s: Annotated[float, number("largest rate of turn", "deg/s", 5.0, 400.0)]


class VehicleFile(Struct, frozen=True, forbid_unknown_fields=True):
    """A vehicle."""

    title: Annotated[str, text("one line for people", 120)]
    source: Annotated[str, text("where the figures come from, and which are assumed", 2000)]
    mass_kg: Annotated[float, number("mass ready to fly", "kg", 0.1, 30.0)]
    inertia_kg_m2: Annotated[_Three, Meta(description="principal moments about x, y, z")]
    layout: Annotated[Literal["quad_x", "hexa_x"], choice("four rotors in an X, or six with two of them at the sides")]
    arm_m: Annotated[
        float, number("position of a rotor: for a quad ahead and aside, for a hexa its distance from the middle", "m", 0.03, 2.0)
    ]
    rotor_radius_m: Annotated[float, number("radius of one rotor", "m", 0.02, 0.6)]
    rotors_above_m: Annotated[float, number("height of the rotor plane over the body's origin", "m", 0.0, 0.5)]
    yaw_torque_per_thrust_m: Annotated[float, number("drag torque of a rotor over its thrust", "m", 0.001, 0.2)]
    thrust_max_n: Annotated[float, number("largest thrust of all rotors together", "N", 1.0, 1000.0)]
    torque_max_n_m: Annotated[_Three, Meta(description="that the loops may ask for, about x, y, z")]
    motor_lag_s: Annotated[float, number("first-order lag of thrust and torque", "s", 0.0, 0.5)]
    command_delay_s: Annotated[float, number("delay from the arrival of a stick command to its effect", "s", 0.0, 0.5)]
    drag_per_s: Annotated[_Three, Meta(description="1/s, deceleration per m/s of airspeed along the body's axes")]
    loops: LoopSettings
    feet: FeetSettings
    limits: LimitSettings
    ground_effect: Annotated[
        Literal["body", "rotors"],
        choice("ground effect by the surface under the body's middle, or by that under each rotor, as at the deck's edge"),
    ] = "rotors"
    landing_speed_m_s: Annotated[float, number("descent rate of the vehicle's own landing", "m/s", 0.1, 1.5)] = 0.4
    response: Annotated[
        str,
        text("shipped response that a flight without a settings file is flown by; auto takes that of the kind of vehicle", 60),
    ] = "auto"

    def __post_init__(self) -> None:
        if min(self.inertia_kg_m2) <= 0 or min(self.torque_max_n_m) <= 0 or min(self.drag_per_s) < 0:
            raise ValueError("inertia_kg_m2 and torque_max_n_m must be positive, drag_per_s 0 or more")
        if self.thrust_max_n < 1.2 * 9.80665 * self.mass_kg:
            raise ValueError(
                f"thrust_max_n is {self.thrust_max_n:g} N: it must be 1.2 times the weight or more, or it cannot climb"
            )
        x, y, z = self.inertia_kg_m2
        if x + y < z or y + z < x or z + x < y:
            raise ValueError("inertia_kg_m2: no body has one moment larger than the sum of the two others")

    def airframe(self) -> Airframe:
        """Return the figures as the physics takes them."""
        loops = Loops(
            tilt_p=self.loops.tilt_p,
            tilt_d=self.loops.tilt_d,
            tilt_max_rad=math.radians(self.loops.tilt_max_deg),
            yaw_rate_p=self.loops.yaw_rate_p,
        )
        feet = Feet(
            half_base_m=self.feet.half_base_m,
            below_m=self.feet.below_m,
            top_m=self.feet.top_m,
            stiffness_n_m=self.feet.stiffness_n_m,
            friction=self.feet.friction,
        )
        return Airframe(
            mass_kg=self.mass_kg,
            inertia_kg_m2=self.inertia_kg_m2,
            thrust_max_n=self.thrust_max_n,
            torque_max_n_m=self.torque_max_n_m,
            motor_lag_s=self.motor_lag_s,
            command_delay_s=self.command_delay_s,
            layout=self.layout,
            arm_m=self.arm_m,
            rotor_radius_m=self.rotor_radius_m,
            ground_effect=self.ground_effect,
            rotors_above_m=self.rotors_above_m,
            yaw_torque_per_thrust_m=self.yaw_torque_per_thrust_m,
            drag_per_s=self.drag_per_s,
            landing_speed_m_s=self.landing_speed_m_s,
            loops=loops,
            feet=feet,
        )

    def stick_limits(self) -> StickLimits:
        """Return what a full stick asks for."""
        v = self.limits
        return StickLimits(math.radians(v.euler_angle_max_deg), v.vz_max_m_s, math.radians(v.yaw_rate_max_deg_s))


def load(path: Path) -> VehicleFile:
    """Return the vehicle in a file.

    Raises:
        BadInput: the file cannot be read, or a key is unknown, missing, wrong or contradicts another: one line with file and key.
    """
    data = read_toml(path)
    try:
        return msgspec.convert(data, VehicleFile, strict=True)
    except msgspec.ValidationError as why:
        raise BadInput(f"{path}: {explain(VehicleFile, data, str(why))}") from why
