"""The autopilot's identity and condition from HEARTBEAT: stack, modes, landed state; and its long status texts, joined.

STATUSTEXT holds 50 characters; MAVLink 2 sends longer texts in several chunks. Source: mavlink.io, STATUSTEXT: `id` is the same
in all chunks of a text and 0 in a text of one message; `chunk_seq` counts from 0; a chunk that is not full is the last. No I/O.
"""

import math
from dataclasses import dataclass
from enum import Enum

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.failsafe import Failsafe
from drivers.mavlink.options import PX4_HOLD, TARGET_MODES, VELOCITY_MODES
from estimator.contracts.geometry import GeoPoint

_FIXED_WING = 1  # MAV_TYPE of a QuadPlane, as ArduPlane reports it unless Q_MAV_TYPE says otherwise
_VTOLS = frozenset(range(19, 26))
"""MAV_TYPEs of a QuadPlane by Q_MAV_TYPE."""


class Stack(Enum):
    """The autopilot's firmware family, which decides what messages it obeys."""

    ARDUPILOT = "ArduPilot"
    """ArduCopter."""
    PLANE = "ArduPlane"
    """ArduPilot's Plane: other mode numbers, and velocities only by `configs/autopilot/decklander_plane.lua`."""
    PX4 = "PX4"
    OTHER = "other"

    @property
    def is_ardupilot(self) -> bool:
        """True for ArduCopter and ArduPlane, whose messages are the same."""
        return self in (Stack.ARDUPILOT, Stack.PLANE)


MULTICOPTERS = frozenset({2, 3, 4, 13, 14, 15, 19, 20, 21, 22, 23, 24, 25, 29, 35})
"""MAV_TYPEs that can hover: multicopters, helicopters and convertibles."""

ARMED = int(mav.MAV_MODE_FLAG_SAFETY_ARMED)
CUSTOM = int(mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)

COPTER_MODES = {
    0: "stabilize", 1: "acro", 2: "alt_hold", 3: "auto", 4: "guided", 5: "loiter", 6: "rtl", 7: "circle", 9: "land", 11: "drift",
    13: "sport", 14: "flip", 15: "autotune", 16: "poshold", 17: "brake", 18: "throw", 19: "avoid_adsb", 20: "guided_nogps",
    21: "smart_rtl", 22: "flowhold", 23: "follow", 24: "zigzag", 25: "systemid", 26: "heli_autorotate", 27: "auto_rtl",
    28: "turtle",
}  # fmt: skip
"""ArduCopter's custom_mode by name of the mode. Source: ArduCopter/mode.h."""

PLANE_MODES = {
    0: "manual", 1: "circle", 2: "stabilize", 3: "training", 4: "acro", 5: "fbwa", 6: "fbwb", 7: "cruise", 8: "autotune",
    10: "auto", 11: "rtl", 12: "loiter", 13: "takeoff", 14: "avoid_adsb", 15: "guided", 16: "initialising", 17: "qstabilize",
    18: "qhover", 19: "qloiter", 20: "qland", 21: "qrtl", 22: "qautotune", 23: "qacro", 24: "thermal", 25: "loiter_alt_qland",
}  # fmt: skip
"""ArduPlane's custom_mode by name of the mode. Source: ArduPlane/mode.h."""

PX4_MODES = {
    (1, 0): "manual", (2, 0): "altctl", (3, 0): "posctl", (4, 1): "auto.ready", (4, 2): "auto.takeoff", (4, 3): "auto.loiter",
    (4, 4): "auto.mission", (4, 5): "auto.rtl", (4, 6): "auto.land", (4, 8): "auto.follow_target", (4, 9): "auto.precland",
    (4, 10): "auto.vtol_takeoff", (5, 0): "acro", (6, 0): "offboard", (7, 0): "stabilized", (8, 0): "rattitude",
    (10, 0): "termination", (11, 0): "altitude_cruise",
}  # fmt: skip
"""PX4's (main, sub) mode by name of the mode. Source: px4_custom_mode.h."""

_MODES = {Stack.ARDUPILOT: COPTER_MODES, Stack.PLANE: PLANE_MODES}
_NUMBERS = {stack: {name: number for number, name in modes.items()} for stack, modes in _MODES.items()}
_PX4_NUMBERS = {name: number for number, name in PX4_MODES.items()}

VELOCITY_MODE = dict(zip((Stack.ARDUPILOT, Stack.PX4), VELOCITY_MODES, strict=True)) | {Stack.PLANE: "guided"}
"""The mode in which each stack follows velocity setpoints."""
LAND_MODE = {Stack.ARDUPILOT: "land", Stack.PLANE: "qland", Stack.PX4: "auto.land"}
TARGET_MODE = dict(zip((Stack.ARDUPILOT, Stack.PX4), TARGET_MODES, strict=True)) | {Stack.PLANE: "qland"}
"""The mode in which each stack lands on LANDING_TARGETs by itself; ArduPlane by its own script alone."""
RETURN_MODE = {Stack.ARDUPILOT: "rtl", Stack.PLANE: "qrtl", Stack.PX4: "auto.rtl"}
HOLD_MODE = {Stack.ARDUPILOT: "brake", Stack.PLANE: "guided", Stack.PX4: PX4_HOLD}
"""The mode in which each stack holds by itself. QLOITER descends where the throttle stick is low or no remote is there."""


