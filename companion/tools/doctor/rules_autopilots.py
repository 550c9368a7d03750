"""Rules for ArduPilot and PX4: the settings that each needs, and the messages that it sends without them or is sent."""

from companion.tools.doctor.finding import Finding, Row, Rule, Severity, advice, error
from companion.tools.doctor.firmware_parameters import named_value
from companion.tools.doctor.snapshot import AutopilotSnapshot, Snapshot
from drivers.mavlink.failsafe import event_id

PARAMETERS = (
    "PLND_ENABLED", "PLND_TYPE", "PLND_EST_TYPE", "PLND_LAG", "PLND_OPTIONS", "PLND_STRICT", "PLND_ORIENT", "PLND_YAW_ALIGN",
    "PLND_CAM_POS_X", "PLND_CAM_POS_Y", "PLND_CAM_POS_Z", "PLND_XY_DIST_MAX", "PLND_ALT_MAX", "INS_GYR_CAL",
    "EK3_SRC1_POSXY", "EK3_SRC1_VELXY", "EK3_SRC1_POSZ", "EK3_SRC1_VELZ", "EK3_SRC1_YAW", "EK3_RNG_USE_HGT",
    "SCR_ENABLE", "SCR_HEAP_SIZE", "DKL_ENABLE",
    *(f"RNGFND{n}_{what}" for n in range(1, 5) for what in ("TYPE", "ORIENT")),
    "GPS_TYPE", "GPS_TYPE2",
)  # fmt: skip
_TWO_ANTENNAS = {
    17.0: "u-blox base", 18.0: "u-blox rover", 22.0: "DroneCAN base", 23.0: "DroneCAN rover", 25.0: "Unicore", 26.0: "Septentrio",
}  # fmt: skip
"""GPS1_TYPE of receivers that measure the heading between two antennas (ardupilot.org, GPS for Yaw)."""
_COMPASS = 1.0  # EK3_SRC1_YAW: compass
_ROVER_OF_HEADING = (1.0, 3.0)
"""GPS_UBX_MODE of a rover whose moving base stands on the vehicle (docs.px4.io, RTK GPS Heading with Dual u-blox F9P)."""
_GNSS_HEADING = 8  # bit of EKF2_GPS_CTRL: heading of two antennas
_EXTERNAL_NAV = 6.0  # EK3_SRCx: external navigation
_BY_RANGE = 2.0  # EK3_SRC1_POSZ: rangefinder
_BY_MAVLINK = 10.0  # RNGFNDx_TYPE: MAVLink
_DOWN = 25.0  # RNGFNDx_ORIENT and PLND_ORIENT: down
_COMPANION = 1.0  # PLND_TYPE: companion computer
_KALMAN = 1.0  # PLND_EST_TYPE: Kalman filter
_MOVING_TARGET = 1  # bit of PLND_OPTIONS: moving landing target
_ERROR, _WARNING, _ADVICE = Severity.ERROR, Severity.WARNING, Severity.ADVICE
_SCRIPT = "configs/autopilot/decklander_disarm.lua"
_HEAP_MIN = 40_000.0
"""Memory that the script needs, with ArduPilot's own share of it, bytes."""
_RANGE_HEIGHT = 2.0  # EKF2_HGT_REF: range sensor


def _of(p: Snapshot, stack: str) -> AutopilotSnapshot | None:
    return p.autopilot if p.autopilot is not None and p.autopilot.stack == stack else None


def _value(p: Snapshot, name: str, stack: str = "ArduPilot") -> float | None:
    a = _of(p, stack)
    return None if a is None else a.parameters.get(name)


def _px4(p: Snapshot, name: str) -> float:
    """Return a parameter of PX4; 0 if it was not read."""
    return _value(p, name, "PX4") or 0.0


def _enabled(p: Snapshot) -> bool:
    return bool(_value(p, "PLND_ENABLED"))


