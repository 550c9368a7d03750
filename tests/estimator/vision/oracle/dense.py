"""Dense registration of a small image of the pad: every pixel is fitted with the whole drawing and all paints at once.

It serves a distant pad, whose edges are so close that they merge in the blur. On a reduced frame it also brings a rough start for
a nearer pad to within a pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from estimator.vision.srgb import light_table
from tests.estimator.vision.oracle.blurred import Blurred
from tests.estimator.vision.oracle.glare import CLIPPED, GlareBlob, find
from tests.estimator.vision.oracle.state import N_STATE, U8, Footprint, RegistrationState

_DARK = 0.01
"""Light at which a sensor's noise in the dark, read-out and rounding, equals the noise of the light: the variance is proportional
to light plus this. Pixel values with uniform noise give about the same, by the tone curve's slope. Only pixels brighter than a
tenth of the brightest set the scale, because darker ones are clipped at zero and look quieter than they are.
"""
_GLARE_DOUBTED = 5e-4
"""Initial residual variance of light over light above which a reflection is searched for."""
TUKEY = 4.7
"""Cut-off in standard deviations: 95 % efficient under Gaussian noise. Source: Holland & Welsch 1977."""


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """The pixels to fit."""

    rays: F64
    """Rays of the pixels, (N, 2)."""
    light: F64
    """Smoothed linear light, (3, N) BGR."""
    grid: tuple[int, int]
    """Rows and columns of the grid that the pixels were taken from."""
    reduced: int
    """Side of a pixel in pixels of the full frame."""
    slope: F64
    """Position in the patch, (2, N), -1..1: light may change linearly across it."""
    at: NDArray[np.intp]
    """Indices of the pixels in the grid, (N,). Those far outside the disc are left out."""


@dataclass(frozen=True, slots=True, eq=False)
class DenseFit:
    """One linearisation."""

    H: F64
    """Information matrix with the paints eliminated, (9, 9)."""
    g: F64
    """Gradient, (9,)."""
    paints: F64
    """Light of the paints, (K, 3) BGR: surroundings, slope in u and v, then contrasts of disc, ring, H (and rim)."""
    cov_paints: F64
    """Variances of the paints, (K, 3); nan before the last linearisation."""
    model: F64
    """Light that pose and paints explain, (3, N)."""
    steep2: F64
    """Squared change of that light over one pixel across the steepest edge, (3, N)."""
    noise: float
    """Robust variance of light over light (and `_DARK`)."""
    noise_on_pad: float
    """The same of the pixels that show the pad alone."""
    weight: F64
    """Robust weight, (3, N), 0..1."""
    scores: F64
    """Summands of the gradient, (9, N)."""
    meat: F64
    """Covariance of the gradient from the residuals, (9, 9)."""
    pull: F64
    """Effect on the gradient of a sector of the drawing that lies a pixel outward, and around the centre, (9, 16)."""
    place: F64
    """What the residuals say of the sectors' places, and the information on them, (2, 16)."""
    values: F64
    """Regressor of each paint coefficient, (K, N)."""
    reflection: GlareBlob | None
    """A reflection of the sun, if the residuals indicate one."""
    glare: F64
    """Light that the reflection adds, (3, N)."""


