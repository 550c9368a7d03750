"""The pad's drawing for measuring: its edges as points with normals, and the share of paint a blurred pixel sees.

A pixel of a blurred picture sees each paint with a weight: the drawing's region convolved with the point spread. Across a
straight edge that is the normal distribution's integral; at the corners of the H it is a product of two, because an isotropic
Gaussian parts into its axes. A circle's edge moves inward as it is blurred. For the heat equation in polar coordinates the
drift is 1/r, whose characteristics are r0^2 = r^2 + sigma^2, so a circle of radius R is seen at r with
Phi((R - sqrt(r^2 + sigma^2)) / sigma): the shift that makes small discs look smaller is part of the model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.pad import Pad

_SPACING_M = 0.004
_A, _B = math.sqrt(2.0 / math.pi), 0.044715 * math.sqrt(2.0 / math.pi)


class EdgeKind(IntEnum):
    """Which two paints meet at an edge: inside before outside."""

    DISC = 0
    """Disc and whatever lies round the pad, or disc and rim where there is one."""
    RING = 1
    """Ring and disc, both sides of the stroke."""
    ARROW = 2
    """Arrowhead beyond the ring, and disc."""
    H = 3
    """H and disc."""


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Points on every edge of the drawing, neighbours in a piece in order, pieces of a kind together."""

    at_m: F64
    """(M, 2) m."""
    normal: F64
    """(M, 2) unit, out of the paint inside."""
    kind: NDArray[np.intp]
    """(M,) `EdgeKind`, ascending."""
    piece: NDArray[np.intp]
    """(M,) ascending: disc, ring inside, ring outside, the arrow's two sides, the H's twelve."""
    spacing_m: F64
    """(M,) distance between neighbours."""


@lru_cache(maxsize=8)
def edges_of(pad: Pad) -> Edges:
    """The edges of a pad's drawing, made once.

    The ring near the arrowhead is left out: there its outer edge is no edge.
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
        # The corners run clockwise seen from above with z into the deck: x to y. Outside lies to the left of the way.
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
    """Where the way from outside the circle meets it; `end` if it does not."""
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


F32 = NDArray[np.floating[Any]]
"""Computed in single precision throughout; the type says only that it is floating, which is what numpy's own types can follow."""
Share = tuple[F32, F32]
"""(N,) share of a paint, and (5, N) its change with x, y (1/m) and the blur's xx, xy, yy (1/m^2)."""


def _phi(d: F32, per: F32) -> tuple[F32, F32, F32]:
    """Normal integral of d / sigma and its derivatives by d and by sigma squared, good to 3e-4 and smooth; `per` is 1 / sigma.

    Source: the tanh form of Page, Approximations to the cumulative normal function, Applied Statistics 26(1), 1977.
    """
    z = d * per
    z2 = z * z
    t = np.tanh(z * (_A + _B * z2))
    slope = (0.5 - 0.5 * t * t) * (_A + 3.0 * _B * z2)
    slope *= per
    return 0.5 + 0.5 * t, slope, slope * z * (-0.5 * per)