def _without(p: Snapshot, stack: str, name: str) -> bool:
    """Return whether the firmware was built without what this parameter belongs to."""
    a = _of(p, stack)
    return a is not None and bool(a.parameters) and name in a.absent


def _other_than(p: Snapshot, name: str, right: float) -> str | None:
    """Return the value of a parameter of precision landing that must have another."""
    value = _value(p, name)
    return f"{value:g}" if _enabled(p) and value is not None and value != right else None


def _not_started(p: Snapshot) -> bool:
    """Return whether precision landing was enabled after the boot and therefore does not run."""
    a = _of(p, "ArduPilot")
    is_set = _enabled(p) and _value(p, "PLND_TYPE") == _COMPANION
    return a is not None and is_set and bool(a.precland_enabled) and a.precland_healthy is False


def _low_ceiling(p: Snapshot) -> str | None:
    ceiling_m = _value(p, "PLND_ALT_MAX")
    return f"{ceiling_m:g}" if _enabled(p) and ceiling_m is not None and ceiling_m < 4.0 else None


def _reported(p: Snapshot, text: str) -> bool:
    a = _of(p, "ArduPilot")
    return a is not None and any(text in t.lower() for t in a.texts)


def _angles_only(p: Snapshot) -> str | None:
    """Return the version of an ArduPilot before 4.1, which reads targets as angles only."""
    a = _of(p, "ArduPilot")
    return None if a is None or a.firmware is None or a.firmware >= (4, 1, 0) else ".".join(map(str, a.firmware))


def _strict(p: Snapshot) -> tuple[float, float, str] | None:
    """Return a PLND_STRICT with which LAND goes on without targets, what it should be, and what it then does."""
    value, to = _value(p, "PLND_STRICT"), 2.0 if p.moving_pad else 1.0
    does = "holds until a person takes it, as does a LAND without any" if p.moving_pad else "climbs and tries again"
    return (value, to, does) if _enabled(p) and value is not None and value < to else None


def _wrong_lag(p: Snapshot) -> tuple[float, float, float] | None:
    """Return a lag, s, that is more than 0.05 s from the delay of a frame, that delay, ms, and the best lag, s."""
    lag_s, delay_s = _value(p, "PLND_LAG"), p.service.exposure_to_belief_s
    if not _enabled(p) or lag_s is None or delay_s is None:
        return None
    best_s = min(max(delay_s, 0.02), 0.25)
    return None if abs(lag_s - best_s) <= 0.05 else (lag_s, 1e3 * delay_s, best_s)


def _still_target(p: Snapshot) -> int | None:
    """Return what PLND_OPTIONS should be in an autopilot that takes a moving pad to stand still."""
    options = int(_value(p, "PLND_OPTIONS") or 0.0)
    known = _enabled(p) and _value(p, "PLND_OPTIONS") is not None
    return options | _MOVING_TARGET if known and p.moving_pad and not options & _MOVING_TARGET else None


_MOUNT = {"PLND_CAM_POS_X": 0.0, "PLND_CAM_POS_Y": 0.0, "PLND_CAM_POS_Z": 0.0, "PLND_YAW_ALIGN": 0.0, "PLND_ORIENT": _DOWN}
"""The parameters of a camera's mount, and their values where the service applies it."""


def _mounted_twice(p: Snapshot) -> str:
    values = {name: _value(p, name) for name, right in _MOUNT.items() if _enabled(p) and _value(p, name) != right}
    return ", ".join(f"{name} {value:g}" for name, value in values.items() if value is not None)


def _kinds(p: Snapshot) -> dict[int, float]:
    found = {n: _value(p, f"RNGFND{n}_TYPE") for n in range(1, 5)}
    return {n: v for n, v in found.items() if v is not None}


