"""The pad's drawing for measuring: its edges as points with normals, and the share of paint a blurred pixel sees.

A pixel of a blurred frame sees each paint with a weight: the drawing's region convolved with the point spread. Across a
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


Phi = tuple[F32, F32, F32]
"""Normal integral of d / sigma, and its derivatives by d and by sigma squared."""
Asked = tuple[F32, F32]
"""d and 1 / sigma of normal integrals, of one shape."""


def _phi(d: F32, per: F32) -> Phi:
    """Normal integral of d / sigma and its derivatives by d and by sigma squared, good to 3e-4 and smooth; `per` is 1 / sigma.

    Source: the tanh form of Page, Approximations to the cumulative normal function, Applied Statistics 26(1), 1977.
    """
    z = d * per
    z2 = z * z
    z2 *= 3.0 * _B
    z2 += _A
    t = z2 + 2.0 * _A
    t *= z
    t *= 1.0 / 3.0
    t = np.tanh(t, out=t)
    slope = t * t
    slope *= -0.5
    slope += 0.5
    slope *= z2
    slope *= per
    t *= 0.5
    t += 0.5
    z *= slope
    z *= per
    z *= -0.5
    return t, slope, z


def _phi_at_once(*asked: Asked) -> list[Phi]:
    """The normal integrals of several shapes by one evaluation: on short arrays most of the time goes into the calls."""
    value, slope, by_var = _phi(np.concatenate([d.ravel() for d, _ in asked]), np.concatenate([per.ravel() for _, per in asked]))
    out: list[Phi] = []
    end = 0
    for d, _ in asked:
        begin, end = end, end + d.size
        shape = d.shape
        out.append((value[begin:end].reshape(shape), slope[begin:end].reshape(shape), by_var[begin:end].reshape(shape)))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Round:
    """Points as circles about the centre see them."""

    x: F32
    y: F32
    seen: F32
    """(N,) radius at which a blurred circle through the point would be drawn."""
    per: F32
    """(N,) one over it."""
    per_sigma: F32
    """(N,) of the blur along the radius."""
    m_cc: F32
    m_cs: F32
    m_ss: F32

    def change(self, c_d: F32, c_v: F32, out: F32 | None = None) -> F32:
        """(5, ..., N) of shares (..., N) whose changes with distance and variance are given."""
        if out is None:
            out = np.empty((5, *c_d.shape), np.float32)
        c_x = c_d * self.per
        inward = c_x * -0.5
        np.negative(c_x, out=c_x)
        np.multiply(c_x, self.x, out=out[0])
        np.multiply(c_x, self.y, out=out[1])
        np.add(c_v * self.m_cc, inward * self.m_ss, out=out[2])
        np.add(c_v * self.m_ss, inward * self.m_cc, out=out[4])
        np.multiply(c_v - inward, self.m_cs, out=out[3])
        return out

    def part(self, part: slice) -> _Round:
        """Some of the points."""
        return _Round(
            self.x[part], self.y[part], self.seen[part], self.per[part], self.per_sigma[part],
            self.m_cc[part], self.m_cs[part], self.m_ss[part],
        )  # fmt: skip


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

    def part(self, part: slice) -> Blurred:
        """Some of the points."""
        return Blurred(self.pad, self.x[part], self.y[part], self.blur_m2, self.scale2[part])

    def circles(self, *radii_m: float | F32) -> list[Share]:
        """The share inside each of some circles about the centre; radii all for all points, or all (N,) for each its own."""
        round_ = self._round()
        radii = np.array(radii_m, np.float32)
        c, c_d, c_v = _phi((radii[:, None] if radii.ndim == 1 else radii) - round_.seen, round_.per_sigma)
        d = np.empty((len(radii_m), 5, len(self.x)), np.float32)
        round_.change(c_d, c_v, d.transpose(1, 0, 2))
        return [(c[i], d[i]) for i in range(len(radii_m))]

    def edge_shares(self, disc: slice, ring: slice, arrow: slice, h: slice) -> tuple[F32, F32, F32]:
        """What is inside the edges that points belong to: the disc's paint, ring, ring and arrowhead, H.

        Args:
            disc, ring, arrow, h: which of the points, one after the other in this order.

        Returns:
            (N,) shares, (5, N) their changes, and of the points at the arrowhead its own share.
        """
        pad, n = self.pad, len(self.x)
        round_ = self.part(slice(0, arrow.stop))._round()
        stroke = slice(ring.start, arrow.stop)
        edge = np.empty(arrow.stop, np.float32)
        edge[disc], edge[stroke] = pad.disc_radius_m - pad.rim_width_m, pad.ring_outer_m
        at_h, at_arrow = self.part(h), self.part(arrow)
        (c, c_d, c_v), (inner, i_d, i_v), in_h, in_arrow = _phi_at_once(
            (edge - round_.seen, round_.per_sigma),
            (np.float32(pad.ring_inner_m) - round_.seen[stroke], round_.per_sigma[stroke]),
            at_h._h_asks(),
            at_arrow._arrow_asks(),
        )
        value, d = np.empty(n, np.float32), np.empty((5, n), np.float32)
        head = np.empty(0, np.float32)
        if arrow.stop > arrow.start:
            beyond = c[arrow], round_.part(arrow).change(c_d[arrow], c_v[arrow])
            head, d_head = at_arrow._arrow_of(in_arrow, beyond)
        value[: arrow.stop] = c
        value[stroke] -= inner
        c_d[stroke] -= i_d
        c_v[stroke] -= i_v
        round_.change(c_d, c_v, d[:, : arrow.stop])
        if arrow.stop > arrow.start:
            value[arrow] += head
            d[:, arrow] += d_head
        at_h._h_of(in_h, value[h], d[:, h])
        return value, d, head

    def arrow(self, beyond: Share) -> Share:
        """The arrowhead's part beyond the ring. `beyond` is the share inside the ring's outer edge.

        Holds where the blur is small against the arrowhead.
        """
        return self._arrow_of(_phi(*self._arrow_asks()), beyond)

    def h(self) -> Share:
        """The H."""
        value, d = np.empty(len(self.x), np.float32), np.empty((5, len(self.x)), np.float32)
        self._h_of(_phi(*self._h_asks()), value, d)
        return value, d

    def _round(self) -> _Round:
        x, y, m = self.x, self.y, self.scale2
        xx, xy, yy = self.blur_m2
        x2 = x * x
        r2 = x2 + y * y
        per_r2 = m / np.maximum(r2, 1e-8)
        m_cc, m_cs = x2 * per_r2, (x * y) * per_r2
        m_ss = m - m_cc
        m_cs += m_cs
        along = m_cc * xx + m_ss * yy
        across = m_ss * xx + m_cc * yy
        if xy != 0.0:
            slant = m_cs * xy
            along += slant
            across -= slant
        r2 += across
        seen = np.sqrt(r2, out=r2)
        return _Round(x, y, seen, 1.0 / seen, 1.0 / np.sqrt(along, out=along), m_cc, m_cs, m_ss)

    def _arrow_asks(self) -> Asked:
        """(3, N): port side, starboard side, base."""
        pad, x, y = self.pad, self.x, self.y
        xx, xy, yy = self.blur_m2
        cu, cv, base = _arrow_lines(pad)
        d, per = np.empty((3, len(x)), np.float32), np.empty((3, len(x)), np.float32)
        ahead, aside = cu * (pad.arrow_tip_m - x), cv * y
        np.subtract(ahead, aside, out=d[0])
        np.add(ahead, aside, out=d[1])
        np.subtract(x, base, out=d[2])
        whole, slant = cu * cu * xx + cv * cv * yy, 2 * cu * cv * xy
        sides = np.array([[whole + slant], [whole - slant], [xx]], np.float32) ** -0.5
        np.divide(sides, np.sqrt(self.scale2), out=per)
        return d, per

    def _arrow_of(self, phi: Phi, beyond: Share) -> Share:
        (s, p, b), (s_d, p_d, b_d), (s_v, p_v, b_v) = phi
        m = self.scale2
        cu, cv, _ = _arrow_lines(self.pad)
        ring, d_ring = beyond
        both = s * p
        sp, ps = s_d * p, p_d * s
        svp, pvs = s_v * p * m, p_v * s * m
        sum_v = svp + pvs
        d = np.empty((5, len(m)), np.float32)
        d[0], d[1] = -cu * (sp + ps), cv * (ps - sp)
        d[2], d[3], d[4] = cu * cu * sum_v, 2 * cu * cv * (svp - pvs), cv * cv * sum_v
        d *= b
        d[0] += both * b_d
        d[2] += both * b_v * m
        both = both * b
        out = 1.0 - ring
        return both * out, d * out - both * d_ring

    def _h_asks(self) -> Asked:
        """(8, N): for either side along x of legs and bar and along y of the H and the gap between its legs."""
        n = len(self.x)
        per = 1.0 / np.sqrt(self.scale2)
        d, per8 = np.empty((8, n), np.float32), np.empty((8, n), np.float32)
        at = d[4:]
        at[:2], at[2:] = self.x, self.y
        per8[:2], per8[2:4] = per * self.blur_m2[0] ** -0.5, per * self.blur_m2[2] ** -0.5
        per8[4:] = per8[:4]
        half = _h_halves(self.pad)
        np.subtract(half, at, out=d[:4])
        at += half
        return d, per8

    def _h_of(self, phi: Phi, value: F32, d: F32) -> None:
        """Fills (N,) share and (5, N) changes."""
        a, a_d, a_v = phi
        m = self.scale2
        (legs, bar, wide, gap), (legs_d, bar_d, wide_d, gap_d) = a[:4] + a[4:] - 1.0, a_d[4:] - a_d[:4]
        legs_v, bar_v, wide_v, gap_v = (a_v[:4] + a_v[4:]) * m
        two = wide - gap
        np.add(legs * two, bar * gap, out=value)
        np.add(legs_d * two, bar_d * gap, out=d[0])
        np.add(legs * (wide_d - gap_d), bar * gap_d, out=d[1])
        np.add(legs_v * two, bar_v * gap, out=d[2])
        d[3] = 0.0
        np.add(legs * (wide_v - gap_v), bar * gap_v, out=d[4])

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


@lru_cache(maxsize=8)
def _arrow_lines(pad: Pad) -> tuple[float, float, float]:
    """Unit normal of the arrowhead's sides, along the arrow and across, and where its base lies."""
    slant = math.hypot(pad.arrow_half_base_m, pad.arrow_depth_m)
    base = pad.arrow_tip_m - pad.arrow_depth_m
    if math.hypot(base, pad.arrow_half_base_m) <= pad.ring_outer_m:
        # The ring hides the base, and a blurred base would eat into the part beyond it: cut where the ring hides all.
        base = 0.5 * pad.arrow_tip_m
    return pad.arrow_half_base_m / slant, pad.arrow_depth_m / slant, base


@lru_cache(maxsize=8)
def _h_halves(pad: Pad) -> F32:
    """(4, 1) half lengths of legs and bar along the arrow, half widths of the H and of the gap between its legs."""
    half_w = pad.h_width_m / 2
    return np.array([pad.h_length_m / 2, pad.bar_width_m / 2, half_w, half_w - pad.leg_width_m], np.float32)[:, None]


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
