"""Rules for what keeps an autopilot from arming, in its own words. Sources: ArduPilot, "Pre-arm safety checks"; PX4, "Arming"."""

from __future__ import annotations

import re

from companion.tools.doctor.finding import Finding, Rule, warning
from companion.tools.doctor.snapshot import Snapshot

_REFUSAL = re.compile(r"^(?:\[[^\]]*\]\s*)?(?:PreArm|Arm|Preflight Fail|Arming denied)[:!]\s*(.+)$", re.IGNORECASE)
_SHOWN = 4
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
    "fence": "switch it off at sea",
    "terrain": "switch terrain following off",
}


def arming_refused(p: Snapshot) -> Finding | None:
    """Find an autopilot that is not armed and told why it will not be."""
    a = p.autopilot
    if a is None or a.armed or p.log is not None:
        return None
    told = list(dict.fromkeys(found[1].strip() for text in a.texts if (found := _REFUSAL.match(text)) is not None))
    if not told:
        return None
    shown = told[:_SHOWN] + ([f"{len(told) - _SHOWN} more"] if len(told) > _SHOWN else [])
    first = told[0].lower()
    fix = next((fix for word, fix in _FIXES.items() if word in first), "its documentation explains each of these texts")
    return warning("arming-refused", f"it refuses to arm: {'; '.join(shown)}", fix)


RULES: tuple[Rule, ...] = (arming_refused,)
