"""Apply all rules to one snapshot. Pure."""

from companion.tools.doctor import rules_autopilots, rules_links, rules_log, rules_values
from companion.tools.doctor.finding import Finding, Rule
from companion.tools.doctor.snapshot import Snapshot

RULES: tuple[Rule, ...] = (
    *rules_links.RULES, *rules_values.ARMING, *rules_log.RULES, *rules_autopilots.RULES, *rules_autopilots.PX4_RULES,
    *rules_values.FAILSAFE_RULES, *rules_values.RULES,
)  # fmt: skip


def _asked(stack: str, own: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys((*own, *rules_values.FAILSAFE_PARAMETERS[stack], *rules_values.PARAMETERS[stack])))


PARAMETERS = {
    "ArduPilot": _asked("ArduPilot", rules_autopilots.PARAMETERS),
    "PX4": _asked("PX4", rules_autopilots.PX4_PARAMETERS),
    "other": (),
}
"""Parameters that the rules need from an autopilot, by stack."""


def diagnose(snapshot: Snapshot) -> tuple[Finding, ...]:
    """Return every finding, the most severe first."""
    found = [finding for rule in RULES if (finding := rule(snapshot)) is not None]
    return tuple(sorted(found, key=lambda f: f.severity))
