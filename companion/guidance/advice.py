"""Advice for each cause that interrupts or ends a landing: one sentence each, for the page and docs/mission.md."""

from companion.base.mission import State
from companion.base.reason import Reason, ReasonCause
from estimator.contracts.estimates import IntegrityAlert, Verdict

_C, _A, _V = ReasonCause, IntegrityAlert, Verdict

_LIGHT = "Look at the picture: is the pad lit, clean and in view?"
_MOUNT = "Check the camera's file: mount, delay and focal length (decklander calibrate); measure the pad."
_SLOW = "End other programs on the drone's computer, or ask for fewer frames."
_CLOCK = "Check clocks and delays with decklander doctor."
_SEA = "Wait for calmer water, or turn the ship so that the deck moves less."
_SHIP = "Check the ship's reports and their link (docs/rendezvous.md)."

_BY_CAUSE: dict[ReasonCause, str] = {
    _C.MOTORS_CUT: "Look where the drone is; decklander fly reset once it is safe.",
    _C.TAKEN_OVER: "Begin again to land with guidance (decklander doctor LOG).",
    _C.VEHICLE_STANDS: "If nobody landed it, look at the battery and the autopilot's own failsafes.",
    _C.NO_OWN_PLACE: "Give the drone a view of the sky, or fly it over the pad by hand.",
    _C.NO_OWN_HEADING: "Calibrate the compass away from steel, or fly the drone over the pad by hand.",
    _C.VESSEL_SILENT: _SHIP,
    _C.VESSEL_OLD: _SHIP,
    _C.VESSEL_LATE: _SHIP,
    _C.VESSEL_JUMPED: _SHIP,
    _C.VESSEL_TOO_FAST: _SHIP,
    _C.VESSEL_SIGMA: _SHIP,
    _C.STALE: _LIGHT,
    _C.INCONSISTENT: _MOUNT,
    _C.NO_ESTIMATE: _LIGHT,
    _C.ANOTHER_PAD: "Look whether there is a second pad; begin again to land on the one that is seen.",
    _C.NOBODY_DECIDED: "Look whether there is a second pad; begin again to land on the one that is seen.",
    _C.LOST_LOW: _LIGHT,
    _C.NOT_FOUND: "Fly the drone by hand until the pad is in the picture, then begin again.",
    _C.NOT_FOUND_AGAIN: "Fly the drone by hand until the pad is in the picture, then begin again.",
    _C.TRY_TIME: "Wait for less wind or swell; guidance.tries has the times.",
    _C.LANDING_TIME: "Wait for less wind or swell; guidance.tries has the times.",
    _C.STATE_TIME: "Wait for less wind or swell; guidance.tries has the times.",
    _C.LOSSES: _LIGHT,
    _C.BLIND_DESCENT: _LIGHT,
    _C.NO_LANDING: "Check that the vehicle takes the landing command: decklander doctor.",
    _C.NO_CONTACT: "Check the height over the deck: pad size, focal length, range sensor.",
    _C.ROSE: "The deck's wind or ground effect lifts it: turn the ship's bow into the wind.",
    _C.OFF_DECK: _SEA,
    _C.DRIFTED: "Wait for less wind, or turn the ship's bow into it.",
    _C.PAST_DECK: "Look where the drone is and take over by hand: the height over the deck is wrong.",
    _C.ROSE_AGAINST: "A sensor lies or the wind lifts it: take over by hand, and look at accelerometer and range sensor.",
    _C.SANK_AGAINST: "Take over by hand: the vehicle does not climb. Look at battery, propellers and load.",
    _C.ANSWERS_LATE: "Look at the link to the vehicle and at the load of the computer (decklander doctor).",
    _C.OFF_ORDERS: "Take over by hand: look at trim, load and battery, and for another sender of commands.",
    _C.STARVED: "End other programs on the drone's computer; see that it is cool and has power.",
    _C.NOT_CLIMBING: "Take over by hand: the vehicle does not climb. Look at battery, propellers and load.",
    _C.ON_PAD: "Clear the pad; if nothing lies there, order clear and begin again.",
    _C.GLARE: "Look at the pad; if nothing lies there, order clear and begin again.",
    _C.NEAR_PAD: "Keep people and things away from the pad; if nothing is there, order clear and begin again.",
    _C.ERROR: "Wait for less wind; if it stays so, check the vehicle's response (decklander calibrate vehicle).",
    _C.ERROR_AHEAD: "Wait for less wind; if it stays so, check the vehicle's response (decklander calibrate vehicle).",
    _C.SIGMA: _LIGHT,
    _C.SPEED_AHEAD: "Wait for less wind, or let the ship keep her course and speed.",
    _C.VIDEO_LATE: "Ask for fewer or smaller frames, or a faster link; more delay costs more centimetres.",
    _C.RELATIVE_SPEED: "Wait for less wind, or let the ship keep her course and speed.",
    _C.DECK_TILT: _SEA,
    _C.DECK_RATE: _SEA,
    _C.DECK_RISE: _SEA,
    _C.DECK_FALL: _SEA,
    _C.SIGHTING_AGE: _SLOW,
    _C.NIS: _MOUNT,
    _C.TIME_LOCK: _CLOCK,
    _C.HEADING: "Let the ship keep her course; check the compass if the ship does not turn.",
    _C.HEADING_TURNED: "Check the pad's arrow: is it worn, wet or half hidden?",
    _C.GUST: "Wait until the squall has passed.",
    _C.WIND: "Wait for less wind, or let the ship run with it.",
    _C.BATTERY: "Land by hand where it is safest, and charge.",
    _C.BATTERY_ENDS: "Land by hand where it is safest, and charge.",
    _C.LANDS_HERE: "Take over by hand if it must not land there.",
}
"""Advice by cause. Causes that are no faults have none, and neither have those that carry their own detail."""

