"""Align the whole drawing with the frame: estimate pose and paints together, by Gauss-Newton on the pixels (dense alignment).

The frame near the pad is modelled as a mixture of four paints (H, orange, disc, surroundings). The drawing gives the coverage of
each paint in every pixel. Light is additive, so for a given pose the paints follow by linear least squares under any
illumination. The pose then follows the model's gradient (Lucas and Kanade 1981, as compositional alignment with the drawing as
template, and with Cauchy weights against occlusion and glare). The result is near enough for edge-based registration to start,
and it holds the inputs of the confidence classifier.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera import Camera
from estimator.vision.detect.alignment import ArrowPlace
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.detect.template import BLURS_M, LOCAL_M, REACH
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.srgb import LINEAR_LIGHT
from tests.estimator.vision.oracle.arrow_support import arrow_places
from tests.estimator.vision.oracle.coverage import on_side, uncovered
from tests.estimator.vision.oracle.template import Maps, maps, sampled

U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]

_SAMPLES, _APPROACH_SAMPLES, _FINAL_SAMPLES = 700, 1000, 2600
"""Largest numbers of samples in the disc's bounding box: during a search, on the way to a registration, and for verification."""
_LOG_BLURS = np.log(np.array(BLURS_M))
_LEAST_SAMPLES = 40
_FEW = 350
"""Number of samples below which a step is so cheap that twice as many are made. From afar a start may be off by a fifth."""
_LEVELS = 5
_ARROW_SAMPLES = 5
"""Pixels of the chosen pyramid level along the arrowhead, if the frame has as many."""
_AT_REST = 0.12
"""Step, in samples, below which the pose is good enough to start a registration."""
_NOISE = 0.02
"""Residual, as a fraction of full scale, that the model leaves even where it is right (wear, noise, ripples)."""
_LENS_BLUR_PX = 0.7
_CHANCE = 4.0
"""Deviations of the noise's sum below which nothing is left to explain."""
_LEAST_AT_START, _LEAST_HALFWAY, _LEAST_AT_END = 0.10, 0.15, 0.40
"""Fractions of the variation about the pad that the drawing must explain at the start of a search, after half of the steps, and
at the end. Of 290 pads that were found 2 % had less than 0.12 at the start and 0.55 at the end; of 2200 false candidates 40 % and
65 %.
"""
_FAR_PX, _LEAST_FAR_AT_START, _LEAST_FAR_HALFWAY, _LEAST_FAR_AT_END = 16.0, 0.05, 0.12, 0.25
"""The same limits for a disc with a radius up to `_FAR_PX`, in pixels. An occluder can leave as little of it."""
_SOUND, _SPREAD, _SPREAD_SHARP = 0.25, 2.0, 1.6
"""Fraction of the samples that are certainly neither occluded nor overexposed, and the factors from their largest residual to a
usual one: while the pose moves, and at the final pose, where a sample that still does not fit shows something else.
"""


_LINEAR = LINEAR_LIGHT.astype(np.float32)
_ROOT = np.sqrt(_LINEAR)


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """The drawing as aligned with one frame."""

    pose: PadPose
    paints: F64
    """Linear light of H, orange, disc and surroundings, (4, 3), 0..1, in blue, green, red."""
    light: F32
    """Linear light of the samples, (n, 3)."""
    coverage: F32
    """Coverage of each sample by each paint, (n, 4)."""
    xy_m: F32
    """Positions of the samples on the pad, (n, 2) m."""
    weight: F32
    """Weights of the samples, (n,), 0..1: small where something occludes or outshines the drawing."""
    sample_m: float
    """Side of a sample on the pad, m."""
    in_view: float
    """Fraction of the disc's area inside the frame."""
    tilt_sigmas: float
    """Tilt of the pose relative to its start, in standard deviations of the prior."""
    local: Local
    arrow: tuple[ArrowPlace, ArrowPlace]
    """Support for the arrowhead at its place, and at the place where it would be with the drawing turned by 180 degrees."""
    noise: float
    """Standard deviation of the samples' noise beyond the usual, as a fraction of full scale."""
    contrast: float
    """Contrast of the frame: 1 if it is clear, less in haze."""


