"""Limits for plausible inputs. The defaults suit a quadcopter of a few kilograms and 30 frames a second."""

import math
from typing import Annotated

from msgspec import Struct

from estimator.contracts.keys import check_ranges, tuning


class IntegrityOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits that an input must keep; any other input is refused, counted and logged.

    Raises:
        ValueError: a number is outside its range.
    """

    specific_force_max_m_s2: Annotated[
        float, tuning("largest plausible reading of an accelerometer; a larger one is refused", "m/s^2", 15.0, 1000.0, "8 g")
    ] = 80.0
    turn_rate_max_deg_s: Annotated[
        float,
        tuning(
            "largest plausible reading of a gyro; a larger one is refused", "deg/s", 100.0, 10_000.0, "range of a common part"
        ),
    ] = 2000.0
    speed_max_m_s: Annotated[
        float, tuning("largest plausible speed of the vehicle or vessel; a larger one is refused", "m/s", 1.0, 100.0)
    ] = 20.0
    acceleration_max_m_s2: Annotated[float, tuning("largest acceleration between two velocity samples", "m/s^2", 1.0, 1000.0)] = (
        30.0
    )
    velocity_step_m_s: Annotated[
        float, tuning("step of velocity that is allowed in addition, for the sensor's noise", "m/s", 0.01, 100.0)
    ] = 1.5
    tilt_rate_max_rad_s: Annotated[float, tuning("largest rate of roll and pitch between two samples", "rad/s", 0.1, 100.0)] = 8.0
    tilt_step_rad: Annotated[float, tuning("step of roll and pitch that is allowed in addition", "rad", 0.001, math.pi)] = (
        math.radians(20.0)
    )
    height_rate_max_m_s: Annotated[
        float, tuning("largest rate of height between two samples of the barometer", "m/s", 0.1, 1000.0)
    ] = 20.0
    height_step_m: Annotated[
        float, tuning("step of a barometer's height that is allowed in addition, for a gust at its port", "m", 0.01, 1000.0)
    ] = 5.0
    spike_s: Annotated[
        float, tuning("time after which a step that persists is accepted, because it is not a spike", "s", 0.01, 60.0)
    ] = 0.5

    heading_tolerance_deg: Annotated[
        float,
        tuning(
            "difference between the reported heading and the one that the gyro holds above which the latter is taken",
            "deg",
            0.5,
            180.0,
        ),
    ] = 6.0
    heading_slip_deg_s: Annotated[
        float,
        tuning(
            "rate at which the gyro's heading follows the reported one, a quarter of it beyond the tolerance: more than the "
            "gyro's bias, less than a compass beside steel",
            "deg/s",
            0.0,
            360.0,
        ),
    ] = 2.0

    imu_frozen_s: Annotated[
        float, tuning("time after which an IMU that repeats the same bits is refused", "s", 0.02, 10.0, "5 ms on a real AR.Drone")
    ] = 0.15
    attitude_frozen_s: Annotated[
        float, tuning("time after which an attitude that repeats the same bits is refused", "s", 0.02, 60.0)
    ] = 0.25
    velocity_frozen_s: Annotated[
        float, tuning("time after which a velocity that repeats the same bits in flight is refused", "s", 0.02, 10.0)
    ] = 0.5
    range_frozen_s: Annotated[
        float,
        tuning("time after which a range that repeats the same bits is refused", "s", 0.02, 60.0, "0.12 s on a real AR.Drone"),
    ] = 2.0
    baro_frozen_s: Annotated[
        float, tuning("time after which a barometer that repeats the same bits is refused", "s", 0.02, 60.0)
    ] = 2.0

    clock_step_max_s: Annotated[
        float,
        tuning(
            "difference of a time of reception from all others above which it is refused until others confirm it", "s", 0.02, 60.0
        ),
    ] = 1.0
    sample_delay_step_max_s: Annotated[
        float,
        tuning("largest difference of a sample's delay (reception minus measurement) from its stream's median", "s", 0.005, 60.0),
    ] = 0.5
    delay_step_max_s: Annotated[
        float,
        tuning(
            "largest difference of a frame's delay from its median; frames beyond are refused until the delay has settled",
            "s",
            0.02,
            2.0,
        ),
    ] = 0.15
    sample_delay_settle_s: Annotated[
        float, tuning("time after which a changed delay of samples is accepted as the stream's new delay", "s", 0.01, 600.0)
    ] = 1.0
    delay_settle_s: Annotated[
        float,
        tuning(
            "time after which a changed delay of frames is the new delay: on the ground, or where the one before held for "
            "less than delay_keep_s",
            "s",
            0.01,
            600.0,
        ),
    ] = 10.0
    delay_keep_s: Annotated[
        float, tuning("time after which the frames' delay gives way to no other before the vehicle stands", "s", 0.1, 600.0)
    ] = 3.0

    view_turned_min_rad: Annotated[
        float,
        tuning(
            "least rotation of the body, one standard deviation within half a second; beyond it, a pad that keeps its position "
            "in the image counts as frozen",
            "rad",
            1e-4,
            1.0,
        ),
    ] = 0.01
    view_still_ratio: Annotated[
        float,
        tuning(
            "the pad counts as frozen if its bearing moves by less than this fraction of the body's rotation", "1", 0.001, 1.0
        ),
    ] = 0.1

    place_step_m: Annotated[
        float,
        tuning(
            "largest distance of a sighting from the pad's expected position, in addition to the uncertainty of both",
            "m",
            0.001,
            100.0,
        ),
    ] = 0.06
    place_step_fraction: Annotated[
        float,
        tuning("the same as a fraction of the height, in addition", "1", 0.001, 10.0, "three degrees of attitude error"),
    ] = 0.05
    adopt_s: Annotated[
        float,
        tuning(
            "time for which sightings must be at one other position, and none at the pad's, for the track to move there",
            "s",
            0.5,
            60.0,
        ),
    ] = 2.0
    pads_apart_m: Annotated[
        float,
        tuning(
            "least distance between the centres of two pads; what is found again nearer than half of it beside the expected "
            "position, and seen for adopt_s, is the tracked pad",
            "m",
            0.0,
            100.0,
            "two of the thesis' pads side by side",
        ),
    ] = 0.78

    range_tolerance_m: Annotated[
        float, tuning("largest difference between range sensor and camera over the pad", "m", 0.01, 100.0)
    ] = 0.08
    range_tolerance_fraction: Annotated[float, tuning("the same as a fraction of the height, in addition", "1", 0.001, 1.0)] = (
        0.08
    )
    range_disagree_s: Annotated[
        float,
        tuning(
            "time for which range sensor and camera must differ for the descent to end; a third where they differ much",
            "s",
            0.1,
            60.0,
        ),
    ] = 1.0
    deck_radius_m: Annotated[
        float,
        tuning("radius of the deck around the pad's centre; beyond it a range is not compared with the camera", "m", 0.05, 100.0),
    ] = 0.6
    height_tolerance_m: Annotated[
        float,
        tuning(
            "how far barometer minus camera may leave its range of 6 to 12 s before (waves bring it back); a "
            "third of the change of the camera's height is added",
            "m",
            0.01,
            100.0,
        ),
    ] = 2.5

    lens_sigma_m: Annotated[
        float,
        tuning(
            "standard deviation of the lens' place by which its error is looked for; 0: it is exact and not watched",
            "m",
            0.0,
            1.0,
        ),
    ] = 0.3
    lens_tolerance_m: Annotated[
        float,
        tuning("error of the lens' place across the body's down axis that is surely no reason not to land", "m", 0.01, 10.0),
    ] = 0.15

    @property
    def turn_rate_max_rad_s(self) -> float:
        """The limit of the gyro, rad/s."""
        return math.radians(self.turn_rate_max_deg_s)

    def __post_init__(self) -> None:
        check_ranges(self)
