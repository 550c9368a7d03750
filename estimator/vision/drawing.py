"""The pad's drawing for measuring: its edges as points with normals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.pad import Pad

_SPACING_M = 0.004


class EdgeKind(IntEnum):
    """Kinds of edges, by the paints that meet: the paint inside is named first."""

    DISC = 0
    """The edge between the disc and the surroundings, or between the disc and its rim if it has one."""
    RING = 1
    """The edges between the ring and the disc, on both sides of the ring."""
    ARROW = 2
    """The edge between the disc and the part of the arrowhead beyond the ring."""
    H = 3
    """The edge between the H and the disc."""


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Points on every edge of the drawing. Neighbours of a piece are in order, and the pieces of one kind are contiguous."""

    at_m: F64
    """Positions of the points, (M, 2) m."""
    normal: F64
    """Unit normals, (M, 2), pointing out of the inner paint."""
    kind: NDArray[np.intp]
    """The `EdgeKind` of each point, (M,), ascending."""
    piece: NDArray[np.intp]
    """Index of the piece of each point, (M,), ascending: disc, ring inside, ring outside, the arrow's two sides, the H's
    twelve.
    """
    spacing_m: F64
    """Distance between neighbours, (M,)."""


@lru_cache(maxsize=8)
def edges_of(pad: Pad) -> Edges:
    """Return the edges of a pad's drawing; the result is cached.

    The ring near the arrowhead is left out, because its outer edge is covered there.
    """
    pieces: list[tuple[EdgeKind, F64, F64]] = []
    clear = math.atan2(1.25 * pad.arrow_half_base_m, pad.ring_inner_m)
    for kind, radius, sign, gap in (
        (EdgeKind.DISC, pad.disc_radius_m - pad.rim_width_m, 1.0, 0.0),
        (EdgeKind.RING, pad.ring_inner_m, -1.0, clear),
        (EdgeKind.RING, pad.ring_outer_m, 1.0, clear),
    ):
        n = math.ceil((math.tau - 2 * gap) * radius / (1.5 * _SPACING_M))
        a = gap + (np.arange(n) + 0.5) / n * (math.tau - 2 * gap)
        normal = np.stack([np.cos(a), np.sin(a)], axis=1)
        pieces.append((kind, radius * normal, sign * normal))
    tip, *base = pad.arrowhead()[:, :2]
    for corner in base:
        pieces.append((EdgeKind.ARROW, *_side(tip, _until_circle(tip, corner, pad.ring_outer_m), np.zeros(2))))
    corners = pad.h_corners()[:, :2]
    for i in range(12):
        a_, b_ = corners[i], corners[(i + 1) % 12]
        along = (b_ - a_) / np.linalg.norm(b_ - a_)
        # The corners run clockwise seen from above with z into the deck, from x to y, so outside is to the left of the direction
        # of travel.
        pieces.append((EdgeKind.H, *_along(a_, b_, np.array([along[1], -along[0]]))))
    order = [EdgeKind.DISC, EdgeKind.RING, EdgeKind.ARROW, EdgeKind.H]
    pieces.sort(key=lambda p: order.index(p[0]))
    count = [len(at) for _, at, _ in pieces]
    spacing = [float(np.linalg.norm(at[1] - at[0])) if len(at) > 1 else _SPACING_M for _, at, _ in pieces]
    return Edges(
        np.concatenate([at for _, at, _ in pieces]),
        np.concatenate([normal for _, _, normal in pieces]),
        np.repeat([int(kind) for kind, _, _ in pieces], count),
        np.repeat(np.arange(len(pieces)), count),
        np.repeat(spacing, count),
    )


def _until_circle(start: F64, end: F64, radius: float) -> F64:
    """Return where the segment from outside the circle meets it; `end` if it does not."""
    way = end - start
    a, b, c = way @ way, start @ way, start @ start - radius**2
    disc = b * b - a * c
    if disc <= 0:
        return end
    s = (-b - math.sqrt(disc)) / a
    return start + way * s if 0 < s < 1 else end


def _side(a: F64, b: F64, inside: F64) -> tuple[F64, F64]:
    along = (b - a) / np.linalg.norm(b - a)
    normal = np.array([along[1], -along[0]])
    return _along(a, b, normal if normal @ (a - inside) > 0 else -normal)


def _along(a: F64, b: F64, normal: F64) -> tuple[F64, F64]:
    n = max(2, round(float(np.linalg.norm(b - a)) / _SPACING_M))
    at = a + (b - a) * ((np.arange(n) + 0.5) / n)[:, None]
    return at, np.broadcast_to(normal, at.shape)
