"""The cone over the pad: the nearer to its axis, the faster the descent; outside it the drone climbs until it is inside."""

import math

from companion.settings.mission import ConeOptions

INSIDE = 1.2
"""The share of the descent rate on the axis, which is limited to 1: near the axis the rate does not depend on the error."""
OUT = 2.0
"""(error / radius)^2 beyond which the drone comes back over the pad before it descends further."""
_LEAST_HEIGHT_M = 0.15
_TAPER_1_S = 1.0
"""Rate per metre of height left over the gate."""


def radius_m(height_m: float, options: ConeOptions) -> float:
    """Return the radius at a height over the deck, metres: that at which the descent would all but end."""
    return options.slope * max(_LEAST_HEIGHT_M, height_m)


def inside(error_m: float, height_m: float, options: ConeOptions) -> bool:
    """Return whether the drone may descend at all."""
    return error_m < math.sqrt(INSIDE) * radius_m(height_m, options)


def outside(error_m: float, height_m: float, options: ConeOptions) -> bool:
    """Return whether the drone has left the cone by more than a gust."""
    return error_m > math.sqrt(OUT) * radius_m(height_m, options)


def descent_rate_m_s(error_m: float, height_m: float, options: ConeOptions, least_m: float | None = None) -> float:
    """Return the rate against the deck, m/s, down positive; it falls to zero at the least height and is negative below it.

    Args:
        error_m: distance from the axis.
        height_m: height over the deck.
        least_m: the height at which the descent ends; None for that of the gate.
    """
    ends_m = options.gate_m if least_m is None else least_m
    share = INSIDE - (error_m / radius_m(height_m, options)) ** 2
    rate = options.descent_rate_m_s * max(-1.0, min(1.0, share))
    return min(rate, _TAPER_1_S * (height_m - ends_m))
