"""The unkind effects on a vehicle that a scenario's table `[effects]` switches on, each with its source; all are off by default.

The formulae are the core's, `sitl/core/physics`; docs/sitl.md compares them with published figures.
"""

from typing import Annotated

from msgspec import Meta, Struct

from estimator.contracts.keys import number


class EffectSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Effects that a vehicle's file does not hold."""

    rotor_saturation: Annotated[
        bool, Meta(description="whether no rotor gives more than its part of the largest thrust, or less than none")
    ] = False
    battery_sag: Annotated[
        float,
        number(
            "share of its voltage that the battery loses at full thrust", "1", 0.0, 0.4, "3S, 1 Ah, 60 to 100 mOhm: 0.14 to 0.2"
        ),
    ] = 0.0
    drag_per_m: Annotated[
        float, number("quadratic drag: deceleration by the square of the airspeed", "1/m", 0.0, 0.1, "frontal area of 0.015 m^2")
    ] = 0.0
    downwash_m_s2: Annotated[
        float,
        number(
            "turbulence of the own downwash below 0.6 m over the deck, standard deviation aside", "m/s^2", 0.0, 3.0, "0.5 to 1"
        ),
    ] = 0.0
    moving_deck: Annotated[
        bool, Meta(description="whether the ground effect lags and a deck that comes closer pushes, instead of by height alone")
    ] = False
    vibration_m_s2: Annotated[
        float, number("amplitude of the rotors' vibration in the accelerometer, sampled without a filter", "m/s^2", 0.0, 30.0)
    ] = 0.0
    loop_climb_sigma_m_s: Annotated[
        float, number("standard deviation of the wandering error of the climb rate by which the loops fly", "m/s", 0.0, 1.0)
    ] = 0.0
    loop_rate_sigma_deg_s: Annotated[
        float,
        number("standard deviation of the turn rates by which the loops fly, each step", "deg/s", 0.0, 20.0, "AR.Drone: 1.9"),
    ] = 0.0
    unknown_mass_kg: Annotated[float, number("mass that the loops do not know of", "kg", -5.0, 10.0)] = 0.0
    thing_height_m: Annotated[float, number("height of a thing that lies on the pad; 0 for none", "m", 0.0, 0.2)] = 0.0
    thing_radius_m: Annotated[float, number("its radius", "m", 0.01, 1.0)] = 0.05
    thing_forward_m: Annotated[float, number("its place along the arrow from the centre", "m", -5.0, 5.0)] = 0.0
    thing_right_m: Annotated[float, number("its place to starboard of the arrow", "m", -5.0, 5.0)] = 0.0
    video_least_s: Annotated[
        float,
        number(
            "least delay of a frame, which wanders up to the most; 90 ms for all if both are 0",
            "s",
            0.0,
            1.0,
        ),
    ] = 0.0
    video_most_s: Annotated[float, number("most delay of a frame", "s", 0.0, 1.0, "AR.Drone 2.0: 0.06 to 0.15")] = 0.0

    def __post_init__(self) -> None:
        if self.video_most_s < self.video_least_s:
            raise ValueError("video_most_s must not be less than video_least_s")
