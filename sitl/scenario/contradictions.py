"""Faults that a scenario lists and that could never act in it, or that its vessel or vehicle cannot have."""

from __future__ import annotations

from collections.abc import Iterator

from sitl.faults.fault import Fault
from sitl.faults.reports import VesselReports
from sitl.faults.ship import ShipSpeed, ShipTurn
from sitl.vessel.settings import VesselSettings


def never_begins(fault: Fault, duration_limit_s: float, start_height_m: float | None) -> str:
    """Return why a fault never begins, in words that follow its path; empty if it may.

    Args:
        duration_limit_s: longest time of the flight.
        start_height_m: height over the pad at the start, None where it starts on the pad.
    """
    if fault.at_s is not None and fault.at_s >= duration_limit_s:
        return f".at_s is {fault.at_s:g} s, but the flight ends after {duration_limit_s:g} s"
    below = fault.below_height_m
    if below is not None and start_height_m is not None and start_height_m < below:
        return f".below_height_m is {below:g} m, but the flight starts at {start_height_m:g} m"
    return ""


def not_of_this_vessel(fault: Fault, vessel: VesselSettings) -> str:
    """Return why a vessel cannot have a fault, in words that follow its path; empty if it can."""
    if isinstance(fault, VesselReports) and vessel.reports_hz == 0.0:
        return ": vessel_reports is of a ship that reports, and this one does not; vessel.reports_hz must be more than 0"
    if isinstance(fault, VesselReports) and (fault.place_north_m or fault.place_east_m) and not vessel.reports_place:
        return ": this ship does not report her place; vessel.reports_place must be true"
    if not isinstance(fault, ShipSpeed | ShipTurn):
        return ""
    if vessel.moored:
        return f": {fault.kind} is of a vessel under way; vessel.moored must be false"
    if vessel.turn_rate_deg_s != 0.0:
        return f": {fault.kind} does not go with a vessel that turns already; vessel.turn_rate_deg_s must be 0"
    if isinstance(fault, ShipTurn) and vessel.speed_m_s == 0.0:
        return ": a vessel that lies still does not turn; vessel.speed_m_s must be more than 0"
    if isinstance(fault, ShipSpeed) and fault.to_m_s == vessel.speed_m_s:
        return f".to_m_s is {fault.to_m_s:g} m/s, which is vessel.speed_m_s already"
    return ""


def contradictions(
    faults: tuple[Fault, ...], duration_limit_s: float, start_height_m: float | None, vessel: VesselSettings
) -> Iterator[str]:
    """Return what contradicts itself: each fault by its path, and why."""
    for n, fault in enumerate(faults):
        if why := never_begins(fault, duration_limit_s, start_height_m) or not_of_this_vessel(fault, vessel):
            yield f"faults[{n}]{why}"