def _heading_unused(p: Snapshot) -> str:
    """Return the receivers that measure the heading between two antennas, where the compass has it instead."""
    a = _of(p, "ArduPilot")
    if a is None or _value(p, "EK3_SRC1_YAW") != _COMPASS:
        return ""
    found = [named_value(a.parameters, name) for name in ("GPS_TYPE", "GPS_TYPE2")]
    return ", ".join(
        f"{v.name} {v.value:g} ({_TWO_ANTENNAS[v.value]})" for v in found if v is not None and v.value in _TWO_ANTENNAS
    )


def _px4_heading_unused(p: Snapshot) -> int | None:
    """Return the EKF2_GPS_CTRL that takes the heading that a rover measures, where it is not taken."""
    control = _value(p, "EKF2_GPS_CTRL", "PX4")
    if _px4(p, "GPS_UBX_MODE") not in _ROVER_OF_HEADING or control is None or int(control) & _GNSS_HEADING:
        return None
    return int(control) | _GNSS_HEADING


def _turned(p: Snapshot) -> dict[str, float]:
    """Return the parameters that turn rangefinders elsewhere than down, with their values."""
    found = {f"RNGFND{n}_ORIENT": _value(p, f"RNGFND{n}_ORIENT") for n, kind in _kinds(p).items() if kind}
    return {name: orient for name, orient in found.items() if orient is not None and orient != _DOWN}


def _rangefinder_turned(p: Snapshot) -> tuple[str, float] | None:
    """Return the parameter that turns a rangefinder over MAVLink, and its value that does not look down."""
    return next((one for one in _turned(p).items() if _value(p, one[0].replace("ORIENT", "TYPE")) == _BY_MAVLINK), None)


_SOURCES = {"EK3_SRC1_POSXY": 3.0, "EK3_SRC1_VELXY": 3.0, "EK3_SRC1_POSZ": 1.0, "EK3_SRC1_VELZ": 3.0, "EK3_SRC1_YAW": 1.0}
"""The EKF's sources, and the value of each that needs nothing from outside."""


def _height_by_range(p: Snapshot) -> dict[str, float]:
    """Return what an EKF needs whose height follows a moving deck."""
    to = {"EK3_SRC1_POSZ": 1.0} if _value(p, "EK3_SRC1_POSZ") == _BY_RANGE else {}
    to |= {"EK3_RNG_USE_HGT": -1.0} if (_value(p, "EK3_RNG_USE_HGT") or 0.0) > 0.0 else {}
    return to if p.moving_pad else {}


def disarm_script(p: Snapshot) -> Finding | None:
    """Find a copter that stays armed on the deck when the service dies there, as far as it can run scripts."""
    a, scripting = _of(p, "ArduPilot"), _value(p, "SCR_ENABLE")
    if a is None or scripting is None or not p.moving_pad:
        return None
    what = "a service that dies in the last decimetres leaves it armed on deck: "
    if scripting != 1.0:
        fix = f"copy {_SCRIPT} to APM/scripts, set SCR_ENABLE 1 and reboot"
        return advice("disarm-script", what + f"SCR_ENABLE is {scripting:g}, no script runs", fix)
    heap = _value(p, "SCR_HEAP_SIZE")
    if heap is not None and heap < _HEAP_MIN:
        few = f"SCR_HEAP_SIZE is {heap:g}, too little for a script"
        return advice("disarm-script", what + few, "set SCR_HEAP_SIZE 80000 and reboot")
    if "DKL_ENABLE" in a.absent:
        fix = f"copy {_SCRIPT} to APM/scripts on the SD card and reboot"
        return advice("disarm-script", what + "the script that disarms it there does not run (no parameter DKL_ENABLE)", fix)
    if _value(p, "DKL_ENABLE") == 0.0:
        return advice("disarm-script", what + "DKL_ENABLE is 0", "set DKL_ENABLE 1")
    return None