def stack_of(heartbeat: Message) -> Stack:
    """Return the firmware family that sent a HEARTBEAT."""
    if heartbeat.autopilot == mav.MAV_AUTOPILOT_ARDUPILOTMEGA:
        return Stack.PLANE if heartbeat.type == _FIXED_WING or heartbeat.type in _VTOLS else Stack.ARDUPILOT
    return Stack.PX4 if heartbeat.autopilot == mav.MAV_AUTOPILOT_PX4 else Stack.OTHER


def mode_name(stack: Stack, custom_mode: int) -> str:
    """Return the mode's name in lower case, or its number if it has no name."""
    if stack in _MODES:
        return _MODES[stack].get(custom_mode, f"mode {custom_mode}")
    if stack is Stack.PX4:
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        return PX4_MODES.get((main, sub)) or PX4_MODES.get((main, 0)) or f"mode {main}.{sub}"
    return f"mode {custom_mode}"


def custom_mode(stack: Stack, name: str) -> int:
    """Return the custom_mode that HEARTBEAT shows in the named mode.

    Raises:
        KeyError: the stack has no such mode.
    """
    if stack in _NUMBERS:
        return _NUMBERS[stack][name]
    main, sub = _PX4_NUMBERS[name]
    return main << 16 | sub << 24


def set_mode(stack: Stack, target: tuple[int, int], name: str) -> Message:
    """Return the MAV_CMD_DO_SET_MODE that selects a mode by name.

    Raises:
        KeyError: the stack has no such mode.
    """
    main, sub = _PX4_NUMBERS[name] if stack is Stack.PX4 else (_NUMBERS[stack][name], 0)
    return mav.MAVLink_command_long_message(*target, mav.MAV_CMD_DO_SET_MODE, 0, CUSTOM, main, sub, 0, 0, 0, 0)


def reposition(target: tuple[int, int], goal: GeoPoint) -> Message:
    """Return the MAV_CMD_DO_REPOSITION that flies to a place of known height, in a mode that both stacks hold it by."""
    latitude, longitude = (round(1e7 * math.degrees(angle)) for angle in (goal.latitude_rad, goal.longitude_rad))
    return mav.MAVLink_command_int_message(
        *target, mav.MAV_FRAME_GLOBAL, mav.MAV_CMD_DO_REPOSITION, 0, 0,
        -1.0, mav.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE, 0.0, math.nan, latitude, longitude, goal.height_m or 0.0,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Identity:
    """The identity of the selected autopilot."""

    system: int
    component: int
    stack: Stack
    kind: int
    """MAV_TYPE of the vehicle."""

    @property
    def address(self) -> tuple[int, int]:
        return self.system, self.component


@dataclass(frozen=True, slots=True)
class Version:
    """The firmware and the hardware of an autopilot."""

    firmware: tuple[int, int, int]
    capabilities: int
    """MAV_PROTOCOL_CAPABILITY bits."""
    uid: int
    """The unique id of the hardware; 0 where it reports none."""

    def __str__(self) -> str:
        hardware = f"hardware {self.uid:x}" if self.uid else "hardware without an id"
        return f"firmware {'.'.join(map(str, self.firmware))}, {hardware}, capabilities {self.capabilities:#x}"


def version_of(m: Message) -> Version:
    """Return what an AUTOPILOT_VERSION says; ArduPilot has the longer of the two ids only."""
    number = int(m.flight_sw_version)
    uid = int.from_bytes(bytes(getattr(m, "uid2", ())), "big") or int(m.uid)
    return Version((number >> 24 & 0xFF, number >> 16 & 0xFF, number >> 8 & 0xFF), int(m.capabilities), uid)


def is_autopilot(heartbeat: Message, component: int) -> bool:
    """Return whether a HEARTBEAT comes from an autopilot of a vehicle that can hover, not from a station, a gimbal or a ship."""
    hovers = heartbeat.type in MULTICOPTERS or stack_of(heartbeat) is Stack.PLANE
    return component == mav.MAV_COMP_ID_AUTOPILOT1 and heartbeat.autopilot != 8 and hovers


@dataclass(frozen=True, slots=True)
class Condition:
    """The condition of the vehicle as far as the autopilot reported it."""

    mode: str = "unknown"
    armed: bool | None = None
    flying: bool | None = None
    terminated: bool = False
    """True if the autopilot cut its motors in flight."""
    battery_fraction: float | None = None
    taking_off: bool = False
    """True if it reports the climb after a take-off."""
    failsafe: Failsafe | None = None
    """The failsafe that is in force; None without one. Its `since` changes with each one that comes."""


_FLYING = {1: False, 2: True, 3: True, 4: True}


def flying_of(landed_state: int, system_status: int, armed: bool) -> bool | None:
    """Return whether the vehicle is in the air, or None if unknown.

    MAV_LANDED_STATE decides; if it is undefined, MAV_STATE and the state of the motors do.
    """
    if landed_state in _FLYING:
        return _FLYING[landed_state]
    if not armed or system_status == mav.MAV_STATE_STANDBY:
        return False
    return True if system_status == mav.MAV_STATE_ACTIVE else None
