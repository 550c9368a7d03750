"""Settings that give the ship's place, and their contradictions."""

from msgspec import Struct

from companion.settings.model import Settings
from drivers.mavlink.options import AutopilotOptions

_AIS_PERIOD_S = 10.0
"""Interval of the AIS reports of a ship under way at up to 14 knots (ITU-R M.1371-5, annex 1, table 1)."""


class Contradiction(Struct, frozen=True):
    """Settings that are good each for itself and do not go together."""

    what: str
    fix: str
    refuses: bool
    """True if the drone refuses every landing that begins out of sight of the pad; otherwise something is only unused."""


def sources(settings: Settings) -> tuple[str, ...]:
    """Return the keys that name a source of the ship's place."""
    named = {
        "vessel.nmea": bool(settings.vessel.nmea),
        "vessel.mqtt": settings.vessel.mqtt,
        "vehicle.vessel_id": isinstance(settings.vehicle, AutopilotOptions) and settings.vehicle.vessel_id != 0,
    }
    return tuple(key for key, is_set in named.items() if is_set)


def contradiction(settings: Settings) -> Contradiction | None:
    """Return what does not go together about the ship's place, or None."""
    reported, flies_there = sources(settings), settings.guidance.rendezvous.enabled
    if flies_there and not reported:
        by_link = ", vehicle.vessel_id" if isinstance(settings.vehicle, AutopilotOptions) else ""
        return Contradiction(
            "guidance.rendezvous.enabled is true, but nothing tells where the ship is",
            f"set a source (vessel.nmea, vessel.mqtt{by_link}), or the drone refuses wherever the pad is not in sight",
            refuses=True,
        )
    if reported and not flies_there:
        return Contradiction(
            f"{', '.join(reported)}: the ship's velocity and heading are used, her place is not",
            "set guidance.rendezvous.enabled = true to fly to it",
            refuses=False,
        )
    if reported == ("vessel.nmea",) and settings.vessel.mmsi and settings.vessel.age_max_s < _AIS_PERIOD_S:
        return Contradiction(
            f"expert.vessel.age_max_s is {settings.vessel.age_max_s:g} s, but AIS reports of a ship under way come every "
            f"{_AIS_PERIOD_S:g} s",
            "where no other sentences give her place, set age_max_s = 12 and a smaller acceleration_m_s2 in [expert.vessel]",
            refuses=False,
        )
    return None
