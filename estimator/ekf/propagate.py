"""What every step of the filter shares: its parameters, and the result of an event."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimator.contracts.fusion import COMPONENTS, FusionResult, components_of, source_of
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


def result(event: Event, outcome: Outcome) -> FusionResult:
    """Return the outcome of an event with the event's source, instants and names of components."""
    verdict, compared, S, nis, nis_max, axes = outcome
    innov = None if compared is None else np.asarray(compared)
    source = source_of(event)
    components: tuple[str, ...] = ()
    if axes:
        components = tuple([COMPONENTS[source][i] for i in axes])
    elif innov is not None:
        components = components_of(source, innov.size)
    for array in (innov, S):
        if array is not None and array.flags.writeable:
            array.setflags(write=False)
    stamp = event.stamp
    return FusionResult("ekf", source, verdict, stamp.measured_at, stamp.received_at, innov, S, components, nis, nis / nis_max)
