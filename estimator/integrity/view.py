"""Detect a frozen view: a pad that keeps its place in the image while the body turns is not below, whatever noise is added.

A rotation moves everything in the image by the same angle, at any distance. So the pad's bearing in the body is compared with the
effect of the rotation alone, as computed from the vehicle's own attitude.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Attitude
from estimator.integrity.options import IntegrityOptions

_SPAN_S = 0.5
_LEAST = 8
_LEAST_SPAN_S = 0.3


Bearing = tuple[int, F64, F64, F64]
"""Instant, ns; unit vector to the pad in `body` and in `level`, (3,); the level frame's axes in `body`, (3, 3)."""


class ViewWatch(NamedTuple):
    """Bearings of the last half second."""

    bearings: tuple[Bearing, ...] = ()
    frozen: bool = False


def watch(state: ViewWatch, sighting: Sighting, attitude: Attitude, o: IntegrityOptions) -> ViewWatch:
    """Process one sighting and the attitude at its exposure."""
    t = sighting.stamp.measured_at
    distance_m = math.sqrt(float(sighting.d_body_pad_level.dot(sighting.d_body_pad_level)))
    if distance_m < 1e-6:
        return state
    R_body_level = attitude.R_ned_body.without_heading().inv.matrix
    level = sighting.d_body_pad_level / distance_m
    span_ns = _SPAN_S * 1e9
    kept = [k for k in state.bearings if 0 <= t - k[0] <= span_ns]
    bearings = (*kept, (t, R_body_level.dot(level), level, R_body_level))
    return ViewWatch(bearings, _is_still(bearings, o))


def _is_still(bearings: tuple[Bearing, ...], o: IntegrityOptions) -> bool:
    if len(bearings) < _LEAST or bearings[-1][0] - bearings[0][0] < _LEAST_SPAN_S * 1e9:
        return False
    _, seen, levels, axes = zip(*bearings, strict=True)
    turned = _spread(np.array(axes).dot(np.add.reduce(levels) / len(levels)))
    return turned > o.view_turned_min_rad and _spread(np.array(seen)) < o.view_still_ratio * turned


def _spread(directions: F64) -> float:
    """Return the root of the mean squared distance from the mean, rad."""
    n = len(directions)
    apart = (directions - np.add.reduce(directions, axis=0) / n).ravel()
    return math.sqrt(float(apart.dot(apart)) / n)