RULES: tuple[Rule, ...] = (
    Row("plnd-missing", _ERROR, lambda p: _without(p, "ArduPilot", "PLND_ENABLED"),
        "this firmware has no precision landing (no parameter PLND_ENABLED)",
        "install a build with AC_PRECLAND: boards with 1 MB of flash need a custom build (custom.ardupilot.org)"),
    Row("plnd-disabled", _ERROR, lambda p: _value(p, "PLND_ENABLED") == 0.0,
        "PLND_ENABLED is 0",
        "set PLND_ENABLED 1 and reboot the autopilot",
        {"PLND_ENABLED": 1.0}),
    Row("plnd-not-rebooted", _ERROR, _not_started,
        "PLND_ENABLED and PLND_TYPE are set, but precision landing does not run",
        "reboot the autopilot: it is started at boot only, and ignores LANDING_TARGET without a word until then"),
    Row("plnd-type", _ERROR, lambda p: _other_than(p, "PLND_TYPE", _COMPANION),
        "PLND_TYPE is {0}",
        "set PLND_TYPE 1 (companion computer) and reboot the autopilot",
        {"PLND_TYPE": _COMPANION}),
    Row("plnd-estimator", _WARNING, lambda p: _other_than(p, "PLND_EST_TYPE", _KALMAN),
        "PLND_EST_TYPE is 0: raw measurements, no velocity of the pad",
        "set PLND_EST_TYPE 1",
        {"PLND_EST_TYPE": _KALMAN}),
    Row("plnd-lag", _ADVICE, _wrong_lag,
        "PLND_LAG is {0[0]:g} s, but a frame is {0[1]:.0f} ms old when it is understood",
        "set PLND_LAG {0[2]:.2f} and reboot: then targets are of instants that were seen, not predicted",
        lambda lag: {"PLND_LAG": round(lag[2], 2)}),
    Row("plnd-still-target", _ERROR, _still_target,
        "PLND_OPTIONS takes the pad to stand still: on a ship at 1.5 m/s it touches down 1.5 m behind",
        "set PLND_OPTIONS {0} (bit 0: moving target)",
        lambda to: {"PLND_OPTIONS": float(to)}),
    Row("plnd-mount-twice", _ERROR, _mounted_twice,
        "the camera's mount is set in the autopilot too: {0}",
        "set PLND_CAM_POS_* and PLND_YAW_ALIGN 0, PLND_ORIENT 25: what is sent is already from the body's origin",
        lambda found: {name: right for name, right in _MOUNT.items() if name in found}),
    Row("plnd-blind", _WARNING, _strict,
        "PLND_STRICT is {0[0]:g}: a LAND whose targets end comes down where it then is, beside a pad that went on",
        "set PLND_STRICT {0[1]:g}: then it {0[2]}",
        lambda strict: {"PLND_STRICT": strict[1]}),
    Row("plnd-ceiling", _WARNING, _low_ceiling,
        "PLND_ALT_MAX is {0} m: above it the pad is not looked for",
        "set PLND_ALT_MAX 8 or more",
        {"PLND_ALT_MAX": 8.0}),
    Row("no-rangefinder", _WARNING,
        lambda p: _kinds(p) and sum(kind != 0.0 for kind in _kinds(p).values()) <= len(_turned(p)) and not _rangefinder_turned(p),
        "there is no rangefinder that looks down: the copter does not slow down near the deck, it touches down at full speed",
        "fit one (RNGFNDx_ORIENT 25), or set RNGFND1_TYPE 10, RNGFND1_ORIENT 25 and reboot: then our distances serve as one"),
    Row("rangefinder-unfed", _ERROR, lambda p: _BY_MAVLINK in _kinds(p).values() and p.service.sends_ranges is False,
        "a rangefinder waits for DISTANCE_SENSOR (RNGFNDx_TYPE 10) and nobody sends it: arming is refused",
        "let the service send ranges, already on the ground, or set RNGFNDx_TYPE 0"),
    Row("rangefinder-turned", _ERROR, _rangefinder_turned,
        "{0[0]} is {0[1]:g}: distances that look down are dropped",
        "set {0[0]} 25 and reboot",
        lambda turned: {turned[0]: _DOWN}),
    Row("ekf-external", _ERROR, lambda p: ", ".join(f"{name} 6" for name in _SOURCES if _value(p, name) == _EXTERNAL_NAV),
        "{0}: the EKF waits for a position that is never sent",
        "set EK3_SRC1_POSXY, VELXY and VELZ 3 (GNSS), POSZ 1 (barometer), YAW 1 (compass): the pad moves, it is no reference",
        lambda found: {name: right for name, right in _SOURCES.items() if name in found}),
    Row("yaw-by-gnss", _ADVICE, _heading_unused,
        "{0}: two antennas measure the heading, and EK3_SRC1_YAW is 1: the compass has it, which a ship's steel turns",
        "set EK3_SRC1_YAW 3 (GNSS, and the compass where that fails) or 2 (GNSS), with the antennas' places (GPS1_MB_*)",
        {"EK3_SRC1_YAW": 3.0}),
    Row("ekf-height-by-range", _ERROR, _height_by_range,
        "the EKF takes height from the rangefinder: it follows the deck's heave, and jumps at the deck's edge",
        "set EK3_SRC1_POSZ 1 (barometer) or 3 (GNSS) and EK3_RNG_USE_HGT -1",
        lambda to: to),
    Row("gyro-calibration", _WARNING, lambda p: p.moving_pad and _value(p, "INS_GYR_CAL") == 1.0,
        "INS_GYR_CAL is 1: at each boot the gyros are calibrated, and the deck's motion with them",
        "calibrate once ashore, then set INS_GYR_CAL 0"),
    Row("frame-not-supported", _ERROR, lambda p: _reported(p, "frame not supported"),
        'the autopilot reported "Plnd: Frame not supported" (once; it then drops every such target without a word)',
        "another program sends LANDING_TARGET in a wrong frame: stop it; ours are MAV_FRAME_BODY_FRD (12)"),
    Row("target-too-rare", _ERROR, lambda p: _reported(p, "init failed"),
        'the autopilot reported "PrecLand: Init Failed": targets come too rarely or with gaps',
        "send at 10 Hz and more: check the link's losses, and why targets are withheld"),
    Row("target-lost", _WARNING, lambda p: _reported(p, "target lost"),
        'the autopilot reported "PrecLand: Target Lost"',
        "see why targets stopped: light, a pad smaller than the camera sees near the deck, a full link"),
    disarm_script,
    Row("firmware-old", _WARNING, _angles_only,
        "ArduPilot {0} reads angles only and needs its own rangefinder for them",
        "update to 4.5 or newer: position, moving targets and strict landing come with it"),
)  # fmt: skip


