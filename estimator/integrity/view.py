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


_LAGS_S = np.arange(-8, 9) * 0.02
"""Delays of the attitude behind the image for which both are compared."""
_LAG_FORGET_S = 3.0
"""Time after which a rotation counts a third for the delay."""
_LATE_S, _LAG_ALIKE, _LAG_BETTER = 0.06, 0.8, 0.05
"""Least delay that makes an alert, least correlation with it, and how much better its square is than that without delay."""
_LAG_TURNED_RAD = 0.03
"""Root of the sum of squares of the rotations that show a delay."""
_LAG_FROM_M = 1.0
"""Least distance to the pad: nearer, a drone's way aside moves the pad more than its lean does, and later."""
_LAG_ASIDE_RAD_S = 0.5
"""Rate of the pad's way through the level view after which nothing is compared for `_LAG_FORGET_S`: after a ship that stops or
turns a drone leans."""
_LAG_LASTS = 15
"""Number of sightings in a row that show it."""


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
    lags: F64 | None = None
    """Sums for each of `_LAGS_S`: squares of view and rotation, and of their product, (17, 3) rad^2, older ones less."""
    lags_shown: int = 0
    """Number of sightings in a row that show a delay."""
    late_s: float = 0.0
    """Delay of the attitude against the image, s; 0 while nothing shows that it is."""
    aside_s: float = -math.inf
    """Instant of the newest way of the pad that is too fast to show a delay, s."""


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
        return state._replace(bearings=bearings, frozen=False)
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
        if distance_m > _LAG_FROM_M:
            state = _lagged(state, np.array(at, float) * 1e-9, expected, found, np.array(levels))
    return state._replace(
        bearings=bearings, frozen=still, moments=moments, reversed=moments is not None and _is_reversed(moments)
    )


def _lagged(state: ViewWatch, at: F64, expected: F64, found: F64, levels: F64) -> ViewWatch:
    """Compare the view in the middle of half a second with the rotation at instants before and after.

    The delay is where both agree best (Knapp, Carter, The generalized correlation method for estimation of time delay, IEEE
    Trans. ASSP 24(4), 1976).

    Args:
        at: instants (n,), s.
        expected: bearings (n, 3) that the rotation alone makes.
        found: bearings (n, 3) in the image.
        levels: bearings (n, 3) in `level`.
    """
    middle, mean = len(at) // 2, np.add.reduce(at) / len(at)
    there = at[middle] + _LAGS_S
    if there[0] < at[0] or there[-1] > at[-1]:
        return state
    along = (at - mean) / float((at - mean).dot(at - mean))
    if math.hypot(*along.dot(levels[:, :2])) > _LAG_ASIDE_RAD_S:
        return state._replace(lags=None, lags_shown=0, late_s=0.0, aside_s=float(at[-1]))
    if 0.0 <= at[-1] - state.aside_s < _LAG_FORGET_S:
        return state
    seen = found[middle, :2] - np.add.reduce(found[:, :2]) / len(at) - (at[middle] - mean) * along.dot(found[:, :2])
    line = np.add.reduce(expected[:, :2]) / len(at) + np.outer(there - mean, along.dot(expected[:, :2]))
    turned = np.stack([np.interp(there, at, expected[:, k]) for k in range(2)], axis=1) - line
    sums = np.stack([np.full(len(there), float(seen.dot(seen))), (turned * turned).sum(axis=1), turned.dot(seen)], axis=1)
    lags = sums + (0.0 if state.lags is None else math.exp((at[-2] - at[-1]) / _LAG_FORGET_S) * state.lags)
    alike = lags[:, 2] / np.sqrt(np.maximum(lags[:, 0] * lags[:, 1], 1e-18))
    best, none = int(np.argmax(alike)), len(_LAGS_S) // 2
    late_s, better = float(_LAGS_S[best]), alike[best] * abs(alike[best]) - alike[none] * abs(alike[none])
    shows = (
        abs(late_s) > _LATE_S - 1e-9 and alike[best] > _LAG_ALIKE and better > _LAG_BETTER and lags[best, 0] > _LAG_TURNED_RAD**2
    )
    shown = state.lags_shown + 1 if shows else 0
    return state._replace(lags=lags, lags_shown=shown, late_s=late_s if shown >= _LAG_LASTS else 0.0)


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
