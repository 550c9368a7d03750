"""The random disturbances of the vehicle: gusts, drifting attitude errors, optical-flow noise."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Wind:
    """Steady wind with gusts, uniform around the vehicle.

    Each component of the gust is a first-order Gauss-Markov process, whose spectrum is Dryden's longitudinal one
    (MIL-F-8785C, 3.7.1.2) with a correlation time of length scale over airspeed.
    """

    v_ned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity of the steady air in ned, m/s."""
    gust_sigma_m_s: float = 0.0
    """Sigma of each horizontal component; the vertical component has half of it."""
    gust_time_s: float = 2.0


def keep_and_fresh(sigma: float, time_s: float, step_s: float) -> tuple[float, float]:
    """Return the factors of x' = keep x + fresh n, a first-order Gauss-Markov process that is exact for any step length.

    Args:
        sigma: standard deviation of x.
        time_s: correlation time.
    """
    keep = math.exp(-step_s / time_s)
    return keep, sigma * math.sqrt(1.0 - keep**2)