PLANE_PARAMETERS = ("Q_ENABLE", "Q_GUIDED_MODE", "SCR_ENABLE", "DKP_ENABLE", "STICK_MIXING")
_Q, _STEERS = "ArduPlane", "configs/autopilot/decklander_plane.lua"


def _no_steering(p: Snapshot) -> str | None:
    """Return why an ArduPlane runs no script that flies our velocities."""
    a = _of(p, _Q)
    if a is None or not a.parameters:
        return None
    if _value(p, "SCR_ENABLE", _Q) != 1.0:
        return "SCR_ENABLE is not 1"
    return "there is no parameter DKP_ENABLE" if "DKP_ENABLE" in a.absent else None


PLANE_RULES: tuple[Rule, ...] = (
    Row("plane-fixed-wing", _ERROR, lambda p: _value(p, "Q_ENABLE", _Q) == 0.0,
        "Q_ENABLE is 0: a fixed wing cannot hover over a deck",
        "land a QuadPlane: Q_ENABLE 1 and VTOL motors"),
    Row("plane-guided", _ERROR, lambda p: _value(p, "Q_GUIDED_MODE", _Q) == 0.0,
        "Q_GUIDED_MODE is 0: GUIDED circles as a fixed wing does",
        "set Q_GUIDED_MODE 1",
        {"Q_GUIDED_MODE": 1.0}),
    Row("plane-script", _ERROR, _no_steering,
        "{0}: ArduPlane flies no velocities by itself, and the script that does is not running",
        f"copy {_STEERS} to APM/scripts on the SD card, set SCR_ENABLE 1 and reboot"),
    Row("plane-script-off", _ERROR, lambda p: _value(p, "DKP_ENABLE", _Q) == 0.0,
        "DKP_ENABLE is 0: our velocities are not flown",
        "set DKP_ENABLE 1",
        {"DKP_ENABLE": 1.0}),
    Row("plane-no-turn", _WARNING, lambda p: _value(p, "STICK_MIXING", _Q) == 0.0,
        "STICK_MIXING is 0: it does not turn to the pad's arrow, and the gate stays closed",
        "set STICK_MIXING 1",
        {"STICK_MIXING": 1.0}),
)  # fmt: skip


