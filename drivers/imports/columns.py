"""The columns of log messages that become samples. Each is read, or has a reason, and values that mean "not measured".

A reader takes a column through `cell`, so that none is read without its row; columns that have no row are reported (`unknown`).
Source: ArduPilot's log messages, Copter 3.1 to 4.6; the topics of PX4 v1.7 to v1.16. Arrays are named without their index.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from drivers.mavlink.fields import Read

Rows = dict[str, Read | str]


def _rows(read: str, absent: Mapping[str, tuple[float, ...]], left: Mapping[str, str]) -> Rows:
    """Return the rows of columns that are read, of those with values that mean "not measured", and of others by the reason."""
    others = {name: why for why, names in left.items() for name in names.split()}
    return {**{name: Read() for name in read.split()}, **{name: Read(values) for name, values in absent.items()}, **others}


_TEMPERATURE, _DEMAND, _PLACE = "no bias is modelled by temperature", "what was demanded", "a place from the log's own origin"
_COUNTS, _OTHER_STAMP = "a reading counts or not by itself", "the message has a stamp"
_EKF = _rows("TimeUS TimeMS C VN VE VD", {}, {
    "ATT has the attitude in use": "Roll Pitch Yaw",
    _PLACE: "PN PE PD dPD OH",
    "the gyro's bias is estimated again": "GX GY GZ",
})  # fmt: skip
_PRIMARY = _rows("TimeUS TimeMS C", {"PI": (-1, 255)}, {
    "the doctor reads them": "SV SP SH SM SMX SMY SMZ SVT errRP OFN OFE EFE FS TS SS GPS",
})  # fmt: skip
DATAFLASH: dict[str, Rows] = {
    "IMU": _rows("TimeUS TimeMS I GyrX GyrY GyrZ AccX AccY AccZ", {"GH": (0,), "AH": (0,)}, {
        _COUNTS: "EG EA ErrG ErrA",
        _TEMPERATURE: "T Temp",
        "the rate of its sampling": "GHz AHz",
    }),
    "ATT": _rows("TimeUS TimeMS Roll Pitch Yaw", {"AEKF": (0,)}, {
        _DEMAND: "DesRoll DesPitch DesYaw RollIn PitchIn YawIn NavYaw",
        "the errors of another estimator": "ErrRP ErrYaw",
    }),
    "BARO": _rows("TimeUS TimeMS I Alt", {"Health": (0,), "H": (0,), "Press": (0,)}, {
        _TEMPERATURE: "Temp GndTemp",
        "heights are compared with the pad's": "AltAMSL CRt Offset CPress",
        _OTHER_STAMP: "SMS",
    }),
    "RFND": _rows("TimeUS TimeMS Instance Dist Orient Dist1 Orient1 Dist2 Orient2", {"Quality": (0,)}, {})
    | {name: Read((0, 1, 2, 3)) for name in ("Stat", "Stat1", "Stat2")},
    "EV": _rows("TimeUS TimeMS Id", {}, {}),
    **dict.fromkeys(("XKF1", "NKF1", "EKF1"), _EKF),
    **dict.fromkeys(("XKF4", "NKF4"), _PRIMARY),
}  # fmt: skip

ULOG: dict[str, Rows] = {
    "sensor_combined": _rows("timestamp gyro_rad accelerometer_m_s2", {"accelerometer_timestamp_relative": (0x7FFFFFFF,)}, {
        "the mean of an interval has no delay worth it": "gyro_integral_dt accelerometer_integral_dt",
        "the doctor counts it": "accelerometer_clipping gyro_clipping",
        _COUNTS: "accel_calibration_count gyro_calibration_count",
        "vehicle_air_data has the height; the heading is fused": "magnetometer_timestamp_relative magnetometer_ga"
        " baro_timestamp_relative baro_alt_meter baro_temp_celcius",
    }),
    "vehicle_attitude": _rows("timestamp q", {}, {
        _OTHER_STAMP: "timestamp_sample",
        "the gyro's own topic comes faster": "rollspeed pitchspeed yawspeed",
        _COUNTS: "delta_q_reset quat_reset_counter",
    }),
    "vehicle_local_position": _rows("timestamp vx vy vz evh evv", {"v_xy_valid": (0,), "v_z_valid": (0,)}, {
        _OTHER_STAMP: "timestamp_sample ref_timestamp surface_bottom_timestamp",
        _PLACE: "x y z z_deriv xy_valid z_valid ref_lat ref_lon ref_alt eph epv xy_global z_global",
        "steps are found by the estimator": "delta_xy delta_z delta_vxy delta_vz delta_heading delta_dist_bottom xy_reset_counter"
        " z_reset_counter vxy_reset_counter vz_reset_counter heading_reset_counter dist_bottom_reset_counter",
        "the attitude has it": "yaw heading heading_var unaided_heading heading_good_for_control tilt_var",
        "the accelerometer has it": "ax ay az",
        "distance_sensor has it": "dist_bottom dist_bottom_rate dist_bottom_var dist_bottom_valid dist_bottom_sensor_bitfield",
        "its sigma grows then": "dead_reckoning",
        "limits of its own": "vxy_max vz_max hagl_min hagl_max hagl_max_z hagl_max_xy",
    }),
    "distance_sensor": _rows("timestamp min_distance max_distance current_distance orientation", {
        "signal_quality": (0,), "mode": (2,), "variance": (0,),
    }, {
        "the instance distinguishes sensors of one direction": "device_id id type",
        "as it looks down, its width is small": "h_fov v_fov q",
        "a number of old firmware without a unit": "covariance",
    }),
    "vehicle_air_data": _rows("timestamp baro_alt_meter", {"baro_pressure_pa": (0,)}, {
        _OTHER_STAMP: "timestamp_sample",
        "the vehicle has chosen one": "baro_device_id calibration_count",
        _TEMPERATURE: "baro_temp_celcius ambient_temperature temperature_source rho eas2tas",
    }),
    "vehicle_land_detected": _rows("timestamp landed", {}, {
        "landed is made of them": "freefall ground_contact maybe_landed at_rest has_low_throttle vertical_movement in_descend"
        " horizontal_movement rotational_movement close_to_ground_or_skipped_check in_ground_effect",
        "a limit of its own": "alt_max",
    }),
}  # fmt: skip


def cell(rows: Rows, name: str, value: Any) -> Any:
    """Return the value of a column that is read; None for one that means "not measured".

    Raises:
        KeyError: the column has no row, or it is not read.
    """
    row = rows[name]
    if not isinstance(row, Read):
        raise KeyError(f"{name} is not read: {row}")
    return None if value in row.absent else value


def unknown(rows: Rows, names: Iterable[str]) -> list[str]:
    """Return the columns of a log that have no row."""
    return sorted({name.partition("[")[0] for name in names} - rows.keys())