@dataclass(frozen=True, slots=True, eq=False)
class Local:
    """The square root of light minus its mean in each sample's neighbourhood, which removes glare and shadows."""

    paints: F64
    """Paints in this measure, (4, 3), known up to a value common to all four."""
    light: F32
    """Light of the samples in this measure, (n, 3)."""
    coverage: F32
    """Coverage of each sample by each paint minus its mean in the neighbourhood, (n, 4)."""
    weight: F32
    """Weights of the samples, (n,)."""


class _Samples(NamedTuple):
    rays: F32
    """Rays of the samples, (3, n)."""
    light: F32
    """Linear light, (3, n)."""
    local: F32
    """Square root of light minus its mean in the neighbourhood, (3, n)."""
    side_m: float


def align(
    pyramid: Pyramid,
    camera: Camera,
    pad: Pad,
    pose: PadPose,
    sigma_tilt_rad: float,
    steps: int = 4,
    *,
    local: bool = False,
    side: F64 | None = None,
) -> Aligned | None:
    """Align the drawing with the frame from a rough pose.

    Args:
        sigma_tilt_rad: standard deviation of the tilt of the start pose's normal.
        steps: number of Gauss-Newton steps; the first half uses a drawing blurred twice as much. With 0 the pose is unchanged.
        local: use the light minus its mean in the neighbourhood, against glare and shadows; the reach is a little shorter.
        side: (2,) unit direction in x and y of the pad: use only the half of the disc on this side, because the other is covered.

    Returns:
        The aligned template; None if too little of the pad is in view, or if the pose diverges.
    """
    tilt_sigmas = 0.0
    if steps > 0:
        moved = _move(pyramid, camera, pad, pose, sigma_tilt_rad, steps, local, _SAMPLES, side)
        if moved is None:
            return None
        pose, tilt_sigmas = moved
    samples = _gather(pyramid, camera, pad, pose, _FINAL_SAMPLES)
    if samples is None:
        return None
    R, t = pose.R_cam_pad.matrix, pose.t_cam_pad
    fit = _blur_of(samples, t, camera)
    model = _model(maps(pad)[fit], samples, samples.light, R, t, pad, slopes=False)
    if model is None:
        return None
    even = np.ones(model.light.shape[1], np.float32)
    paints, weight, _, _ = _paint(model.light, model.coverage, even, final=True)
    drawing = maps(pad, True)[fit]
    own_light, own_coverage = samples.local.take(model.used, axis=1), _sampled(drawing.coverage, drawing, model.xy)
    start = uncovered(own_light.T, own_coverage.T, model.xy.T)
    own_paints, own_weight, _, _ = _paint(own_light, own_coverage, start, final=True)
    noise, contrast, _ = pyramid.quality.tolist()
    level = min(_LEVELS, math.floor(math.log2(max(1.0, camera.fx * pad.markings.arrow_depth_m / (_ARROW_SAMPLES * t[2])))))
    arrow = arrow_places(pyramid[level], 1 << level, _ROOT, camera, pad, pose, own_paints.astype(float), noise)
    r2 = model.xy * model.xy
    inside = float(np.count_nonzero(r2[0] + r2[1] < pad.disc_radius_m**2)) * samples.side_m**2
    return Aligned(
        pose, paints.astype(float), model.light.T, model.coverage.T, model.xy.T, weight, samples.side_m,
        min(1.0, inside / (math.pi * pad.disc_radius_m**2 * abs(float(R[2, 2])))), tilt_sigmas,
        Local(own_paints.astype(float), own_light.T, own_coverage.T, own_weight), arrow,
        noise / _times_smaller(samples, t, camera), contrast,
    )  # fmt: skip


def approach(pyramid: Pyramid, camera: Camera, pad: Pad, pose: PadPose, sigma_tilt_rad: float, steps: int = 6) -> PadPose | None:
    """Return a pose that edge-based registration can start from, given a rough one.

    This is `align` without the inputs of the classifier.
    """
    moved = _move(pyramid, camera, pad, pose, sigma_tilt_rad, steps, False, _APPROACH_SAMPLES)
    return None if moved is None else moved[0]


