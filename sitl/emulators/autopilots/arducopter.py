"""Start ArduCopter on the simulated physics. Source: its own --help and the documentation of its parameters."""

from collections.abc import Mapping
from pathlib import Path

from sitl.emulators.autopilots.ardupilot_json import CURVE
from sitl.emulators.autopilots.px4_hil import Home

DEFAULTS = "decklander.parm"
PARAMETERS: dict[str, float] = {
    # A quad X whose motors are those of `sitl.emulators.autopilots.motors`
    "FRAME_CLASS": 1,
    "FRAME_TYPE": 1,
    "MOT_THST_EXPO": CURVE,
    "MOT_THST_HOVER": 0.48,
    # Gains of its yaw: the airframe yaws weakly, at the default rate gain more slowly than the default angle gain requests, and
    # its heading swings by itself, 10 degrees to either side (ATC_RAT_YAW_P 0.18, ATC_ANG_YAW_P 4.5)
    "ATC_RAT_YAW_P": 0.6,
    "ATC_RAT_YAW_I": 0.06,
    "ATC_ANG_YAW_P": 3.0,
    # Calibration of its simulated compass and accelerometers, so that it arms
    "COMPASS_OFS_X": 5,
    "COMPASS_OFS_Y": 13,
    "COMPASS_OFS_Z": -18,
    "COMPASS_OFS2_X": 5,
    "COMPASS_OFS2_Y": 13,
    "COMPASS_OFS2_Z": -18,
    "COMPASS_OFS3_X": 5,
    "COMPASS_OFS3_Y": 13,
    "COMPASS_OFS3_Z": -18,
    "INS_ACCOFFS_X": 0.001,
    "INS_ACCOFFS_Y": 0.001,
    "INS_ACCOFFS_Z": 0.001,
    "INS_ACCSCAL_X": 1.001,
    "INS_ACCSCAL_Y": 1.001,
    "INS_ACCSCAL_Z": 1.001,
    "INS_ACC2OFFS_X": 0.001,
    "INS_ACC2OFFS_Y": 0.001,
    "INS_ACC2OFFS_Z": 0.001,
    "INS_ACC2SCAL_X": 1.001,
    "INS_ACC2SCAL_Y": 1.001,
    "INS_ACC2SCAL_Z": 1.001,
    "INS_GYR_CAL": 0,
    # Flight without a remote control and without a ground station's heartbeat
    "FS_THR_ENABLE": 0,
    "FS_GCS_ENABLE": 0,
    "DISARM_DELAY": 10,
    # ArduCopter's own simulated lidar, looking down, fed by our `rng_1`
    "RNGFND1_TYPE": 100,
    "RNGFND1_ORIENT": 25,
    "RNGFND1_MIN_CM": 2,
    "RNGFND1_MAX_CM": 4000,
    # The parameters that docs/ardupilot.md recommends
    "PLND_ENABLED": 1,
    "PLND_TYPE": 1,
    "PLND_EST_TYPE": 1,
    "PLND_OPTIONS": 1,
    "PLND_STRICT": 1,
    "PLND_LAG": 0.05,
    "GUID_TIMEOUT": 1,
    "GUID_OPTIONS": 16,
    "PSC_JERK_XY": 20,
    "WPNAV_ACCEL": 500,
    "PSC_ACCZ_FF": 0.48,
    "PSC_JERK_Z": 15,
    "WPNAV_ACCEL_Z": 300,
    "ANGLE_MAX": 4500,
    "LOG_DISARMED": 0,
}
"""The parameters that differ from ArduCopter's defaults."""


def argv(
    binary: Path,
    folder: Path,
    *,
    physics_port: int,
    mavlink_ports: tuple[int, int],
    heading_deg: float = 0.0,
    home: Home | None = None,
    parameters: Mapping[str, float] | None = None,
    speedup: float = 1.0,
) -> list[str]:
    """Return the command line, and write the file of parameters.

    Args:
        physics_port: UDP port on which `serve_json` answers.
        mavlink_ports: UDP ports on the loopback to which its first two MAVLink ports send.
        heading_deg: initial heading of the vehicle.
    """
    at = home or Home()
    defaults = folder / DEFAULTS
    asked = {**PARAMETERS, **(parameters or {})}
    defaults.write_text("".join(f"{name} {value:g}\n" for name, value in asked.items()))
    place = f"{at.latitude_deg:.7f},{at.longitude_deg:.7f},{at.altitude_m:g},{heading_deg:g}"
    first, second = (f"udpclient:127.0.0.1:{port}" for port in mavlink_ports)
    others = [word for n in (2, 5, 6, 7, 8) for word in (f"--serial{n}", f"none:{n}")]
    return [
        str(binary), "--model", "JSON:127.0.0.1", "--sim-address", "127.0.0.1", "--sim-port-out", str(physics_port),
        "--home", place, "--defaults", str(defaults), "--speedup", f"{speedup:g}", "--rc-in-port", "0", "--wipe",
        "--serial0", first, "--serial1", second, *others,
    ]  # fmt: skip