_BY_ALERT: dict[IntegrityAlert, str] = {
    _A.CAMERA_FROZEN: "Restart the camera: its picture is dead.",
    _A.VIEW_FROZEN: "Restart the camera: its picture is dead.",
    _A.VIEW_REVERSED: "Turn off the camera's mirror (horizontal or vertical flip); else check rpy_body_cam_deg in its file.",
    _A.IMU_FROZEN: "Land by hand and reboot the autopilot: its sensor is dead.",
    _A.ATTITUDE_FROZEN: "Land by hand and reboot the autopilot: its attitude is dead.",
    _A.ATTITUDE: "Land by hand, and calibrate the autopilot's gyro and accelerometer: its attitude is wrong.",
    _A.IMU_LATE: _CLOCK,
    _A.STAMPS: _CLOCK,
    _A.APART: "Wait: the filter starts again by itself; if it comes back, land by hand and calibrate accelerometer and gyro.",
    _A.ELSEWHERE: "Look whether there is a second pad; begin again to land on the one that is seen.",
    _A.RANGE: "Check focal length and pad size; look for something under the range sensor.",
    _A.UNFELT: "Land by hand and calibrate the accelerometer.",
    _A.DECK: "Land by hand: the accelerometer may lie (decklander doctor).",
    _A.HEIGHT: "Check focal length and pad size; a gust into the barometer passes.",
}
_BY_FRAMES: dict[Verdict, str] = {
    _V.NO_PAD: _LIGHT,
    _V.GATED: _MOUNT,
    _V.LOW_CONFIDENCE: _LIGHT,
    _V.TOO_OLD: _SLOW,
    _V.TOO_NEW: _CLOCK,
    _V.SINGULAR: _MOUNT,
    _V.REPLACED: _SLOW,
    _V.SKIPPED: _SLOW,
    _V.NO_ATTITUDE: "Compare the stamps of frames and samples (decklander doctor); end other programs if the computer is busy.",
    _V.NO_GIMBAL: "Point the gimbal down; see that it reports its attitude (decklander doctor).",
    _V.FAILED: "Read the log: the frames have another size than the camera's file says, or are damaged.",
    _V.REPEATED: "Restart the camera: its picture is dead.",
    _V.FROZEN: "Restart the camera: its picture is dead.",
    _V.IMPOSSIBLE: _MOUNT,
    _V.ELSEWHERE: "Look whether there is a second pad; begin again to land on the one that is seen.",
}
_WAITING = frozenset({State.REFUSED, State.GAVE_UP, State.ABORTED})
_HOVERS = "It hovers until you begin again or land it."


def advice(state: State, reason: Reason) -> str:
    """Return what a person can do after this change of state; empty if there is nothing to do.

    Args:
        state: the state that the machine went to.
        reason: why.
    """
    detail = reason.detail
    if isinstance(detail, IntegrityAlert):
        first = _BY_ALERT[detail]
    elif isinstance(detail, Verdict):
        first = _BY_FRAMES.get(detail, "")
    else:
        first = _BY_CAUSE.get(reason.cause, "")
    return " ".join(filter(None, (first, _HOVERS if state in _WAITING else "")))


def advised_causes() -> dict[ReasonCause, str]:
    """Return the advice by cause, in the order of the causes."""
    return {cause: _BY_CAUSE[cause] for cause in ReasonCause if cause in _BY_CAUSE}


def advised_alerts() -> dict[IntegrityAlert, str]:
    """Return the advice for what makes an estimate doubtful."""
    return dict(_BY_ALERT)
