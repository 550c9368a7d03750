"""Parameters by firmware: which have another name in a later release, often with another unit, and what they are by default.

Rules are written in the names and units of 4.5. Source: ArduPilot, "Parameter Name Changes" (4.5 to 4.6, 4.6 to 4.7).
"""

import functools
import operator
import re
from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

Firmware = tuple[int, int, int]
_CENTI = 0.01  # factor from hundredths
_EQUAL = 1e-5  # difference of two values, as a share, up to which they are equal


class LaterName(NamedTuple):
    """A parameter's later name."""

    name: str
    factor: float
    """Value there of one unit here."""
    since: Firmware


_46, _47 = (4, 6, 0), (4, 7, 0)
RENAMED = {
    "GPS_RATE_MS": LaterName("GPS1_RATE_MS", 1.0, _46),
    "GPS_TYPE": LaterName("GPS1_TYPE", 1.0, _46),
    "GPS_TYPE2": LaterName("GPS2_TYPE", 1.0, _46),
    "LAND_SPEED": LaterName("LAND_SPD_MS", _CENTI, _47),
    "LAND_SPEED_HIGH": LaterName("LAND_SPD_HIGH_MS", _CENTI, _47),
    "LAND_ALT_LOW": LaterName("LAND_ALT_LOW_M", _CENTI, _47),
    "RTL_ALT_FINAL": LaterName("RTL_ALT_FINAL_M", _CENTI, _47),
    "WPNAV_SPEED": LaterName("WP_SPD", _CENTI, _47),
    "WPNAV_SPEED_UP": LaterName("WP_SPD_UP", _CENTI, _47),
    "WPNAV_SPEED_DN": LaterName("WP_SPD_DN", _CENTI, _47),
    "WPNAV_ACCEL": LaterName("WP_ACC", _CENTI, _47),
    "WPNAV_ACCEL_Z": LaterName("WP_ACC_Z", _CENTI, _47),
    "LOIT_SPEED": LaterName("LOIT_SPEED_MS", _CENTI, _47),
    "ANGLE_MAX": LaterName("ATC_ANGLE_MAX", _CENTI, _47),
    "RNGFND1_MAX_CM": LaterName("RNGFND1_MAX", _CENTI, _47),
    "RNGFND1_MIN_CM": LaterName("RNGFND1_MIN", _CENTI, _47),
    "PSC_JERK_XY": LaterName("PSC_JERK_NE", 1.0, _47),
    "PSC_JERK_Z": LaterName("PSC_JERK_D", 1.0, _47),
    "PSC_VELXY_P": LaterName("PSC_NE_VEL_P", 1.0, _47),
    "PSC_VELXY_I": LaterName("PSC_NE_VEL_I", 1.0, _47),
    "PSC_VELXY_FLTE": LaterName("PSC_NE_VEL_FLTE", 1.0, _47),
    "PSC_VELZ_P": LaterName("PSC_D_VEL_P", 1.0, _47),
    "PSC_VELZ_FLTE": LaterName("PSC_D_VEL_FLTE", 1.0, _47),
    "PSC_ACCZ_P": LaterName("PSC_D_ACC_P", 0.1, _47),
    "PSC_ACCZ_FF": LaterName("PSC_D_ACC_FF", 0.1, _47),
    "PSC_ACCZ_FLTE": LaterName("PSC_D_ACC_FLTE", 1.0, _47),
}


_SINCE: dict[str, Firmware] = {"ARMING_SKIPCHK": _47}
"""Parameters that earlier releases do not have."""


class NamedValue(NamedTuple):
    """A parameter as the firmware has it."""

    name: str
    """Its name there."""
    value: float
    """Its value in the unit that rules are written in."""
    factor: float
    """Value there of one unit of the rules."""

    def there(self, value: float) -> float:
        """Return a value in the unit of the firmware."""
        return round(value * self.factor, 6)


def named_value(parameters: Mapping[str, float], name: str) -> NamedValue | None:
    """Return a parameter under whichever name the firmware has it; None if it was not read."""
    if name in parameters:
        return NamedValue(name, parameters[name], 1.0)
    later = RENAMED.get(name)
    if later is None or later.name not in parameters:
        return None
    # Four decimals: what a firmware keeps in 32 bits is not exactly a hundredth of what the rule says.
    return NamedValue(later.name, round(parameters[later.name] / later.factor, 4), later.factor)


def names_in(names: Iterable[str], firmware: Firmware | None, read: Collection[str] = ()) -> tuple[str, ...]:
    """Return the names that a firmware has for these parameters; those of 4.5 where its version is not known.

    Args:
        read: names that the autopilot or a file has, which decide before the release does.
    """
    out = []
    for name in names:
        if firmware is not None and firmware < _SINCE.get(name, firmware):
            continue
        later = RENAMED.get(name)
        if later is None or name in read:
            out.append(name)
        else:
            out.append(later.name if later.name in read or (firmware is not None and firmware >= later.since) else name)
    return tuple(out)


