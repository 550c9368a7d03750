"""The filter's options: noises, priors, gates, sizes. The defaults suit an AR.Drone 2.0 over a small vessel."""

import math
from typing import Annotated, ClassVar, Literal

from msgspec import Struct

from estimator.contracts.keys import check_ranges, choice, tuning

_MOTION_CAPTURE = "a recorded AR.Drone 2.0 flight under motion capture"


class EkfOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """Options of the error-state filter.

    A spectral density `asd_` is per square root of hertz: its integral over T seconds has the standard deviation `asd * sqrt(T)`.

    Raises:
        ValueError: a number is outside its range.
    """

    asd_gyro_rad_s: Annotated[
        float,
        tuning(
            "noise density of the gyro: the error of an attitude integrated from the gyro alone after 1 s",
            "rad/s/sqrt(Hz)",
            1e-7,
            1.0,
        ),
    ] = 0.003
    asd_accel_m_s2: Annotated[
        float,
        tuning(
            "noise density of the accelerometer with vibration: the error, m/s, of a velocity integrated from it after 1 s",
            "m/s^2/sqrt(Hz)",
            1e-6,
            10.0,
        ),
    ] = 0.03
    sigma_gyro_bias_rad_s: Annotated[float, tuning("standard deviation of the gyro's bias at the start", "rad/s", 1e-6, 1.0)] = (
        0.02
    )
    asd_gyro_bias_rad_s2: ClassVar[float] = 1e-4  # Random walk of the gyro's bias: its change within 1 s
    sigma_accel_bias_m_s2: Annotated[
        float,
        tuning(
            "standard deviation of the accelerometer's bias at the start, across the body's down axis",
            "m/s^2",
            1e-4,
            10.0,
            "two captures of AR.Drones: 0.03 to 0.8",
        ),
    ] = 0.4
    sigma_accel_bias_down_m_s2: Annotated[
        float,
        tuning(
            "the same along the down axis, where a scale error adds to it because the axis measures the weight",
            "m/s^2",
            1e-4,
            10.0,
        ),
    ] = 0.6
    asd_accel_bias_m_s3: Annotated[
        float,
        tuning(
            "random walk of the accelerometer's bias: its change within 1 s; 0.02 for an autopilot if nothing is set, which may "
            "take its own, changing estimate of the bias off what it sends",
            "m/s^3/sqrt(Hz)",
            1e-7,
            1.0,
        ),
    ] = 2e-3
    accel_step_m_s2: ClassVar[float] = 15.0
    """Largest plausible change of specific force between two samples; the rest is cut off and counts as uncertainty."""
    gyro_step_rad_s: ClassVar[float] = 4.0  # Largest plausible change of the angular velocity
    sigma_initial_tilt_rad: ClassVar[float] = math.radians(3.0)
    """Standard deviation of roll and pitch at the start if the vehicle sends no attitude."""
    sigma_initial_heading_rad: ClassVar[float] = math.radians(10.0)
    """Standard deviation of the heading at the start if the vehicle sends no attitude."""
    sigma_initial_velocity_m_s: ClassVar[float] = 2.0  # Standard deviation of the vehicle's velocity at the start

    sigma_attitude_bias_rad: Annotated[
        float,
        tuning(
            "standard deviation of the constant error of the vehicle's own roll and pitch at the start; half a degree for an "
            "autopilot if nothing is set",
            "rad",
            1e-5,
            1.0,
            _MOTION_CAPTURE + ": 0.5 degrees in the calm, 9 when pulled",
        ),
    ] = math.radians(1.5)
    asd_attitude_bias_rad_s: ClassVar[float] = 2e-3
    """Random walk of that error: its change within 1 s; an AR.Drone in a steady side wind loses its level by much more."""
    attitude_correlation_s: ClassVar[float] = 1.0
    """Time over which errors of the vehicle's own attitude are correlated; samples closer together count as parts of one."""
    velocity_correlation_s: ClassVar[float] = 0.25  # Correlation time of its velocity
    range_correlation_s: ClassVar[float] = 0.05  # Correlation time of its range sensor
    baro_correlation_s: ClassVar[float] = 0.5  # Correlation time of its barometer
    aiding_period_s: ClassVar[float] = 0.05
    """Time over which samples of attitude, velocity, range and height are averaged before they are fused."""

    velocity_scale: Annotated[float, tuning("initial scale factor: measured over true horizontal velocity", "1", 0.1, 10.0)] = 1.0
    sigma_velocity_scale: Annotated[
        float,
        tuning(
            "standard deviation of the scale factor at the start; 0.02 for an autopilot if nothing is set, as GNSS has none",
            "1",
            1e-4,
            10.0,
            _MOTION_CAPTURE,
        ),
    ] = 0.2
    asd_velocity_scale: ClassVar[float] = 1e-3  # Random walk of the scale factor: its change within 1 s
    velocity_is_over: Annotated[
        Literal["auto", "ground", "pad", "either"],
        choice(
            "reference of the velocity sensor: the ground (GNSS), the pad's deck, or either, whichever fits better at the time "
            "(optical flow measures the deck when over it); auto is ground for an autopilot, either for an AR.Drone",
            page=True,
        ),
    ] = "auto"

    sigma_vessel_velocity_m_s: ClassVar[float] = 2.0  # Standard deviation of the vessel's velocity before the first sighting
    asd_vessel_velocity_m_s2: ClassVar[float] = 0.03
    """Random walk of the vessel's steady velocity, without the waves: its change within 1 s."""
    sigma_turn_rate_rad_s: ClassVar[float] = math.radians(3.0)
    """Standard deviation of the vessel's steady rate of turn before the first sighting."""
    asd_turn_rate_rad_s2: ClassVar[float] = 0.006  # Random walk of the steady rate of turn: its change within 1 s
    sigma_wave_yaw_rate_rad_s: ClassVar[float] = math.radians(2.5)
    """Standard deviation of the rate at which waves make the vessel yaw about its course."""
    wave_yaw_period_s: ClassVar[float] = 6.0  # Period of the yaw motion in waves
    sigma_list_rad: ClassVar[float] = math.radians(1.0)  # Standard deviation of the deck's constant list and trim
    pad_yaw_in_vessel_rad: Annotated[
        float, tuning("direction of the pad's arrow from the bow, clockwise from above", "rad", 0.0, 2.0 * math.pi, public=True)
    ] = 0.0
    pad_forward_m: Annotated[
        float,
        tuning("the pad from the point whose velocity the ship reports, towards the bow, as `vessel` says", "m", -400.0, 400.0),
    ] = 0.0
    pad_right_m: Annotated[float, tuning("the same to starboard", "m", -100.0, 100.0)] = 0.0
    deck_radius_m: Annotated[
        float, tuning("distance from the pad's centre within which a range sensor is used", "m", 0.05, 100.0, public=True)
    ] = 0.6
    sigma_range_offset_m: ClassVar[float] = 0.05
    """Standard deviation of the range sensor's constant error, with that of its mounting height."""
    asd_range_offset_m: ClassVar[float] = 2e-3  # Random walk of that error: its change within 1 s
    sigma_baro_offset_m: ClassVar[float] = 100.0  # Standard deviation of the barometer's constant error
    asd_baro_offset_m: ClassVar[float] = 0.02  # Random walk of that error: its change within 1 s

    sigma_delay_s: Annotated[
        float, tuning("standard deviation of the common error of the sightings' time stamps", "s", 1e-6, 1.0)
    ] = 0.03
    delay_drift_s_sqrt_s: ClassVar[float] = 1e-4  # Random walk of that error: its change within 1 s
    sigma_mount_rad: Annotated[
        float, tuning("standard deviation of the camera's orientation on the body, about each axis", "rad", 1e-6, 0.5)
    ] = math.radians(1.0)
    sigma_lever_m: Annotated[
        float,
        tuning(
            "standard deviation of the lens' place in the camera's file, along each axis of the body; 0: it is exact",
            "m",
            0.0,
            1.0,
        ),
    ] = 0.0
    mount_drift_rad_sqrt_s: ClassVar[float] = 1e-5  # Random walk of that orientation: its change within 1 s

    min_confidence: ClassVar[float] = 0.05  # Least confidence of a sighting; estimator.min_confidence applies earlier
    reopen_count: ClassVar[int] = 5
    """Number of consecutive refused sightings, in agreement with one another, that reset the filter to them."""
    reopen_s: ClassVar[float] = 0.6  # Least time that these sightings must span
    heading_memory_s: ClassVar[float] = 10.0
    """Longest time for which the gyro holds a heading that sightings contradict, if they agreed for as long before."""
    confirm_s: ClassVar[float] = 1.0  # Time after the newest fused sighting or velocity for which the estimate can be consistent
    consistent_sigma_m: ClassVar[float] = 1.0
    """Largest standard deviation of the pad's position at which the estimate can be consistent."""
    forget_s: Annotated[float, tuning("time without a sighting after which there is no estimate", "s", 0.1, 600.0)] = 30.0

    history_s: Annotated[float, tuning("largest delay of a measurement", "s", 0.05, 30.0)] = 1.0
    max_ahead_s: ClassVar[float] = 0.05  # Largest time by which a measurement may be ahead of the latest time of reception
    leap_s: ClassVar[float] = 2.0  # Jump of the time of reception beyond which a sample is refused until others agree with it
    leap_count: ClassVar[int] = 5  # Number of consecutive samples that must agree for that
    tick_s: ClassVar[float] = 0.1
    """Longest time between two propagations of the covariance; the state is propagated at every IMU sample."""
    hold_s: ClassVar[float] = 0.06  # Time for which an IMU sample is valid; after that the body is assumed to keep its velocity
    asd_coast_m_s2: ClassVar[float] = 1.5  # Density of the unknown acceleration while the IMU is silent
    asd_coast_rad_s: ClassVar[float] = 0.3  # Density of the unknown rotation while the IMU is silent

    def __post_init__(self) -> None:
        check_ranges(self)
