"""Rules for parameters that can spoil or endanger a landing: harmless ranges, failsafes together, arming.

Each row is one rule. The limits are meant for a landing by setpoints on a deck that moves; a value inside them is not praised,
only not named. Sources: parameter references of ArduCopter 4.5, PX4 1.16 and 1.17, and flights of both on a deck
(docs/ardupilot.md, docs/px4.md).
"""

import math

from msgspec import Struct

from companion.tools.doctor.finding import Finding, ParameterChange, Row, Rule, Severity, warning
from companion.tools.doctor.firmware_parameters import NamedValue, named_value
from companion.tools.doctor.snapshot import AutopilotSnapshot, Snapshot
from drivers.mavlink.joined_texts import ARMING_REFUSAL

# Both stacks return to the place of the take-off over the ground. A ship under way has left it, so a return must end in a
# hover, in which a person can take over.

_SHOWN = 4  # reasons that are listed
_FIXES = {
    "position estimate": "wait for GNSS under an open sky; on a ship under way see gnss-checks and px4-gnss-checks",
    "health failures": "see the other refusals, and px4-gnss-checks on a ship under way",
    "gyro": "let it stand still at boot, ashore: see gyro-calibration",
    "accel": "calibrate level ashore; on a deck that rolls two accelerometers may disagree until it is calmer",
    "compass": "move it from steel and currents, or calibrate it where it stands",
    "mag": "move it from steel and currents, or calibrate it where it stands",
    "rangefinder": "let ranges be sent already on the ground (rangefinder-unfed)",
    "remote control": "switch it on, or tell the autopilot that there is none (COM_RC_IN_MODE 4, FS_THR_ENABLE 0)",
    "rc ": "switch it on, or tell the autopilot that there is none (COM_RC_IN_MODE 4, FS_THR_ENABLE 0)",
    "battery": "charge it, or correct its limits",
    "fence": "it is yours to change: the finding fence says what of it conflicts with a ship",
    "terrain": "switch terrain following off",
}
_HOVER_CM = 200.0  # height of a return's hover below which it descends onto what is below
_HOVER_TO_CM = 500.0  # height that is advised
_GUIDED_GOES_ON = 1 << 2  # bit of FS_OPTIONS: continue in guided mode
_OFFBOARD = 1 << 2  # bit of COM_DLL_EXCEPT and COM_RCL_EXCEPT: offboard
_NO_STICKS = 4.0  # COM_RC_IN_MODE: sticks disabled
_PX4_RETURN = 2.0  # NAV_RCL_ACT and NAV_DLL_ACT: return
_CIRCLE = 1 << 1  # bit of FENCE_TYPE: circle around home
_FLOOR = 1 << 3  # bit of FENCE_TYPE: least altitude
_FLOOR_MAX_M = -1.0  # FENCE_ALT_MIN above which a landing on a deck is in the way of it
_HOLDS = 2.0  # least GF_ACTION that acts: hold


def arming_refused(p: Snapshot) -> Finding | None:
    """Find an autopilot that is not armed and reports why it cannot be."""
    a = p.autopilot
    if a is None or a.armed or p.log is not None:
        return None
    reported = list(dict.fromkeys(found[1].strip() for text in a.texts if (found := ARMING_REFUSAL.match(text)) is not None))
    if not reported:
        return None
    shown = reported[:_SHOWN] + ([f"{len(reported) - _SHOWN} more"] if len(reported) > _SHOWN else [])
    first = reported[0].lower()
    fix = next((fix for word, fix in _FIXES.items() if word in first), "its documentation explains each of these texts")
    return warning("arming-refused", f"it refuses to arm: {'; '.join(shown)}", fix)


ARMING: tuple[Rule, ...] = (
    arming_refused,
    Row("parameter-name", Severity.WARNING,
        lambda p: p.autopilot and ", ".join(f"{name} for {known}" for name, known in p.autopilot.misspelt.items()),
        "misspelt, so that no autopilot takes it: {0}",
        "write the known name"),
)  # fmt: skip


