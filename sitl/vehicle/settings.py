"""The table `[vehicle]` of a scenario: which vehicle, and what is changed about it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Literal

from msgspec import Struct

from estimator.contracts.keys import choice, number, text
from sitl.vehicle.airframe import Airframe, StickLimits
from sitl.vehicle.file import VehicleFile

_UNLESS = "; the vehicle's own unless said"


class VehicleSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The vehicle, and what may be changed about it."""

    file: Annotated[str, text("a shipped vehicle (configs/vehicles), or a path relative to the scenario file", 200)] = "ardrone2"
    generation: Annotated[
        Literal["1.0", "2.0"],
        choice("generation of the AR.Drone whose protocol it speaks; a 1.0 films 176x144 px, with the camera ardrone1_bottom"),
    ] = "2.0"
    mass_kg: Annotated[float, number("mass; the inertia is in proportion" + _UNLESS, "kg", 0.2, 30.0)] | None = None
    command_delay_s: (
        Annotated[float, number("delay from the arrival of a stick command to its effect" + _UNLESS, "s", 0.0, 0.5)] | None
    ) = None
    motor_lag_s: Annotated[float, number("time constant of rotor thrust" + _UNLESS, "s", 0.0, 0.5)] | None = None
    landing_speed_m_s: Annotated[float, number("descent rate of its own landing" + _UNLESS, "m/s", 0.1, 1.5)] | None = None
    gnss_hz: Annotated[
        float, number("places a second of a GNSS receiver on it, the AR.Drone's flight recorder; 0 without one", "Hz", 0.0, 20.0)
    ] = 0.0
    ground_effect: (
        Annotated[
            Literal["body", "rotors"],
            choice(
                "ground effect by the surface under the body's middle, or by that under each rotor, as at the deck's edge"
                + _UNLESS
            ),
        ]
        | None
    ) = None
    euler_angle_max_deg: (
        Annotated[float, number("limit at full stick, until the configuration changes it" + _UNLESS, "deg", 1.0, 28.0)] | None
    ) = None
    vz_max_m_s: (
        Annotated[float, number("limit at full stick, until the configuration changes it" + _UNLESS, "m/s", 0.1, 2.0)] | None
    ) = None
    yaw_rate_max_deg_s: (
        Annotated[float, number("limit at full stick, until the configuration changes it" + _UNLESS, "deg/s", 10.0, 350.0)] | None
    ) = None

    def airframe(self, vehicle: VehicleFile) -> Airframe:
        """Return a vehicle's figures with these changes."""
        base = vehicle.airframe()
        mass = base.mass_kg if self.mass_kg is None else self.mass_kg
        k = mass / base.mass_kg
        ix, iy, iz = base.inertia_kg_m2
        return replace(
            base,
            mass_kg=mass,
            inertia_kg_m2=(k * ix, k * iy, k * iz),
            command_delay_s=base.command_delay_s if self.command_delay_s is None else self.command_delay_s,
            motor_lag_s=base.motor_lag_s if self.motor_lag_s is None else self.motor_lag_s,
            landing_speed_m_s=base.landing_speed_m_s if self.landing_speed_m_s is None else self.landing_speed_m_s,
            ground_effect=base.ground_effect if self.ground_effect is None else self.ground_effect,
        )

    def stick_limits(self, vehicle: VehicleFile) -> StickLimits:
        """Return what a full stick of a vehicle asks for at first, with these changes."""
        limits = vehicle.stick_limits()
        if self.euler_angle_max_deg is not None:
            limits.euler_angle_max_rad = math.radians(self.euler_angle_max_deg)
        if self.vz_max_m_s is not None:
            limits.vz_max_m_s = self.vz_max_m_s
        if self.yaw_rate_max_deg_s is not None:
            limits.yaw_rate_max_rad_s = math.radians(self.yaw_rate_max_deg_s)
        return limits
