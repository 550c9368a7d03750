"""The drawing as numbers: which paint covers which place, once around the centre by angle and once as maps at several blurs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.pad import Pad

F32 = NDArray[np.float32]

_NO_SECOND_MAP = np.empty(0, np.float32)

ANGLES = 48
_RADII = 18
_FINE = 4
"""Sub-samples a polar cell and axis: coverage to about 2 %."""
_STEP_M = 0.004
"""Between places of the maps: a quarter of the ring's width or so."""
BLURS_M = (0.005, 0.010, 0.020, 0.040, 0.080)
"""Standard deviations of the maps' blur; the middle of a frame element from 0.7 m to 40 m away."""
LOCAL_M = 0.06
"""Standard deviation of the neighbourhood that a place is compared with where the light is uneven: wider than the strokes,
narrower than glare and shadows."""
REACH = 1.22
"""How far the maps reach, in radii of the disc."""

H, ORANGE, DISC, AROUND = 0, 1, 2, 3
"""Order of the paints in maps and tables: the letter, ring and arrowhead, the disc, whatever lies around it."""


def disc_edge_m(pad: Pad) -> float:
    """Radius at which the disc's own paint ends: at the rim where there is one."""
    return pad.disc_radius_m - pad.rim_width_m


def paints_at(xy_m: F64, pad: Pad) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Masks of H, ring, arrowhead and disc (disjoint) at (N, 2) places on the pad, m."""
    x, y = xy_m[:, 0], xy_m[:, 1]
    r = np.hypot(x, y)
    half = pad.h_width_m / 2
    leg = (np.abs(y) <= half) & (np.abs(y) >= half - pad.leg_width_m) & (np.abs(x) <= pad.h_length_m / 2)
    bar = (np.abs(y) <= half) & (np.abs(x) <= pad.bar_width_m / 2)
    ring = (r >= pad.ring_inner_m) & (r <= pad.ring_outer_m)
    behind = pad.arrow_tip_m - x
    arrow = (behind >= 0) & (behind <= pad.arrow_depth_m) & (np.abs(y) * pad.arrow_depth_m <= behind * pad.arrow_half_base_m)
    h_marking = leg | bar
    arrow &= ~ring
    return h_marking, ring, arrow, (r <= disc_edge_m(pad)) & ~h_marking & ~ring & ~arrow


@dataclass(frozen=True, slots=True, eq=False)
class PolarDrawing:
    """Cells around the centre, (radii, angles), and their share of each paint; an arrow at angle 0."""

    xy_m: F64
    """(radii * angles, 2)."""
    area: F32
    """(radii, 1) of a cell, relative."""
    area_inside: F32
    """(radii, 1) the same within the disc's paint, 0 around it."""
    ring: F32
    """(radii, 1) share of ring."""
    turning: NDArray[np.complex64]
    """(2, radii, angles // 2 + 1): conjugate spectra of the shares of H and arrowhead."""


@lru_cache(maxsize=8)
def polar_drawing(pad: Pad) -> PolarDrawing:
    """See `PolarDrawing`; the outermost tenth of the radii lies around the disc."""
    outer = 1.12 * pad.disc_radius_m
    r = (np.arange(_RADII) + 0.5) / _RADII * outer
    a = np.arange(ANGLES) * math.tau / ANGLES

    def places(radii: F64, angles: F64) -> F64:
        rr, aa = np.meshgrid(radii, angles, indexing="ij")
        return np.stack([rr * np.cos(aa), rr * np.sin(aa)], axis=2).reshape(-1, 2)

    fine_r = (np.arange(_RADII * _FINE) + 0.5) / (_RADII * _FINE) * outer
    fine_a = (np.arange(ANGLES * _FINE) - (_FINE - 1) / 2) * math.tau / (ANGLES * _FINE)
    masks = paints_at(places(fine_r, fine_a), pad)
    h_marking, ring, arrow, disc = (m.reshape(_RADII, _FINE, ANGLES, _FINE).mean(axis=(1, 3)) for m in masks)
    spectra = np.conj(np.fft.rfft(np.stack([h_marking, arrow]), axis=2)).astype(np.complex64)
    inside = (h_marking + ring + arrow + disc).mean(axis=1, keepdims=True) > 0.5
    area = (r / r.mean()).astype(np.float32)[:, None]
    return PolarDrawing(
        places(r, a),
        area,
        area * inside,
        ring.mean(axis=1, keepdims=True).astype(np.float32),
        spectra,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Maps:
    """Share of each paint over the pad's plane, blurred, and its slope."""

    layers: F32
    """(n, n, 12) shares of H, orange, disc, around, their slopes along x (1/m) and those along y; row by x, column by y."""
    share: F32
    """(n, n, 4) the shares again, by themselves: a third of the memory to walk through where slopes are not wanted."""
    per_m: float
    centre: float
    """Index of the pad's centre, rows and columns alike."""


@lru_cache(maxsize=16)
def maps(pad: Pad, local: bool = False) -> tuple[Maps, ...]:
    """One `Maps` for each of `BLURS_M`; `local` ones hold shares less their mean in the neighbourhood (`LOCAL_M`)."""
    half = math.ceil(REACH * pad.disc_radius_m / _STEP_M)
    n = 2 * half + 1
    fine = (np.arange(3 * n) - (3 * n - 1) / 2) * _STEP_M / 3
    gx, gy = np.meshgrid(fine, fine, indexing="ij")
    h_marking, ring, arrow, disc = paints_at(np.stack([gx.ravel(), gy.ravel()], axis=1), pad)
    flat = np.stack([h_marking, ring | arrow, disc, ~(h_marking | ring | arrow | disc)], axis=1).astype(np.float32)
    sharp = flat.reshape(n, 3, n, 3, 4).mean(axis=(1, 3))
    out = []
    for blur_m in BLURS_M:
        share = _blurred(sharp, blur_m)
        if local:
            share = share - _blurred(share, LOCAL_M)
        layers = np.concatenate([share, *np.gradient(share, _STEP_M, axis=(0, 1))], axis=2).astype(np.float32)
        out.append(Maps(layers, share, 1.0 / _STEP_M, float(half)))
    return tuple(out)


def sampled(image: NDArray[Any], at: F32) -> NDArray[Any]:
    """The frame (h, w, c) at fractional places (n, m, 2), column first, bilinear; what lies outside continues the edge.

    A single row of places takes half the time of a single column.
    """
    return cv2.remap(image, at, _NO_SECOND_MAP, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _blurred(share: F32, sigma_m: float) -> F32:
    return np.asarray(cv2.GaussianBlur(share, (0, 0), sigma_m / _STEP_M, borderType=cv2.BORDER_REPLICATE), np.float32)
