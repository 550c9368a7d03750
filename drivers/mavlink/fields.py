"""The fields of MAVLink messages that become samples. Each is read, or has a reason, and values that mean "not measured".

A sensor that is not fitted is reported by a placeholder, and two sensors of one kind differ in one field alone. A test compares
the table with the dialect's definitions and with what is read. NaN is no measurement in any field, as each has a range;
readings that never move are found by the estimator (`frozen`, docs/estimator.md).
Source: mavlink.io, common message set; ArduPilot's GCS_MAVLINK and PX4's mavlink streams for what they send without a sensor.
"""

from msgspec import Struct

from drivers.mavlink.dialect import Message, mav

U8 = 0xFF
"""Largest value of a byte, which stands for "not known"."""
U16 = 0xFFFF
"""Largest value of two bytes, which stands for "not known"."""
I16, I32 = (-0x8000, 0x7FFF), (-0x80000000, 0x7FFFFFFF)
"""The ends of a wire type: placeholders, and where a value that did not fit was cut off."""


class Read(Struct, frozen=True):
    """A field that is read."""

    absent: tuple[float, ...] = ()
    """Values that mean "not measured"."""


_R, _R16, _R32 = Read(), Read(I16), Read(I32)
_TIME = dict.fromkeys(("time_boot_ms",), _R)
_FOR_ANYBODY = dict.fromkeys(("target_system", "target_component"), "a report is true for every receiver")
_OTHER = "nothing here depends on it"
_ANGLE_RATES = dict.fromkeys(("rollspeed", "pitchspeed", "yawspeed"), "the gyro's own message comes faster and without a filter")
_MAGNETIC = dict.fromkeys(("xmag", "ymag", "zmag"), "the autopilot's heading is fused, which has the compass in it")
_TEMPERATURE = "no bias is modelled by temperature"
_HEALTH = tuple(f"onboard_control_sensors_{of}{more}" for of in ("present", "enabled", "health") for more in ("", "_extended"))
_INERTIAL = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro")

FIELDS: dict[str, dict[str, Read | str]] = {
    "HEARTBEAT": {
        "type": "read by `vehicle.stack_of` and `is_autopilot`, before there is a sampler",
        "autopilot": "likewise",
        "base_mode": _R,
        "custom_mode": _R,
        "system_status": Read((mav.MAV_STATE_UNINIT,)),
        "mavlink_version": "the frame itself says it",
    },
    "EXTENDED_SYS_STATE": {
        "vtol_state": "a QuadPlane's mode says whether it hovers",
        "landed_state": Read((mav.MAV_LANDED_STATE_UNDEFINED,)),
    },
    "SYS_STATUS": {
        **dict.fromkeys(_HEALTH, "sensors are judged by what they send; the remote's bits are read by `rc_switch`"),
        "load": _OTHER,
        "voltage_battery": Read((0, U16)),
        "current_battery": _OTHER,
        "battery_remaining": Read((-1,)),
        "drop_rate_comm": "links are judged by what arrives here",
        **dict.fromkeys(("errors_comm", *(f"errors_count{n}" for n in range(1, 5))), _OTHER),
    },
    "ATTITUDE_QUATERNION": {
        **_TIME,
        **dict.fromkeys(("q1", "q2", "q3", "q4"), _R),
        **_ANGLE_RATES,
        "repr_offset_q": "it turns what a pilot is shown (tailsitters), not the body",
    },
    "ATTITUDE": {**_TIME, **dict.fromkeys(("roll", "pitch", "yaw"), _R), **_ANGLE_RATES},
    "LOCAL_POSITION_NED": {**_TIME, **dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"), _R)},
    "GLOBAL_POSITION_INT": {
        **_TIME,
        "lat": _R32,
        "lon": _R32,
        "alt": _R32,
        "relative_alt": "it is above the place of arming, which is a deck that moves",
        "vx": _R16,
        "vy": _R16,
        "vz": _R16,
        "hdg": Read((U16,)),
    },
    "RAW_IMU": {"time_usec": _R, **dict.fromkeys(_INERTIAL, _R16), **_MAGNETIC, "id": _R, "temperature": _TEMPERATURE},
    "HIGHRES_IMU": {
        "time_usec": _R,
        **dict.fromkeys(_INERTIAL, _R),
        **_MAGNETIC,
        "abs_pressure": Read((0,)),
        "diff_pressure": "air speed",
        "pressure_alt": "it is made of the pressure, by an atmosphere that may be another",
        "temperature": _TEMPERATURE,
        "fields_updated": _R,
        "id": _R,
    },
    "FENCE_STATUS": {
        "breach_status": _R,
        **dict.fromkeys(("breach_count", "breach_type", "breach_time", "breach_mitigation"), "every breach is reported alike"),
    },
    "EVENT": {
        "destination_component": "an event for another receiver is true as well",
        "destination_system": "likewise",
        "id": _R,
        "event_time_boot_ms": "a failsafe counts from its arrival",
        "sequence": "a lost event is not requested again: the heartbeat has the state",
        "log_levels": "the events that are read are named one by one",
        "arguments": _R,
    },
    "DISTANCE_SENSOR": {
        **_TIME,
        "min_distance": _R,
        "max_distance": _R,
        "current_distance": Read((0, U16)),
        "type": "`id` distinguishes sensors of one direction",
        "id": _R,
        "orientation": _R,
        "covariance": Read((0, U8)),
        "horizontal_fov": "0 from nearly every sensor",
        "vertical_fov": "likewise",
        "quaternion": "only with an orientation of one's own, which is not taken to look down",
        "signal_quality": Read((1,)),
    },
    "SCALED_PRESSURE": {
        **_TIME,
        "press_abs": Read((0,)),
        "press_diff": "air speed",
        "temperature": _TEMPERATURE,
        "temperature_press_diff": "air speed",
    },
    "FOLLOW_TARGET": {
        "timestamp": _R,
        "est_capabilities": _R,
        "lat": _R32,
        "lon": _R32,
        "alt": _R,
        "vel": _R,
        "acc": "the ship's motion is estimated here",
        "attitude_q": "a phone's or a beacon's attitude is not the ship's",
        "rates": "likewise",
        "position_cov": Read((0,)),
        "custom_state": "every sender has one of its own",
    },
    "GIMBAL_DEVICE_ATTITUDE_STATUS": {
        **_FOR_ANYBODY,
        **_TIME,
        "flags": _R,
        "q": _R,
        **dict.fromkeys(("angular_velocity_x", "angular_velocity_y", "angular_velocity_z"), "the attitude comes fast enough"),
        "failure_flags": _R,
        "delta_yaw": Read((0,)),
        "delta_yaw_velocity": "the attitude comes fast enough",
        "gimbal_device_id": _R,
    },
    "MOUNT_ORIENTATION": {**_TIME, **dict.fromkeys(("roll", "pitch", "yaw", "yaw_absolute"), _R)},
    "MOUNT_STATUS": {
        **_FOR_ANYBODY,
        **dict.fromkeys(("pointing_a", "pointing_b", "pointing_c"), _R),
        "mount_mode": "the angles are reported in every mode",
    },
}  # fmt: skip


def measured(message: Message, name: str) -> float | None:
    """Return the value of a field that is read; None for one that means "not measured"."""
    value, row = getattr(message, name), FIELDS[message.get_type()][name]
    return None if isinstance(row, Read) and value in row.absent else value
