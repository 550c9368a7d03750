"""Find right-angled corners at sub-pixel precision, with the directions of their arms.

Around a corner a small circle crosses between paint and ground twice, with the crossings a right angle apart. With a quarter of
the circle on paint the corner is a tip; with three quarters it is an inner corner. The crossings on circles of several radii lie
on the two arms; lines fitted to them meet in the corner. This needs no neighbourhood averages, which depend on the range, and no
rounding or drawing into the frame that is measured.
"""

import math

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.thesis.segmentation import F32, U8

_RADII = 7  # Circles about a corner
_MIN_RADIUS_PX = 1.6  # Smallest radius of a circle, px; closer in, blur rounds the corner


class RightAngle(Struct, frozen=True, eq=False):
    """A corner, in the coordinates of the channel it was found in."""

    uv_px: F64
    """Position, (2,) px."""
    arms: F64
    """Unit vectors from the corner along its edges, (2, 2). The second follows the first by about 90 degrees; between them lies
    the smaller side: paint for a tip, ground for an inner corner.
    """
    inner: bool
    """True if three quarters of its surroundings are paint."""
    sigma_px: float
    """One standard deviation of `uv_px` in each axis."""


def candidates(coverage: F32, where: U8, stroke_px: float) -> F64:
    """Return (N, 2) px of the peaks of the Harris response, good to a few pixels, strongest first; N <= 40.

    Args:
        coverage: (h, w) coverage by paint.
        where: (h, w) mask of the search area.
        stroke_px: width of the strokes that form the corners; the search runs at a scale where it is about 8 px.
    """
    k = max(1, int(stroke_px / 8.0))
    h, w = coverage.shape
    grey = np.clip(coverage * 255.0, 0.0, 255.0).astype(np.uint8)
    if k > 1:
        grey = np.asarray(cv2.resize(grey, (max(8, w // k), max(8, h // k)), interpolation=cv2.INTER_AREA), np.uint8)
    fu, fv = w / grey.shape[1], h / grey.shape[0]
    smooth = cv2.GaussianBlur(grey, (5, 5), 1.0)
    response = cv2.cornerHarris(smooth, 3, 3, 0.04, borderType=cv2.BORDER_REPLICATE)
    reach = 2 * max(1, round(0.3 * stroke_px / k)) + 1
    peak = (response == cv2.dilate(response, np.ones((reach, reach), np.uint8))) & (response > 0.02 * response.max(initial=0.0))
    small = cv2.resize(where, (grey.shape[1], grey.shape[0]), interpolation=cv2.INTER_NEAREST)
    peak &= small > 0
    v, u = np.nonzero(peak)
    order = np.argsort(-response[v, u])[:40]
    return np.stack([(u[order] + 0.5) * fu - 0.5, (v[order] + 0.5) * fv - 0.5], axis=1)


def refine(coverage: F32, uv_px: F64, reach_px: float, paint: F64 | None = None, settled: bool = False) -> list[RightAngle]:
    """Return the right-angled corners among the candidates, each once.

    Args:
        coverage: (h, w) coverage by paint: 0 is ground, 1 is paint.
        uv_px: (N, 2) candidates, off by up to half of `reach_px`.
        reach_px: radius within which only a corner's two arms show.
        settled: the candidates are corners already, off by a fraction of a pixel.
        paint: (N,) coverage that counts as full at each candidate, 1 by default; the edge is at half of it.
    """
    if len(uv_px) == 0 or reach_px < _MIN_RADIUS_PX + 0.8:
        return []
    at = np.asarray(uv_px, dtype=float)
    level = 0.5 * (np.ones(len(at)) if paint is None else paint)
    radii = np.linspace(max(_MIN_RADIUS_PX, 0.3 * reach_px), reach_px, _RADII)
    if not settled:
        # From an inexact start, only the outer circles certainly enclose the corner.
        uv, _, _, _, ok = _fit(coverage, at, np.linspace(0.5 * reach_px, reach_px, 4), level)
        at, level = uv[ok], level[ok]
        if len(at) == 0:
            return []
    uv, arms, inner, sigma, ok = _fit(coverage, at, radii, level)
    out: list[RightAngle] = []
    fitted = np.flatnonzero(ok)
    for i in fitted[np.argsort(sigma[fitted])]:
        if all(math.dist(uv[i], corner.uv_px) > 0.5 * reach_px for corner in out):
            out.append(RightAngle(uv[i], arms[i], bool(inner[i]), float(sigma[i])))
    return out


def _fit(coverage: F32, at: F64, radii: F64, level: F64) -> tuple[F64, F64, NDArray[np.bool_], F64, NDArray[np.bool_]]:
    """Fit a line to each arm from the two crossings of circles about (N, 2) points, and return the lines' intersections.

    They are the four fields of `RightAngle`, with N rows each, and a mask of those that are right angles.
    """
    n, m = len(at), len(radii)
    # Steps are 0.7 px at most; otherwise an edge fits between two samples and its crossing is off.
    count_a = int(np.clip(math.ceil(math.tau * radii[-1] / 0.7), 48, 256))
    angle = np.arange(count_a) * (math.tau / count_a)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    pts = at[:, None, None, :] + radii[None, :, None, None] * ring[None, None, :, :]
    flat = pts.reshape(n * m, count_a, 2).astype(np.float32)
    value = cv2.remap(
        coverage, flat[:, :, 0], flat[:, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=-100.0
    )
    v = np.asarray(value, float).reshape(n, m, count_a)
    inside = v.min(axis=2) > -10.0
    half = level[:, None]
    bright = v >= half[:, :, None]
    after = np.roll(v, -1, axis=2)
    rising = ~bright & np.roll(bright, -1, axis=2)
    falling = bright & ~np.roll(bright, -1, axis=2)
    clean = inside & (rising.sum(axis=2) == 1) & (falling.sum(axis=2) == 1)

    def crossing(edge: NDArray[np.bool_]) -> F64:
        k = np.argmax(edge, axis=2)
        a, b = np.take_along_axis(v, k[:, :, None], 2)[:, :, 0], np.take_along_axis(after, k[:, :, None], 2)[:, :, 0]
        part = (half - a) / np.where(np.abs(b - a) > 1e-6, b - a, 1.0)
        return np.asarray((k + np.clip(part, 0.0, 1.0)) * (math.tau / count_a))

    def arm(angle: F64) -> tuple[F64, F64, F64]:
        return _lines(at[:, None, :] + radii[None, :, None] * np.stack([np.cos(angle), np.sin(angle)], axis=2), good, at)

    rise, fall = crossing(rising), crossing(falling)
    paint = np.mod(fall - rise, math.tau) / math.tau
    good = clean & (np.abs(np.abs(paint - 0.5) - 0.25) < 0.16)
    count = good.sum(axis=1)
    paint_fraction = np.sum(np.where(good, paint, 0.0), axis=1) / np.maximum(count, 1)
    inner = paint_fraction > 0.5
    (c1, d1, e1), (c2, d2, e2) = arm(rise), arm(fall)
    cross = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    gap = c2 - c1
    safe = np.where(np.abs(cross) > 0.3, cross, 1.0)
    t = (gap[:, 0] * d2[:, 1] - gap[:, 1] * d2[:, 0]) / safe
    uv = c1 + t[:, None] * d1
    # In frame axes (v down) angles grow clockwise; the smaller side lies clockwise of a tip's rise, of an inner corner's fall.
    arms = np.where(inner[:, None, None], np.stack([d2, d1], axis=1), np.stack([d1, d2], axis=1))
    rms = np.sqrt(0.5 * (e1**2 + e2**2))
    # Extrapolating a line of m points at radii r to radius 0 multiplies their error by sqrt(1/m + mean^2/sum of squares).
    lever = math.sqrt(1.0 / m + float(np.mean(radii) ** 2 / np.sum((radii - np.mean(radii)) ** 2)))
    sigma = np.maximum(rms, 0.03) * lever
    shifted = np.linalg.norm(uv - at, axis=1)
    ok = (count >= m - m // 3) & (np.abs(cross) > 0.75) & (rms < 0.06 * radii[-1] + 0.2) & (shifted < 0.8 * radii[-1])
    return uv, arms, inner, sigma, ok


def _lines(pts: F64, good: NDArray[np.bool_], origin: F64) -> tuple[F64, F64, F64]:
    """Fit total-least-squares lines to those of (N, M, 2) points that are good.

    Return a point (N, 2), a direction away from `origin` (N, 2), and the rms (N,).
    """
    weight = good.astype(float)
    total = np.maximum(weight.sum(axis=1), 1e-9)
    centre = np.einsum("nm,nmi->ni", weight, pts) / total[:, None]
    d = pts - centre[:, None, :]
    sxx = np.einsum("nm,nm->n", weight, d[:, :, 0] ** 2) / total
    syy = np.einsum("nm,nm->n", weight, d[:, :, 1] ** 2) / total
    sxy = np.einsum("nm,nm->n", weight, d[:, :, 0] * d[:, :, 1]) / total
    angle = 0.5 * np.arctan2(2.0 * sxy, sxx - syy)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    away = np.sum(direction * (centre - origin), axis=1)
    direction *= np.where(away < 0.0, -1.0, 1.0)[:, None]
    across = 0.5 * (sxx + syy) - np.hypot(0.5 * (sxx - syy), sxy)
    return centre, direction, np.sqrt(np.maximum(across, 0.0))
