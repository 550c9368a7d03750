"""What can be chosen about the filter: noises, priors, gates, sizes. The defaults suit an AR.Drone 2.0 over a small vessel."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal

_MAY_BE_ZERO = {"pad_yaw_in_vessel_rad", "max_ahead_s", "min_confidence", "mount_drift_rad_sqrt_s", "delay_drift_s_sqrt_s"}


@dataclass(frozen=True, slots=True)
class EkfOptions:
    """A density named `asd_` is per square root of hertz: integrated over T seconds it leaves `asd * sqrt(T)`.

    Raises:
        ValueError: a number that is not finite or not positive.
    """

    asd_gyro_rad_s: float = 0.003
    """rad/s/sqrt(Hz). Attitude from the gyro alone errs by this after 1 s, by three times as much after 10 s."""
    asd_accel_m_s2: float = 0.03
    """m/s^2/sqrt(Hz), vibration included. Velocity from the accelerometer alone errs by this (m/s) after 1 s."""
    sigma_gyro_bias_rad_s: float = 0.02
    asd_gyro_bias_rad_s2: float = 1e-4
    """The bias wanders by this much in 1 s."""
    sigma_accel_bias_m_s2: float = 0.15
    """Standard deviation of the accelerometer's bias across the body's down axis."""
    sigma_accel_bias_down_m_s2: float = 0.6
    """Along that axis: there it carries the vehicle's weight, and a wrong scale adds to it."""
    asd_accel_bias_m_s3: float = 2e-3
    accel_step_m_s2: float = 15.0
    """Change of the specific force from one sample to the next that the vehicle can make. Of a larger one this much is taken, and
    the rest is doubt."""
    gyro_step_rad_s: float = 4.0
    """The same for the rate of turn."""
    sigma_initial_tilt_rad: float = math.radians(3.0)
    sigma_initial_heading_rad: float = math.radians(10.0)
    sigma_initial_velocity_m_s: float = 2.0

    sigma_attitude_bias_rad: float = math.radians(2.0)
    """Standard deviation of the error of the vehicle's own roll and pitch when the filter starts, in flight maybe. Later only the
    accelerometer tells of it, as well as its own bias is known."""
    asd_attitude_bias_rad_s: float = 2e-3
    """rad/s/sqrt(Hz): it wanders by 0.4 degrees in 10 s. An AR.Drone in a steady side wind loses its level by much more."""
    attitude_correlation_s: float = 1.0
    """Over how long the vehicle's own attitude errs alike; samples closer together count as parts of one."""
    velocity_correlation_s: float = 0.25
    range_correlation_s: float = 0.05
    baro_correlation_s: float = 0.5
    aiding_period_s: float = 0.05
    """Samples of attitude, velocity, range, height are averaged over this long and fused at once."""

    velocity_scale: float = 1.0
    """First guess of measured over true horizontal velocity."""
    sigma_velocity_scale: float = 0.2
    asd_velocity_scale: float = 1e-3
    velocity_is_over: Literal["ground", "pad", "either"] = "either"
    """What the velocity sensor is right about: the ground (GNSS), the pad's deck, or whichever fits better at the time, as for a
    sensor that sees the deck when it is over the deck."""

    sigma_vessel_velocity_m_s: float = 2.0
    asd_vessel_velocity_m_s2: float = 0.03
    """How much the vessel's steady velocity wanders in 1 s; what waves do is not part of it."""
    sigma_turn_rate_rad_s: float = math.radians(3.0)
    """Standard deviation of the vessel's steady rate of turn before anything is seen."""
    asd_turn_rate_rad_s2: float = 0.006
    """rad/s^2/sqrt(Hz). The steady rate of turn wanders by this much in 1 s."""
    sigma_wave_yaw_rate_rad_s: float = math.radians(2.5)
    """Standard deviation of the rate at which waves make the vessel yaw about its course."""
    wave_yaw_period_s: float = 6.0
    """Period of that yawing."""
    sigma_sway_per_heave: float = 0.2
    """Standard deviation of the metres that the pad moves sideways in phase with each metre of its heave."""
    asd_sway_per_heave: float = 5e-3
    sigma_list_rad: float = math.radians(1.0)
    """Of the deck's constant list and trim."""
    pad_yaw_in_vessel_rad: float = 0.0
    """Direction of the arrow against the bow, clockwise from above."""
    deck_radius_m: float = 0.6
    """A range sensor is believed only where the deck is certainly below: this far around the pad's centre."""
    sigma_range_offset_m: float = 0.05
    """Of the range sensor's constant error: where it sits under the body's origin, and sound slower or faster than thought."""
    asd_range_offset_m: float = 2e-3
    sigma_baro_offset_m: float = 100.0
    asd_baro_offset_m: float = 0.02

    sigma_delay_s: float = 0.03
    """How wrong the time stamps of sightings may be, one and the same for all."""
    delay_drift_s_sqrt_s: float = 1e-4
    sigma_mount_rad: float = math.radians(1.0)
    """Of the camera's orientation on the body."""
    mount_drift_rad_sqrt_s: float = 1e-5
    sighting_has_attitude_error: bool = True
    """Whether the covariance of a sighting includes that of the attitude it was levelled with. It is taken out again."""

    gate_probability: float = 1e-4
    """How often an honest measurement is refused: 0.01, 1e-3 or 1e-4."""
    min_confidence: float = 0.05
    """A sighting below is refused."""
    reopen_count: int = 5
    """So many sightings refused in a row that agree with one another, over at least `reopen_s`, are believed after all."""
    reopen_s: float = 0.6
    heading_memory_s: float = 10.0
    """A heading that sightings contradict is held by the gyro for as long as they agreed with it before, at most this long."""
    confirm_s: float = 1.0
    """The belief is called consistent for so long after the newest sighting or velocity that was fused."""
    consistent_sigma_m: float = 1.0
    """Largest standard deviation of the pad's position along any axis at which the estimate is called consistent."""
    forget_s: float = 30.0
    """Without a sighting for so long there is no belief any more."""

    history_s: float = 1.0
    """How late a measurement may come."""
    max_ahead_s: float = 0.05
    """How far past everything heard so far a measurement may lie."""
    leap_s: float = 2.0
    """A sample received so much later or earlier than all before it is refused, until `leap_count` in a row agree."""
    leap_count: int = 5
    tick_s: float = 0.1
    """The covariance moves on at least this often, and wherever something is fused; the nominal state at every IMU sample."""
    hold_s: float = 0.06
    """How long an IMU sample holds; past that the body is taken to keep its velocity."""
    asd_coast_m_s2: float = 1.5
    """Acceleration of a body of which no IMU tells."""
    asd_coast_rad_s: float = 0.3

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, str | bool):
                continue
            if not math.isfinite(value) or value < 0 or (value == 0 and f.name not in _MAY_BE_ZERO):
                raise ValueError(f"EkfOptions.{f.name} must be a positive number, got {value!r}")
        if self.gate_probability not in (0.01, 1e-3, 1e-4):
            raise ValueError(f"EkfOptions.gate_probability must be 0.01, 1e-3 or 1e-4, got {self.gate_probability!r}")
        if self.velocity_is_over not in ("ground", "pad", "either"):
            raise ValueError(f"EkfOptions.velocity_is_over must be ground, pad or either, got {self.velocity_is_over!r}")
