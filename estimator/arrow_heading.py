"""The heading of the pad's arrow, by the newest sighting that shows it."""

import math
from dataclasses import dataclass

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.time import MonoNs, seconds_between


@dataclass(frozen=True, slots=True)
class ArrowHeading:
    """The heading of the arrow against the same north as the vehicle's own attitude."""

    heading_rad: float
    var: float
    at: MonoNs
    """Measurement instant of the newest sighting with a heading."""
    ambiguous: bool
    """True while no sighting resolved which end of the arrow is its tip."""

    def var_at(self, now: MonoNs, sigma_rate_rad_s: float) -> float:
        """Return the variance, rad^2, at an instant, with the drift of the vehicle's heading since the sighting."""
        drift_s = max(0.0, seconds_between(self.at, now))
        return self.var + (sigma_rate_rad_s * drift_s) ** 2


def heading_after(arrow: ArrowHeading | None, heading_rad: float, sighting: Sighting) -> ArrowHeading | None:
    """Return the arrow after a sighting; as it was if that has no heading.

    Args:
        heading_rad: the vehicle's own heading at the sighting's instant.
    """
    if sighting.yaw_rad is None:
        return arrow
    seen = wrap_pi(heading_rad - sighting.yaw_rad)
    if sighting.yaw_ambiguous and arrow is not None and abs(wrap_pi(seen - arrow.heading_rad)) > math.pi / 2:
        seen = wrap_pi(seen + math.pi)
    ambiguous = sighting.yaw_ambiguous and (arrow is None or arrow.ambiguous)
    return ArrowHeading(seen, float(sighting.cov[3, 3]), sighting.stamp.measured_at, ambiguous)
