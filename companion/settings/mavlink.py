"""The options of this program's MAVLink output: the tables [landing_target] and [bridge] of the settings file."""

from typing import Annotated, Literal

from msgspec import Struct

from drivers.mavlink.options import MavlinkOptions
from estimator.contracts.keys import check_ranges, choice, number


class OutputOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """The pad in messages to an autopilot: LANDING_TARGET, TARGET_RELATIVE and DISTANCE_SENSOR (docs/mavlink.md).

    Raises:
        ValueError: a number is outside its range.
    """

    rate_hz: Annotated[
        float, number("LANDING_TARGET messages a second, at least", "Hz", 1.0, 50.0, "10 to 50 suit ArduPilot", public=True)
    ] = 25.0
    receiver_s: Annotated[
        float,
        number("time from a message's arrival until the autopilot uses it", "s", 0.0, 0.2, "half a period of ArduPilot's 400 Hz"),
    ] = 0.00125
    vision_target_estimator: Annotated[
        bool, choice("whether PX4 runs its vision target estimator, which needs TARGET_RELATIVE too", public=True)
    ] = False
    ranges: Annotated[
        Literal["auto", "on", "off"],
        choice(
            "whether to send DISTANCE_SENSOR; auto: if an ArduPilot's parameters say that its rangefinder is a MAVLink one",
            public=True,
        ),
    ] = "auto"
    range_rate_hz: Annotated[float, number("DISTANCE_SENSOR messages a second", "Hz", 1.0, 50.0)] = 20.0
    range_id: Annotated[int, number("id of the sensor in DISTANCE_SENSOR", "id", 0, 255)] = 0
    ground_clearance_m: Annotated[
        float,
        number("reading of a rangefinder while the vehicle is on the ground; ArduPilot does not arm without it", "m", 0.02, 2.0),
    ] = 0.1

    def __post_init__(self) -> None:
        check_ranges(self)


class BridgeOptions(MavlinkOptions, frozen=True, forbid_unknown_fields=True):
    """An AR.Drone as a MAVLink quadrotor for ground stations, which can watch it, arm it, take off, hold and land.

    Raises:
        ValueError: as for `MavlinkOptions`.
    """

    system_id: Annotated[int, number("system id under which the drone appears", "id", 1, 255, public=True)] = 1
