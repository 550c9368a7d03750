"""Start PX4 on the simulated physics.

PX4's ports are fixed: it connects to 4560 for the physics, and sends to companions on 14540 and to ground stations on 14550.

Source: PX4 1.16, ROMFS/px4fmu_common/init.d-posix (rcS, px4-rc.simulator, px4-rc.mavlink).
"""

from collections.abc import Mapping
from pathlib import Path

from estimator.contracts.errors import BadInput
from sitl.emulators.autopilots.program import GUIDE
from sitl.emulators.autopilots.px4_hil import PORT, Home

PHYSICS_PORT = PORT
MAVLINK_PORTS = (14540, 14550)
STEP_S = 0.004
"""Step of the physics, s: PX4's start-up files set IMU_INTEG_RATE to 250 Hz in simulation."""
PARAMETERS: dict[str, float] = {
    # Flight without a remote control; the loss of a ground station has no effect
    "COM_RC_IN_MODE": 4,
    "NAV_DLL_ACT": 0,
    "COM_OF_LOSS_T": 1.0,
    "COM_OBL_RC_ACT": 5,
    # Without the checks that compare GNSS with a vehicle at rest: a ship under way is not at rest (docs/px4.md)
    "EKF2_GPS_CHECK": 21,
    # Thrust is linear in the command, as for the simulated motors
    "THR_MDL_FAC": 0.0,
    "MPC_THR_HOVER": 0.48,
}


def start(
    binary: Path, *, height_m: float, home: Home | None = None, parameters: Mapping[str, float] | None = None
) -> tuple[list[str], dict[str, str]]:
    """Return the command line and the variables to add to the environment.

    Args:
        height_m: height to which AUTO.TAKEOFF climbs.

    Raises:
        BadInput: the start-up files are not where PX4's build puts them.
    """
    etc = binary.parent.parent / "etc"
    if not (etc / "init.d-posix" / "rcS").is_file():
        raise BadInput(
            f"--binary: there is no {etc / 'init.d-posix' / 'rcS'}; PX4 needs its build's etc beside bin (see {GUIDE})"
        )
    at = home or Home()
    asked = {**PARAMETERS, "MIS_TAKEOFF_ALT": height_m, **(parameters or {})}
    environment = {
        "PX4_SIM_MODEL": "none_iris",
        "PX4_SYS_AUTOSTART": "10016",
        "PX4_SIM_HOSTNAME": "127.0.0.1",
        "PX4_HOME_LAT": f"{at.latitude_deg:.7f}",
        "PX4_HOME_LON": f"{at.longitude_deg:.7f}",
        "PX4_HOME_ALT": f"{at.altitude_m:g}",
        **{f"PX4_PARAM_{name}": f"{value:g}" for name, value in asked.items()},
    }
    return [str(binary), "-d", "-i", "0", str(etc)], environment
