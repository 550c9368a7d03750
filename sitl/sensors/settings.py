"""Scenario settings for the errors of the vehicle's sensors."""

from typing import Annotated, Literal

from msgspec import Struct

from estimator.contracts.keys import check_order, choice, number

_MEASURED = "a recorded AR.Drone 2.0 flight against motion capture"
_THESIS = "the thesis' simulator"


class SensorSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The errors of the vehicle's sensors and of its own estimator."""

    accel_bias_sigma_m_s2: Annotated[
        float,
        number(
            "standard deviation of the accelerometer's constant error, each axis",
            "m/s^2",
            0.0,
            3.0,
            "biases of 80 mg in a captured navdata",
        ),
    ] = 0.6
    accel_noise_sigma_m_s2: Annotated[
        float, number("standard deviation of a sample, motors turning", "m/s^2", 0.0, 5.0, _MEASURED + ": 0.040 to 0.046")
    ] = 0.043
    accel_rest_sigma_m_s2: Annotated[
        float, number("standard deviation of a sample, motors off", "m/s^2", 0.0, 5.0, _MEASURED + ": up to 0.012")
    ] = 0.01
    gyro_bias_sigma_rad_s: Annotated[
        float,
        number(
            "standard deviation of the gyro's constant error after the drone removed its own offsets",
            "rad/s",
            0.0,
            0.2,
            _MEASURED,
        ),
    ] = 0.001
    gyro_noise_sigma_rad_s: Annotated[
        float, number("standard deviation of a sample, motors turning", "rad/s", 0.0, 1.0, _MEASURED + ": 0.027 to 0.042")
    ] = 0.034
    gyro_rest_sigma_rad_s: Annotated[
        float, number("standard deviation of a sample, motors off", "rad/s", 0.0, 1.0, _MEASURED + ": 0.0004 to 0.0005")
    ] = 0.0005
    tilt_bias_sigma_deg: Annotated[
        float, number("standard deviation of the constant error of the drone's roll and pitch", "deg", 0.0, 10.0, _MEASURED)
    ] = 0.5
    tilt_drift_sigma_deg: Annotated[
        float,
        number(
            "standard deviation of the wandering error of the drone's roll and pitch",
            "deg",
            0.0,
            10.0,
            _MEASURED + ": 0.16 and 0.77",
        ),
    ] = 0.4
    tilt_drift_time_s: Annotated[float, number("its correlation time", "s", 0.05, 600.0, _MEASURED)] = 1.0
    heading_bias_sigma_deg: Annotated[
        float, number("standard deviation of the constant error of the drone's heading", "deg", 0.0, 180.0, "assumed")
    ] = 3.0
    heading_drift_sigma_deg: Annotated[
        float, number("standard deviation of the wandering error of the drone's heading", "deg", 0.0, 60.0, _MEASURED + ": 2.4")
    ] = 2.0
    heading_drift_time_s: Annotated[float, number("its correlation time", "s", 0.05, 600.0, _MEASURED)] = 6.0
    velocity_scale: Annotated[float, number("scale factor: reported over true velocity", "1", 0.1, 2.0, _MEASURED)] = 0.83
    velocity_noise_sigma_m_s: Annotated[
        float,
        number("standard deviation of the wandering error of the velocity", "m/s", 0.0, 1.0, _MEASURED + ": 0.011 to 0.024"),
    ] = 0.015
    velocity_noise_time_s: Annotated[float, number("its correlation time", "s", 0.01, 60.0, _MEASURED)] = 0.25
    velocity_lag_s: Annotated[
        float, number("first-order lag of the reported velocity", "s", 0.001, 1.0, _MEASURED + ": 0.02 to 0.04")
    ] = 0.03
    velocity_over: Annotated[
        Literal["seen", "water"],
        choice("reference of the velocity: the surface that the bottom camera sees (the deck when over it), or always the water"),
    ] = "seen"
    ultrasound_rate_hz: Annotated[float, number("rate of measurements", "Hz", 1.0, 60.0, "pic:ultrasound_freq 8")] = 25.0
    ultrasound_min_m: Annotated[float, number("shortest measurable distance", "m", 0.0, 1.0, "assumed")] = 0.2
    ultrasound_max_m: Annotated[float, number("longest measurable distance", "m", 0.5, 20.0, "Parrot's specification")] = 6.0
    ultrasound_cone_deg: Annotated[
        float, number("full angle of the sensor's cone; the nearest surface counts", "deg", 1.0, 90.0, _THESIS)
    ] = 40.0
    ultrasound_sigma_m: Annotated[
        float, number("standard deviation of a reading", "m", 0.0, 1.0, _MEASURED + ": 0.003 to 0.007")
    ] = 0.005
    ultrasound_delay_s: Annotated[float, number("delay from the echo to the telemetry", "s", 0.0, 0.5, _MEASURED)] = 0.06
    pressure_sigma_pa: Annotated[
        float, number("standard deviation of a reading", "Pa", 0.0, 200.0, _THESIS + ": 0.5 m of height")
    ] = 6.0
    pressure_drift_sigma_pa: Annotated[
        float, number("standard deviation of the slow wandering error", "Pa", 0.0, 500.0, "assumed")
    ] = 10.0
    magnetometer_sigma_t: Annotated[
        float, number("standard deviation of a reading, each axis", "T", 0.0, 1e-4, _THESIS + ": 0.013 G")
    ] = 1.3e-6
    magnetometer_bias_sigma_t: Annotated[
        float, number("standard deviation of the constant error, each axis", "T", 0.0, 1e-4, "assumed")
    ] = 1e-6
    battery_start: Annotated[float, number("charge at the start", "1", 0.0, 1.0)] = 0.9
    battery_life_s: Annotated[float, number("flight time of a full battery", "s", 10.0, 36000.0, _THESIS)] = 1200.0

    def __post_init__(self) -> None:
        check_order(self, "ultrasound_min_m < ultrasound_max_m")
