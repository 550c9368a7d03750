"""Detect a frozen view and a mirrored one: the pad does not move in the image as the body's rotation moves it.

A rotation moves everything in the image by the same angle, at any distance. So the pad's bearing in the body is compared with the
effect of the rotation alone, as computed from the vehicle's own attitude. A pad that keeps its place in the image while the body
turns is not below, whatever noise is added. One that moves the other way is seen by a camera that mirrors, or that is mounted the
other way round. The drone's drift is slower than its rotation: each bearing's distance from a line through those of half a second
is free of it, and the sums of these distances over some seconds decide.
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
_FORGET_S = 6.0
"""Time after which a rotation counts a third for which way the view moves."""
_JUMP_RAD = 0.1
"""A bearing that leaves the one before by more, beyond the rotation of the body, is that of something else."""
_LEAST_TURNED_RAD = 0.015
"""Root of the sum of squares of the rotations that say which way the view moves."""
_AGAINST = -0.2
"""Correlation of view and rotation along one axis, below which the view moves against the body."""


Bearing = tuple[int, F64, F64, F64]
"""Instant, ns; unit vector to the pad in `body` and in `level`, (3,); the level frame's axes in `body`, (3, 3)."""


class ViewWatch(NamedTuple):
    """Bearings of the last half second, and the moments of the fast rotations before."""

    bearings: tuple[Bearing, ...] = ()
    frozen: bool = False
    moments: F64 | None = None
    """Sum of the products of [expected forward, right, seen forward, right] in the body, (4, 4) rad^2, older ones less."""
    reversed: bool = False
    """True if the pad moves in the image against the rotation of the body, along some axis."""


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
    if len(bearings) < _LEAST or t - bearings[0][0] < _LEAST_SPAN_S * 1e9:
        return ViewWatch(bearings, False, state.moments, state.reversed)
    at, seen, levels, axes = zip(*bearings, strict=True)
    expected, found = np.array(axes).dot(np.add.reduce(levels) / len(levels)), np.array(seen)
    turned = _spread(expected)
    still = turned > o.view_turned_min_rad and _spread(found) < o.view_still_ratio * turned
    weights = _off_line(np.array(at, float))
    apart = np.concatenate([weights.dot(expected)[:2], weights.dot(found)[:2]])
    moments = state.moments
    if abs(np.diff(found - expected, axis=0)).max() < _JUMP_RAD:
        kept_share = math.exp((bearings[-2][0] - t) * 1e-9 / _FORGET_S)
        moments = np.outer(apart, apart) + (0.0 if moments is None else kept_share * moments)
    return ViewWatch(bearings, still, moments, moments is not None and _is_reversed(moments))


def _off_line(at: F64) -> F64:
    """Return the weights (n,) of values at these instants whose sum is the last one's distance from the line through all."""
    at = at - np.add.reduce(at) / len(at)
    weights = -1.0 / len(at) - at[-1] * at / float(at.dot(at))
    weights[-1] += 1.0
    return np.asarray(weights)


def _is_reversed(moments: F64) -> bool:
    """Return whether view and rotation run against each other along the axis on which they agree least."""
    expected, crossed, seen = moments[:2, :2], moments[:2, 2:], moments[2:, 2:]
    axis = np.linalg.eigh(crossed + crossed.T)[1][:, 0]
    turned = float(axis.dot(expected).dot(axis))
    both = math.sqrt(max(turned * float(axis.dot(seen).dot(axis)), 0.0))
    return turned > _LEAST_TURNED_RAD**2 and float(axis.dot(crossed).dot(axis)) < _AGAINST * both


def _spread(directions: F64) -> float:
    """Return the root of the mean squared distance from the mean, rad."""
    n = len(directions)
    apart = (directions - np.add.reduce(directions, axis=0) / n).ravel()
    return math.sqrt(float(apart.dot(apart)) / n)
