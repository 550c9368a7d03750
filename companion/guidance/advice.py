"""Advice for each cause that interrupts or ends a landing: one sentence each, for the page and docs/mission.md."""

from companion.base.mission import Reason, ReasonCause, State
from estimator.contracts.estimates import IntegrityAlert, Verdict

_C, _A, _V = ReasonCause, IntegrityAlert, Verdict

CAUSES: dict[str, tuple[ReasonCause | IntegrityAlert | Verdict, ...]] = {
    "Look where the drone is; decklander fly reset once it is safe.": (_C.MOTORS_CUT,),
    "Begin again to land with guidance (decklander doctor LOG).": (_C.TAKEN_OVER,),
    "If nobody landed it, look at the battery and the autopilot's own failsafes.": (_C.VEHICLE_STANDS,),
    "Give the drone a view of the sky, or fly it over the pad by hand.": (_C.NO_OWN_PLACE,),
    "Calibrate the compass away from steel, or fly the drone over the pad by hand.": (_C.NO_OWN_HEADING,),
    "Check the ship's reports and their link (docs/rendezvous.md).": (
        _C.VESSEL_SILENT,
        _C.VESSEL_OLD,
        _C.VESSEL_LATE,
        _C.VESSEL_JUMPED,
        _C.VESSEL_TOO_FAST,
        _C.VESSEL_SIGMA,
    ),
    "Look at the picture: is the pad lit, clean and in view?": (
        _C.STALE,
        _C.NO_ESTIMATE,
        _C.LOST_LOW,
        _C.LOSSES,
        _C.BLIND_DESCENT,
        _C.SIGMA,
        _V.NO_PAD,
        _V.LOW_CONFIDENCE,
    ),
    "Check the camera's file: mount, delay and focal length (decklander calibrate); measure the pad.": (
        _C.INCONSISTENT,
        _C.NIS,
        _V.GATED,
        _V.SINGULAR,
        _V.IMPOSSIBLE,
    ),
    "Look whether there is a second pad; begin again to land on the one that is seen.": (
        _C.ANOTHER_PAD,
        _C.NOBODY_DECIDED,
        _A.ELSEWHERE,
        _V.ELSEWHERE,
    ),
    "Fly the drone by hand until the pad is in the picture, then begin again.": (_C.NOT_FOUND, _C.NOT_FOUND_AGAIN),
    "Wait for less wind or swell; guidance.tries has the times.": (_C.TRY_TIME, _C.LANDING_TIME, _C.STATE_TIME),
    "Check that the vehicle takes the landing command: decklander doctor.": (_C.NO_LANDING,),
    "Check the height over the deck: pad size, focal length, range sensor.": (_C.NO_CONTACT,),
    "The deck's wind or ground effect lifts it: turn the ship's bow into the wind.": (_C.ROSE,),
    "Wait for calmer water, or turn the ship so that the deck moves less.": (
        _C.OFF_DECK,
        _C.DECK_TILT,
        _C.DECK_RATE,
        _C.DECK_RISE,
        _C.DECK_FALL,
    ),
    "Wait for less wind, or turn the ship's bow into it.": (_C.DRIFTED,),
    "Look where the drone is and take over by hand: the height over the deck is wrong.": (_C.PAST_DECK,),
    "A sensor lies or the wind lifts it: take over by hand, and look at accelerometer and range sensor.": (_C.ROSE_AGAINST,),
    "Take over by hand: the vehicle does not climb. Look at battery, propellers and load.": (_C.SANK_AGAINST, _C.NOT_CLIMBING),
    "Look at the link to the vehicle and at the load of the computer (decklander doctor).": (_C.ANSWERS_LATE,),
    "Take over by hand: look at trim, load and battery, and for another sender of commands.": (_C.OFF_ORDERS,),
    "End other programs on the drone's computer; see that it is cool and has power.": (_C.STARVED,),
    "Clear the pad; if nothing lies there, order clear and begin again.": (_C.ON_PAD,),
    "Look at the pad; if nothing lies there, order clear and begin again.": (_C.GLARE,),
    "Keep people and things away from the pad; if nothing is there, order clear and begin again.": (_C.NEAR_PAD,),
    "Wait for less wind; if it stays so, check the vehicle's response (decklander calibrate vehicle).": (
        _C.ERROR,
        _C.ERROR_AHEAD,
    ),
    "Wait for less wind, or let the ship keep her course and speed.": (_C.SPEED_AHEAD, _C.RELATIVE_SPEED),
    "Ask for fewer or smaller frames, or a faster link; more delay costs more centimetres.": (_C.VIDEO_LATE,),
    "End other programs on the drone's computer, or ask for fewer frames.": (
        _C.SIGHTING_AGE,
        _V.TOO_OLD,
        _V.REPLACED,
        _V.SKIPPED,
    ),
    "Check clocks and delays with decklander doctor.": (_C.TIME_LOCK, _A.IMU_LATE, _A.STAMPS, _V.TOO_NEW),
    "Let the ship keep her course; check the compass if the ship does not turn.": (_C.HEADING,),
    "Check the pad's arrow: is it worn, wet or half hidden?": (_C.HEADING_TURNED,),
    "Wait until the squall has passed.": (_C.GUST,),
    "Wait for less wind, or let the ship run with it.": (_C.WIND,),
    "Land by hand where it is safest, and charge.": (_C.BATTERY, _C.BATTERY_ENDS),
    "Take over by hand if it must not land there.": (_C.LANDS_HERE,),
    "Restart the camera: its picture is dead.": (_A.CAMERA_FROZEN, _A.VIEW_FROZEN, _V.REPEATED, _V.FROZEN),
    "Turn off the camera's mirror (horizontal or vertical flip); else check rpy_body_cam_deg in its file.": (_A.VIEW_REVERSED,),
    "Land by hand and reboot the autopilot: its sensor is dead.": (_A.IMU_FROZEN,),
    "Land by hand and reboot the autopilot: its attitude is dead.": (_A.ATTITUDE_FROZEN,),
    "Land by hand, and calibrate the autopilot's gyro and accelerometer: its attitude is wrong.": (_A.ATTITUDE,),
    "Wait: the filter starts again by itself; if it comes back, land by hand and calibrate accelerometer and gyro.": (_A.APART,),
    "Check focal length and pad size; look for something under the range sensor.": (_A.RANGE,),
    "Land by hand and calibrate the accelerometer.": (_A.UNFELT,),
    "Land by hand: the accelerometer may lie (decklander doctor).": (_A.DECK,),
    "Check focal length and pad size; a gust into the barometer passes.": (_A.HEIGHT,),
    "Compare the stamps of frames and samples (decklander doctor); end other programs if the computer is busy.": (
        _V.NO_ATTITUDE,
    ),
    "Point the gimbal down; see that it reports its attitude (decklander doctor).": (_V.NO_GIMBAL,),
    "Read the log: the frames have another size than the camera's file says, or are damaged.": (_V.FAILED,),
}
"""Causes, alerts and verdicts on frames by what a person can do. Those that are no faults are not named."""
_ADVICE = {cause: words for words, causes in CAUSES.items() for cause in causes}
_WAITING = frozenset({State.REFUSED, State.GAVE_UP, State.ABORTED})
_HOVERS = "It hovers until you begin again or land it."


def advice(state: State, reason: Reason) -> str:
    """Return what a person can do after this change of state; empty if there is nothing to do.

    Args:
        state: the state that the machine went to.
        reason: why.
    """
    named = reason.detail if isinstance(reason.detail, IntegrityAlert | Verdict) else reason.cause
    return " ".join(filter(None, (_ADVICE.get(named, ""), _HOVERS if state in _WAITING else "")))