def _move(
    pyramid: Pyramid,
    camera: Camera,
    pad: Pad,
    pose: PadPose,
    sigma_tilt_rad: float,
    steps: int,
    local: bool,
    most: int,
    side: F64 | None = None,
) -> tuple[PadPose, float] | None:
    """Return the pose after some steps, and its tilt away from the start in standard deviations."""
    samples = _gather(pyramid, camera, pad, pose, most)
    if samples is None:
        return None
    if side is not None:
        there = on_side(samples.rays, pose, side)
        rays, light, own = (s.take(there, axis=1) for s in (samples.rays, samples.light, samples.local))
        samples = _Samples(rays, light, own, samples.side_m)
    R, t = pose.R_cam_pad.matrix.copy(), pose.t_cam_pad.copy()
    depth = float(t[2])
    fit = _blur_of(samples, t, camera)
    softer = min(fit + 1, len(BLURS_M) - 1)
    tilt = np.zeros(2)
    n = samples.rays.shape[1]
    trust = np.ones(n, np.float32)
    noise = pyramid.noise / _times_smaller(samples, t, camera)
    if n < _FEW:
        steps *= 2
    far = camera.fx * pad.disc_radius_m < _FAR_PX * depth
    at_start, halfway, at_end = (
        (_LEAST_FAR_AT_START, _LEAST_FAR_HALFWAY, _LEAST_FAR_AT_END) if far else (_LEAST_AT_START, _LEAST_HALFWAY, _LEAST_AT_END)
    )
    least = {steps // 2: halfway, 0: at_start}
    for i in range(steps):
        drawing = maps(pad, local)[softer if i < steps // 2 else fit]
        model = _model(drawing, samples, samples.local if local else samples.light, R, t, pad)
        if model is None:
            return None
        paints, weight, residual, spread = _paint(model.light, model.coverage, trust[model.used])
        if local and i in least and _explained(model.light, residual, weight, noise) < least[i]:
            return None
        trust[model.used] = weight
        N, g = _normal(paints, weight, residual, spread, model)
        step = _solved(N, g, tilt, sigma_tilt_rad)
        step[:3] *= min(1.0, 0.12 * depth / max(1e-9, math.sqrt(float(step[:3] @ step[:3]))))
        step[3:] *= min(1.0, 0.25 / max(1e-9, math.sqrt(float(step[3:] @ step[3:]))))
        tilt += step[3:5]
        t = t + R @ step[:3]
        R = R @ cv2.Rodrigues(step[3:])[0]
        if not (t[2] > 0.02 and abs(math.log(t[2] / depth)) < 0.7 and R[2, 2] > 0.2):
            return None
        moved = (math.hypot(step[0], step[1]) + pad.disc_radius_m * (abs(step[2]) / depth + abs(step[5]))) / samples.side_m
        if i >= steps // 2 and moved < _AT_REST:
            break
    if local and model is not None and _explained(model.light, residual, weight, noise) < at_end:
        return None
    return PadPose(Rotation(R @ (1.5 * np.eye(3) - 0.5 * R.T @ R)), t), math.hypot(tilt[0], tilt[1]) / sigma_tilt_rad


def _times_smaller(samples: _Samples, t: F64, camera: Camera) -> float:
    """Return the factor by which the samples' level of the pyramid is smaller than the frame."""
    return samples.side_m * camera.fx / float(t[2])


def _blur_of(samples: _Samples, t: F64, camera: Camera) -> int:
    """Return the index of the drawing's blur that is nearest to that of the samples."""
    blur = math.hypot(0.29 * samples.side_m, _LENS_BLUR_PX * float(t[2]) / camera.fx)
    return int(np.abs(_LOG_BLURS - math.log(blur)).argmin())


@lru_cache(maxsize=8)
def _box(pad: Pad) -> F64:
    """Return (24, 3) m: a circle that encloses all samples."""
    return pad.circle(1.15 * pad.disc_radius_m, 24)


@lru_cache(maxsize=4)
def _grids(camera: Camera, sizes: tuple[tuple[int, int], ...]) -> tuple[F32, ...]:
    """Return the grid of every pyramid level; all at once, so that no frame in flight waits for one or takes memory for it.

    Args:
        sizes: columns and rows of each level.
    """
    return tuple(_grid(camera, 1 << level, width, height) for level, (width, height) in enumerate(sizes))


def _grid(camera: Camera, k: int, width: int, height: int) -> F32:
    """Return (3, height, width): x/z, y/z and 1 at the pixel centres of a frame `k` times smaller."""
    u, v = np.meshgrid((np.arange(width) + 0.5) * k - 0.5, (np.arange(height) + 0.5) * k - 0.5)
    rays = camera.rays(np.stack([u.ravel(), v.ravel()], axis=1)).T.reshape(2, height, width)
    return np.concatenate([rays, np.ones((1, height, width))]).astype(np.float32)


def _gather(pyramid: Pyramid, camera: Camera, pad: Pad, pose: PadPose, most: int) -> _Samples | None:
    """Sample the pixels about the disc from the pyramid level that has a suitable number of them there."""
    if pose.t_cam_pad[2] < 0.02:
        return None
    edge = pose.points(_box(pad))
    x0, y0, x1, y1 = 0.0, 0.0, float(camera.width), float(camera.height)
    if not float(edge[:, 2].min()) < 0.05:
        uv = camera.project(edge)
        (low_u, low_v), (high_u, high_v) = uv.min(axis=0).tolist(), uv.max(axis=0).tolist()
        x0, y0, x1, y1 = max(x0, low_u), max(y0, low_v), min(x1, high_u + 1.0), min(y1, high_v + 1.0)
    if x1 - x0 < 3.0 or y1 - y0 < 3.0:
        return None
    level = min(_LEVELS, max(0, math.ceil(0.5 * math.log2((x1 - x0) * (y1 - y0) / most))))
    k = 1 << level
    width, height = pyramid.size(level)
    left, top, right, below = (
        math.floor(x0 / k),
        math.floor(y0 / k),
        min(math.ceil(x1 / k), width),
        min(math.ceil(y1 / k), height),
    )
    if right - left < 3 or below - top < 3:
        return None
    patch = pyramid.cut(level, left, top, right, below)
    side = float(k * pose.t_cam_pad[2] / camera.fx)
    root = cv2.LUT(patch, _ROOT)
    local = root - cv2.GaussianBlur(root, (0, 0), LOCAL_M / side, borderType=cv2.BORDER_REPLICATE)
    rays = _grids(camera, tuple(pyramid.size(k) for k in range(_LEVELS + 1)))[level][:, top:below, left:right].reshape(3, -1)
    return _Samples(rays, _channels(cv2.LUT(patch, _LINEAR)), _channels(local), side)


def _channels(image: NDArray[Any]) -> F32:
    """Reshape (h, w, c) to (c, h * w): with the channels outermost numpy's inner loops are long."""
    return np.ascontiguousarray(image.reshape(-1, image.shape[2]).T, dtype=np.float32)


class _Model(NamedTuple):
    """The samples on or near the disc for one pose."""

    light: F32
    """Light of the samples, (3, n)."""
    coverage: F32
    """Coverage of each sample by each paint, (4, n)."""
    slope_x: F32
    """Derivative of the coverage by x, (4, n) 1/m; empty if it is not requested."""
    slope_y: F32
    xy: F32
    """Positions of the samples on the pad, (2, n) m."""
    ab: F32
    """Rays of the samples in `pad` over their depth, (2, n)."""
    used: NDArray[np.intp]
    """Indices of these samples among all samples, (n,)."""


def _model(drawing: Maps, samples: _Samples, light: F32, R: F64, t: F64, pad: Pad, slopes: bool = True) -> _Model | None:
    r = R.T.astype(np.float32) @ samples.rays
    c0, c1, c2 = (t @ R).tolist()
    ab = r[:2] / np.maximum(r[2], 0.05)
    xy = ab * c2
    xy -= np.array([[c0], [c1]], np.float32)
    limit = min(REACH * pad.disc_radius_m - 2.0 / drawing.per_m, 1.12 * pad.disc_radius_m + samples.side_m)
    r2 = xy * xy
    used = ((r[2] > 0.05) & (r2[0] + r2[1] < limit**2)).nonzero()[0]
    if len(used) < _LEAST_SAMPLES:
        return None
    ab, xy = ab.take(used, axis=1), xy.take(used, axis=1)
    layers = _sampled(drawing.layers if slopes else drawing.coverage, drawing, xy)
    return _Model(light.take(used, axis=1), layers[:4], layers[4:8], layers[8:], xy, ab, used)


def _sampled(layers: F32, drawing: Maps, xy: F32) -> F32:
    """Return (c, n) layers of the maps at (2, n) positions on the pad. The maps' rows run along x."""
    return np.ascontiguousarray(sampled(layers, (xy[::-1].T * drawing.per_m + drawing.centre).astype(np.float32)).T)


def _paint(light: F32, coverage: F32, weight: F32, final: bool = False) -> tuple[F32, F32, F32, float]:
    """Fit the paints (4, 3) by iteratively reweighted least squares.

    Return them, the weights, the residuals (3, n) and their spread. While the pose moves the weights are Cauchy's. At the final
    pose (`final`) they are Geman and McClure's, which drop outliers completely.
    """
    n = light.shape[1]
    both = np.concatenate([coverage, light])
    floor = max(1e-4, _NOISE * math.sqrt(float((light * light).sum(axis=0).max())))
    low = int(_SOUND * n)
    usual = _SPREAD_SHARP if final else _SPREAD
    for _ in range(4 if final else 2):
        normal = (coverage * weight) @ both.T
        normal.flat[:28:8] += 1e-4 * n
        ok, paints = cv2.solve(normal[:, :4], normal[:, 4:], flags=cv2.DECOMP_CHOLESKY)
        if not ok:
            paints = np.linalg.solve(normal[:, :4], normal[:, 4:])
        residual = light - paints.T @ coverage
        squared = (residual * residual).sum(axis=0)
        spread = max(floor, usual * math.sqrt(float(np.partition(squared, low)[low])))
        squared *= 0.25 / spread**2
        squared += 1.0
        weight = 1.0 / squared
        if final:
            weight *= weight
    return np.asarray(paints, np.float32), weight, residual, spread


def _explained(light: F32, residual: F32, weight: F32, noise: float) -> float:
    """Return the fraction of the light's weighted variance that the model explains, without what noise adds to it."""
    apart = light - (light @ weight / float(weight.sum()))[:, None]
    total = float((apart * apart @ weight).sum())
    count = 3.0 * float(weight.sum())
    above = max(total - noise**2 * count, _CHANCE * noise**2 * math.sqrt(2.0 * count), 1e-12)
    return (total - float((residual * residual @ weight).sum())) / above


def _normal(paints: F32, weight: F32, residual: F32, spread: float, model: _Model) -> tuple[F64, F64]:
    """Return the normal matrix and the gradient of a small (translation, rotation) in `pad`."""
    gx, gy = paints.T @ model.slope_x, paints.T @ model.slope_y
    x, y = model.xy
    J = np.empty((6, *gx.shape), np.float32)
    np.negative(gx, out=J[0])
    np.negative(gy, out=J[1])
    along = np.add(gx * model.ab[0], gy * model.ab[1], out=J[2])
    np.multiply(along, y, out=J[3])
    np.multiply(along, -x, out=J[4])
    np.subtract(gx * y, gy * x, out=J[5])
    Jw = (J * weight).reshape(6, -1)
    scale = spread**-2
    return (Jw @ J.reshape(6, -1).T).astype(float) * scale, (Jw @ residual.ravel()).astype(float) * scale


def _solved(N: F64, g: F64, tilt: F64, sigma_tilt: float) -> F64:
    """Solve for the step, including the prior on the tilt."""
    M = N.copy()
    M[3, 3] += sigma_tilt**-2
    M[4, 4] += sigma_tilt**-2
    g = g.copy()
    g[3:5] -= tilt * sigma_tilt**-2
    M.flat[::7] = M.flat[::7] * 1.001 + 1e-6
    ok, step = cv2.solve(M, g[:, None], flags=cv2.DECOMP_CHOLESKY)
    return np.asarray(step[:, 0] if ok else np.linalg.solve(M, g), float)
