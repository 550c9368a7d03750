"""Read a file of parameters as ground stations keep them: `NAME,VALUE`, `NAME VALUE`, or QGroundControl's table with tabs."""

import math
import re
from pathlib import Path

from drivers.imports.log_history import AutopilotLog, LogHistory
from estimator.contracts.errors import BadInput

_PX4_NAMES = re.compile(r"MAV_SYS_ID|(COM|MPC|EKF2|CAL|SENS|NAV|LNDMC|RTL|CBRK|MC|IMU)_")
_ARDUPILOT_NAMES = re.compile(r"SYSID_|MAV_SYSID|FRAME_CLASS|(INS|EK3|ATC|PSC|PLND|GUID|LAND|WPNAV|ARMING|SERVO\d+|RC\d+)_")


def read_history(path: Path) -> AutopilotLog:
    """Return the parameters as a log that holds nothing else; the stack is what the file says, or its names tell.

    Raises:
        BadInput: the file cannot be read, or no line of it is a parameter.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as why:
        raise BadInput(f"{path}: {why.strerror or why}") from why
    parameters: dict[str, float] = {}
    for line in lines:
        if (found := _parameter(line)) is not None:
            parameters[found[0]] = found[1]
    if not parameters:
        raise BadInput(f"{path}: no line of it is a parameter")
    comments = " ".join(line for line in lines[:40] if line.startswith("#"))
    said = re.search(r"Stack:\s*(PX4|ArduPilot)", comments)
    px4 = sum(_PX4_NAMES.match(name) is not None for name in parameters)
    ardupilot = sum(_ARDUPILOT_NAMES.match(name) is not None for name in parameters)
    stack = said[1] if said is not None else "PX4" if px4 > ardupilot else "ArduPilot"
    version = re.search(r"Version:\s*(\d+)\.(\d+)\.(\d+)", comments)
    firmware = None if version is None else (int(version[1]), int(version[2]), int(version[3]))
    return AutopilotLog(stack, None, firmware, dict(sorted(parameters.items())), (), (), LogHistory(0.0))


def _parameter(line: str) -> tuple[str, float] | None:
    words = re.split(r"[\s,=]+", line.split("#")[0].strip())
    if len(words) >= 4 and words[0].isdigit() and words[1].isdigit():
        words = words[2:]
    if len(words) < 2 or re.fullmatch(r"[A-Z][A-Z0-9_]{0,15}", words[0]) is None:
        return None
    try:
        value = float(words[1])
    except ValueError:
        return None
    return (words[0], value) if math.isfinite(value) else None
