"""Limits of what is possible. The defaults hold for a quadcopter of a few kilograms and 30 frames a second."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields


@dataclass(frozen=True, slots=True)
class IntegrityOptions:
    """Every limit with its unit.

    Raises:
        ValueError: a number that is not finite or not positive.
    """

    specific_force_max_m_s2: float = 80.0
    """Largest specific force; a landing on a hard deck stays below 8 g."""
    turn_rate_max_rad_s: float = math.radians(2000.0)
    """Largest turn rate: the range of a common gyro."""
    speed_max_m_s: float = 20.0
    """Largest speed of the vehicle and of the vessel over the ground."""
    acceleration_max_m_s2: float = 30.0
    """Largest change of velocity between two samples, over their time."""
    velocity_step_m_s: float = 1.5
    """Step of a velocity that is allowed in addition, for its sensor's own noise."""
    tilt_rate_max_rad_s: float = 8.0
    """Largest rate of roll and pitch between two samples."""
    tilt_step_rad: float = math.radians(20.0)
    """Step of roll and pitch that is allowed in addition."""
    height_rate_max_m_s: float = 20.0
    """Largest rate of height between two samples of the barometer."""
    height_step_m: float = 5.0
    """Step of a barometer's height that is allowed in addition, for a gust on its port."""
    spike_s: float = 0.5
    """A step that is still there after this long is no spike, and is let through."""

    imu_frozen_s: float = 0.15
    """An IMU sample that repeats the one before to the bit for this long is refused. In 41 s of a real AR.Drone's flight none
    repeated for longer than 5 ms."""
    attitude_frozen_s: float = 0.25
    velocity_frozen_s: float = 0.5
    range_frozen_s: float = 2.0
    """An ultrasound that counts in millimetres holds over flat ground: 0.12 s in that flight."""
    baro_frozen_s: float = 2.0

    clock_step_max_s: float = 1.0
    """An arrival this far from all others' is refused until others confirm it."""
    sample_delay_step_max_s: float = 0.5
    """How far a sample's delay (arrival less measurement) may lie from its stream's median."""
    sighting_delay_step_max_s: float = 0.15
    """The same for sightings."""
    sample_delay_settle_s: float = 1.0
    """A delay that stays elsewhere for this long is the stream's new one."""
    sighting_delay_settle_s: float = 10.0

    view_turned_min_rad: float = 0.01
    """How much the body has to turn (one standard deviation, within half a second) before a pad that keeps its place in the image
    counts as frozen."""
    view_still_ratio: float = 0.1
    """It does when its bearing moves less than this share of what the turning alone would move it."""

    place_step_m: float = 0.06
    """How far a sighting may lie from where the pad is expected, besides its own and the belief's uncertainty."""
    place_step_share: float = 0.05
    """The same, in addition, as a share of the height: what three degrees of attitude error make."""
    adopt_s: float = 2.0
    """A single other place, seen for this long while the track is not, becomes the new track."""

    range_tolerance_m: float = 0.08
    range_tolerance_share: float = 0.08
    """How far range sensor and camera may differ over the pad: a length plus a share of the height."""
    range_doubt_s: float = 1.0
    """Time for which they must differ."""
    deck_radius_m: float = 0.6
    """Radius of the deck around the pad's centre: beyond it there may be water below, and a range says nothing of the pad."""
    height_tolerance_m: float = 2.5
    """How far the height's change over ten seconds may differ between barometer and camera, besides a third of the change: heave
    of the deck and drift of the air are in it."""

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"IntegrityOptions.{f.name} must be a positive number, got {value!r}")
