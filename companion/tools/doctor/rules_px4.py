"""Rules for PX4, and for the messages that the service itself sends."""

from companion.tools.doctor.finding import Finding, Rule, advice, error, warning
from companion.tools.doctor.snapshot import AutopilotSnapshot, Snapshot

PARAMETERS = (
    "PLD_HACC_RAD", "PLD_BTOUT", "LTEST_MODE", "VTE_EN", "COM_OF_LOSS_T", "COM_OBL_RC_ACT", "EKF2_EV_CTRL", "EKF2_HGT_REF",
    "MAV_PROTO_VER",
)  # fmt: skip
_RANGE_HEIGHT = 2.0
_OFFBOARD_ACTIONS = {
    3.0: ("return", "leaves the ship"),
    4.0: ("land", "lands where it is"),
    6.0: ("terminate", "falls out of the air"),
    7.0: ("disarm", "falls out of the air"),
}
_MOTORS_OFF = (6.0, 7.0)


def event_id(name: str) -> int:
    """Return the number that EVENT carries: component 1 and 24 bits of the name's FNV-1a hash. Source: PX4, Tools/px4events."""
    value = 0x811C9DC5
    for byte in name.encode():
        value = (value ^ byte) * 0x1000193 & 0xFFFFFFFF
    return 1 << 24 | value & 0xFFFFFF


def _px4(p: Snapshot) -> AutopilotSnapshot | None:
    return p.autopilot if p.autopilot is not None and p.autopilot.stack == "PX4" else None


def _value(p: Snapshot, name: str) -> float | None:
    a = _px4(p)
    return None if a is None else a.parameters.get(name)


def precland_missing(p: Snapshot) -> Finding | None:
    """Find a firmware that was built without precision landing."""
    a = _px4(p)
    if a is None or not a.parameters or "PLD_HACC_RAD" not in a.absent:
        return None
    return warning(
        "px4-precland-missing",
        "this firmware has no precision landing (no parameter PLD_HACC_RAD): AUTO.PRECLAND does not exist",
        "fly by velocity (OFFBOARD), which needs no module, or build with CONFIG_NAVIGATOR precision landing",
    )


def precland_moving(p: Snapshot) -> Finding | None:
    """Find AUTO.PRECLAND over a pad that moves, on which it never descends."""
    a = _px4(p)
    if a is None or not p.moving_pad or a.mode != "auto.precland":
        return None
    return error(
        "px4-precland-moving",
        "AUTO.PRECLAND never descends on a pad that moves at 1 m/s",
        "fly by velocity: let the service take the vehicle in OFFBOARD",
    )


def unsupported_frame(p: Snapshot) -> Finding | None:
    """Find PX4's message or event that a target came in a frame it does not know."""
    a = _px4(p)
    if a is None:
        return None
    in_text = any("unsupported" in t.lower() and "frame" in t.lower() for t in a.texts)
    if not in_text and event_id("mavlink_rcv_lnd_target_unsup_coord") not in a.events:
        return None
    return error(
        "px4-frame",
        "PX4 said that a landing target's coordinate frame is unsupported",
        "another program sends LANDING_TARGET in a wrong frame: stop it; ours are MAV_FRAME_LOCAL_NED (1)",
    )


def offboard_loss(p: Snapshot) -> Finding | None:
    """Find a time limit of OFFBOARD above 2 s."""
    timeout_s = _value(p, "COM_OF_LOSS_T")
    if timeout_s is None or timeout_s <= 2.0:
        return None
    return warning(
        "px4-offboard-loss",
        f"COM_OF_LOSS_T is {timeout_s:g} s: so long it flies on with the last velocity when the service dies",
        "set COM_OF_LOSS_T 1",
        {"COM_OF_LOSS_T": 1.0},
    )


def offboard_action(p: Snapshot) -> Finding | None:
    """Find an action at the loss of OFFBOARD that leaves a moving ship."""
    action = _value(p, "COM_OBL_RC_ACT")
    if action is None or action not in _OFFBOARD_ACTIONS or not p.moving_pad:
        return None
    name, does = _OFFBOARD_ACTIONS[action]
    return (error if action in _MOTORS_OFF else warning)(
        "px4-offboard-action",
        f"COM_OBL_RC_ACT is {action:g} ({name}): when the service dies it {does}",
        "set COM_OBL_RC_ACT 0 (position) or 5 (hold)",
        {"COM_OBL_RC_ACT": 5.0},
    )


def height_by_range(p: Snapshot) -> Finding | None:
    """Find an EKF whose height follows a moving deck."""
    if _value(p, "EKF2_HGT_REF") != _RANGE_HEIGHT or not p.moving_pad:
        return None
    return error(
        "ekf-height-by-range",
        "EKF2_HGT_REF is 2: the height follows the deck's heave, and jumps at the deck's edge",
        "set EKF2_HGT_REF 1 (GNSS) or 0 (barometer)",
        {"EKF2_HGT_REF": 1.0},
    )


def external_vision(p: Snapshot) -> Finding | None:
    """Find an EKF that waits for a vision position."""
    if not _value(p, "EKF2_EV_CTRL"):
        return None
    return warning(
        "px4-external-vision",
        f"EKF2_EV_CTRL is {_value(p, 'EKF2_EV_CTRL'):g}: the EKF waits for a vision position, and a pad on a ship is none",
        "set EKF2_EV_CTRL 0 unless another source sends ODOMETRY",
        {"EKF2_EV_CTRL": 0.0},
    )


def targets_withheld(p: Snapshot) -> Finding | None:
    """Find targets that the service did not send, whatever the autopilot."""
    s = p.service
    if s.targets_sent is None or s.targets_sent > 0 or not s.withheld:
        return None
    why = max(s.withheld, key=lambda k: s.withheld[k])
    cures = {
        "not seen": "the pad is not in the frame, or colours and light do not suit: decklander detect on a frame shows why",
        "on ground": "no targets are sent while the vehicle reports that it is on the ground: this is as it should be",
        "taking off": "no targets are sent during a take-off: this is as it should be",
        "no attitude": "no attitude covers the instant: see attitude-slow and clock-not-locked",
        "no local position": "LOCAL_POSITION_NED does not come: see stream-silent",
        "no newer position": "LOCAL_POSITION_NED comes too rarely: ask for 30 Hz and more, see link-lossy",
        "not below": "the pad is not below the vehicle: check the camera's mount (rpy_body_cam_deg)",
        "unknown autopilot": "neither ArduPilot nor PX4: no form of target is known to be obeyed",
    }
    make = advice if why in ("on ground", "taking off") else error
    return make("targets-withheld", f"no target was sent: {why}", cures.get(why, "see the log"))


RULES: tuple[Rule, ...] = (
    precland_missing, precland_moving, unsupported_frame, offboard_loss, offboard_action, height_by_range, external_vision,
    targets_withheld,
)  # fmt: skip
