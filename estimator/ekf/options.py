"""The filter's options: noises, priors, gates, sizes. The defaults suit an AR.Drone 2.0 over a small vessel."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from msgspec import Struct

from estimator.contracts.keys import check_ranges, choice, number

_MOTION_CAPTURE = "a recorded AR.Drone 2.0 flight under motion capture"


class EkfOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """The error-state filter. A density `asd_` is per square root of hertz: integrated over T seconds it leaves `asd * sqrt(T)`.

    Raises:
        ValueError: a number outside its range.
    """

    asd_gyro_rad_s: Annotated[
        float,
        number("noise of the gyro: attitude from the gyro alone errs by this after 1 s", "rad/s/sqrt(Hz)", 1e-7, 1.0),
    ] = 0.003
    asd_accel_m_s2: Annotated[
        float,
        number(
            "noise of the accelerometer, vibration included: velocity from it alone errs by this, in m/s, after 1 s",
            "m/s^2/sqrt(Hz)",
            1e-6,
            10.0,
        ),
    ] = 0.03
    sigma_gyro_bias_rad_s: Annotated[
        float, number("one standard deviation of the gyro's bias at the start", "rad/s", 1e-6, 1.0)
    ] = 0.02
    asd_gyro_bias_rad_s2: Annotated[
        float, number("the gyro's bias wanders by this much in 1 s", "rad/s^2/sqrt(Hz)", 1e-9, 0.1)
    ] = 1e-4
    sigma_accel_bias_m_s2: Annotated[
        float, number("one standard deviation of the accelerometer's bias across the body's down axis", "m/s^2", 1e-4, 10.0)
    ] = 0.15
    sigma_accel_bias_down_m_s2: Annotated[
        float,
        number("the same along that axis, where a wrong scale adds to it because it carries the weight", "m/s^2", 1e-4, 10.0),
    ] = 0.6
    asd_accel_bias_m_s3: Annotated[
        float, number("the accelerometer's bias wanders by this much in 1 s", "m/s^3/sqrt(Hz)", 1e-7, 1.0)
    ] = 2e-3
    accel_step_m_s2: Annotated[
        float,
        number(
            "change of specific force between two samples that the vehicle can make; more is cut off and counts as doubt",
            "m/s^2",
            0.1,
            1000.0,
        ),
    ] = 15.0
    gyro_step_rad_s: Annotated[float, number("the same for the rate of turn", "rad/s", 0.01, 1000.0)] = 4.0
    sigma_initial_tilt_rad: Annotated[
        float, number("one standard deviation of roll and pitch where no attitude says it", "rad", 1e-4, math.pi)
    ] = math.radians(3.0)
    sigma_initial_heading_rad: Annotated[
        float, number("one standard deviation of the heading where no attitude says it", "rad", 1e-4, math.pi)
    ] = math.radians(10.0)
    sigma_initial_velocity_m_s: Annotated[
        float, number("one standard deviation of the vehicle's velocity at the start", "m/s", 1e-3, 100.0)
    ] = 2.0

    sigma_attitude_bias_rad: Annotated[
        float,
        number("one standard deviation of the constant error of the vehicle's own roll and pitch at the start", "rad", 1e-5, 1.0),
    ] = math.radians(2.0)
    asd_attitude_bias_rad_s: Annotated[
        float,
        number(
            "that error wanders by this much in 1 s; an AR.Drone in a steady side wind loses its level by much more",
            "rad/s/sqrt(Hz)",
            1e-7,
            1.0,
        ),
    ] = 2e-3
    attitude_correlation_s: Annotated[
        float,
        number(
            "over how long the vehicle's own attitude errs alike; samples closer together count as parts of one", "s", 1e-4, 60.0
        ),
    ] = 1.0
    velocity_correlation_s: Annotated[float, number("the same for its velocity", "s", 1e-4, 60.0)] = 0.25
    range_correlation_s: Annotated[float, number("the same for its range sensor", "s", 1e-4, 60.0)] = 0.05
    baro_correlation_s: Annotated[float, number("the same for its barometer", "s", 1e-4, 60.0)] = 0.5
    aiding_period_s: Annotated[
        float,
        number("samples of attitude, velocity, range and height are averaged over this long and fused at once", "s", 1e-3, 5.0),
    ] = 0.05

    velocity_scale: Annotated[float, number("first guess of measured over true horizontal velocity", "1", 0.1, 10.0)] = 1.0
    sigma_velocity_scale: Annotated[float, number("one standard deviation of that guess", "1", 1e-4, 10.0, _MOTION_CAPTURE)] = 0.2
    asd_velocity_scale: Annotated[float, number("the true scale wanders by this much in 1 s", "1/sqrt(s)", 1e-7, 1.0)] = 1e-3
    velocity_is_over: Annotated[
        Literal["auto", "ground", "pad", "either"],
        choice(
            "what the velocity sensor measures against: the ground (GNSS), the pad's deck, or either, whichever fits better at "
            "the time (optical flow sees the deck when over it); auto is ground for an autopilot, either for an AR.Drone"
        ),
    ] = "auto"

    sigma_vessel_velocity_m_s: Annotated[
        float, number("one standard deviation of the vessel's velocity before anything is seen", "m/s", 1e-3, 100.0)
    ] = 2.0
    asd_vessel_velocity_m_s2: Annotated[
        float,
        number("the vessel's steady velocity, without the waves, wanders by this much in 1 s", "m/s^2/sqrt(Hz)", 1e-6, 10.0),
    ] = 0.03
    sigma_turn_rate_rad_s: Annotated[
        float, number("one standard deviation of the vessel's steady rate of turn before anything is seen", "rad/s", 1e-5, 1.0)
    ] = math.radians(3.0)
    asd_turn_rate_rad_s2: Annotated[
        float, number("the steady rate of turn wanders by this much in 1 s", "rad/s^2/sqrt(Hz)", 1e-7, 1.0)
    ] = 0.006
    sigma_wave_yaw_rate_rad_s: Annotated[
        float,
        number("one standard deviation of the rate at which waves make the vessel yaw about its course", "rad/s", 1e-5, 1.0),
    ] = math.radians(2.5)
    wave_yaw_period_s: Annotated[float, number("period of that yawing", "s", 0.5, 60.0)] = 6.0
    sigma_sway_per_heave: Annotated[
        float,
        number("one standard deviation of the metres that the pad sways in phase with each metre of its heave", "1", 1e-4, 10.0),
    ] = 0.2
    asd_sway_per_heave: Annotated[float, number("that ratio wanders by this much in 1 s", "1/sqrt(s)", 1e-7, 1.0)] = 5e-3
    sigma_list_rad: Annotated[float, number("one standard deviation of the deck's constant list and trim", "rad", 1e-5, 0.5)] = (
        math.radians(1.0)
    )
    pad_yaw_in_vessel_rad: Annotated[
        float, number("direction of the pad's arrow against the bow, clockwise from above", "rad", 0.0, 2.0 * math.pi)
    ] = 0.0
    deck_radius_m: Annotated[
        float,
        number("a range sensor is used only this near the pad's centre, where the deck is certainly below", "m", 0.05, 100.0),
    ] = 0.6
    sigma_range_offset_m: Annotated[
        float,
        number("one standard deviation of the range sensor's constant error, its mounting height included", "m", 1e-4, 10.0),
    ] = 0.05
    asd_range_offset_m: Annotated[float, number("that error wanders by this much in 1 s", "m/sqrt(s)", 1e-7, 1.0)] = 2e-3
    sigma_baro_offset_m: Annotated[
        float, number("one standard deviation of the barometer's constant error", "m", 1e-3, 10_000.0)
    ] = 100.0
    asd_baro_offset_m: Annotated[float, number("that error wanders by this much in 1 s", "m/sqrt(s)", 1e-6, 10.0)] = 0.02

    sigma_delay_s: Annotated[
        float, number("one standard deviation of the time stamps' common error, of all sightings", "s", 1e-6, 1.0)
    ] = 0.03
    delay_drift_s_sqrt_s: Annotated[float, number("that error wanders by this much in 1 s", "s/sqrt(s)", 0.0, 0.1)] = 1e-4
    sigma_mount_rad: Annotated[
        float, number("one standard deviation of the camera's orientation on the body", "rad", 1e-6, 0.5)
    ] = math.radians(1.0)
    mount_drift_rad_sqrt_s: Annotated[float, number("that orientation wanders by this much in 1 s", "rad/sqrt(s)", 0.0, 0.1)] = (
        1e-5
    )
    sighting_has_attitude_error: Annotated[
        bool, choice("the covariance of a sighting includes that of the attitude it was levelled with, and it is taken out again")
    ] = True

    gate_probability: Annotated[
        float, number("how often an honest measurement is refused: 0.01, 0.001 or 0.0001", "1", 1e-4, 0.01)
    ] = 1e-4
    min_confidence: Annotated[
        float,
        number("a sighting less sure than this to be the pad is refused; estimator.min_confidence refuses before", "1", 0.0, 1.0),
    ] = 0.05
    reopen_count: Annotated[
        int, number("so many refused sightings in a row that agree with one another reset the filter onto them", "1", 1, 1000)
    ] = 5
    reopen_s: Annotated[float, number("and they must span at least this long", "s", 1e-3, 60.0)] = 0.6
    heading_memory_s: Annotated[
        float,
        number(
            "a heading that sightings contradict is held by the gyro for as long as they agreed with it before, at most so long",
            "s",
            0.01,
            600.0,
        ),
    ] = 10.0
    confirm_s: Annotated[
        float,
        number("the estimate is called consistent for so long after the newest sighting or velocity fused", "s", 0.01, 60.0),
    ] = 1.0
    consistent_sigma_m: Annotated[
        float,
        number("largest standard deviation of the pad's position at which the estimate is called consistent", "m", 1e-4, 100.0),
    ] = 1.0
    forget_s: Annotated[float, number("without a sighting for so long there is no estimate any more", "s", 0.1, 600.0)] = 30.0

    history_s: Annotated[float, number("how late a measurement may come", "s", 0.05, 30.0)] = 1.0
    max_ahead_s: Annotated[float, number("how far past everything received so far a measurement may lie", "s", 0.0, 5.0)] = 0.05
    leap_s: Annotated[
        float,
        number("a sample received so much later or earlier than all before it is refused until others agree", "s", 0.05, 60.0),
    ] = 2.0
    leap_count: Annotated[int, number("how many samples in a row must agree for that", "1", 1, 1000)] = 5
    tick_s: Annotated[
        float,
        number("longest time between two steps of the covariance; the state moves on at every IMU sample", "s", 1e-3, 1.0),
    ] = 0.1
    hold_s: Annotated[
        float, number("how long an IMU sample holds; past that the body is taken to keep its velocity", "s", 1e-3, 5.0)
    ] = 0.06
    asd_coast_m_s2: Annotated[
        float, number("unknown acceleration of a body whose IMU is silent", "m/s^2/sqrt(Hz)", 1e-4, 100.0)
    ] = 1.5
    asd_coast_rad_s: Annotated[float, number("unknown rotation of a body whose IMU is silent", "rad/s/sqrt(Hz)", 1e-5, 10.0)] = (
        0.3
    )

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.gate_probability not in (0.01, 1e-3, 1e-4):
            raise ValueError(f"gate_probability must be 0.01, 1e-3 or 1e-4, got {self.gate_probability!r}")
