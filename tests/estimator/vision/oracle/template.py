"""The drawing as maps of coverage and its gradients."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.vision.detect.template import BLURS_M, LOCAL_M, REACH, STEP_M, paints_at
from estimator.vision.pad import Pad

F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Maps:
    """Coverage by each paint over the pad's plane, blurred, and its gradient."""

    layers: F32
    """Coverage by H, orange, disc and surroundings, then its derivatives along x (1/m), then along y: (n, n, 12), row by x,
    column by y.
    """
    coverage: F32
    """The coverage alone, (n, n, 4): a third of the memory to read if no gradients are needed."""
    per_m: float
    centre: float
    """Index of the pad's centre, in rows and columns."""


@lru_cache(maxsize=16)
def maps(pad: Pad, local: bool = False) -> tuple[Maps, ...]:
    """Return one `Maps` for each of `BLURS_M`.

    With `local` they hold coverage minus its mean in the neighbourhood (`LOCAL_M`).
    """
    half = math.ceil(REACH * pad.disc_radius_m / STEP_M)
    n = 2 * half + 1
    fine = (np.arange(3 * n) - (3 * n - 1) / 2) * STEP_M / 3
    gx, gy = np.meshgrid(fine, fine, indexing="ij")
    h_marking, ring, arrow, disc = paints_at(np.stack([gx.ravel(), gy.ravel()], axis=1), pad)
    flat = np.stack([h_marking, ring | arrow, disc, ~(h_marking | ring | arrow | disc)], axis=1).astype(np.float32)
    sharp = flat.reshape(n, 3, n, 3, 4).mean(axis=(1, 3))
    out = []
    for blur_m in BLURS_M:
        coverage = _blurred(sharp, blur_m)
        if local:
            coverage = coverage - _blurred(coverage, LOCAL_M)
        layers = np.concatenate([coverage, *np.gradient(coverage, STEP_M, axis=(0, 1))], axis=2).astype(np.float32)
        out.append(Maps(layers, coverage, 1.0 / STEP_M, float(half)))
    return tuple(out)


def sampled(image: F32, at: F32) -> F32:
    """Sample an image (h, w, c) at fractional positions (n, 2), column first, bilinear; outside it the edge is repeated."""
    h, w = image.shape[:2]
    u, v = np.clip(at[:, 0], 0.0, w - 1.0), np.clip(at[:, 1], 0.0, h - 1.0)
    left, top = np.minimum(u.astype(int), w - 2), np.minimum(v.astype(int), h - 2)
    across, down = (u - left)[:, None], (v - top)[:, None]
    upper = image[top, left] * (1.0 - across) + image[top, left + 1] * across
    lower = image[top + 1, left] * (1.0 - across) + image[top + 1, left + 1] * across
    return np.asarray(upper * (1.0 - down) + lower * down, np.float32)


def _blurred(coverage: F32, sigma_m: float) -> F32:
    return np.asarray(cv2.GaussianBlur(coverage, (0, 0), sigma_m / STEP_M, borderType=cv2.BORDER_REPLICATE), np.float32)
