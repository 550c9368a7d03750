"""Outcome of one event in the filter."""

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
from msgspec import Struct

from estimator.contracts.estimates import Verdict
from estimator.contracts.fusion import COMPONENTS, FusionResult, Source, components_of, source_of
from estimator.contracts.geometry import F64
from estimator.ekf.packed_event import Event


class Outcome(Struct, frozen=True, eq=False):
    """Outcome of one event. It is small: re-propagation repeats many events, and discards their outcomes."""

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


@cache
def _named(source: Source, axes: tuple[int, ...]) -> tuple[str, ...]:
    return tuple([COMPONENTS[source][i] for i in axes])


def result(event: Event, outcome: Outcome) -> FusionResult:
    """Return the outcome of an event with the event's source, instants and names of components."""
    source, stamp = source_of(event), event.stamp
    if outcome.innovation is None:
        return FusionResult("ekf", source, outcome.verdict, stamp.measured_at, stamp.received_at)
    verdict, S, innov = outcome.verdict, outcome.innovation_cov, np.asarray(outcome.innovation)
    if outcome.axes:
        components = _named(source, outcome.axes)
    else:
        components = components_of(source, innov.size)
    nis, ratio = outcome.nis, outcome.nis / outcome.nis_max
    return FusionResult("ekf", source, verdict, stamp.measured_at, stamp.received_at, innov, S, components, nis, ratio)
