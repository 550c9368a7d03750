"""Limits of what is possible. The defaults hold for a quadcopter of a few kilograms and 30 frames a second."""

from __future__ import annotations

import math
from typing import Annotated

from msgspec import Struct

from estimator.contracts.keys import check_ranges, number


class IntegrityOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits that an input must keep; any other input is refused, counted and logged.

    Raises:
        ValueError: a number outside its range.
    """

    specific_force_max_m_s2: Annotated[
        float, number("an accelerometer that reads more is not believed", "m/s^2", 15.0, 1000.0, "8 g")
    ] = 80.0
    turn_rate_max_deg_s: Annotated[
        float, number("a gyro that reads more is not believed", "deg/s", 100.0, 10_000.0, "range of a common part")
    ] = 2000.0
    speed_max_m_s: Annotated[
        float, number("a velocity of the vehicle or vessel above this is not believed", "m/s", 1.0, 100.0)
    ] = 20.0
    acceleration_max_m_s2: Annotated[
        float, number("largest change of velocity between two samples, over the time between them", "m/s^2", 1.0, 1000.0)
    ] = 30.0
    velocity_step_m_s: Annotated[
        float, number("step of velocity that is allowed in addition, for the sensor's own noise", "m/s", 0.01, 100.0)
    ] = 1.5
    tilt_rate_max_rad_s: Annotated[float, number("largest rate of roll and pitch between two samples", "rad/s", 0.1, 100.0)] = 8.0
    tilt_step_rad: Annotated[float, number("step of roll and pitch that is allowed in addition", "rad", 0.001, math.pi)] = (
        math.radians(20.0)
    )
    height_rate_max_m_s: Annotated[
        float, number("largest rate of height between two samples of the barometer", "m/s", 0.1, 1000.0)
    ] = 20.0
    height_step_m: Annotated[
        float, number("step of a barometer's height that is allowed in addition, for a gust on its port", "m", 0.01, 1000.0)
    ] = 5.0
    spike_s: Annotated[
        float, number("a step that is still there after this long is no spike, and is let through", "s", 0.01, 60.0)
    ] = 0.5

    imu_frozen_s: Annotated[
        float, number("an IMU that repeats itself to the bit for longer is refused", "s", 0.02, 10.0, "5 ms on a real AR.Drone")
    ] = 0.15
    attitude_frozen_s: Annotated[
        float, number("an attitude that repeats itself to the bit for longer is refused", "s", 0.02, 60.0)
    ] = 0.25
    velocity_frozen_s: Annotated[
        float, number("a velocity in flight that repeats itself to the bit for longer is refused", "s", 0.02, 10.0)
    ] = 0.5
    range_frozen_s: Annotated[
        float,
        number("a range that repeats itself to the bit for longer is refused", "s", 0.02, 60.0, "0.12 s on a real AR.Drone"),
    ] = 2.0
    baro_frozen_s: Annotated[
        float, number("a barometer that repeats itself to the bit for longer is refused", "s", 0.02, 60.0)
    ] = 2.0

    clock_step_max_s: Annotated[
        float, number("an arrival this far from all others' is refused until others confirm it", "s", 0.02, 60.0)
    ] = 1.0
    sample_delay_step_max_s: Annotated[
        float, number("how far a sample's delay (arrival less measurement) may lie from its stream's median", "s", 0.005, 60.0)
    ] = 0.5
    delay_step_max_s: Annotated[
        float,
        number("frames whose delay leaves its own median by more are refused until it has stayed there", "s", 0.02, 2.0),
    ] = 0.15
    sample_delay_settle_s: Annotated[
        float, number("a sample's delay that stays elsewhere for this long is the stream's new one", "s", 0.01, 600.0)
    ] = 1.0
    delay_settle_s: Annotated[
        float, number("a frame's delay that stays elsewhere for this long is the new one", "s", 0.01, 600.0)
    ] = 10.0

    view_turned_min_rad: Annotated[
        float,
        number(
            "how far the body has to turn (one standard deviation within half a second) before a pad that keeps its place in "
            "the image counts as frozen",
            "rad",
            1e-4,
            1.0,
        ),
    ] = 0.01
    view_still_ratio: Annotated[
        float, number("it does when its bearing moves less than this share of what the turning alone makes", "1", 0.001, 1.0)
    ] = 0.1

    place_step_m: Annotated[
        float,
        number("how far a sighting may lie from where the pad is expected, besides the uncertainty of both", "m", 0.001, 100.0),
    ] = 0.06
    place_step_share: Annotated[
        float,
        number("and by this share of the height in addition", "1", 0.001, 10.0, "three degrees of attitude error"),
    ] = 0.05
    adopt_s: Annotated[
        float, number("for how long a single other place must be seen, and the pad not, to become the pad", "s", 0.5, 60.0)
    ] = 2.0

    range_tolerance_m: Annotated[float, number("range sensor and camera may differ by this over the pad", "m", 0.01, 100.0)] = (
        0.08
    )
    range_tolerance_share: Annotated[float, number("and by this share of the height besides", "1", 0.001, 1.0)] = 0.08
    range_doubt_s: Annotated[float, number("for how long they must differ for the descent to end", "s", 0.1, 60.0)] = 1.0
    deck_radius_m: Annotated[
        float,
        number("radius of the deck around the pad's centre; beyond it a range says nothing of the pad", "m", 0.05, 100.0),
    ] = 0.6
    height_tolerance_m: Annotated[
        float,
        number(
            "by how much barometer and camera may differ about the change of height over ten seconds, besides a third of it",
            "m",
            0.01,
            100.0,
        ),
    ] = 2.5

    @property
    def turn_rate_max_rad_s(self) -> float:
        """The limit of the gyro, rad/s."""
        return math.radians(self.turn_rate_max_deg_s)

    def __post_init__(self) -> None:
        check_ranges(self)
