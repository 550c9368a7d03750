"""Parameters of ArduCopter that have another name, and often another unit, in a later release.

Rules are written in the names and units of 4.5. Source: ArduPilot, "Parameter Name Changes" (4.5 to 4.6, 4.6 to 4.7).
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

Firmware = tuple[int, int, int]


class LaterName(NamedTuple):
    """A parameter's later name."""

    name: str
    factor: float
    """Value there of one unit here."""
    since: Firmware


_46, _47 = (4, 6, 0), (4, 7, 0)
_CENTI = 0.01
RENAMED = {
    "GPS_RATE_MS": LaterName("GPS1_RATE_MS", 1.0, _46),
    "LAND_SPEED": LaterName("LAND_SPD_MS", _CENTI, _47),
    "LAND_SPEED_HIGH": LaterName("LAND_SPD_HIGH_MS", _CENTI, _47),
    "LAND_ALT_LOW": LaterName("LAND_ALT_LOW_M", _CENTI, _47),
    "RTL_ALT_FINAL": LaterName("RTL_ALT_FINAL_M", _CENTI, _47),
    "WPNAV_SPEED": LaterName("WP_SPD", _CENTI, _47),
    "WPNAV_SPEED_UP": LaterName("WP_SPD_UP", _CENTI, _47),
    "WPNAV_SPEED_DN": LaterName("WP_SPD_DN", _CENTI, _47),
    "WPNAV_ACCEL": LaterName("WP_ACC", _CENTI, _47),
    "WPNAV_ACCEL_Z": LaterName("WP_ACC_Z", _CENTI, _47),
    "LOIT_SPEED": LaterName("LOIT_SPEED_MS", _CENTI, _47),
    "ANGLE_MAX": LaterName("ATC_ANGLE_MAX", _CENTI, _47),
    "RNGFND1_MAX_CM": LaterName("RNGFND1_MAX", _CENTI, _47),
    "RNGFND1_MIN_CM": LaterName("RNGFND1_MIN", _CENTI, _47),
    "PSC_JERK_XY": LaterName("PSC_JERK_NE", 1.0, _47),
    "PSC_JERK_Z": LaterName("PSC_JERK_D", 1.0, _47),
    "PSC_VELXY_P": LaterName("PSC_NE_VEL_P", 1.0, _47),
    "PSC_VELXY_I": LaterName("PSC_NE_VEL_I", 1.0, _47),
    "PSC_VELXY_FLTE": LaterName("PSC_NE_VEL_FLTE", 1.0, _47),
    "PSC_VELZ_P": LaterName("PSC_D_VEL_P", 1.0, _47),
    "PSC_VELZ_FLTE": LaterName("PSC_D_VEL_FLTE", 1.0, _47),
    "PSC_ACCZ_P": LaterName("PSC_D_ACC_P", 0.1, _47),
    "PSC_ACCZ_FLTE": LaterName("PSC_D_ACC_FLTE", 1.0, _47),
}


_SINCE: dict[str, Firmware] = {"ARMING_SKIPCHK": _47}
"""Parameters that earlier releases do not have."""


class NamedValue(NamedTuple):
    """A parameter as the firmware has it."""

    name: str
    """Its name there."""
    value: float
    """Its value in the unit that rules are written in."""
    factor: float
    """Value there of one unit of the rules."""

    def there(self, value: float) -> float:
        """Return a value in the unit of the firmware."""
        return round(value * self.factor, 6)


def named_value(parameters: Mapping[str, float], name: str) -> NamedValue | None:
    """Return a parameter under whichever name the firmware has it; None if it was not read."""
    if name in parameters:
        return NamedValue(name, parameters[name], 1.0)
    later = RENAMED.get(name)
    if later is None or later.name not in parameters:
        return None
    # Four decimals: what a firmware keeps in 32 bits is not exactly a hundredth of what the rule says.
    return NamedValue(later.name, round(parameters[later.name] / later.factor, 4), later.factor)


def names_in(names: Iterable[str], firmware: Firmware | None) -> tuple[str, ...]:
    """Return the names that a firmware has for these parameters; those of 4.5 where its version is not known."""
    out = []
    for name in names:
        if firmware is not None and firmware < _SINCE.get(name, firmware):
            continue
        later = RENAMED.get(name)
        out.append(name if later is None or firmware is None or firmware < later.since else later.name)
    return tuple(out)
