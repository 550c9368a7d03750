"""The error of the filter's estimate: read from recordings, fitted over height and time since the newest sighting."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, wrap_pi
from sitl.perception.parameters import EstimateCell, EstimateModel
from sitl.perception.recorded import Recorded

HEIGHTS_M = (0.2, 0.35, 0.5, 0.8, 1.3, 2.0, 3.0, 4.5, 7.0, 10.0, 15.0, 22.0)
AGES_S = (0.2, 0.35, 0.6, 1.0, 1.7, 3.0, 5.0)
LEAST = 30
"""Fewest samples of a cell."""
_SETTLED_S = 1.0
"""Time after the first sighting from which on the estimate counts."""
_LEAST_M = 0.1
"""Lowest height that counts: below it the drone stands."""
_LAGS = (5, 10, 20, 40)
"""Lags, in guidance cycles, over which the correlation time is fitted."""
_COMPONENTS = 7


class Errors(NamedTuple):
    """The estimate's errors in one flight, one row a guidance cycle in which there was an estimate."""

    at_s: F64
    """(N,)"""
    height_m: F64
    """(N,) true height of the body over the pad's centre."""
    age_s: F64
    """(N,) time since the newest sighting."""
    error: F64
    """(N, 7) estimate less truth: position over the height, velocity m/s, heading rad."""


def errors_of(recorded: Recorded) -> Errors:
    """Return the errors of a recorded flight's steering estimate, from its first second to the first contact."""
    first = min((b.sighted for b in recorded.beliefs), default=0)
    rows = []
    for b in recorded.beliefs:
        truth = recorded.truths.get(b.at)
        if truth is None or (b.at - first) * 1e-9 < _SETTLED_S or b.yaw_rad is None or truth.touchdown is not None:
            continue
        height = truth.d_body_pad_level[2]
        if height < _LEAST_M:
            continue
        d = (b.d_body_pad_level - np.array(truth.d_body_pad_level)) / height
        v = b.v_pad_level - np.array(truth.v_pad_level)
        rows.append((b.at * 1e-9, height, b.age_s(b.at), *d, *v, wrap_pi(b.yaw_rad - truth.yaw_rad)))
    table = np.array(rows, dtype=float).reshape(-1, 3 + _COMPONENTS)
    return Errors(table[:, 0], table[:, 1], table[:, 2], table[:, 3:])


def fit_estimates(flights: Sequence[Errors]) -> EstimateModel:
    """Return the error model of the estimate.

    Raises:
        BadInput: too few estimates beside a truth.
    """
    places: dict[tuple[int, int], list[F64]] = defaultdict(list)
    samples = 0
    for flight in flights:
        for height, age, error in zip(flight.height_m, flight.age_s, flight.error, strict=True):
            if abs(error[6]) > math.pi / 2:  # half a turn: an ambiguity of vision and no error of the filter
                continue
            places[bisect_right(HEIGHTS_M, height), bisect_right(AGES_S, age)].append(error)
            samples += 1
    cells = []
    for (height, age), errors in sorted(places.items()):
        if len(errors) < LEAST:
            continue
        e = np.array(errors)
        cov = e.T.dot(e) / len(e)
        cells.append(EstimateCell(height, age, len(e), tuple(cov[np.tril_indices(_COMPONENTS)].tolist())))
    if not cells:
        raise BadInput(f"the recordings hold no height with {LEAST} estimates beside a truth")
    return EstimateModel(HEIGHTS_M, AGES_S, samples, _correlation_times(flights), tuple(cells))


def _correlation_times(flights: Sequence[Errors]) -> tuple[float, ...]:
    """Return the time in which the correlation of each component falls to 1/e, by a fit of log correlation over the lag."""
    out = []
    for k in range(_COMPONENTS):
        times = []
        for lag in _LAGS:
            products, squares, lag_s = 0.0, 0.0, []
            for flight in flights:
                e = flight.error[:, k]
                near = flight.age_s < AGES_S[0]
                if len(e) <= lag:
                    continue
                a, b, both = e[:-lag], e[lag:], near[:-lag] & near[lag:]
                products += float((a * b)[both].sum())
                squares += float((0.5 * (a * a + b * b))[both].sum())
                lag_s.append(float(np.median(flight.at_s[lag:] - flight.at_s[:-lag])))
            if squares > 0.0 and 0.0 < products < squares:
                times.append(float(np.median(lag_s)) / -math.log(products / squares))
        out.append(float(np.clip(np.median(times), 0.05, 60.0)) if times else 1.0)
    return tuple(out)
