"""Take a snapshot of an autopilot from its flight log. It judges nothing."""

import contextlib
import math
import re
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from msgspec import structs

from companion.tools.doctor.diagnose import PARAMETERS
from companion.tools.doctor.firmware_parameters import differing, names_in
from companion.tools.doctor.snapshot import AutopilotSnapshot, Snapshot
from drivers.imports import dataflash, px4_ulog, tlog
from drivers.imports.kinds import FileKind, kind_of
from drivers.imports.log_history import AutopilotLog, LogHistory
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


_PX4_NAMES = re.compile(r"MAV_SYS_ID|(COM|MPC|EKF2|CAL|SENS|NAV|LNDMC|RTL|CBRK|MC|IMU)_")
_OF_TABLE = re.compile(r"(\d+)\t(\d+)\t")
_DECIMAL_COMMA = re.compile(r"[A-Z]\w*[\s,=]+-?\d+,\d+\s*(?:#|$)")
_ARDUPILOT_NAMES = re.compile(r"SYSID_|MAV_SYSID|FRAME_CLASS|(INS|EK3|ATC|PSC|PLND|GUID|LAND|WPNAV|ARMING|SERVO\d+|RC\d+)_")


def parameters_of(path: Path) -> AutopilotLog:
    """Read a file of parameters as ground stations keep them: `NAME,VALUE`, `NAME VALUE`, or QGroundControl's table with tabs.

    Return a log that holds nothing else; the stack is given by the file, or by its names.

    Raises:
        BadInput: the file cannot be read, no line of it is a parameter, or a value is not clear: two of one name, two vehicles,
            decimal commas, a file that is included.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as why:
        raise BadInput(f"{path}: {why.strerror or why}") from why
    parameters: dict[str, float] = {}
    table = [row for line in lines if (row := _OF_TABLE.match(line)) is not None]
    if len({row[1] for row in table}) > 1:
        raise BadInput(f"{path}: it holds the parameters of several vehicles: save those of one")
    usual = Counter(row[2] for row in table).most_common(1)
    for line in lines:
        if line.startswith("@include"):
            raise BadInput(f"{path}: it includes another file ({line[8:].strip()}): give one with all parameters")
        if table and (row := _OF_TABLE.match(line)) is not None and row[2] != usual[0][0]:
            continue  # another component, such as a gimbal
        if (found := _parameter_in(line)) is not None:
            name, value = found
            if parameters.setdefault(name, value) != value:
                raise BadInput(f"{path}: {name} stands in it twice, as {parameters[name]:g} and as {value:g}")
    if not parameters:
        raise BadInput(f"{path}: no line of it is a parameter")
    if not any("." in line or "Value" in line for line in lines) and any(_DECIMAL_COMMA.match(line) for line in lines):
        raise BadInput(f"{path}: its numbers have decimal commas: save it with points")
    comments = " ".join(line for line in lines[:40] if line.startswith("#"))
    output = re.search(r"Stack:\s*(PX4|ArduPilot)", comments)
    px4 = sum(_PX4_NAMES.match(name) is not None for name in parameters)
    ardupilot = sum(_ARDUPILOT_NAMES.match(name) is not None for name in parameters)
    stack = output[1] if output is not None else "PX4" if px4 > ardupilot else "ArduPilot"
    version = re.search(r"Version:\s*(\d+)\.(\d+)\.(\d+)", comments)
    firmware = None if version is None else (int(version[1]), int(version[2]), int(version[3]))
    return AutopilotLog(stack, None, firmware, dict(sorted(parameters.items())), (), (), LogHistory(0.0))


def _parameter_in(line: str) -> tuple[str, float] | None:
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
