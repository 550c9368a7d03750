"""The settings of the ship: sources and limits of her reports, and the flight to her."""

import math
from typing import Annotated

from msgspec import Struct

from estimator.contracts.keys import CheckedOptions, choice, tuning
from estimator.ship_motion import ShipMotionOptions


class ReportLimits(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Limits for the positions that ship and vehicle report.

    Raises:
        ValueError: a number outside its range, or two that do not go together.
    """

    age_max_s: Annotated[
        float,
        tuning("age beyond which a report is refused, and beyond which the newest one tells no place any more", "s", 0.2, 60.0),
    ] = 5.0
    speed_max_m_s: Annotated[float, tuning("speed that no ship of yours reaches; a faster one is refused", "m/s", 1.0, 50.0)] = (
        20.0
    )
    jump_m: Annotated[
        float,
        tuning(
            "how far a report may lie from the place that was carried on to its time, beyond three of the sigmas; a farther one "
            "is refused",
            "m",
            1.0,
            1000.0,
        ),
    ] = 10.0
    forget_s: Annotated[
        float, tuning("time without a report that fits after which the next one is believed alone", "s", 1.0, 600.0)
    ] = 30.0
    acceleration_m_s2: Annotated[
        float, tuning("acceleration by which the ship may leave the course that carries her place on", "m/s^2", 0.01, 5.0)
    ] = 0.2
    sigma_max_m: Annotated[
        float, tuning("horizontal standard deviation of the place beyond which nobody flies to it", "m", 0.5, 200.0)
    ] = 15.0
    pad_forward_m: Annotated[
        float, tuning("the pad from the point that the ship reports, towards her bow", "m", -400.0, 400.0, public=True)
    ] = 0.0
    pad_right_m: Annotated[float, tuning("the same to starboard", "m", -100.0, 100.0, public=True)] = 0.0
    pad_up_m: Annotated[
        float,
        tuning("the same upward; without a reported height (AIS) the pad's height over the sea", "m", -50.0, 50.0, public=True),
    ] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.forget_s < 2.0 * self.age_max_s:
            raise ValueError(f"forget_s ({self.forget_s:g} s) must be at least twice age_max_s ({self.age_max_s:g} s)")

    @property
    def pad_aside_m(self) -> float:
        """The pad's horizontal distance from the point that the ship reports, metres."""
        return math.hypot(self.pad_forward_m, self.pad_right_m)


class RendezvousOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """The flight to the ship: to a hold-off point, then a search over her pad until the camera sees it.

    It is level or upward: nothing but sight of the pad brings the drone down.

    Raises:
        ValueError: a number outside its range, or two that do not go together.
    """

    enabled: Annotated[
        bool,
        choice(
            "whether the drone flies to the ship's reported place when a landing is ordered without sight", public=True, page=True
        ),
    ] = False
    bearing_deg: Annotated[
        float,
        tuning(
            "direction of the hold-off point from the pad, clockwise from the bow: 180 is behind",
            "deg",
            -180.0,
            180.0,
            public=True,
        ),
    ] = 180.0
    range_m: Annotated[float, tuning("horizontal distance of the hold-off point from the pad", "m", 1.0, 200.0, public=True)] = (
        8.0
    )
    height_m: Annotated[
        float, tuning("height over the pad to which it climbs, and never descends, above masts", "m", 1.0, 100.0, public=True)
    ] = 6.0
    reached_m: Annotated[float, tuning("distance at which it counts as there", "m", 0.5, 50.0)] = 2.0
    speed_m_s: Annotated[float, tuning("largest speed against the ship on the way", "m/s", 0.2, 15.0, public=True)] = 3.0
    time_s: Annotated[float, tuning("longest time on the way; after it the drone gives up", "s", 5.0, 3600.0)] = 180.0
    lost_s: Annotated[
        float, tuning("time without sight and without a usable place of ship or drone after which it refuses", "s", 1.0, 600.0)
    ] = 10.0
    search_speed_m_s: Annotated[float, tuning("speed against the ship along the search pattern", "m/s", 0.1, 5.0)] = 1.0
    spacing_m: Annotated[
        float,
        tuning(
            "distance of the tracks of the expanding square", "m", 0.3, 100.0, "half the width that the camera sees from height_m"
        ),
    ] = 2.5
    extent_m: Annotated[
        float, tuning("distance from the pad's reported place at which the square begins again", "m", 1.0, 500.0)
    ] = 10.0

    ORDER = ("reached_m < range_m", "spacing_m <= extent_m")


class VesselOptions(ReportLimits, Struct, frozen=True, forbid_unknown_fields=True):
    """The ship's own reports of her place, velocity and heading. An autopilot's link has another source: `vehicle.vessel_id`.

    Raises:
        ValueError: a number outside its range.
    """

    mqtt: Annotated[
        bool, choice("whether reports arrive on the topic `vessel`, from whom commands may come (`mqtt.commands`)", public=True)
    ] = False
    motion_sensor: ShipMotionOptions = ShipMotionOptions()

    @property
    def source_keys(self) -> tuple[str, ...]:
        """The keys that name a source of her place if they are set."""
        return ("mqtt",)

    def reported_too_rarely(self, sources: tuple[str, ...]) -> str:
        """Return why reports of these sources alone come more rarely than `age_max_s` lets them; empty if they do not."""
        return ""
