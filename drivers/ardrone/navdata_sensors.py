"""Navdata options 17, 18, 21 to 24, 26 and 27: pressure, magnetometer, wind, radio, GPS, and two of the firmware's own.

Source: Parrot SDK 2.0.1 `navdata_common.h`; the GPS body from a datagram of firmware 2.4.8.
"""

from typing import Annotated

from msgspec import Struct

from drivers.ardrone.navdata_layout import F32, F64, I16, I32, U8, U32, Floats, Ints, option

_ZERO3 = (0.0, 0.0, 0.0)


@option(17)
class Watchdog(Struct, frozen=True):
    """Count of the control loop's watchdog."""

    watchdog: I32 = 0


@option(18)
class AdcDataFrame(Struct, frozen=True):
    """Raw frame of the converter board."""

    version: U32 = 0
    data_frame: Annotated[Ints, "32B"] = (0,) * 32


@option(21)
class PressureRaw(Struct, frozen=True):
    """Barometer."""

    up: I32
    ut: I16
    temperature_dc: I32
    """The temperature, tenths of a degree Celsius."""
    pressure_pa: I32


@option(22)
class Magneto(Struct, frozen=True):
    """Magnetometer, milligauss and degrees."""

    mx: I16 = 0
    my: I16 = 0
    mz: I16 = 0
    magneto_raw_mg: Annotated[Floats, "3f"] = _ZERO3
    magneto_rectified_mg: Annotated[Floats, "3f"] = _ZERO3
    magneto_offset_mg: Annotated[Floats, "3f"] = _ZERO3
    heading_unwrapped_deg: F32 = 0.0
    heading_gyro_unwrapped_deg: F32 = 0.0
    heading_fusion_unwrapped_deg: F32 = 0.0
    calibration_ok: U8 = 0
    state: U32 = 0
    radius: F32 = 0.0
    error_mean: F32 = 0.0
    error_var: F32 = 0.0


@option(23)
class WindSpeed(Struct, frozen=True):
    """The wind that the drone estimates: speed in m/s, direction in radians in the north-east plane."""

    wind_speed_m_s: F32 = 0.0
    wind_angle_rad: F32 = 0.0
    comp_theta: F32 = 0.0
    comp_phi: F32 = 0.0
    state_x: Annotated[Floats, "6f"] = (0.0,) * 6
    debug: Annotated[Floats, "3f"] = _ZERO3


@option(24)
class KalmanPressure(Struct, frozen=True):
    """The drone's own height filter over pressure, ultrasound and motors."""

    offset_pressure_pa: F32 = 0.0
    est_z: F32 = 0.0
    est_zdot: F32 = 0.0
    est_bias_pwm: F32 = 0.0
    est_bias_pressure: F32 = 0.0
    offset_us: F32 = 0.0
    prediction_us: F32 = 0.0
    cov_alt: F32 = 0.0
    cov_pwm: F32 = 0.0
    cov_velocity: F32 = 0.0
    ground_effect: U32 = 0
    sum_innovation: F32 = 0.0
    rejected_us: U32 = 0
    u_multisinus: F32 = 0.0
    gaz_altitude: F32 = 0.0
    flag_multisinus: U32 = 0
    flag_multisinus_start: U32 = 0


@option(26)
class Wifi(Struct, frozen=True):
    """Radio link."""

    link_quality: U32 = 0


@option(27)
class Zimmu3000(Struct, frozen=True):
    """Option 27 of firmware up to 2.3."""

    vzimmu_lsb: I32 = 0
    vz_find: F32 = 0.0


@option(27)
class Gps(Struct, frozen=True):
    """Option 27 of firmware 2.4.8 with the flight recorder."""

    lat_deg: F64 = 0.0
    lon_deg: F64 = 0.0
    elevation_m: F64 = 0.0
    hdop: F64 = 0.0
    data_available: I32 = 0
    zero_validated: I32 = 0
    wpt_validated: I32 = 0
    lat0_deg: F64 = 0.0
    lon0_deg: F64 = 0.0
    lat_fused_deg: F64 = 0.0
    lon_fused_deg: F64 = 0.0
    gps_state: U32 = 0
    x_traj: F32 = 0.0
    x_ref: F32 = 0.0
    y_traj: F32 = 0.0
    y_ref: F32 = 0.0
    theta_p: F32 = 0.0
    phi_p: F32 = 0.0
    theta_i: F32 = 0.0
    phi_i: F32 = 0.0
    theta_d: F32 = 0.0
    phi_d: F32 = 0.0
    vdop: F64 = 0.0
    pdop: F64 = 0.0
    speed: F32 = 0.0
    last_frame_timestamp: U32 = 0
    degree: F32 = 0.0
    degree_mag: F32 = 0.0
    ehpe: F32 = 0.0
    ehve: F32 = 0.0
    c_n0: F32 = 0.0
    nb_satellites: U32 = 0
    channels_sat_cn0: Annotated[Ints, "24B"] = (0,) * 24
    """The satellite number and the carrier-to-noise ratio of each of twelve channels."""
    gps_plugged: I32 = 0
    ephemeris_status: U32 = 0
    vx_traj: F32 = 0.0
    vy_traj: F32 = 0.0
    firmware_status: U32 = 0