def patch(
    px: U8, camera: Camera, pad: Pad, state: RegistrationState, margin_px: float, max_pixels: int, gamma: bool, exact: bool
) -> tuple[Patch, RegistrationState] | None:
    """Cut out the part of the frame that holds the pad, reduced by a whole factor to about `max_pixels`.

    Args:
        margin_px: margin around the disc, in pixels of the reduced frame.
        exact: average linear light; otherwise average pixel values, which is faster.

    Returns:
        The pixels, and the state with the blur in their units; None if too little of the pad is in view.
    """
    rim = pad.circle(pad.disc_radius_m, 24) @ state.R.T + state.t
    front = rim[:, 2] > 0.02
    h, w = px.shape[:2]
    if not front.any():
        return None
    k = 1
    for _ in range(2):
        if front.all():
            uv = camera.project(rim)
            low, high = uv.min(axis=0) - margin_px * k, uv.max(axis=0) + margin_px * k
            x0, y0 = max(0, math.floor(low[0])), max(0, math.floor(low[1]))
            x1, y1 = min(w, math.ceil(high[0]) + 1), min(h, math.ceil(high[1]) + 1)
        else:
            x0, y0, x1, y1 = 0, 0, w, h
        if x1 - x0 < 4 or y1 - y0 < 4:
            return None
        k = max(1, math.ceil(math.sqrt((x1 - x0) * (y1 - y0) / max_pixels)))
        if k == 1:
            break
    cols, rows = (x1 - x0) // k, (y1 - y0) // k
    if cols < 4 or rows < 4:
        return None
    cut = px[y0 : y0 + rows * k, x0 : x0 + cols * k]
    table = light_table(gamma)
    if k > 1 and not exact:
        cut = np.asarray(cv2.resize(cut, (cols, rows), interpolation=cv2.INTER_AREA), np.uint8)
    bright = cv2.LUT(cut, table)
    if k > 1 and exact:
        bright = cv2.resize(bright, (cols, rows), interpolation=cv2.INTER_AREA)
    light = smooth(bright).reshape(-1, 3)
    j, i = np.mgrid[1 : rows - 1, 1 : cols - 1].reshape(2, -1)
    uv = np.stack([x0 + k * i + 0.5 * (k - 1), y0 + k * j + 0.5 * (k - 1)], axis=1)
    rays = camera.rays(uv) if camera.distorted else (uv - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    coarse = state.reduced(k, SMOOTHING_PX2)
    places = coarse.footprint(rays, pad).places
    reach = pad.disc_radius_m + margin_px * coarse.m_per_px
    near = np.nonzero(places.x**2 + places.y**2 < reach**2)[0]
    if len(near) < 24:
        return None
    i, j = i[near], j[near]
    at = j * cols + i
    slope = np.stack([2.0 * i / (cols - 1) - 1.0, 2.0 * j / (rows - 1) - 1.0])
    return Patch(rays[near], np.ascontiguousarray(light[at].T), (rows, cols), k, slope, at), coarse


def median(a: F64) -> float:
    """Return the upper median, with a fraction of numpy's overhead on small arrays."""
    k = len(a) // 2
    return float(np.partition(a, k)[k])


def smooth(image: NDArray[Any]) -> F64:
    """Filter (H, W, C) with (1, 2, 1) / 4 in both directions: the variance is half a pixel squared.

    After this filter the remaining fine detail resembles a Gaussian blur for any lens, pixel and colour filter interpolation.
    Without it their true shape, which is unknown, biases thin strokes.
    """
    kernel = np.array([0.25, 0.5, 0.25])
    return np.asarray(cv2.sepFilter2D(image, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT_101), dtype=float)


SMOOTHING_PX2 = 0.5
NOISE_LEFT = (0.25**2 + 0.5**2 + 0.25**2) ** 2
"""Fraction of independent noise's variance that remains after smoothing."""


def basis(fp: Footprint, cut: Patch) -> tuple[F64, F64]:
    """Return the (K, N) regressors of the paint coefficients, and the (K - 3, 5, N) derivatives by the pose of those with any."""
    b = fp.places
    pad = b.pad
    if pad.markings.rim_width_m:
        (disc, d_disc), (field, d_field), outer, inner = b.circles(
            pad.disc_radius_m, pad.markings.field_radius_m, pad.markings.ring_outer_m, pad.markings.ring_inner_m
        )
    else:
        (field, d_field), outer, inner = b.circles(pad.disc_radius_m, pad.markings.ring_outer_m, pad.markings.ring_inner_m)
    arrow, d_arrow = b.arrow_small()
    white, d_white = b.h()
    values = [1.0, *cut.slope, field, outer[0] - inner[0] + arrow, white]
    changes = [d_field, outer[1] - inner[1] + d_arrow, d_white]
    if pad.markings.rim_width_m:
        values.append(disc - field)
        changes.append(d_disc - d_field)
    out = np.empty((len(values), len(field)))
    for row, value in zip(out, values, strict=True):
        row[:] = value
    return out, np.stack(changes)


def fit(
    state: RegistrationState, cut: Patch, pad: Pad, last: DenseFit | None, edge_sigma_px: float, final: bool = False
) -> DenseFit:
    """Compute one linearisation.

    Args:
        last: the previous linearisation; its light and gradients set the scale of the residuals. None gives full weight.
        edge_sigma_px: standard deviation of the model's prediction of an edge's place in the frame.
        final: also compute `DenseFit.meat`.
    """
    fp = state.footprint(cut.rays, pad)
    painted, changes = basis(fp, cut)
    K, n = painted.shape
    y = cut.light
    light = y if last is None else last.model
    judged = light > 0.1 * float(light.max())
    judged[judged.sum(axis=1) < 3 * K] = True
    level = np.maximum(light, 0.0) + _DARK
    unsharp = np.zeros((3, n)) if last is None else edge_sigma_px**2 * last.steep2
    var = level if last is None else last.noise * level + unsharp
    w = 1.0 / var
    weight = np.ones((3, n))
    values, sound, reflection = painted, weight, None if last is None else last.reflection
    if last is None:
        _, a = _paints(painted, w, y)
        r = y - a @ painted
        if float((w * r * r).mean()) > _GLARE_DOUBTED:
            reflection = find(fp.places.x, fp.places.y, r, w, painted, pad)
    if reflection is not None:
        values = np.concatenate([painted, reflection.columns(fp.places.x, fp.places.y)])
        sound = (y < CLIPPED).astype(float)
        w = w * sound
        measured = judged & (y < CLIPPED)
        judged = np.where(measured.sum(axis=1, keepdims=True) < 3 * K, judged, measured)
    for round_ in range(2):
        M, a = _paints(values, w, y)
        model = a @ values
        r = y - model
        r2 = r * r
        if last is None or round_ == 1:
            break
        noise = np.array([max(median(x) / 0.4549, 1e-7) for x in _each((r2 - unsharp) / level, judged)])
        var = noise[:, None] * level + unsharp
        u = np.maximum(1.0 - r2 / (TUKEY**2 * var), 0.0)
        weight = u * u * sound
        w = weight / var
    inside = weight > 0.0
    count = inside.sum(axis=1)
    spent = count / np.maximum(1, count - len(values) - 3)
    kept = inside & judged
    chi2 = np.where(kept, r2 / var, 0.0).sum(axis=1) / np.maximum(kept.sum(axis=1), 1)
    scale = np.where(kept.any(axis=1), np.maximum(chi2 * spent, 1e-7), 1.0)
    change = (a[:, 3:K].astype(np.float32) @ changes.reshape(K - 3, 5 * n)).reshape(3, 5, n).transpose(1, 0, 2)
    steep2 = (change[0] ** 2 + change[1] ** 2).astype(float) * state.m_per_px**2
    J = fp.jacobian(change).astype(float)
    w = w / scale[:, None]
    Jw = J * w
    M = M / scale[:, None, None]
    C = Jw.transpose(1, 0, 2) @ values.T
    out = np.linalg.solve(M, C.transpose(0, 2, 1))
    H = Jw.reshape(N_STATE, -1) @ J.reshape(N_STATE, -1).T - (C @ out).sum(axis=0)
    scores = (Jw * r).sum(axis=1)
    cov, meat = np.full((K, 3), np.nan), np.zeros((N_STATE, N_STATE))
    pull, place = np.zeros((N_STATE, 16)), np.zeros((2, 16))
    if final:
        x, at_y = fp.places.x, fp.places.y
        px_m = state.m_per_px / np.maximum(np.hypot(x, at_y), 1e-3)
        sector = 4 * (at_y < 0) + 2 * (x < 0) + (np.abs(at_y) > np.abs(x))
        cov = np.linalg.inv(M).diagonal(axis1=1, axis2=2).T[:K]
        # The weights have a fixed shape, so that a wrong start cannot adapt them to itself; the covariance uses the actual noise.
        fractions = _fractions(painted)
        seen = np.array([_noise_of_paints(r[c], fractions, inside[c], float(spent[c])) for c in range(3)])
        u = r / np.sqrt(seen)
        shared = _correlation_of_channels(u, fractions, inside.all(axis=0))
        common = np.zeros((N_STATE, n))
        for c in range(3):
            projected = Jw[:, c] - out[c].T @ (values * w[c])
            for k, move in enumerate((px_m * (x * J[0, c] + at_y * J[1, c]), px_m * (x * J[1, c] - at_y * J[0, c]))):
                for of in range(8):
                    there = sector == of
                    pull[:, 2 * of + k] += projected[:, there] @ move[there]
                    place[:, 2 * of + k] += (w[c] * r[c] * move)[there].sum(), (w[c] * move * move)[there].sum()
            alone = _shared_back(cut, projected, 1)
            meat += (alone * (seen[c] * (1.0 - shared) / NOISE_LEFT)) @ alone.T
            common += alone * np.sqrt(seen[c] * shared)
        times = _grain(cut, np.where(inside, u, 0.0), shared)
        for k in range(times // 4 + times % 4):
            common = _shared_back(cut, common, 2 if k < times // 4 else 1)
        kernel = np.array([1.0])
        for _ in range(2 * (1 + times)):
            kernel = np.convolve(kernel, [0.5, 0.5])
        meat += common @ common.T / float(kernel @ kernel) ** 2
        # Paints and pose follow what is coarse in the noise: they take more of it than their share.
        taken = len(values) + 3
        ratio = max(1.0, float(np.mean(np.diag(meat) / np.maximum(np.diag(H), 1e-300))))
        meat *= max(n - taken, 0.3 * n) / max(n - ratio * taken, 0.3 * n)
    left = np.mean([median(x) for x in _each(r2 / level, judged)]) / 0.4549
    # What lies around the pad says nothing of what lies on it.
    covered = judged & (painted[3] + (painted[6] if K > 6 else 0.0) > 0.98)
    covered = np.where(covered.sum(axis=1, keepdims=True) < 64, judged, covered)
    on_pad = np.mean([median(x) for x in _each(r2 / level, covered)]) / 0.4549
    return DenseFit(
        H, scores.sum(axis=1), a.T[:K], cov, model, steep2, max(float(left), 1e-7), float(on_pad), weight,
        scores, meat, pull, place, painted,
        None if reflection is None else reflection.moved(a[:, K:].sum(axis=0), pad), a[:, K:] @ values[K:],
    )  # fmt: skip


def _paints(values: F64, w: F64, y: F64) -> tuple[F64, F64]:
    """Return the (3, K, K) normal matrices and the (3, K) solutions of each channel's weighted least squares."""
    K, n = values.shape
    vw = values * w[:, None]
    M = vw @ values.T + 1e-7 * n * np.eye(K) * w.mean(axis=1)[:, None, None]
    return M, np.linalg.solve(M, vw @ y[:, :, None])[:, :, 0]


def _each(rows: F64, of: NDArray[np.bool_]) -> list[F64]:
    """Return the chosen values of each row."""
    return [row[chosen] for row, chosen in zip(rows, of, strict=True)]


def _fractions(values: F64) -> F64:
    """Return the (5, N) fraction of each pixel that surroundings, disc, orange, white and rim cover."""
    paints = np.clip(values[3:], 0.0, 1.0)
    disc, orange, white = paints[:3]
    rim = paints[3] if len(paints) > 3 else np.zeros_like(disc)
    return np.maximum(np.stack([1.0 - disc - rim, disc - orange - white, orange, white, rim]), 0.0)


def _by_paint(fractions: F64, of: F64, inside: NDArray[np.bool_]) -> F64:
    """Return the (N,) mean over a pixel's paints of the paints' means; a paint that is hardly in view takes the mean of all."""
    total, sums = fractions @ inside, fractions @ np.where(inside, of, 0.0)
    mean = np.where(total > 4.0, sums / np.maximum(total, 1.0), sums.sum() / max(1.0, float(total.sum())))
    return np.asarray(mean @ fractions)


def _noise_of_paints(r: F64, fractions: F64, inside: NDArray[np.bool_], grow: float) -> F64:
    """Return the (N,) variance of light, from residuals: each paint has its own, and a pixel the mean over its paints.

    Args:
        grow: factor for the degrees of freedom that the fit has removed from the residuals.
    """
    return np.maximum(_by_paint(fractions, r * r * grow, inside), 1e-10)


def _correlation_of_channels(u: F64, fractions: F64, inside: NDArray[np.bool_]) -> F64:
    """Return the (N,) correlation of the channels' normalised residuals (3, N), 0 to 1."""
    products = (u.sum(axis=0) ** 2 - (u * u).sum(axis=0)) / 6.0
    return np.clip(_by_paint(fractions, products, inside), 0.0, 1.0)


def _shared_back(cut: Patch, rows: F64, step: int) -> F64:
    """Return the (K, N) sums over neighbours `step` apart, by (1, 2, 1) / 4 in both directions.

    Smoothing shares noise between neighbours; its transpose, which is itself, maps the sums back to pixels.
    """
    grid = np.zeros((len(rows), cut.grid[0] * cut.grid[1]))
    grid[:, cut.at] = rows
    wide = np.pad(grid.reshape(len(rows), *cut.grid), ((0, 0), (step, step), (step, step)))
    h, w = cut.grid
    out = np.zeros((len(rows), h, w))
    for dy, by in ((0, 0.25), (1, 0.5), (2, 0.25)):
        for dx, bx in ((0, 0.25), (1, 0.5), (2, 0.25)):
            out += by * bx * wide[:, dy * step : dy * step + h, dx * step : dx * step + w]
    return np.asarray(out.reshape(len(rows), -1)[:, cut.at])


def _grain(cut: Patch, u: F64, shared: F64) -> int:
    """Return how often what all channels see has been smoothed before the patch is.

    Of n smoothings in all, (1, 2, 1) / 4, the correlation over two pixels is (2n - 1) / (2n + 2) of that over one.
    """
    if float(shared.mean()) < 0.05:
        return 0
    sums = np.zeros(2)
    for sign, row in ((1.0, u.sum(axis=0)), *((-1.0, x) for x in u)):
        grid = np.zeros(cut.grid[0] * cut.grid[1])
        grid[cut.at] = row
        g = grid.reshape(cut.grid)
        for k in (1, 2):
            sums[k - 1] += sign * float((g[:, k:] * g[:, :-k]).sum() + (g[k:] * g[:-k]).sum())
    if sums[0] <= 0.0:
        return 0
    ratio = min(sums[1] / sums[0], 0.95)
    return int(np.clip((2.0 * ratio + 1.0) / (2.0 * (1.0 - ratio)) - 0.5, 0.0, 8.0))


def arrow_amplitudes(state: RegistrationState, cut: Patch, pad: Pad, fit: DenseFit) -> tuple[float, float, float] | None:
    """Return the amplitude of the arrowhead at its place, at the opposite place, and the sigma of either; 1 is a whole arrowhead.

    Return None if the ring's paint does not differ from the disc's, or if no arrowhead would be in view.
    """
    contrast = fit.paints[4]
    mix = contrast / (np.maximum(fit.paints[[0, 3]].sum(axis=0), 0.0) + 0.02)
    size = float(mix @ contrast)
    if size < 1e-4:
        return None
    mix = mix / size
    y = mix @ (cut.light - fit.glare)
    b = state.footprint(cut.rays, pad).places
    here = b.arrow_small()[0]
    there = Blurred(pad, -b.x, -b.y, b.blur_m2, b.scale2).arrow_small()[0]
    field, ring = fit.values[3], fit.values[4] - here
    # Beyond the ring the H has no effect; the surroundings do.
    r = np.hypot(b.x, b.y)
    w = ((r > pad.markings.ring_inner_m) & (field > 0.98)).astype(float)
    if float(w @ here) < 0.1 and float(w @ there) < 0.1:
        return None
    columns = np.stack([np.ones_like(ring), ring, here, there])
    M = (columns * w) @ columns.T + 1e-6 * np.eye(4)
    a = np.linalg.solve(M, (columns * w) @ y)
    residual = (y - a @ columns)[w > 0]
    var = float(residual @ residual) / max(1, len(residual) - 4)
    inverse = np.linalg.inv(M)
    return float(a[2]), float(a[3]), math.sqrt(var * float(max(inverse[2, 2], inverse[3, 3])))
