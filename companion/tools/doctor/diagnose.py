"""Apply all rules to one snapshot; those for what a flight log shows, whatever the parameters say, are here. Pure."""

from companion.tools.doctor import rules_autopilots, rules_links, rules_switch, rules_values
from companion.tools.doctor.finding import Finding, Row, Rule, Severity, error, warning
from companion.tools.doctor.firmware_parameters import names_in
from companion.tools.doctor.snapshot import Snapshot
from drivers.log_history import VIBRATION_LIMIT_M_S2, Excess

_SHOWN = 4  # entries that are listed
_REFUSED_S = 1.0  # time for which the filter refuses a measurement that is a warning
_REFUSED_LONG_S = 3.0  # time for which it does that is an error
_CLIPPED_MAX = 100
"""Readings at the end of the range that one hard touchdown explains. Source: ArduPilot, "Measuring vibration"."""
_ARMED_MAX_S = 5.0  # time armed after a landing that is not reported
_LOST_MAX = 2  # losses of the target that are not reported
_DROPOUT_MAX_S = 0.5  # time missing in a log that is not reported
_FIXES = {
    "setpoints lost": "see why the stream stopped (the service's journal at that time), and set COM_OF_LOSS_T 1",
    "remote control": "fly with one in reach, or set what its loss does: NAV_RCL_ACT, COM_RCL_EXCEPT, FS_THR_ENABLE, FS_OPTIONS",
    "station": "choose what its loss does: NAV_DLL_ACT 0, FS_GCS_ENABLE 0",
    "battery": "take off with a full one, and see that its limits (BAT_LOW_THR, BATT_LOW_VOLT) leave time for a landing",
    "fence": "it is yours to change: see fence and px4-fence; the service's own ([limits]) goes with the ship",
    "EKF": "see log-ekf; keep compass and GNSS away from steel and currents",
    "compass": "keep it away from steel and currents, and calibrate it ashore",
    "GNSS": "see that the antenna sees the sky beside mast and superstructure",
    "crash": "see the touchdown before it: a lean at contact, or a deck that struck the vehicle from below",
    "thrust": "check motors, propellers and battery: it could not climb with all of them at the end",
    "vibration": "see log-vibration",
}
_SOURCES = {
    "velocity": "GNSS: antenna, reflections from the superstructure, EK3_GPS_CHECK or EKF2_GPS_CHECK",
    "position": "GNSS: antenna, reflections from the superstructure, EK3_GPS_CHECK or EKF2_GPS_CHECK",
    "height": "barometer in the propellers' wind, or a height from the rangefinder (ekf-height-by-range)",
    "compass": "steel and currents: raise the compass, calibrate it ashore",
}


def counted(p: Snapshot, found: int) -> str:
    """Return what was judged and what was not, and how many faults were found."""
    a, s = p.autopilot, p.service
    parts = {
        "the log": (p.log,), "the links": p.links, "the settings and their files": (s.camera_size, s.camera_fault),
        "the camera": (s.frame_rate_hz, s.device_fault), "the running service": (s.exposure_to_belief_s, s.targets_sent),
        "the broker": (s.broker,), "the AR.Drone's control port": (s.drone,),
        "the ship's reports": (*s.ship_sources, s.ship_fault),
    }  # fmt: skip
    judged, left = [name for name, seen in parts.items() if any(one is not None for one in seen)], []
    if a is not None:
        names = dict.fromkeys(names_in(PARAMETERS[a.stack], a.firmware, a.parameters))
        unread = [name for name in names if name not in a.parameters and name not in a.absent]
        judged.append(f"{len(names) - len(unread)} of {len(names)} parameters")
        shown = ", ".join(unread[:_SHOWN]) + " ..." * (len(unread) > _SHOWN)
        left += [f"parameters that were not read: {shown}"] if unread else []
    elif p.links:
        left.append(f"an autopilot ({'no link is open' if all(one.down for one in p.links) else 'none was received'})")
    left += ["the camera, the ship and a running service (for the fault of a file)"] if s.camera_fault else []
    left += ["the AR.Drone itself"] if s.drone else []
    lines = [f"{word}: {'; '.join(what)}\n" for word, what in (("judged", judged), ("not judged", left)) if what]
    return f"{''.join(lines)}{found or 'none'} of the known faults found"


def failsafes(p: Snapshot) -> Finding | None:
    """Find failsafes, checks and crashes that the autopilot logged."""
    log = p.log
    if log is None or not log.failsafes:
        return None
    shown = [f"{m.what} at {m.at_s:.1f} s" for m in log.failsafes[:_SHOWN]]
    if len(log.failsafes) > _SHOWN:
        shown.append(f"{len(log.failsafes) - _SHOWN} more")
    first = log.failsafes[0].what.lower()
    fix = next((fix for word, fix in _FIXES.items() if word.lower() in first), "see what the autopilot's texts say at that time")
    return error("log-failsafe", "; ".join(shown), fix)


