"""What the filter makes of one event."""

from __future__ import annotations

import math
from collections.abc import Sequence

from msgspec import Struct

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import F64


class Outcome(Struct, frozen=True, eq=False):
    """What became of one event. Re-propagation repeats many events whose outcomes nobody asks for, so it holds no more."""

    verdict: Verdict
    innovation: Sequence[float] | F64 | None = None
    """(m,) measured minus predicted, None where nothing was compared."""
    innovation_cov: F64 | None = None
    """(m, m) covariance of the innovation."""
    nis: float = math.nan
    nis_max: float = math.nan
    """The gate's limit of the NIS."""
    axes: tuple[int, ...] = ()
    """Indices of the m components among those of the event's source; by default the first m."""
