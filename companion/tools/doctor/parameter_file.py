"""Files of the parameters that an autopilot needs for a landing, as ground stations load them; the doctor's own rules make them.

Sources: Mission Planner, parameter files (a name and a value a line, a comment after #); QGroundControl, parameter files (five
fields with tabs: system, component, name, value, MAV_PARAM_TYPE).
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal

from companion.settings.load import write_whole
from companion.tools.doctor.diagnose import diagnose
from companion.tools.doctor.finding import Finding
from companion.tools.doctor.firmware_parameters import PX4_SINCE, Firmware, defaults_of
from companion.tools.doctor.snapshot import AutopilotSnapshot, Snapshot
from estimator.contracts.errors import BadInput, file_errors

_PX4_INTEGERS = frozenset((
    "COM_ARM_MAG_STR", "COM_DLL_EXCEPT", "COM_FLT_TIME_MAX", "COM_LOW_BAT_ACT", "COM_OBL_RC_ACT", "COM_RCL_EXCEPT",
    "COM_RC_IN_MODE", "EKF2_EV_CTRL", "EKF2_GPS_CHECK", "EKF2_GPS_CTRL", "EKF2_HGT_REF", "EKF2_MAG_TYPE", "EKF2_OF_CTRL",
    "EKF2_RNG_CTRL", "FD_FAIL_P", "FD_FAIL_R", "GF_ACTION", "IMU_GYRO_RATEMAX", "LTEST_MODE", "MAV_FWDEXTSP", "MAV_PROTO_VER",
    "NAV_DLL_ACT", "NAV_RCL_ACT", "RTL_PLD_MD", "VTE_EN",
))  # fmt: skip
"""PX4's parameters of type INT32 among those that rules change: QGroundControl loads a value of its own type alone."""
_INT32 = 6  # MAV_PARAM_TYPE_INT32
_REAL32 = 9  # MAV_PARAM_TYPE_REAL32
_HOVER_THRUST = {"MOT_THST_HOVER": 0.35}
"""ArduPilot's value before a flight has learnt it."""

Kept = Literal["ArduPilot", "PX4"]
"""Stacks whose defaults are known."""
Wanted = dict[str, tuple[float | None, str]]
"""Values by name, each with the reason for it, or for leaving it out where there is none."""


def wanted_of(found: Iterable[Finding]) -> Wanted:
    """Return the parameters that fix findings."""
    return {change.parameter: (change.value, f.what) for f in found for change in f.changes}


def wanted_by_default(stack: Kept, firmware: Firmware | None = None, *, moving_pad: bool = True) -> Wanted:
    """Return what an autopilot with its firmware's defaults needs, fixed until no fix shows another fault.

    Args:
        firmware: its release; None for any, and then what differs by release has no value.
    """
    values, out = defaults_of(stack, firmware) | _HOVER_THRUST, Wanted()
    while True:
        snapshot = Snapshot(0.0, (), AutopilotSnapshot(stack, 1, firmware=firmware, parameters=values), moving_pad=moving_pad)
        more = {name: one for name, one in wanted_of(diagnose(snapshot)).items() if name not in out}
        if not more:
            break
        out |= more
        values |= {name: value for name, (value, _) in more.items() if value is not None}
    for name in (n for n in out if n.endswith("_OPTIONS")):  # bits of which a file sets all
        out[name] = (out[name][0], f"{out[name][1]}; add the bits that yours has")
    if stack == "PX4" and firmware is None:
        later = {f"{since[0]}.{since[1]}": wanted_by_default(stack, since, moving_pad=moving_pad) for since in PX4_SINCE}
        for name in out.keys() & {name for changed in PX4_SINCE.values() for name in changed}:
            shown = ", ".join(f"{release}: {wanted[name][0]:g}" for release, wanted in later.items() if name in wanted)
            why = f"{name} differs by release ({out[name][0]:g}; since {shown}) and is left out: doctor --link URL --fix sets it"
            out[name] = (None, why)
    return dict(sorted(out.items()))


UP_TO_4_6 = "names and units up to ArduPilot 4.6; for 4.7, which has others, give the autopilot (--link URL) or its file"
"""The note on a list that is not of one release of ArduPilot."""


def stack_named(path: Path) -> Kept:
    """Return the stack that a file's name says.

    Raises:
        BadInput: the name says neither stack.
    """
    stacks: Mapping[str, Kept] = {"px4": "PX4", "ardupilot": "ArduPilot", "copter": "ArduPilot"}
    for word, stack in stacks.items():
        if word in path.name.lower():
            return stack
    raise BadInput(f"--write {path}: name it ardupilot.param or px4.params, or give the autopilot by --link or a LOG")


def write_parameters_file(path: Path, stack: str, wanted: Wanted, system: int = 1, note: str = "") -> None:
    """Write a file of parameters, below a note in comments.

    Raises:
        BadInput: the file cannot be written.
    """
    with file_errors(f"--write {path}"):
        write_whole(path, note + "".join(_lines(stack, wanted, system)))


def _lines(stack: str, wanted: Wanted, system: int) -> Sequence[str]:
    lines = []
    for name, (value, why) in wanted.items():
        if value is None:
            lines.append(f"# {why}\n")
            continue
        kind = _INT32 if name in _PX4_INTEGERS else _REAL32
        entry = f"{name},{value:g}" if stack != "PX4" else f"{system}\t1\t{name}\t{value:g}\t{kind}"
        lines += [f"# {why}\n", f"{entry}\n"]
    return lines
