"""Take a snapshot from an autopilot's flight log: what it holds of the setup, so that the same rules judge it afterwards."""

from __future__ import annotations

from pathlib import Path

from companion.tools.doctor.diagnose import PARAMETERS
from companion.tools.doctor.renamed import names_in
from companion.tools.doctor.snapshot import AutopilotSnapshot, Snapshot
from drivers.imports import dataflash, dataflash_history, px4_ulog, ulog_history
from drivers.imports.log_history import AutopilotLog
from estimator.contracts.errors import BadInput

_MANY = 100
"""A log with so many parameters holds all of them: one that is missing is not in the firmware."""
_COPTER = "ArduCopter"


def examine_log(path: Path) -> Snapshot:
    """Return the snapshot of a dataflash log (.bin) or a PX4 log (.ulg), told apart by its first bytes.

    Raises:
        BadInput: the file cannot be read, is neither, or is of a vehicle that cannot hover.
    """
    try:
        with path.open("rb") as file:
            head = file.read(len(px4_ulog.MAGIC))
    except OSError as why:
        raise BadInput(f"{path}: {why.strerror or why}") from why
    if head.startswith(dataflash.MAGIC):
        return _snapshot(path, dataflash_history.read_history(path))
    if head == px4_ulog.MAGIC:
        return _snapshot(path, ulog_history.read_history(path))
    raise BadInput(f"{path}: neither a dataflash log (.bin) nor a PX4 log (.ulg)")


def _snapshot(path: Path, log: AutopilotLog) -> Snapshot:
    if log.vehicle not in (None, _COPTER):
        raise BadInput(f"{path}: it is a log of {log.vehicle}, and no rule knows that vehicle")
    asked = names_in(PARAMETERS[log.stack], log.firmware)
    system = next((int(log.parameters[n]) for n in ("SYSID_THISMAV", "MAV_SYSID", "MAV_SYS_ID") if n in log.parameters), 1)
    return Snapshot(
        0.0,
        autopilot=AutopilotSnapshot(
            stack="ArduPilot" if log.stack == "ArduPilot" else "PX4",
            system=system,
            firmware=log.firmware,
            mode="auto.precland" if log.precision_landing else "unknown",
            parameters={n: v for n, v in log.parameters.items() if n in asked},
            absent=tuple(n for n in asked if n not in log.parameters) if len(log.parameters) >= _MANY else (),
            texts=log.texts,
            events=log.events,
        ),
        log=log.history,
    )
