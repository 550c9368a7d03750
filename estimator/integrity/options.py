"""Limits for plausible inputs. The defaults suit a quadcopter of a few kilograms and 30 frames a second."""

import math
from typing import Annotated, ClassVar

from msgspec import Struct

from estimator.contracts.keys import check_ranges, tuning


class IntegrityOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits that an input must keep; any other input is refused, counted and logged.

    Raises:
        ValueError: a number is outside its range.
    """

    specific_force_max_m_s2: ClassVar[float] = 80.0
    """Largest plausible reading of an accelerometer; a larger one is refused (8 g)."""
    turn_rate_max_deg_s: ClassVar[float] = 2000.0
    """Largest plausible reading of a gyro; a larger one is refused (range of a common part)."""
    speed_max_m_s: Annotated[
        float, tuning("largest plausible speed of the vehicle or vessel; a larger one is refused", "m/s", 1.0, 100.0)
    ] = 20.0
    acceleration_max_m_s2: ClassVar[float] = 30.0  # Largest acceleration between two velocity samples
    velocity_step_m_s: ClassVar[float] = 1.5  # Step of velocity that is allowed in addition, for the sensor's noise
    tilt_rate_max_rad_s: ClassVar[float] = 8.0  # Largest rate of roll and pitch between two samples
    tilt_step_rad: ClassVar[float] = math.radians(20.0)  # Step of roll and pitch that is allowed in addition
    height_rate_max_m_s: ClassVar[float] = 20.0  # Largest rate of height between two samples of the barometer
    height_step_m: ClassVar[float] = 5.0  # Step of a barometer's height that is allowed in addition, for a gust at its port
    spike_s: ClassVar[float] = 0.5  # Time after which a step that persists is accepted, because it is not a spike

    heading_tolerance_deg: ClassVar[float] = 6.0
    """Difference between the reported heading and the one that the gyro holds above which the latter is taken."""
    heading_slip_deg_s: ClassVar[float] = 2.0
    """Rate at which the gyro's heading follows the reported one, a quarter of it beyond the tolerance: more than the gyro's bias,
    less than a compass beside steel."""

    imu_frozen_s: ClassVar[float] = 0.15
    """Time after which an IMU that repeats the same bits is refused (5 ms on a real AR.Drone)."""
    attitude_frozen_s: ClassVar[float] = 0.25  # Time after which an attitude that repeats the same bits is refused
    velocity_frozen_s: ClassVar[float] = 0.5  # Time after which a velocity that repeats the same bits in flight is refused
    range_frozen_s: ClassVar[float] = 2.0
    """Time after which a range that repeats the same bits is refused (0.12 s on a real AR.Drone)."""
    baro_frozen_s: ClassVar[float] = 2.0  # Time after which a barometer that repeats the same bits is refused

    clock_step_max_s: ClassVar[float] = 1.0
    """Difference of a time of reception from all others above which it is refused until others confirm it."""
    sample_delay_step_max_s: ClassVar[float] = 0.5
    """Largest difference of a sample's delay (reception minus measurement) from its stream's median."""
    delay_step_max_s: ClassVar[float] = 0.15
    """Largest difference of a frame's delay from its median; frames beyond are refused until the delay has settled."""
    sample_delay_settle_s: ClassVar[float] = 1.0
    """Time after which a changed delay of samples is accepted as the stream's new delay."""
    delay_settle_s: ClassVar[float] = 10.0
    """Time after which a changed delay of frames is the new delay: on the ground, or where the one before held for less than
    delay_keep_s."""
    delay_keep_s: ClassVar[float] = 3.0  # Time after which the frames' delay gives way to no other before the vehicle stands

    view_turned_min_rad: ClassVar[float] = 0.01
    """Least rotation of the body, one standard deviation within half a second; beyond it, a pad that keeps its position in the
    image counts as frozen."""
    view_still_ratio: ClassVar[float] = 0.1
    """The pad counts as frozen if its bearing moves by less than this fraction of the body's rotation."""

    place_step_m: ClassVar[float] = 0.06
    """Largest distance of a sighting from the pad's expected position, in addition to the uncertainty of both."""
    place_step_fraction: ClassVar[float] = 0.05
    """The same as a fraction of the height, in addition (three degrees of attitude error)."""
    adopt_s: ClassVar[float] = 2.0
    """Time for which sightings must be at one other position, and none at the pad's, for the track to move there."""
    pads_apart_m: Annotated[
        float, tuning("least distance between the centres of two pads; where there is one alone, a large one", "m", 0.1, 1000.0)
    ] = 0.78
    """A pad that is found again nearer than half of it beside the expected position, and seen for adopt_s, is the tracked one."""

    range_tolerance_m: Annotated[
        float, tuning("largest difference between range sensor and camera over the pad", "m", 0.01, 100.0)
    ] = 0.08
    range_tolerance_fraction: ClassVar[float] = 0.08  # The same as a fraction of the height, in addition
    range_disagree_s: ClassVar[float] = 1.0
    """Time for which range sensor and camera must differ for the descent to end; a third where they differ much."""
    deck_radius_m: Annotated[
        float,
        tuning("radius of the deck around the pad's centre; beyond it a range is not compared with the camera", "m", 0.05, 100.0),
    ] = 0.6
    height_tolerance_m: ClassVar[float] = 2.5
    """Width by which barometer minus camera may leave its range of 6 to 12 s before: waves bring it back. A third of the
    change of the camera's height is added."""

    lens_sigma_m: Annotated[
        float,
        tuning(
            "standard deviation of the lens' place by which its error is looked for; 0: it is exact and not watched",
            "m",
            0.0,
            1.0,
        ),
    ] = 0.3
    lens_tolerance_m: ClassVar[float] = 0.15
    """Error of the lens' place across the body's down axis that is surely no reason not to land."""

    @property
    def turn_rate_max_rad_s(self) -> float:
        """The limit of the gyro, rad/s."""
        return math.radians(self.turn_rate_max_deg_s)

    def __post_init__(self) -> None:
        check_ranges(self)