@dataclass(frozen=True, slots=True, eq=False)
class Blurred:
    """Points of the pad plane seen through a Gaussian blur."""

    pad: Pad
    x: F32
    """(N,) m."""
    y: F32
    blur_m2: tuple[float, float, float]
    """xx, xy, yy of the blur's covariance where `scale2` is 1."""
    scale2: F32
    """(N,) factor on the covariance at each point: the square of its depth against the reference."""

    def circles(self, *radii_m: float | F32) -> list[Share]:
        """The share inside each of some circles about the centre; radii all for all points, or all (N,) for each its own."""
        x, y, m = self.x, self.y, self.scale2
        xx, xy, yy = self.blur_m2
        r2 = x * x + y * y
        per_r2 = 1.0 / np.maximum(r2, 1e-8)
        cc, cs = x * x * per_r2, x * y * per_r2
        ss = 1.0 - cc
        m_cc, m_cs, m_ss = m * cc, 2.0 * m * cs, m * ss
        per_r = 1.0 / np.sqrt(m_cc * xx + m_cs * xy + m_ss * yy)
        seen = np.sqrt(r2 + (m_ss * xx - m_cs * xy + m_cc * yy))
        per = 1.0 / seen
        radii = np.array(radii_m, np.float32)
        c, c_d, c_v = _phi((radii[:, None] if radii.ndim == 1 else radii) - seen, per_r)
        c_x = -c_d * per
        inward = 0.5 * c_x
        d = np.empty((len(radii_m), 5, len(x)), np.float32)
        np.multiply(c_x, x, out=d[:, 0])
        np.multiply(c_x, y, out=d[:, 1])
        np.add(c_v * m_cc, inward * m_ss, out=d[:, 2])
        np.multiply(c_v - inward, m_cs, out=d[:, 3])
        np.add(c_v * m_ss, inward * m_cc, out=d[:, 4])
        return [(c[i], d[i]) for i in range(len(radii_m))]

    def arrow(self, beyond: Share) -> Share:
        """The arrowhead's part beyond the ring. `beyond` is the share inside the ring's outer edge.

        Holds where the blur is small against the arrowhead.
        """
        pad, x, y, m = self.pad, self.x, self.y, self.scale2
        xx, xy, yy = self.blur_m2
        slant = math.hypot(pad.arrow_half_base_m, pad.arrow_depth_m)
        cu, cv = pad.arrow_half_base_m / slant, pad.arrow_depth_m / slant
        ahead = cu * (pad.arrow_tip_m - x)
        per = 1.0 / np.sqrt(m)
        s, s_d, s_v = _phi(ahead - cv * y, per / math.sqrt(cu * cu * xx + 2 * cu * cv * xy + cv * cv * yy))
        p, p_d, p_v = _phi(ahead + cv * y, per / math.sqrt(cu * cu * xx - 2 * cu * cv * xy + cv * cv * yy))
        ring, d_ring = beyond
        out = 1.0 - ring
        both = s * p
        sp, ps = s_d * p, p_d * s
        svp, pvs = s_v * p * m, p_v * s * m
        d = np.stack([-cu * (sp + ps), cv * (ps - sp), cu * cu * (svp + pvs), 2 * cu * cv * (svp - pvs), cv * cv * (svp + pvs)])
        base = pad.arrow_tip_m - pad.arrow_depth_m
        if math.hypot(base, pad.arrow_half_base_m) <= pad.ring_outer_m:
            # The ring hides the base, and a blurred base would eat into the part beyond it: cut where the ring hides all.
            base = 0.5 * pad.arrow_tip_m
        b, b_d, b_v = _phi(x - base, per / math.sqrt(xx))
        d *= b
        d[0] += both * b_d
        d[2] += both * b_v * m
        both = both * b
        return both * out, d * out - both * d_ring

    def arrow_small(self) -> Share:
        """The arrowhead's part beyond the ring where the blur is not small against it: a sum of strips along the arrow.

        A product of blurred sides holds while each is blurred by itself. Strips between an arc and a slanted side are exact in
        the limit of many; the steps that a few leave are far finer than the blur.
        """
        pad, x, y, m = self.pad, self.x, self.y, self.scale2
        xx, _, yy = self.blur_m2
        starboard, low, high = _strips(pad)
        reach = 4.0 * math.sqrt(max(xx, yy) * float(m.max(initial=0.0)))
        near = (np.abs(y) < starboard[-1] + reach) & (x > low.min() - reach) & (x < pad.arrow_tip_m + reach)
        at = np.nonzero(near)[0]
        value, d = np.zeros(len(x), np.float32), np.zeros((5, len(x)), np.float32)
        if len(at) == 0:
            return value, d
        x, y, m = x[at], y[at], m[at]
        per = 1.0 / np.sqrt(m)
        side, side_d, side_v = _phi(starboard[:, None] - y, per / math.sqrt(yy))
        across, across_d, across_v = np.diff(side, axis=0), np.diff(side_d, axis=0), np.diff(side_v, axis=0)
        fore, fore_d, fore_v = _phi(high[:, None] - x, per / math.sqrt(xx))
        aft, aft_d, aft_v = _phi(low[:, None] - x, per / math.sqrt(xx))
        along = fore - aft
        value[at] = (across * along).sum(axis=0)
        d[0, at] = (across * (aft_d - fore_d)).sum(axis=0)
        d[1, at] = -(across_d * along).sum(axis=0)
        d[2, at] = (across * (fore_v - aft_v)).sum(axis=0) * m
        d[4, at] = (across_v * along).sum(axis=0) * m
        return value, d

    def h(self) -> Share:
        """The H."""
        pad, m = self.pad, self.scale2
        half_w = pad.h_width_m / 2
        half = np.array([pad.h_length_m / 2, pad.bar_width_m / 2, half_w, half_w - pad.leg_width_m], np.float32)[:, None]
        per = 1.0 / np.sqrt(m)
        at, per4 = np.empty((4, len(m)), np.float32), np.empty((4, len(m)), np.float32)
        at[:2], at[2:] = self.x, self.y
        per4[:2], per4[2:] = per / math.sqrt(self.blur_m2[0]), per / math.sqrt(self.blur_m2[2])
        a, a_d, a_v = _phi(half - at, per4)
        b, b_d, b_v = _phi(half + at, per4)
        (legs, bar, wide, gap), (legs_d, bar_d, wide_d, gap_d) = a + b - 1.0, b_d - a_d
        legs_v, bar_v, wide_v, gap_v = a_v + b_v
        two = wide - gap
        d = np.empty((5, len(self.x)), np.float32)
        d[0] = legs_d * two + bar_d * gap
        d[1] = legs * (wide_d - gap_d) + bar * gap_d
        d[2] = (legs_v * two + bar_v * gap) * m
        d[3] = 0.0
        d[4] = (legs * (wide_v - gap_v) + bar * gap_v) * m
        return legs * two + bar * gap, d


@lru_cache(maxsize=8)
def _strips(pad: Pad, n: int = 6) -> tuple[F32, F32, F32]:
    """(n + 1,) borders in y, and (n,) beginning and end in x of the strips that make up the arrowhead beyond the ring."""
    slope = pad.arrow_half_base_m / pad.arrow_depth_m
    base = pad.arrow_tip_m - pad.arrow_depth_m

    def extent(y: F64) -> tuple[F64, F64]:
        end = pad.arrow_tip_m - np.abs(y) / slope
        return np.maximum(base, np.sqrt(np.maximum(pad.ring_outer_m**2 - y * y, 0.0))), end

    fine = np.linspace(0.0, pad.arrow_half_base_m, 1001)
    begin, end = extent(fine)
    half = float(fine[np.nonzero(end > begin)[0][-1]])
    borders = np.linspace(-half, half, n + 1)
    inner = borders[:-1, None] + (np.arange(20) + 0.5) / 20 * (borders[1] - borders[0])
    begin, end = extent(inner)
    return borders.astype(np.float32), begin.mean(axis=1).astype(np.float32), end.mean(axis=1).astype(np.float32)
