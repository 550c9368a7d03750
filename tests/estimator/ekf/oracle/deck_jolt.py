"""Widen the belief about the deck where sightings keep missing it by more than the filter claims.

The oscillators of the main filter have the size and period that the bank has learned. A wave that nothing announced, such as
another ship's wake after a calm, is neither, and until the bank has learned it the filter takes the deck's motion for its own.
The innovations say so at once. Along each axis of `ned` the filter keeps by how much the newest squared innovations exceed the
largest that their claimed variances let expect. If the median is positive, the wave along that axis has received an acceleration
that the model does not have, and the covariance gains the median (covariance matching: Mehra, Approaches to adaptive filtering,
IEEE Trans. Automatic Control 17(5), 1972). The median ignores single wrong sightings, and a sighting with little information on
an axis neither adds to it nor scales it.
"""

import numpy as np

from estimator.contracts.geometry import F64
from estimator.core.abi import EXCESSES_MAX
from estimator.ekf.state import POS_AXES, POS_EAST, POS_NORTH, SWAY_PER_HEAVE, WAVES, InnovationExcesses, N

RATIO_MAX = 2.5
"""Squared innovation over its variance above which the covariance grows; the median of five honest ones is above this once in
seventy times."""
_RATIO_COUNTED = 49.0
"""A sighting farther off than this is not counted: it is another pad or none, and the gate decides about it."""
_MEMORY_NS = 350_000_000
"""Sightings older than this, against the newest, are not counted."""
_NEEDED, _SPAN_NS = 3, 120_000_000
"""The median is of at least this many sightings that span at least so long."""
_ACTED_S = 0.3
"""Time for which the unknown acceleration is assumed to have acted, s."""


def extended(excesses: InnovationExcesses, t: int, innov_ned: F64, cov_ned: F64) -> InnovationExcesses:
    """Return the excesses after one more sighting.

    Args:
        excesses: those of the sightings before it.
        t: its instant, ns.
        innov_ned: (3,) m.
        cov_ned: (3, 3) m^2, its covariance as the filter claims it.
    """
    squares, var = innov_ned * innov_ned, np.diagonal(cov_ned)
    if (squares > _RATIO_COUNTED * var).any():
        return excesses
    north, east, down = (squares - RATIO_MAX * var).tolist()
    first = max(sum(one < t - _MEMORY_NS for one in excesses.t), len(excesses.t) + 1 - EXCESSES_MAX)
    return InnovationExcesses((*excesses.t[first:], t), (*excesses.values[first:], (north, east, down)))


def missing(excesses: InnovationExcesses) -> F64 | None:
    """Return the (3,) variance, m^2, by which the claimed one falls short along north, east, down; None if it does nowhere."""
    if len(excesses.t) < _NEEDED or excesses.t[-1] - excesses.t[0] < _SPAN_NS:
        return None
    excess = np.array([_median(axis) for axis in zip(*excesses.values, strict=True)])
    return None if float(excess.max()) <= 0.0 else np.asarray(np.maximum(excess, 0.0))


def _median(values: tuple[float, ...]) -> float:
    """Return the median; numpy's takes ten times as long for the few values of a third of a second."""
    ordered, half = sorted(values), len(values) // 2
    return ordered[half] if len(values) % 2 else 0.5 * (ordered[half - 1] + ordered[half])


def widened(P: F64, x: F64, var_ned: F64) -> F64:
    """Return the (N, N) covariance after unknown accelerations of the deck.

    Args:
        P: (N, N) covariance.
        x: (N,) state.
        var_ned: (3,) variance, m^2, that the pad's displacement along north, east, down gains.
    """
    P = P.copy()
    # White acceleration for T seconds: displacement T^3 / 3, rate T, both together T^2 / 2.
    across, rate = 1.5 / _ACTED_S, 3.0 / _ACTED_S**2
    noise = np.array([[1.0, across], [across, rate]])
    for axis, var in enumerate(var_ned.tolist()):
        if var <= 0.0:
            continue
        by = np.zeros((N, 2))
        by[POS_AXES[axis], 0] = by[WAVES[axis, 0], 0] = by[WAVES[axis, 1], 1] = 1.0
        if axis == 2:
            by[[POS_NORTH, POS_EAST], 0] = x[SWAY_PER_HEAVE]
        P += var * (by @ noise @ by.T)
    return P
