"""The coverage of each paint of the pad in a blurred pixel.

A pixel of a blurred frame mixes the paints; the weight of a paint is its region convolved with the point spread function. Across
a straight edge that is the normal distribution's integral. At the corners of the H it is a product of two, because an isotropic
Gaussian separates into its axes. A circle's edge moves inward as it is blurred. For the heat equation in polar coordinates the
drift is 1/r, whose characteristics are r0^2 = r^2 + sigma^2, so the coverage of a circle of radius R at radius r is Phi((R -
sqrt(r^2 + sigma^2)) / sigma). The model thereby includes the shift that makes small discs look smaller.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.pad import Pad

_A, _B = math.sqrt(2.0 / math.pi), 0.044715 * math.sqrt(2.0 / math.pi)
F32 = NDArray[np.floating[Any]]
"""An array that is computed in single precision throughout. The type says only "floating", because numpy's own stubs follow no
more.
"""
Coverage = tuple[F32, F32]
"""Coverage of a paint, (N,), and its derivatives (5, N) by x, y (1/m) and by the blur's xx, xy, yy (1/m^2)."""


Phi = tuple[F32, F32, F32]
"""The normal integral of d / sigma, and its derivatives by d and by sigma squared."""
PhiArguments = tuple[F32, F32]
"""Arguments d and 1 / sigma of normal integrals, of one shape."""


