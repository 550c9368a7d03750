"""What every step of the filter shares: its parameters, and the result of an event."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from estimator.contracts.fusion import COMPONENTS, FusionResult, Source, components_of, source_of
from estimator.ekf import motion
from estimator.ekf.options import EkfOptions
from estimator.ekf.outcome import Outcome
from estimator.ekf.packed_event import Event


class FilterParams(NamedTuple):
    """The parameters that every step needs and no step changes."""

    options: EkfOptions
    process_noise: motion.ProcessNoise


def parameters(options: EkfOptions) -> FilterParams:
    """Return the parameters for these options."""
    return FilterParams(options, motion.ProcessNoise(options))


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
