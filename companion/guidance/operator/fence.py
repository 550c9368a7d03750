"""Compute the margin to a fence, and the velocity that stays inside."""

import math

import numpy as np

from estimator.contracts.geometry import F64

_TANGENT_S = 0.1
"""More than half the period of commands keeps a vehicle that flies along a circle inside it."""

Corners = tuple[tuple[float, float], ...]
_ON_THE_LINE_M = 1e-6  # distance below which a place lies on a fence's line


def margin(p: F64, radius_m: float, corners: Corners) -> tuple[float, F64]:
    """Return how far a place is inside the fence, and the outward direction of the fence's nearest part.

    Args:
        p: (2,) m from the fence's centre.
        corners: of the polygon; empty for a circle of `radius_m`.

    Returns:
        The distance to the fence, m, negative outside; and the direction, (2,), of length 1.
    """
    if not corners:
        r = float(np.hypot(p[0], p[1]))
        return radius_m - r, p / r if r > _ON_THE_LINE_M else np.array([1.0, 0.0])
    inside, best_m, nearest, edge = False, math.inf, p, np.zeros(2)
    for a, b in zip(corners, (*corners[1:], corners[0]), strict=True):
        start, along = np.array(a), np.array(b) - np.array(a)
        length_2 = float(along @ along)
        t = 0.0 if length_2 == 0.0 else min(1.0, max(0.0, float((p - start) @ along) / length_2))
        on = start + t * along
        distance_m = float(np.hypot(*(p - on)))
        if distance_m < best_m:
            best_m, nearest, edge = distance_m, on, along
        # Count the edges that a ray along +x crosses (even-odd rule).
        if (a[1] > p[1]) != (b[1] > p[1]) and p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]):
            inside = not inside
    if best_m > _ON_THE_LINE_M:
        towards = (nearest - p) / best_m
        return (best_m, towards) if inside else (-best_m, -towards)
    normal = np.array([edge[1], -edge[0]])
    normal = normal / max(float(np.hypot(*normal)), 1e-12)
    ahead, _ = margin(p + 1e-3 * normal, radius_m, corners)
    return 0.0, normal if ahead < 0.0 else -normal


def within(v: F64, p: F64, radius_m: float, corners: Corners, brake_s: float, spread_m: float = 0.0) -> F64:
    """Return the velocity with as much of it removed as keeps the place inside the fence.

    Inside, the velocity towards the fence is at most the distance to it over `brake_s`. Outside, nothing is left that leads
    farther away; whatever leads back stays. Where the place may be outside, on an unknown side, nothing is left.

    Args:
        v: (2,) m/s relative to the fence's centre.
        p: (2,) m from the fence's centre.
        spread_m: distance from there at which it may be.
    """
    inside_m, n = margin(p, radius_m, corners)
    if inside_m < spread_m and float(np.hypot(p[0], p[1])) <= spread_m:
        return np.zeros(2)
    inside_m -= spread_m
    excess = float(v @ n) - max(0.0, inside_m / brake_s)
    if excess > 0.0:
        v = v - excess * n
    if not corners:
        # Along the tangent it would creep outwards: the next instant counts as well.
        later_m, n_later = margin(p + _TANGENT_S * v, radius_m, corners)
        return v - max(0.0, float(v @ n_later)) * n_later if later_m < spread_m else v
    if inside_m <= 0.0:
        return v
    # Another edge may be met sooner than the nearest one, in a corner for example.
    later_m, n_later = margin(p + brake_s * v, radius_m, corners)
    if later_m < spread_m:
        v = v - max(0.0, float(v @ n_later)) * n_later
        later_m, _ = margin(p + brake_s * v, radius_m, corners)
    return v if later_m >= spread_m - _ON_THE_LINE_M else np.zeros(2)
