"""Apply all rules to one snapshot. Pure."""

from __future__ import annotations

from companion.doctor import rules_ardupilot, rules_links, rules_log, rules_px4, rules_values
from companion.doctor.finding import Finding, Rule
from companion.doctor.snapshot import Snapshot

RULES: tuple[Rule, ...] = (
    *rules_links.RULES, *rules_log.RULES, *rules_ardupilot.RULES, *rules_px4.RULES, *rules_values.RULES,
)  # fmt: skip
PARAMETERS = {
    "ArduPilot": tuple(dict.fromkeys((*rules_ardupilot.PARAMETERS, *rules_values.PARAMETERS["ArduPilot"]))),
    "PX4": tuple(dict.fromkeys((*rules_px4.PARAMETERS, *rules_values.PARAMETERS["PX4"]))),
    "other": (),
}
"""Parameters that the rules need from an autopilot, by stack."""


def diagnose(snapshot: Snapshot) -> tuple[Finding, ...]:
    """Return every finding, the most severe first."""
    found = [finding for rule in RULES if (finding := rule(snapshot)) is not None]
    return tuple(sorted(found, key=lambda f: f.severity))