def estimator(p: Snapshot) -> Finding | None:
    """Find an estimator that refused its measurements for a second or more."""
    log = p.log
    if log is None:
        return None
    refused = {n: r for n, r in log.ratios.items() if r.over_s >= _REFUSED_S}
    if not refused:
        return None
    worst = max(refused, key=lambda n: refused[n].over_s)
    output = ", ".join(f"{n} for {r.over_s:.1f} s (ratio {r.worst:.1f} at {r.at_s:.1f} s)" for n, r in refused.items())
    make = error if refused[worst].over_s >= _REFUSED_LONG_S and worst in ("velocity", "position") else warning
    return make("log-ekf", f"the EKF refused what it measured: {output}", f"check {_SOURCES.get(worst, worst)}")


def _vibration(p: Snapshot) -> tuple[float, Excess] | None:
    """Return what the stack's documentation allows of vibration, m/s^2, and by how much and when it was exceeded."""
    seen = None if p.log is None or p.autopilot is None else p.log.vibration_m_s2
    if p.autopilot is None or seen is None or seen.over_s < _REFUSED_S:
        return None
    return VIBRATION_LIMIT_M_S2.get(p.autopilot.stack, 30.0), seen


def _taken_back(p: Snapshot) -> tuple[float, str, str] | None:
    """Return a landing that the detector saw and took back: its time in s, how often, and what PX4 needs."""
    one = None if p.log is None else next((one for one in p.log.landings if one.lost > 0), None)
    if one is None or p.autopilot is None:
        return None
    often = "once" if one.lost == 1 else f"{one.lost} times"
    return one.at_s, often, "set LNDMC_ROT_MAX 20; " if p.autopilot.stack == "PX4" else ""


LOG_RULES: tuple[Rule, ...] = (
    failsafes, estimator,
    Row("log-clipping", Severity.WARNING, lambda p: p.log is not None and p.log.clipped > _CLIPPED_MAX and p.log.clipped,
        "the accelerometer reached the end of its range {0} times: velocity and height are wrong after each",
        "mount the autopilot softly, balance the propellers, and look for what strikes it"),
    Row("log-vibration", Severity.WARNING, _vibration,
        "vibration was above {0[0]:g} m/s^2 for {0[1].over_s:.1f} s (worst {0[1].worst:.0f} at {0[1].at_s:.1f} s): "
        "a contact is not felt in it",
        "mount the autopilot softly and balance the propellers before filters are made slower"),
    Row("log-land-detector", Severity.WARNING, _taken_back,
        "the landing at {0[0]:.1f} s was detected and taken back {0[1]}: a moving deck hides it",
        "{0[2]}leave vehicle.disarm_on_contact on: the service stops the motors itself"),
    Row("log-armed-on-deck", Severity.WARNING,
        lambda p: p.log and p.moving_pad and next((one for one in p.log.landings if one.armed_s > _ARMED_MAX_S), None),
        "it stayed armed for {0.armed_s:.0f} s after the landing at {0.at_s:.1f} s: "
        "it slides, or leaps off with a deck that falls away",
        "leave vehicle.disarm_on_contact on, or set COM_DISARM_LAND 2 (PX4), and land in LAND (ArduCopter)"),
    Row("log-target-lost", Severity.WARNING,
        lambda p: p.log is not None and p.log.targets_lost > _LOST_MAX and p.log.targets_lost,
        "precision landing lost its target {0} times",
        "see why targets stop: light, a pad larger than the camera sees near the deck, a full link"),
    Row("log-dropouts", Severity.ADVICE, lambda p: p.log is not None and p.log.dropouts_s > _DROPOUT_MAX_S and p.log.dropouts_s,
        "the log lost {0:.1f} s: what happened then is not known",
        "use a faster card, or log less"),
    Row("log-damaged", Severity.ADVICE, lambda p: p.log is not None and "; ".join(p.log.notes[:_SHOWN]),
        "not all of the log is as it was written: {0}",
        "check the card, and the clock"),
)  # fmt: skip


RULES: tuple[Rule, ...] = (
    *rules_links.RULES, *rules_values.ARMING, *LOG_RULES, *rules_autopilots.RULES, *rules_autopilots.PX4_RULES,
    *rules_autopilots.PLANE_RULES,
    *rules_values.FAILSAFE_RULES, *rules_values.RULES, *rules_switch.RULES,
)  # fmt: skip


_OWN = {
    "ArduPilot": rules_autopilots.PARAMETERS, "ArduPlane": rules_autopilots.PLANE_PARAMETERS,
    "PX4": rules_autopilots.PX4_PARAMETERS, "other": (),
}  # fmt: skip
PARAMETERS = {
    stack: tuple(dict.fromkeys((*own, *rules_values.FAILSAFE_PARAMETERS.get(stack, ()), *rules_values.PARAMETERS.get(stack, ()))))
    for stack, own in _OWN.items()
}
"""Parameters that the rules need from an autopilot, by stack."""


def diagnose(snapshot: Snapshot) -> tuple[Finding, ...]:
    """Return every finding, the most severe first."""
    found = [finding for rule in RULES if (finding := rule(snapshot)) is not None]
    return tuple(sorted(found, key=lambda f: f.severity))