PX4_PARAMETERS = (
    "PLD_HACC_RAD", "PLD_BTOUT", "MPC_JERK_AUTO", "LTEST_MODE", "VTE_EN", "COM_OF_LOSS_T", "COM_OBL_RC_ACT", "EKF2_EV_CTRL",
    "EKF2_HGT_REF", "MAV_PROTO_VER", "GPS_UBX_MODE", "EKF2_GPS_CTRL",
)  # fmt: skip
_LEAVES = {
    3.0: "3 (return): when the service dies it leaves the ship",
    4.0: "4 (land): when the service dies it lands where it is",
}
_FALLS = {6.0: "6 (terminate)", 7.0: "7 (disarm)"}
_HOLD = "set COM_OBL_RC_ACT 0 (position) or 5 (hold)"
"""Actions at the loss of OFFBOARD that leave a moving ship or stop the motors in the air, and what to set instead."""


def targets_withheld(p: Snapshot) -> Finding | None:
    """Find targets that the service did not send, whatever the autopilot."""
    s = p.service
    if s.targets_sent is None or s.targets_sent > 0 or not s.withheld:
        return None
    why = max(s.withheld, key=lambda k: s.withheld[k])
    cures = {
        "not seen": "the pad is not in the frame, or colours and light do not suit: decklander detect on a frame shows why",
        "on ground": "no targets are sent while the vehicle reports that it is on the ground: this is as it should be",
        "not ordered": "guidance.mission is targets, and nobody has begun: give the order, or choose the landing mode",
        "taking off": "no targets are sent during a take-off: this is as it should be",
        "no attitude": "no attitude covers the instant: see attitude-slow and clock-not-locked",
        "no local position": "LOCAL_POSITION_NED does not come: see stream-silent",
        "no newer position": "LOCAL_POSITION_NED comes too rarely: ask for 30 Hz and more, see link-lossy",
        "not below": "the pad is not below the vehicle: check the camera's mount (rpy_body_cam_deg)",
        "unknown autopilot": "neither ArduPilot nor PX4: no form of target is known to be obeyed",
    }
    make = advice if why in ("on ground", "taking off", "not ordered") else error
    return make("targets-withheld", f"no target was sent: {why}", cures.get(why, "see the log"))


def _foreign_frame(p: Snapshot) -> bool:
    """Return whether PX4 reported, by text or event, that a target came in a frame it does not know."""
    a = _of(p, "PX4")
    if a is None:
        return False
    in_text = any("unsupported" in t.lower() and "frame" in t.lower() for t in a.texts)
    return in_text or event_id("mavlink_rcv_lnd_target_unsup_coord") in a.events


def _precland_of(p: Snapshot, name: str, least: float) -> str | None:
    """Return the value of a parameter with which PX4's own landing, where it is to land, loses a pad that moves."""
    a, value = _of(p, "PX4"), _value(p, name, "PX4")
    lands = a is not None and p.moving_pad and (p.service.leads or a.mode == "auto.precland")
    return f"{value:g}" if lands and value is not None and value < least else None


