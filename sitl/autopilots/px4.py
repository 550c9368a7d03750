"""How PX4 is started on our physics. Source: PX4 1.16, ROMFS/px4fmu_common/init.d-posix (rcS, px4-rc.simulator, px4-rc.mavlink).

Its ports are fixed: it calls 4560 for the physics, speaks to companions on 14540 and to ground stations on 14550.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from estimator.contracts.errors import BadInput
from sitl.autopilots.program import GUIDE
from sitl.autopilots.px4_hil import PORT, Home

PHYSICS_PORT = PORT
MAVLINK_PORTS = (14540, 14550)
STEP_S = 0.004
"""IMU_INTEG_RATE is set to 250 Hz where it is simulated."""
PARAMETERS: dict[str, float] = {
    # Without a remote control; a lost ground station does nothing
    "COM_RC_IN_MODE": 4,
    "NAV_DLL_ACT": 0,
    "COM_OF_LOSS_T": 1.0,
    "COM_OBL_RC_ACT": 5,
    # Thrust goes linearly with the command, as in our motors
    "THR_MDL_FAC": 0.0,
    "MPC_THR_HOVER": 0.48,
}


def start(
    binary: Path, *, height_m: float, home: Home | None = None, parameters: Mapping[str, float] | None = None
) -> tuple[list[str], dict[str, str]]:
    """The command line and what is added to the environment.

    Args:
        height_m: that AUTO.TAKEOFF climbs to.

    Raises:
        BadInput: its start-up files do not lie where a build puts them.
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