FAILSAFE_PARAMETERS = {
    "ArduPilot": (
        "FS_THR_ENABLE", "FS_GCS_ENABLE", "FS_OPTIONS", "BATT_FS_LOW_ACT", "BATT_FS_CRT_ACT", "RTL_ALT_FINAL",
        "FENCE_ENABLE", "FENCE_ACTION", "FENCE_TYPE", "FENCE_ALT_MIN",
    ),
    "PX4": (
        "NAV_RCL_ACT", "NAV_DLL_ACT", "COM_RC_IN_MODE", "COM_RCL_EXCEPT", "COM_DLL_EXCEPT", "RTL_LAND_DELAY",
        "GF_ACTION", "GF_MAX_HOR_DIST",
    ),
}  # fmt: skip
_RETURNS = {
    "FS_THR_ENABLE": (1.0, 2.0, 4.0, 6.0),
    "FS_GCS_ENABLE": (1.0, 2.0, 3.0, 6.0),
    "BATT_FS_LOW_ACT": (2.0, 3.0, 6.0),
    "BATT_FS_CRT_ACT": (2.0, 3.0, 6.0),
}
"""Values of ArduCopter's failsafe actions that return."""
_REMOTE_LANDS = {3.0: "land", 5.0: "smart return or land", 7.0: "brake or land"}


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
    climbs = {final.name: final.there(_HOVER_TO_CM)} if final is not None and final.value < _HOVER_CM else {}
    return warning(
        "remote-loss",
        f"FS_THR_ENABLE is {action:g} ({_REMOTE_LANDS[action]}): without a remote control it lands where it is, in the sea",
        "set FS_THR_ENABLE 1 (return) and " + " ".join(_hover(a)) + " (which ends in a hover 5 m up)",
        {"FS_THR_ENABLE": 1.0} | climbs,
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


def _px4_returns(p: Snapshot) -> tuple[str, float] | None:
    """Return the failsafes of PX4 that return, and the delay with which a return ends in a landing, s."""
    a = _of(p, "PX4")
    if a is None or a.parameters.get("RTL_LAND_DELAY", -1.0) < 0.0:
        return None
    returning = []
    if a.parameters.get("NAV_RCL_ACT") == _PX4_RETURN and _sticks_matter(a):
        returning.append("NAV_RCL_ACT 2")
    if a.parameters.get("NAV_DLL_ACT") == _PX4_RETURN and not int(a.parameters.get("COM_DLL_EXCEPT", 0.0)) & _OFFBOARD:
        returning.append("NAV_DLL_ACT 2")
    return (", ".join(returning), a.parameters["RTL_LAND_DELAY"]) if returning else None


def _sticks_matter(a: AutopilotSnapshot) -> bool:
    """Return whether the loss of the remote control is a failsafe in OFFBOARD."""
    excepted = int(a.parameters.get("COM_RCL_EXCEPT", 0.0)) & _OFFBOARD
    return not excepted and a.parameters.get("COM_RC_IN_MODE") != _NO_STICKS


def _joystick_only(p: Snapshot) -> bool:
    """Return whether a PX4 takes a station's joystick alone: a station that is lost is a remote control that is lost."""
    a = _of(p, "PX4")
    return a is not None and a.parameters.get("COM_RC_IN_MODE") == 1.0 and _sticks_matter(a)


def _copter_fence(p: Snapshot) -> tuple[float, str] | None:
    """Return the action of ArduCopter's fence, and what of it a landing on a ship breaks."""
    a = _of(p, "ArduPilot")
    read = {} if a is None else a.parameters
    action, kinds = read.get("FENCE_ACTION", 1.0), int(read.get("FENCE_TYPE", 7.0))
    broken = ["the circle around home, which stays where the ship was"] if kinds & _CIRCLE else []
    if kinds & _FLOOR and (floor_m := read.get("FENCE_ALT_MIN", -10.0)) > _FLOOR_MAX_M:
        broken.append(f"the least altitude, {floor_m:g} m")
    return (action, " and ".join(broken)) if read.get("FENCE_ENABLE") and action and broken else None


def _px4_fence(p: Snapshot) -> tuple[float, float] | None:
    """Return the radius of PX4's fence around home, m, and its action."""
    a = _of(p, "PX4")
    reach_m = 0.0 if a is None else a.parameters.get("GF_MAX_HOR_DIST", 0.0)
    action = _HOLDS if a is None else a.parameters.get("GF_ACTION", _HOLDS)
    return (reach_m, action) if reach_m > 0.0 and action >= _HOLDS else None


_ERROR, _WARNING, _ADVICE = Severity.ERROR, Severity.WARNING, Severity.ADVICE
FAILSAFE_RULES: tuple[Rule, ...] = (
    copter_remote_loss, copter_return,
    Row("fence", _WARNING, _copter_fence,
        "the fence ends the flight (FENCE_ACTION {0[0]:g}) at {0[1]}",
        "by hand, as it is your containment: make FENCE_RADIUS longer than her way or take 2 (the circle) out of FENCE_TYPE, "
        "put FENCE_ALT_MIN below the sea, and keep the ceiling"),
    Row("px4-fence", _WARNING, _px4_fence,
        "GF_MAX_HOR_DIST is {0[0]:g} with GF_ACTION {0[1]:g}: the fence stays where the ship was, and ends the flight there",
        "by hand, as it is your containment: make it longer than her way, and keep GF_MAX_VER_DIST"),
    Row("px4-return-lands", _WARNING, _px4_returns,
        "{0[0]}: it returns to where the ship was, and RTL_LAND_DELAY {0[1]:g} lands it there",
        "set RTL_LAND_DELAY -1: a return ends in a hover, for a person to take over",
        {"RTL_LAND_DELAY": -1.0}),
    Row("px4-joystick-only", _ERROR, _joystick_only,
        "COM_RC_IN_MODE is 1: the remote control is not listened to, and without a station's joystick it fails safe in OFFBOARD",
        "set COM_RC_IN_MODE 3 (both), or 4 where nobody holds a remote control",
        {"COM_RC_IN_MODE": 3.0}),
)  # fmt: skip


class ValueRule(Struct, frozen=True):
    """One parameter, what is wrong with a value outside its range, and a value that is not."""

    rule: str
    stack: str
    parameter: str
    good: float
    """The value that the fix names; where bits must not be set, the fix clears these alone."""
    why: str
    """Effect of a wrong value."""
    low: float = -math.inf
    high: float = math.inf
    wrong: tuple[float, ...] = ()
    """Single values that are wrong inside the range."""
    right: tuple[float, ...] = ()
    """Single values that are right outside the range: those that switch a filter or a check off."""
    bits: int = 0
    """Bits that must not be set."""
    needed: int = 0
    """Bits that must be set."""
    over_ship: float | None = None
    """Least excess of a speed limit over the ship's speed, m/s; None if her speed does not matter."""
    per_m_s: float = 1.0
    """Value of the parameter for 1 m/s."""
    like: str = ""
    """Parameter whose value is the good one, where it is known: two thirds of it to 1.5 times it pass."""
    severity: Severity = _WARNING
    lacking: tuple[Severity, str] | None = None
    """Severity and effect where a needed bit alone is missing; None leaves both."""
    on_ship: bool = True
    """True if it only matters where the pad moves."""
    by_hand: str = ""
    """The fix where the parameter is the pilot's own protection: only a person may loosen it, so no change is offered."""

    def __call__(self, snapshot: Snapshot) -> Finding | None:
        """Return the finding, or None where the value is good or not known."""
        autopilot = snapshot.autopilot
        if autopilot is None or autopilot.stack != self.stack or (self.on_ship and not snapshot.moving_pad):
            return None
        named = named_value(autopilot.parameters, self.parameter)
        if named is None:
            return None
        value, low, high, good = named.value, self._low(snapshot), self.high, self.good
        if (alike := autopilot.parameters.get(self.like, 0.0)) > 0.0:
            low, high, good = alike / 1.5, alike * 1.5, alike
        inside = low <= value <= high and value not in self.wrong
        if value in self.right or (inside and not int(value) & self.bits and int(value) & self.needed == self.needed):
            return None
        masked = self.bits or self.needed
        to = float(int(value) & ~self.bits | self.needed) if masked else good if self.over_ship is None else max(good, low)
        to = named.there(to)
        severity, why = self.severity, self.why
        if self.lacking is not None and inside and not int(value) & self.bits:
            severity, why = self.lacking
        what = f"{named.name} is {named.there(value):g}: {why}"
        if self.over_ship is not None and low > self.low:
            what += f" (she makes {snapshot.ship_speed_m_s:g} m/s)"
        if self.by_hand:
            return Finding(self.rule, severity, what, f"by hand, as it protects the vehicle: {self.by_hand}")
        return Finding(self.rule, severity, what, f"set {named.name} {to:g}", (ParameterChange(named.name, to),))

    def _low(self, snapshot: Snapshot) -> float:
        if self.over_ship is None or snapshot.ship_speed_m_s is None:
            return self.low
        return max(self.low, self.per_m_s * (snapshot.ship_speed_m_s + self.over_ship))


_A, _P, _Q = "ArduPilot", "PX4", "ArduPlane"
_BATTERY = "set its limits so that a landing on the ship fits before them; 2 returns, 0 only warns"
_ARDUPILOT = (
    ValueRule("guided-timeout", _A, "GUID_TIMEOUT", 1,
              "a gap in the link stops it over the ground, or a dead service flies on", 1, 5),
    ValueRule("land-speed", _A, "LAND_SPEED", 40,
              "it strikes the deck, or never gets down on one that heaves", 20, 70, on_ship=False),
    ValueRule("land-speed-high", _A, "LAND_SPEED_HIGH", 0,
              "it comes down on the ship faster than a deck can be followed", 0, 200),
    ValueRule("range-max", _A, "RNGFND1_MAX_CM", 700, "above it the rangefinder says nothing, and LAND does not slow down", 400),
    ValueRule("range-min", _A, "RNGFND1_MIN_CM", 5, "below it the rangefinder says nothing of the deck", -1, 30),
    ValueRule("plnd-distance", _A, "PLND_XY_DIST_MAX", 2.5, "farther off it never descends, and 0 allows it beside the pad", 0.5),
    ValueRule("plnd-timeout", _A, "PLND_TIMEOUT", 4, "so long it descends without a target before it tries again", 2, 8),
    ValueRule("plnd-low", _A, "PLND_ALT_MIN", 0.75, "below it it lands where it is, with the pad or without", -1, 1.5),
    ValueRule("guided-accel", _A, "WPNAV_ACCEL", 500, "in fresh wind it stays decimetres off its place", 400, severity=_ADVICE),
    ValueRule("jerk", _A, "PSC_JERK_XY", 20, "in fresh wind it stays decimetres off its place", 15, severity=_ADVICE),
    # Their quotient is the lag of a climb in the response file: 0.2 s.
    ValueRule("guided-accel-z", _A, "WPNAV_ACCEL_Z", 300, "it climbs too late before a deck that rises", 200, severity=_ADVICE),
    ValueRule("descent-limit", _A, "WPNAV_SPEED_DN", 150, "a deck that falls away is not reached", 100),
    ValueRule("climb-limit", _A, "WPNAV_SPEED_UP", 250, "a deck that rises strikes it from below", 150),
    ValueRule("jerk-z", _A, "PSC_JERK_Z", 15, "it climbs too late before a deck that rises", 10, severity=_ADVICE),
    ValueRule("thrust-late", _A, "PSC_ACCZ_FF", 0.3, "half of the acceleration up or down comes a second late", 0.1,
              like="MOT_THST_HOVER", severity=_ADVICE),
    ValueRule("velocity-integral", _A, "PSC_VELXY_I", 1, "wind is not cancelled", 0.2),
    ValueRule("lean-slow", _A, "ATC_INPUT_TC", 0.15, "its lean follows too late for a deck", -1, 0.3),
    ValueRule("lean-loose", _A, "ATC_ANG_RLL_P", 4.5, "its lean follows too late for a deck", 3),
    ValueRule("lean-limit", _A, "ANGLE_MAX", 3000, "it cannot hold against wind and follow the deck", 1500),
    ValueRule("accel-filter", _A, "INS_ACCEL_FILTER", 20, "the contact with the deck is felt too late or not at all", 10),
    ValueRule("gyro-filter", _A, "INS_GYRO_FILTER", 40, "the filter delays the loops", 15, on_ship=False),
    ValueRule("notch-low", _A, "INS_HNTCH_FREQ", 80, "a notch so low delays the loops", 30, on_ship=False),
    ValueRule("disarm-delay", _A, "DISARM_DELAY", 10, "it disarms before it has climbed, or stays armed on deck", 5, 30),
    ValueRule("spin-min", _A, "MOT_SPIN_MIN", 0.15, "it cannot descend on a deck that falls away", -1, 0.3, on_ship=False),
    ValueRule("guided-options", _A, "GUID_OPTIONS", 16, "with bit 5 GUIDED does not hold a velocity",
              bits=0b100000, needed=0b010000, severity=_ERROR, on_ship=False,
              lacking=(_ADVICE, "without bit 4 GUIDED also holds a position, against the commanded velocity")),
    ValueRule("slow-too-late", _A, "LAND_ALT_LOW", 1000, "LAND slows down only so high over the ground", 500, on_ship=False),
    ValueRule("cruise-speed", _A, "WPNAV_SPEED", 1000, "it cannot overtake the ship on its way to her", 300,
              over_ship=3, per_m_s=100),
    ValueRule("loiter-speed", _A, "LOIT_SPEED", 1250, "a person who takes over in LOITER cannot keep up with the ship", 300,
              over_ship=3, per_m_s=100),
    ValueRule("velocity-loose", _A, "PSC_VELXY_P", 2, "its velocity follows too late for a deck", 1),
    ValueRule("climb-loose", _A, "PSC_VELZ_P", 5, "it cannot follow the deck's heave", 2.5),
    ValueRule("velocity-filter", _A, "PSC_VELXY_FLTE", 5, "the filter delays the velocity loop", 2),
    ValueRule("climb-filter", _A, "PSC_VELZ_FLTE", 5, "the filter delays the climb loop", 2),
    ValueRule("thrust-loose", _A, "PSC_ACCZ_P", 0.5, "it cannot follow the deck's heave", 0.2),
    ValueRule("thrust-filter", _A, "PSC_ACCZ_FLTE", 20, "the filter delays the climb loop", 5),
    ValueRule("roll-filter", _A, "ATC_RAT_RLL_FLTD", 20, "the filter delays the loops", 8, right=(0.0,), on_ship=False),
    ValueRule("pitch-filter", _A, "ATC_RAT_PIT_FLTD", 20, "the filter delays the loops", 8, right=(0.0,), on_ship=False),
    ValueRule("pitch-loose", _A, "ATC_ANG_PIT_P", 4.5, "its lean follows too late for a deck", 3),
    ValueRule("second-notch-low", _A, "INS_HNTC2_FREQ", 80, "a notch so low delays the loops", 30, on_ship=False),
    ValueRule("notch-wide", _A, "INS_HNTCH_BW", 40, "a notch so wide delays the loops", 1, 100, on_ship=False),
    ValueRule("gnss-rate", _A, "GPS_RATE_MS", 200, "its velocity comes too rarely for a deck", 50, 200),
    ValueRule("rotors-slow", _A, "MOT_SPOOL_TIME", 0.5, "take-off is late by so much", 0, 1.5),
    ValueRule("compass-learns", _A, "COMPASS_LEARN", 0, "it learns the ship's steel", wrong=(2.0, 3.0)),
    ValueRule("ekf-failsafe", _A, "FS_EKF_THRESH", 0.8, "an EKF that is wrong is flown on", 0.5, 1.0),
    ValueRule("ekf-action", _A, "FS_EKF_ACTION", 1, "an EKF in doubt lands it even where a person flies it",
              by_hand="1 lands it in modes that need a position alone", wrong=(3.0,)),
    ValueRule("station-loss", _A, "FS_GCS_ENABLE", 0, "without a station it lands where it is, in the sea",
              by_hand="1 returns, and RTL_ALT_FINAL 500 lets a return end in a hover; 0 is off", wrong=(4.0, 5.0, 7.0)),
    ValueRule("battery-action", _A, "BATT_FS_LOW_ACT", 0, "with a low battery it comes down where it is, in the sea",
              by_hand=_BATTERY, wrong=(1.0, 4.0, 5.0, 7.0)),
    ValueRule("battery-critical", _A, "BATT_FS_CRT_ACT", 0, "with an empty battery it comes down where it is, in the sea",
              by_hand=_BATTERY, wrong=(1.0, 4.0, 5.0, 7.0)),
    ValueRule("mode-blocked", _A, "FLTMODE_GCSBLOCK", 0, "GUIDED cannot be entered over MAVLink: the landing never begins",
              bits=1 << 4, severity=_ERROR, on_ship=False),
    ValueRule("ekf-no-velocity", _A, "EK3_SRC1_VELXY", 3, "GNSS gives the EKF no velocity: it lands three times as far off",
              wrong=(0.0,), on_ship=False),
    ValueRule("ekf-no-climb", _A, "EK3_SRC1_VELZ", 3, "GNSS gives the EKF no vertical speed, and the deck heaves",
              wrong=(0.0,), on_ship=False),
    ValueRule("gnss-checks", _A, "EK3_GPS_CHECK", 31,
              "its checks of drift take a ship under way for a bad GNSS", bits=0b11100000, severity=_ERROR),
    ValueRule("arming-checks", _A, "ARMING_CHECK", 1,
              "it takes off without its checks", wrong=(0.0,), severity=_ADVICE, on_ship=False),
    ValueRule("arming-skipped", _A, "ARMING_SKIPCHK", 0,
              "it takes off without its checks", wrong=(-1.0,), severity=_ADVICE, on_ship=False),
)  # fmt: skip
_PX4 = (
    ValueRule("px4-gnss-checks", _P, "EKF2_GPS_CHECK", 21,
              "its checks of drift never pass on a ship under way: arming is refused for ever",
              bits=0b111100000, severity=_ERROR),
    ValueRule("px4-offboard-short", _P, "COM_OF_LOSS_T", 1,
              "every gap between setpoints is a failsafe", 0.5, severity=_ERROR, on_ship=False),
    # It takes 1.1 times this for a descent at the least, and sets the parameter itself to at most MPC_LAND_CRWL / 1.2
    ValueRule("px4-land-descent", _P, "LNDMC_Z_VEL_MAX", 0.25,
              "a landing at 0.4 m/s is no descent to it, or the least heave is no standing", 0.1, 0.7, severity=_ADVICE),
    ValueRule("px4-land-way", _P, "LNDMC_XY_VEL_MAX", 1.5, "the ship's way hides from it that it stands", 1.0,
              over_ship=0.5, severity=_ADVICE),
    ValueRule("px4-land-time", _P, "LNDMC_TRIG_TIME", 1, "it sees too late that it stands", -1, 3),
    ValueRule("px4-land-rotation", _P, "LNDMC_ROT_MAX", 20, "a rolling deck hides from it that it stands", 10),
    ValueRule("px4-speed-limit", _P, "MPC_XY_VEL_MAX", 12, "it cannot overtake the ship", 3, over_ship=3, severity=_ERROR),
    ValueRule("px4-descent-limit", _P, "MPC_Z_VEL_MAX_DN", 1.5, "a deck that falls away is not reached", 1, severity=_ERROR),
    ValueRule("px4-climb-limit", _P, "MPC_Z_VEL_MAX_UP", 3, "a deck that rises strikes it from below", 1.5),
    ValueRule("px4-lean-limit", _P, "MPC_TILTMAX_AIR", 45, "it cannot hold against wind and follow the deck", 20),
    ValueRule("px4-lean-take-off", _P, "MPC_TILTMAX_LND", 12,
              "it cannot go with the ship at take-off, or turns over on deck", 8, 20),
    ValueRule("px4-velocity-loose", _P, "MPC_XY_VEL_P_ACC", 1.8, "its velocity follows too late for a deck", 1.2),
    ValueRule("px4-velocity-integral", _P, "MPC_XY_VEL_I_ACC", 0.4, "wind is not cancelled", 0.1),
    ValueRule("px4-climb-loose", _P, "MPC_Z_VEL_P_ACC", 4, "it cannot follow the deck's heave", 2.5),
    ValueRule("px4-lean-loose", _P, "MC_ROLL_P", 6.5, "its lean follows too late for a deck", 4),
    ValueRule("px4-thrust-min", _P, "MPC_THR_MIN", 0.12, "it cannot descend on a deck that falls away", -1, 0.2, on_ship=False),
    ValueRule("px4-thrust-max", _P, "MPC_THR_MAX", 1, "it cannot climb from a deck that rises", 0.7),
    ValueRule("px4-spool-up", _P, "COM_SPOOLUP_TIME", 1, "the take-off is late by so much", -1, 3),
    ValueRule("px4-take-off-ramp", _P, "MPC_TKO_RAMP_T", 3, "it stands half weightless on a moving deck for so long", -1, 4),
    ValueRule("px4-disarm-late", _P, "COM_DISARM_LAND", 2, "it stays armed on deck", 0.1, 5, on_ship=False),
    ValueRule("px4-disarm-early", _P, "COM_DISARM_PRFLT", 10, "it disarms before it has climbed", 5, on_ship=False),
    ValueRule("px4-time-limit", _P, "COM_FLT_TIME_MAX", -1, "after so long in the air it flies home, in a landing too",
              900, right=(-1.0,), severity=_ERROR, on_ship=False,
              by_hand="make it longer than the flight to the ship with the landing (900 s and more)"),
    ValueRule("px4-setpoints-ignored", _P, "MAV_FWDEXTSP", 1, "setpoints are not passed on: OFFBOARD never begins",
              wrong=(0.0,), severity=_ERROR, on_ship=False),
    ValueRule("px4-manual-speed", _P, "MPC_VEL_MANUAL", 10, "a person who takes over cannot keep up with the ship", 3,
              over_ship=2),
    ValueRule("px4-gnss-control", _P, "EKF2_GPS_CTRL", 7, "GNSS gives it no position or no velocity",
              needed=0b101, severity=_ERROR),
    ValueRule("px4-gnss-delay", _P, "EKF2_GPS_DELAY", 110, "its velocity is old by so much", 0, 250),
    ValueRule("px4-gnss-wait", _P, "EKF2_REQ_GPS_H", 10, "so long it refuses to arm on deck", 0, 30),
    ValueRule("px4-heading", _P, "EKF2_MAG_TYPE", 0, "it has no heading until it has flown", wrong=(5.0,), severity=_ERROR),
    ValueRule("px4-compass-strength", _P, "COM_ARM_MAG_STR", 2, "a deck of steel keeps it from arming",
              by_hand="2 only warns", wrong=(1.0,), severity=_ADVICE),
    ValueRule("px4-velocity-doubt", _P, "COM_VEL_FS_EVH", 1, "a small doubt about its velocity ends OFFBOARD", 0.5),
    ValueRule("px4-wind-limit", _P, "COM_WIND_MAX", -1, "wind at sea ends the landing", 10, right=(-1.0,),
              by_hand="raise it to the wind in which this vehicle may fly"),
    ValueRule("px4-roll-limit", _P, "FD_FAIL_R", 60, "a lean against a gust counts as a failure", 45, right=(0.0,)),
    ValueRule("px4-pitch-limit", _P, "FD_FAIL_P", 60, "a lean against a gust counts as a failure", 45, right=(0.0,)),
    ValueRule("px4-pitch-loose", _P, "MC_PITCH_P", 6.5, "its lean follows too late for a deck", 4),
    ValueRule("px4-hover-thrust", _P, "MPC_THR_HOVER", 0.5, "it leaps or sinks at take-off, and sees landings where none are",
              0.1, 0.8, on_ship=False),
    ValueRule("px4-velocity-filter", _P, "MPC_VELD_LP", 5, "the filter delays the velocity loop", 2, right=(0.0,)),
    ValueRule("px4-notch-low", _P, "IMU_GYRO_NF0_FRQ", 0, "a notch so low delays the loops", 30, right=(0.0,), on_ship=False),
    ValueRule("px4-second-notch-low", _P, "IMU_GYRO_NF1_FRQ", 0, "a notch so low delays the loops", 30, right=(0.0,),
              on_ship=False),
    ValueRule("px4-gyro-rate", _P, "IMU_GYRO_RATEMAX", 400, "the rate loop is too slow", 250, on_ship=False),
    ValueRule("px4-remote-loss", _P, "NAV_RCL_ACT", 1,
              "without a remote control it comes down where it is, in the sea", wrong=(3.0, 5.0, 6.0)),
    ValueRule("px4-station-loss", _P, "NAV_DLL_ACT", 1,
              "without a station it comes down where it is, in the sea", wrong=(3.0, 5.0, 6.0)),
    ValueRule("px4-battery-action", _P, "COM_LOW_BAT_ACT", 0,
              "at the critical level 2 lands and 3 returns to where the ship was; at the emergency level both land, in the sea",
              by_hand="set BAT_CRIT_THR so that a landing on the ship fits before it; 0 only warns", wrong=(2.0, 3.0)),
    ValueRule("px4-return-precland", _P, "RTL_PLD_MD", 0, "a return waits for a pad that never holds still for it", wrong=(2.0,)),
    ValueRule("px4-still-target", _P, "LTEST_MODE", 0, "it takes the pad to stand still", wrong=(1.0,), severity=_ERROR),
    ValueRule("px4-range-aid", _P, "EKF2_RNG_CTRL", 0, "its height follows the deck's heave", wrong=(2.0,), severity=_ERROR),
    ValueRule("px4-flow", _P, "EKF2_OF_CTRL", 0,
              "optical flow over a deck, where a sensor is fitted, is no speed over the ground", wrong=(1.0,), severity=_ADVICE),
    ValueRule("px4-accel-filter", _P, "IMU_ACCEL_CUTOFF", 30, "its velocity loop follows too late", 15),
    ValueRule("px4-gyro-filter", _P, "IMU_GYRO_CUTOFF", 40, "the filter delays the loops", 20, on_ship=False),
    ValueRule("px4-rate-filter", _P, "IMU_DGYRO_CUTOFF", 30, "the filter delays the loops", 10, on_ship=False),
    ValueRule("px4-land-speed", _P, "MPC_LAND_SPEED", 0.5,
              "it strikes the deck where its own mode lands", 0.2, 0.9, on_ship=False),
)  # fmt: skip
_PLANE = (
    ValueRule("plane-jerk", _Q, "Q_P_JERK_XY", 20, "it follows too late for a deck", 15),
    ValueRule("plane-accel", _Q, "Q_WP_ACCEL", 500, "in fresh wind it stays decimetres off its place", 400, severity=_ADVICE),
    ValueRule("plane-jerk-z", _Q, "Q_P_JERK_Z", 20, "it climbs too late before a deck that rises", 10),
    ValueRule("plane-accel-z", _Q, "Q_PILOT_ACCEL_Z", 3, "it climbs too late before a deck that rises", 2, severity=_ADVICE),
    ValueRule("plane-speed", _Q, "Q_WP_SPEED", 1000, "it cannot overtake the ship", 300, over_ship=3, per_m_s=100),
    ValueRule("plane-lean-limit", _Q, "Q_ANGLE_MAX", 3000, "it cannot hold against wind and follow the deck", 1500),
)
RULES: tuple[ValueRule, ...] = (*_ARDUPILOT, *_PX4, *_PLANE)
PARAMETERS = {
    stack: tuple(name for rule in RULES if rule.stack == stack for name in (rule.parameter, rule.like) if name)
    for stack in (_A, _P, _Q)
}
"""The parameters that the rules read, by stack."""