def earlier_names(absent: Iterable[str]) -> tuple[str, ...]:
    """Return the earlier names of parameters that a firmware does not know: a development build has them for a year or more."""
    earlier = {later.name: name for name, later in RENAMED.items()}
    return tuple(earlier[name] for name in absent if name in earlier)


_ARDUPILOT: dict[str, float] = {
    # modes and what takes the vehicle
    "GUID_OPTIONS": 0, "GUID_TIMEOUT": 3, "FLTMODE_GCSBLOCK": 0, "FS_THR_ENABLE": 1, "FS_GCS_ENABLE": 0, "FS_OPTIONS": 16,
    "FS_EKF_ACTION": 1, "FS_EKF_THRESH": 0.8, "FS_CRASH_CHECK": 1, "FS_VIBE_ENABLE": 1, "FS_DR_ENABLE": 2, "FENCE_ENABLE": 0,
    "BATT_FS_LOW_ACT": 0, "BATT_FS_CRT_ACT": 0, "RTL_ALT_FINAL": 0, "ARMING_CHECK": 1, "SCR_ENABLE": 0,
    # precision landing
    "PLND_ENABLED": 0, "PLND_TYPE": 0, "PLND_EST_TYPE": 1, "PLND_LAG": 0.02, "PLND_OPTIONS": 0, "PLND_STRICT": 1,
    "PLND_ORIENT": 25, "PLND_YAW_ALIGN": 0, "PLND_ALT_MAX": 8, "PLND_XY_DIST_MAX": 2.5,
    # time limits and speeds
    "DISARM_DELAY": 10, "FS_GCS_TIMEOUT": 5, "FS_DR_TIMEOUT": 30, "RTL_LOIT_TIME": 5000, "LAND_SPEED": 50, "LAND_SPEED_HIGH": 0,
    "LAND_ALT_LOW": 1000, "WPNAV_SPEED": 1000, "WPNAV_SPEED_UP": 250, "WPNAV_SPEED_DN": 150, "WPNAV_ACCEL": 250,
    "WPNAV_ACCEL_Z": 100, "ANGLE_MAX": 3000,
    # sources of the EKF
    "AHRS_EKF_TYPE": 3, "EK3_ENABLE": 1, "EK3_SRC1_POSXY": 3, "EK3_SRC1_VELXY": 3, "EK3_SRC1_POSZ": 1, "EK3_SRC1_VELZ": 3,
    "EK3_SRC1_YAW": 1, "EK3_RNG_USE_HGT": -1, "EK3_GPS_CHECK": 31, "EK3_HGT_DELAY": 60, "EK3_VELNE_M_NSE": 0.3,
    "EK3_VELD_M_NSE": 0.5, "EK3_POSNE_M_NSE": 0.5,
    # loops
    "SCHED_LOOP_RATE": 400, "PSC_POSXY_P": 1, "PSC_VELXY_P": 2, "PSC_VELXY_I": 1, "PSC_POSZ_P": 1, "PSC_VELZ_P": 5,
    "PSC_ACCZ_P": 0.5, "PSC_ACCZ_I": 1, "PSC_ACCZ_FF": 0, "PSC_JERK_XY": 5, "PSC_JERK_Z": 5, "ATC_INPUT_TC": 0.15,
    "ATC_ANG_RLL_P": 4.5, "ATC_ANG_PIT_P": 4.5, "ATC_RAT_RLL_P": 0.135, "ATC_RAT_PIT_P": 0.135, "ATC_RATE_R_MAX": 0,
    "ATC_RATE_P_MAX": 0, "INS_ACCEL_FILTER": 20, "INS_GYRO_FILTER": 20, "MOT_SPIN_MIN": 0.15, "MOT_SPOOL_TIME": 0.5,
    "MOT_SLEW_UP_TIME": 0,
}  # fmt: skip
_PX4: dict[str, float] = {
    # modes and what takes the vehicle
    "COM_OBL_RC_ACT": 0, "COM_RC_IN_MODE": 3, "COM_RC_OVERRIDE": 1, "COM_RCL_EXCEPT": 0, "COM_DLL_EXCEPT": 0,
    "COM_LOW_BAT_ACT": 0, "COM_WIND_MAX": -1, "COM_POS_FS_EPH": 5,
    "COM_VEL_FS_EVH": 1, "NAV_RCL_ACT": 2, "NAV_DLL_ACT": 0, "GF_ACTION": 2,
    "GF_MAX_HOR_DIST": 0, "GF_MAX_VER_DIST": 0, "RTL_LAND_DELAY": 0, "RTL_PLD_MD": 0, "FD_FAIL_R": 60, "FD_FAIL_P": 60,
    # time limits and speeds
    "COM_FLT_TIME_MAX": -1, "COM_OF_LOSS_T": 1, "COM_RC_LOSS_T": 0.5, "COM_DL_LOSS_T": 10, "COM_FAIL_ACT_T": 5,
    "COM_DISARM_LAND": 2, "COM_DISARM_PRFLT": 10, "COM_SPOOLUP_TIME": 1, "LNDMC_Z_VEL_MAX": 0.25, "LNDMC_XY_VEL_MAX": 1.5,
    "LNDMC_TRIG_TIME": 1, "LNDMC_ROT_MAX": 20, "MPC_XY_VEL_MAX": 12, "MPC_Z_VEL_MAX_UP": 3, "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_LAND_SPEED": 0.7, "MPC_TILTMAX_AIR": 45, "MPC_TILTMAX_LND": 12, "MPC_TKO_RAMP_T": 3,
    # sources of the EKF
    "EKF2_EN": 1, "EKF2_IMU_CTRL": 7, "EKF2_GPS_CTRL": 7, "EKF2_BARO_CTRL": 1, "EKF2_RNG_CTRL": 1, "EKF2_EV_CTRL": 0,
    "EKF2_HGT_REF": 1, "EKF2_MAG_TYPE": 0, "EKF2_GPS_CHECK": 245, "EKF2_REQ_GPS_H": 10, "EKF2_GPS_DELAY": 110,
    "SYS_HAS_GPS": 1, "SYS_HAS_MAG": 1, "SYS_HAS_BARO": 1,
    # loops
    "MPC_XY_P": 0.95, "MPC_Z_P": 1, "MPC_XY_VEL_P_ACC": 1.8, "MPC_XY_VEL_I_ACC": 0.4, "MPC_XY_VEL_D_ACC": 0.2,
    "MPC_Z_VEL_P_ACC": 4, "MPC_Z_VEL_I_ACC": 2, "MPC_THR_MIN": 0.12, "MPC_THR_MAX": 1, "MPC_USE_HTE": 1, "MC_ROLL_P": 6.5,
    "MC_PITCH_P": 6.5, "MC_ROLLRATE_P": 0.15, "MC_PITCHRATE_P": 0.15, "MC_ROLLRATE_MAX": 220, "MC_PITCHRATE_MAX": 220,
    "MC_YAWRATE_MAX": 200, "IMU_GYRO_CUTOFF": 40, "IMU_DGYRO_CUTOFF": 30, "IMU_ACCEL_CUTOFF": 30, "IMU_GYRO_RATEMAX": 400,
}  # fmt: skip
PX4_SINCE: dict[Firmware, dict[str, float]] = {
    (1, 16, 0): {"EKF2_GPS_CHECK": 1023},
    (1, 17, 0): {"EKF2_GPS_CHECK": 2047, "IMU_DGYRO_CUTOFF": 20, "MC_ROLL_P": 4, "MC_PITCH_P": 4},
}
"""Defaults of PX4 that a later release changed."""
_TOUCHES = re.compile(
    r"AHRS_EKF_TYPE|ANGLE_MAX|ARMING_|ATC_|BATT\d?_FS_|COM_(?!FLIGHT_UUID)|DISARM_DELAY|EK3_|EKF2_|FD_|FENCE_|FLTMODE|FS_|GF_|GUID_|"
    r"IMU_(GYRO|DGYRO|ACCEL)_|INS_(GYRO|ACCEL)_FILTER|INS_HNTC|LAND_|LNDMC_|LOIT_|MC_|MOT_(SPIN|SPOOL|SLEW)|MPC_|NAV_|PILOT_|PLND_|"
    r"PSC_|RTL_|SCHED_LOOP|SCR_ENABLE|SYS_HAS_|VTE_|WPNAV_|WP_"
)
"""The names of parameters that touch modes, time limits, the EKF's sources or loops."""


def defaults_of(stack: str, firmware: Firmware | None, read: Collection[str] = ()) -> dict[str, float]:
    """Return the known defaults of a firmware under its own names and in its own units; none of another stack.

    Args:
        read: names that the autopilot knew, which decide before its release does.
    """
    if stack == "ArduPilot":
        out = {}
        for name, default in _ARDUPILOT.items():
            (own,) = names_in((name,), firmware, read) or (name,)
            out[own] = default if own == name else round(default * RENAMED[name].factor, 6)
        return out
    if stack != "PX4":
        return {}
    later = [changed for since, changed in PX4_SINCE.items() if firmware is not None and firmware >= since]
    return functools.reduce(operator.or_, later, _PX4)


def differing(parameters: Mapping[str, float], defaults: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Return the value and the default of each parameter that a landing may feel and that is not as the firmware begins."""
    return {
        name: (value, default)
        for name, value in sorted(parameters.items())
        if (default := defaults.get(name)) is not None
        and _TOUCHES.match(name) is not None
        and abs(value - default) > _EQUAL * max(1.0, abs(default))
    }
