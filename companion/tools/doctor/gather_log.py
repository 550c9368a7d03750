"""Take a snapshot of an autopilot from its flight log. It judges nothing."""

import contextlib
import sys
from collections.abc import Callable
from pathlib import Path

from msgspec import structs

from companion.tools.doctor.diagnose import PARAMETERS
from companion.tools.doctor.firmware_parameters import differing, names_in
from companion.tools.doctor.snapshot import AutopilotSnapshot, Snapshot
from drivers.imports import dataflash, px4_ulog, tlog
from drivers.imports.kinds import FileKind, kind_of
from drivers.imports.log_history import AutopilotLog, parameters_of
from drivers.imports.stamps import Tell
from estimator.contracts.errors import BadInput

_MANY = 100
"""A log with this many parameters holds all of them: one that is missing is not in the firmware."""
_COPTER = "ArduCopter"


def examine_log(path: Path) -> Snapshot:
    """Return the snapshot of a flight log, a telemetry log or a file of parameters, distinguished by their content.

    Raises:
        BadInput: the file cannot be read, is none of them, or is of a vehicle that cannot hover.
    """
    kind, notes = kind_of(path), list[str]()
    if kind is FileKind.PARAMETERS:
        return structs.replace(_log_snapshot(path, parameters_of(path)), log=None)
    if kind not in _HISTORIES:
        raise BadInput(
            f"{path}: {kind.value}, and neither a dataflash log (.bin, .log), a PX4 log (.ulg), a telemetry log (.tlog) nor a "
            "file of parameters"
        )
    with contextlib.redirect_stdout(sys.stderr):  # parsers print what they meet, and standard output is for findings
        log = _HISTORIES[kind](path, notes.append)
    return _log_snapshot(path, structs.replace(log, history=structs.replace(log.history, notes=tuple(notes))))


_HISTORIES: dict[FileKind, Callable[[Path, Tell], AutopilotLog]] = {
    FileKind.ULOG: px4_ulog.read_history, FileKind.DATAFLASH: dataflash.read_history, FileKind.TLOG: tlog.read_history,
}  # fmt: skip


def _log_snapshot(path: Path, log: AutopilotLog) -> Snapshot:
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
            texts=_standing(log),
            events=log.events,
            differs=differing(log.parameters, log.defaults),
        ),
        log=log.history,
    )


_NEAR_DECK_S = 10.0
"""Time before a landing in which targets may end: the pad leaves the picture, and none are sent on the ground."""


def _standing(log: AutopilotLog) -> tuple[str, ...]:
    """Return the texts of a log but those of ArduPilot's precision landing that a later one takes back.

    Its estimate is begun by the first target, whether or not somebody ordered a landing. What came well before the contact is
    no fault of the landing, and a target that is lost just before a landing, or after it, is none at all.
    """
    out, begun = [], False
    for text, at_s in reversed(tuple(zip(log.texts, log.text_times_s, strict=True))):
        lower = text.lower()
        begun |= "precland: init complete" in lower
        landed = any(at_s >= one.at_s - _NEAR_DECK_S for one in log.history.landings)
        if ("precland: init failed" in lower and begun) or ("precland: target lost" in lower and (begun or landed)):
            continue
        out.append(text)
    return tuple(reversed(out))
