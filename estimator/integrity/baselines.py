"""Follow a baseline between two GNSS antennas against the estimate: the camera and the receivers check one another.

A wrong whole number of wavelengths puts a baseline off by decimetres at once, and its receiver does not know. It is found by
what else agrees. With a recent picture, which the gyro's motion confirms, a baseline that agreed before and leaps is wrong: it is
left out and named. A belief that has become too uncertain to find one wavelength confirms nothing: what comes after such a gap
has to last. Without a picture nobody knows which of the two solutions was wrong, and a baseline that has never agreed with
the camera may as well show an antenna that is not where the settings say: then nobody descends.
"""

import math

from msgspec import Struct
from msgspec.structs import replace

from estimator.contracts.estimates import FusionResult, Verdict

_PICTURE_S = 0.5
"""Age of the newest fused picture up to which it decides."""
_SIGMAS, _LEAST_M = 5.0, 0.06
"""Distance from the estimate beyond which a baseline contradicts it: of its own standard deviation, and beside that."""
_MISSES = 2
_AGREES_S, _AGREES_ALONE_S = 1.0, 10.0
"""Time for which baselines have to agree with the estimate until they are believed again, with a picture and without."""
_CHECKS_M = 0.06
"""Standard deviation of the innovation up to which a wrong wavelength, 0.19 m, shows in it."""
_FLOAT_M = 0.1
"""Standard deviation of a baseline from which on it is too coarse to be judged."""
_PROVEN = 10
"""Number of baselines in agreement with pictures after which a leap is theirs."""


class BaselineWatch(Struct, frozen=True):
    """Agreement of the baselines with the estimate so far."""

    pictured: int | None = None
    """Instant of the newest fused sighting by the camera, ns."""
    t: int = 0
    """Instant of the newest baseline, ns."""
    proven: int = 0
    """Number of baselines that agreed with the estimate while the camera saw the pad."""
    misses: int = 0
    missed_at: int | None = None
    """Instant of the newest baseline that contradicted the estimate, ns; None while they are believed."""
    off_m: float = 0.0
    """Distance from the estimate when they began to contradict it."""

    @property
    def contradicts(self) -> bool:
        """True while baselines contradict the estimate, or did so a moment before."""
        return self.misses >= _MISSES

    @property
    def outvoted(self) -> bool:
        """True if the camera decides that the baselines are wrong."""
        return self.contradicts and self.proven >= _PROVEN and self.sees

    @property
    def undecided(self) -> bool:
        """True if nothing decides which is wrong."""
        return self.contradicts and not self.outvoted

    @property
    def sees(self) -> bool:
        """True if the camera has shown the pad a moment before."""
        return self.pictured is not None and self.t - self.pictured <= _PICTURE_S * 1e9


def compared(state: BaselineWatch, result: FusionResult, sigma_m: float) -> BaselineWatch:
    """Process a baseline that the filter has compared with the estimate.

    Args:
        sigma_m: its largest standard deviation on one axis.
    """
    state = replace(state, t=max(state.t, int(result.measured_at)))
    if result.innovation is None or result.innovation_cov is None or sigma_m > _FLOAT_M:
        return state
    if not state.sees and math.sqrt(float(result.innovation_cov.diagonal().max())) > _CHECKS_M:
        return replace(state, misses=_MISSES, missed_at=state.t, off_m=math.inf)
    off_m = math.hypot(*result.innovation.tolist())
    if result.verdict is Verdict.GATED or off_m > _SIGMAS * sigma_m + _LEAST_M:
        held_m = off_m if state.misses < _MISSES else state.off_m
        return replace(state, misses=state.misses + 1, missed_at=state.t, off_m=held_m)
    if state.missed_at is None:
        return replace(state, misses=0, proven=state.proven + state.sees)
    agreed_s = (state.t - state.missed_at) * 1e-9
    if state.contradicts and agreed_s < (_AGREES_S if state.sees else _AGREES_ALONE_S):
        return state
    return replace(state, misses=0, missed_at=None)
