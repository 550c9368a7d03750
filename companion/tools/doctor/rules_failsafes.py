"""Rules for failsafes that work together: an action that returns, and a return that lands where the ship was.

Both stacks return to the place of the take-off over the ground. A ship under way has left it, so a return must end in a hover, in
which a person can take over. Sources: parameter references of ArduCopter 4.5 (FS_*, RTL_*) and PX4 1.16 (NAV_*, COM_*, RTL_*).
"""

from __future__ import annotations

from companion.tools.doctor.finding import Finding, Rule, error, warning
from companion.tools.doctor.renamed import NamedValue, named_value
from companion.tools.doctor.snapshot import AutopilotSnapshot, Snapshot

PARAMETERS = {
    "ArduPilot": ("FS_THR_ENABLE", "FS_GCS_ENABLE", "FS_OPTIONS", "BATT_FS_LOW_ACT", "BATT_FS_CRT_ACT", "RTL_ALT_FINAL"),
    "PX4": ("NAV_RCL_ACT", "NAV_DLL_ACT", "COM_RC_IN_MODE", "COM_RCL_EXCEPT", "COM_DLL_EXCEPT", "RTL_LAND_DELAY"),
}
_RETURNS = {
    "FS_THR_ENABLE": (1.0, 2.0, 4.0, 6.0),
    "FS_GCS_ENABLE": (1.0, 2.0, 3.0, 6.0),
    "BATT_FS_LOW_ACT": (2.0, 3.0, 6.0),
    "BATT_FS_CRT_ACT": (2.0, 3.0, 6.0),
}
"""Values of ArduCopter's failsafe actions that return."""
_REMOTE_LANDS = {3.0: "land", 5.0: "smart return or land", 7.0: "brake or land"}
_HOVER_CM, _HOVER_TO_CM = 200.0, 500.0
_GUIDED_GOES_ON = 1 << 2
_OFFBOARD = 1 << 2
_NO_STICKS = 4.0
_PX4_RETURN = 2.0


def _of(p: Snapshot, stack: str) -> AutopilotSnapshot | None:
    a = p.autopilot
    return a if a is not None and a.stack == stack and p.moving_pad else None


def _hover(a: AutopilotSnapshot) -> tuple[str, str]:
    final = named_value(a.parameters, "RTL_ALT_FINAL") or NamedValue("RTL_ALT_FINAL", 0.0, 1.0)
    return final.name, f"{final.there(_HOVER_TO_CM):g}"


def copter_remote_loss(p: Snapshot) -> Finding | None:
    """Find an ArduCopter that lands where it is when the remote control is lost."""
    a = _of(p, "ArduPilot")
    action = None if a is None else a.parameters.get("FS_THR_ENABLE")
    if a is None or action not in _REMOTE_LANDS:
        return None
    final = named_value(a.parameters, "RTL_ALT_FINAL")
    to = {"FS_THR_ENABLE": 1.0}
    if final is not None and final.value < _HOVER_CM:
        to[final.name] = final.there(_HOVER_TO_CM)
    return warning(
        "remote-loss",
        f"FS_THR_ENABLE is {action:g} ({_REMOTE_LANDS[action]}): without a remote control it lands where it is, in the sea",
        "set FS_THR_ENABLE 1 (return) and " + " ".join(_hover(a)) + " (which ends in a hover 5 m up)",
        to,
    )


def copter_return(p: Snapshot) -> Finding | None:
    """Find a failsafe of ArduCopter that returns, where a return ends with a landing."""
    a = _of(p, "ArduPilot")
    final = None if a is None else named_value(a.parameters, "RTL_ALT_FINAL")
    if a is None or final is None or final.value >= _HOVER_CM:
        return None
    goes_on = int(a.parameters.get("FS_OPTIONS", 0.0)) & _GUIDED_GOES_ON
    returning = [
        f"{name} {value:g}"
        for name, values in _RETURNS.items()
        if (value := a.parameters.get(name)) in values and not (name == "FS_THR_ENABLE" and goes_on)
    ]
    if not returning:
        return None
    lands = f"{final.name} {final.there(final.value):g} lands it there"
    return warning(
        "return-lands",
        f"{', '.join(returning)}: it returns to where the ship was, and {lands}",
        f"set {' '.join(_hover(a))}: a return ends in a hover 5 m up, for a person to take over",
        {final.name: final.there(_HOVER_TO_CM)},
    )


def px4_return(p: Snapshot) -> Finding | None:
    """Find a failsafe of PX4 that returns, where a return ends with a landing."""
    a = _of(p, "PX4")
    if a is None or a.parameters.get("RTL_LAND_DELAY", -1.0) < 0.0:
        return None
    returning = []
    if a.parameters.get("NAV_RCL_ACT") == _PX4_RETURN and _sticks_matter(a):
        returning.append("NAV_RCL_ACT 2")
    if a.parameters.get("NAV_DLL_ACT") == _PX4_RETURN and not int(a.parameters.get("COM_DLL_EXCEPT", 0.0)) & _OFFBOARD:
        returning.append("NAV_DLL_ACT 2")
    if not returning:
        return None
    lands = f"RTL_LAND_DELAY {a.parameters['RTL_LAND_DELAY']:g} lands it there"
    return warning(
        "px4-return-lands",
        f"{', '.join(returning)}: it returns to where the ship was, and {lands}",
        "set RTL_LAND_DELAY -1: a return ends in a hover, for a person to take over",
        {"RTL_LAND_DELAY": -1.0},
    )


def _sticks_matter(a: AutopilotSnapshot) -> bool:
    """Return whether the loss of the remote control is a failsafe in OFFBOARD."""
    excepted = int(a.parameters.get("COM_RCL_EXCEPT", 0.0)) & _OFFBOARD
    return not excepted and a.parameters.get("COM_RC_IN_MODE") != _NO_STICKS


def joystick_only(p: Snapshot) -> Finding | None:
    """Find a PX4 that takes a ground station's joystick alone: a station that is lost is a remote control that is lost."""
    a = _of(p, "PX4")
    if a is None or a.parameters.get("COM_RC_IN_MODE") != 1.0 or not _sticks_matter(a):
        return None
    return error(
        "px4-joystick-only",
        "COM_RC_IN_MODE is 1: the remote control is not listened to, and without a station's joystick it fails safe in OFFBOARD",
        "set COM_RC_IN_MODE 3 (both), or 4 where nobody holds a remote control",
        {"COM_RC_IN_MODE": 3.0},
    )


RULES: tuple[Rule, ...] = (copter_remote_loss, copter_return, px4_return, joystick_only)