def _phi(d: F32, per: F32) -> Phi:
    """Return the normal integral of d / sigma and its derivatives by d and by sigma squared; `per` is 1 / sigma.

    The approximation is good to 3e-4 and smooth.

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


def _phi_at_once(*arguments: PhiArguments) -> list[Phi]:
    """Return the normal integrals of arguments of several shapes from one evaluation.

    On short arrays most of the time goes into the calls.
    """
    value, slope, by_var = _phi(
        np.concatenate([d.ravel() for d, _ in arguments]), np.concatenate([per.ravel() for _, per in arguments])
    )
    out: list[Phi] = []
    end = 0
    for d, _ in arguments:
        begin, end = end, end + d.size
        shape = d.shape
        out.append((value[begin:end].reshape(shape), slope[begin:end].reshape(shape), by_var[begin:end].reshape(shape)))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Round:
    """Points of the pad's plane, prepared for the coverage of circles about the centre."""

    x: F32
    y: F32
    seen: F32
    """Effective radius sqrt(r^2 + sigma^2) of each point, (N,): a circle of this radius has its blurred edge at the point."""
    per: F32
    """Inverse of `seen`, (N,)."""
    per_sigma: F32
    """Inverse standard deviation of the blur along the radius, (N,)."""
    m_cc: F32
    m_cs: F32
    m_ss: F32

    def change(self, c_d: F32, c_v: F32, out: F32 | None = None) -> F32:
        """Return the (5, ..., N) derivatives of coverages (..., N) from their derivatives by distance and variance."""
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
        """Return a subset of the points."""
        return _Round(
            self.x[part], self.y[part], self.seen[part], self.per[part], self.per_sigma[part],
            self.m_cc[part], self.m_cs[part], self.m_ss[part],
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Blurred:
    """Points of the pad plane under a Gaussian blur."""

    pad: Pad
    x: F32
    """Coordinate of the points, (N,) m."""
    y: F32
    blur_m2: tuple[float, float, float]
    """The elements xx, xy, yy of the blur's covariance at a `scale2` of 1."""
    scale2: F32
    """Factor on the covariance at each point, (N,): the squared ratio of its depth to the reference depth."""

    def part(self, part: slice) -> Blurred:
        """Return a subset of the points."""
        return Blurred(self.pad, self.x[part], self.y[part], self.blur_m2, self.scale2[part])

    def circles(self, *radii_m: float | F32) -> list[Coverage]:
        """Return the coverage inside each of several circles about the centre.

        The radii are either one for all points each, or (N,) arrays with one radius per point.
        """
        round_ = self._round()
        radii = np.array(radii_m, np.float32)
        c, c_d, c_v = _phi((radii[:, None] if radii.ndim == 1 else radii) - round_.seen, round_.per_sigma)
        d = np.empty((len(radii_m), 5, len(self.x)), np.float32)
        round_.change(c_d, c_v, d.transpose(1, 0, 2))
        return [(c[i], d[i]) for i in range(len(radii_m))]

    def edge_coverages(self, disc: slice, ring: slice, arrow: slice, h: slice) -> tuple[F32, F32, F32]:
        """Return the coverage inside the edge that each point belongs to: disc, ring, ring with arrowhead, or H.

        Args:
            disc, ring, arrow, h: slices of the points of each kind, contiguous and in this order.

        Returns:
            The (N,) coverages, their (5, N) derivatives, and the coverage of the arrowhead alone at the arrow's points.
        """
        pad, n = self.pad, len(self.x)
        round_ = self.part(slice(0, arrow.stop))._round()
        stroke = slice(ring.start, arrow.stop)
        edge = np.empty(arrow.stop, np.float32)
        edge[disc], edge[stroke] = pad.markings.field_radius_m, pad.markings.ring_outer_m
        at_h, at_arrow = self.part(h), self.part(arrow)
        (c, c_d, c_v), (inner, i_d, i_v), in_h, in_arrow = _phi_at_once(
            (edge - round_.seen, round_.per_sigma),
            (np.float32(pad.markings.ring_inner_m) - round_.seen[stroke], round_.per_sigma[stroke]),
            at_h._h_arguments(),
            at_arrow._arrow_arguments(),
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

    def arrow(self, beyond: Coverage) -> Coverage:
        """Return the coverage of the arrowhead beyond the ring; `beyond` is the coverage inside the ring's outer edge.

        This holds where the blur is small compared with the arrowhead.
        """
        return self._arrow_of(_phi(*self._arrow_arguments()), beyond)

    def h(self) -> Coverage:
        """Return the coverage of the H."""
        value, d = np.empty(len(self.x), np.float32), np.empty((5, len(self.x)), np.float32)
        self._h_of(_phi(*self._h_arguments()), value, d)
        return value, d

    def _slant(self) -> float:
        """Return the blur's covariance along both axes, as far as a short series in the correlation holds."""
        xx, xy, yy = self.blur_m2
        most = 0.5 * math.sqrt(xx * yy)
        return min(max(xy, -most), most)

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

    def _arrow_arguments(self) -> PhiArguments:
        """Return (3, N) arguments of the normal integrals: port side, starboard side, base."""
        pad, x, y = self.pad, self.x, self.y
        xx, xy, yy = self.blur_m2
        cu, cv, base = _arrow_lines(pad)
        d, per = np.empty((3, len(x)), np.float32), np.empty((3, len(x)), np.float32)
        ahead, aside = cu * (pad.markings.arrow_tip_m - x), cv * y
        np.subtract(ahead, aside, out=d[0])
        np.add(ahead, aside, out=d[1])
        np.subtract(x, base, out=d[2])
        whole, slant = cu * cu * xx + cv * cv * yy, 2 * cu * cv * xy
        sides = np.array([[whole + slant], [whole - slant], [xx]], np.float32) ** -0.5
        np.divide(sides, np.sqrt(self.scale2), out=per)
        return d, per

    def _arrow_of(self, phi: Phi, beyond: Coverage) -> Coverage:
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

    def _h_arguments(self) -> PhiArguments:
        """Return (8, N) arguments of the normal integrals, for both sides of each interval.

        The intervals are legs and bar along x, and the H and the gap between its legs along y.
        """
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
        """Write the (N,) coverage of the H to `value` and its (5, N) derivatives to `d`."""
        a, a_d, a_v = phi
        m = self.scale2
        (legs, bar, wide, gap), (legs_d, bar_d, wide_d, gap_d) = a[:4] + a[4:] - 1.0, a_d[4:] - a_d[:4]
        legs_v, bar_v, wide_v, gap_v = a_v[:4] + a_v[4:]
        slant = self._slant() * m
        value[:], d[:] = 0.0, 0.0
        for along, across in (
            ((legs, legs_d, legs_v), (wide - gap, wide_d - gap_d, wide_v - gap_v)),
            ((bar, bar_d, bar_v), (gap, gap_d, gap_v)),
        ):
            _add_product(along, across, slant, m, value, d)

    def arrow_small(self) -> Coverage:
        """Return the coverage of the arrowhead beyond the ring where the blur is not small compared with it.

        It is a sum of strips along x. A product of blurred sides is valid only while each side is blurred separately. Strips
        between an arc and a slanted side are exact in the limit of many; a few leave steps far finer than the blur.
        """
        pad, x, y, m = self.pad, self.x, self.y, self.scale2
        xx, _, yy = self.blur_m2
        starboard, low, high = _strips(pad)
        reach = 4.0 * math.sqrt(max(xx, yy) * float(m.max(initial=0.0)))
        near = (np.abs(y) < starboard[-1] + reach) & (x > low.min() - reach) & (x < pad.markings.arrow_tip_m + reach)
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
        total, change = np.zeros(len(x), np.float32), np.zeros((5, len(x)), np.float32)
        lengthwise, crosswise = (along, aft_d - fore_d, fore_v - aft_v), (across, -across_d, across_v)
        for k in range(len(along)):
            part = [tuple(each[k] for each in of) for of in (lengthwise, crosswise)]
            _add_product(part[0], part[1], self._slant() * m, m, total, change)
        value[at], d[:, at] = total, change
        return value, d


def _add_product(along: Phi, across: Phi, slant: F32, m: F32, value: F32, d: F32) -> None:
    """Add the coverage of a rectangle from its coverages along x and y, their slopes, and their derivatives by variance.

    The blur's covariance of x and y, `slant`, enters by the first two terms of the tetrachoric series.
    """
    (a, a_d, a_v), (b, b_d, b_v) = along, across
    value += a * b + slant * (a_d * b_d + 2.0 * slant * a_v * b_v)
    d[0] += a_d * b + 2.0 * slant * a_v * b_d
    d[1] += a * b_d + 2.0 * slant * a_d * b_v
    d[2] += a_v * b * m
    d[3] += (a_d * b_d + 4.0 * slant * a_v * b_v) * m
    d[4] += a * b_v * m


@lru_cache(maxsize=8)
def _arrow_lines(pad: Pad) -> tuple[float, float, float]:
    """Return the unit normal of the arrowhead's sides, along the arrow and across it, and the x of its base."""
    slant = math.hypot(pad.markings.arrow_half_base_m, pad.markings.arrow_depth_m)
    base = pad.markings.arrow_tip_m - pad.markings.arrow_depth_m
    if math.hypot(base, pad.markings.arrow_half_base_m) <= pad.markings.ring_outer_m:
        # The ring hides the base, and a blurred base would reduce the part beyond the ring. The base is cut where the ring covers
        # it all.
        base = 0.5 * pad.markings.arrow_tip_m
    return pad.markings.arrow_half_base_m / slant, pad.markings.arrow_depth_m / slant, base


@lru_cache(maxsize=8)
def _h_halves(pad: Pad) -> F32:
    """Return (4, 1): half lengths of legs and bar along the arrow, half widths of the H and of the gap between its legs."""
    half_w = pad.markings.h_width_m / 2
    return np.array(
        [pad.markings.h_length_m / 2, pad.markings.bar_width_m / 2, half_w, half_w - pad.markings.leg_width_m], np.float32
    )[:, None]


@lru_cache(maxsize=8)
def _strips(pad: Pad, n: int = 6) -> tuple[F32, F32, F32]:
    """Return the strips of the arrowhead beyond the ring: (n + 1,) borders in y, and (n,) beginnings and ends in x."""
    slope = pad.markings.arrow_half_base_m / pad.markings.arrow_depth_m
    base = pad.markings.arrow_tip_m - pad.markings.arrow_depth_m

    def extent(y: F64) -> tuple[F64, F64]:
        end = pad.markings.arrow_tip_m - np.abs(y) / slope
        return np.maximum(base, np.sqrt(np.maximum(pad.markings.ring_outer_m**2 - y * y, 0.0))), end

    fine = np.linspace(0.0, pad.markings.arrow_half_base_m, 1001)
    begin, end = extent(fine)
    half = float(fine[np.nonzero(end > begin)[0][-1]])
    borders = np.linspace(-half, half, n + 1)
    inner = borders[:-1, None] + (np.arange(20) + 0.5) / 20 * (borders[1] - borders[0])
    begin, end = extent(inner)
    return borders.astype(np.float32), begin.mean(axis=1).astype(np.float32), end.mean(axis=1).astype(np.float32)