PX4_RULES: tuple[Rule, ...] = (
    Row("px4-precland-missing", _WARNING, lambda p: _without(p, "PX4", "PLD_HACC_RAD"),
        "this firmware has no precision landing (no parameter PLD_HACC_RAD): AUTO.PRECLAND does not exist",
        "fly by velocity (OFFBOARD), which needs no module, or build with CONFIG_NAVIGATOR precision landing"),
    Row("px4-yaw-by-gnss", _ADVICE, _px4_heading_unused,
        "GPS_UBX_MODE measures the heading by two antennas, and the compass has it, which a ship's steel turns",
        "set EKF2_GPS_CTRL {0} (bit 3: heading), and GPS_YAW_OFFSET as the antennas stand",
        lambda to: {"EKF2_GPS_CTRL": float(to)}),
    Row("px4-precland-moving", _ERROR, lambda p: _precland_of(p, "PLD_HACC_RAD", 5.0),
        "PLD_HACC_RAD is {0}: AUTO.PRECLAND stays behind a pad that moves, and descends no farther from it than this",
        "set PLD_HACC_RAD 8 for guidance.mission \"targets\", or let the service fly it in OFFBOARD",
        {"PLD_HACC_RAD": 8.0}),
    Row("px4-precland-jerk", _WARNING, lambda p: _precland_of(p, "MPC_JERK_AUTO", 15.0),
        "MPC_JERK_AUTO is {0}: AUTO.PRECLAND stays some seconds behind a pad that moves, and loses it from sight",
        "set MPC_JERK_AUTO 20",
        {"MPC_JERK_AUTO": 20.0}),
    Row("px4-frame", _ERROR, _foreign_frame,
        "PX4 reported that a landing target's coordinate frame is unsupported",
        "another program sends LANDING_TARGET in a wrong frame: stop it; ours are MAV_FRAME_LOCAL_NED (1)"),
    Row("px4-offboard-loss", _WARNING, lambda p: _px4(p, "COM_OF_LOSS_T") > 2.0 and _px4(p, "COM_OF_LOSS_T"),
        "COM_OF_LOSS_T is {0:g} s: so long it flies on with the last velocity when the service dies",
        "set COM_OF_LOSS_T 1",
        {"COM_OF_LOSS_T": 1.0}),
    Row("px4-offboard-action", _WARNING, lambda p: p.moving_pad and _LEAVES.get(_px4(p, "COM_OBL_RC_ACT")),
        "COM_OBL_RC_ACT is {0}", _HOLD, {"COM_OBL_RC_ACT": 5.0}),
    Row("px4-offboard-action", _ERROR, lambda p: p.moving_pad and _FALLS.get(_px4(p, "COM_OBL_RC_ACT")),
        "COM_OBL_RC_ACT is {0}: when the service dies it falls out of the air", _HOLD, {"COM_OBL_RC_ACT": 5.0}),
    Row("ekf-height-by-range", _ERROR, lambda p: p.moving_pad and _px4(p, "EKF2_HGT_REF") == _RANGE_HEIGHT,
        "EKF2_HGT_REF is 2: the height follows the deck's heave, and jumps at the deck's edge",
        "set EKF2_HGT_REF 1 (GNSS) or 0 (barometer)",
        {"EKF2_HGT_REF": 1.0}),
    Row("px4-external-vision", _WARNING, lambda p: _px4(p, "EKF2_EV_CTRL"),
        "EKF2_EV_CTRL is {0:g}: the EKF waits for a vision position, and a pad on a ship is none",
        "set EKF2_EV_CTRL 0 unless another source sends ODOMETRY",
        {"EKF2_EV_CTRL": 0.0}),
    targets_withheld,
)  # fmt: skip
