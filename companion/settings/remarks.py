"""Say of settings that are good what their author may want to know."""

from collections.abc import Sequence

from companion.settings.effect import without_effect
from companion.settings.model import Settings
from companion.settings.ship_place import contradiction
from drivers.mavlink.options import AutopilotOptions


def remarks(settings: Settings) -> tuple[str, ...]:
    """Return a line for each thing in good settings that is hardly what their author meant."""
    found = contradiction(settings)
    return (*without_effect(settings), *(() if found is None else (f"{found.what}: {found.fix}",)), *_empty_battery(settings))


def _empty_battery(settings: Settings) -> tuple[str, ...]:
    """Return that a drone which refuses hovers until its battery is empty, where the settings say so."""
    o = settings.guidance
    leaves = o.refused != "hold" and isinstance(settings.vehicle, AutopilotOptions)
    return (
        () if leaves or o.last_charge > 0.0 else ("expert.guidance.last_charge is 0: a drone that refused hovers until it falls",)
    )


def not_checked(keys: Sequence[str]) -> str:
    """Return a remark about settings that name systemd credentials, which exist only inside the unit; "" if there are none."""
    return f" ({', '.join(keys)}: credentials of the systemd unit, not checked here)" if keys else ""
