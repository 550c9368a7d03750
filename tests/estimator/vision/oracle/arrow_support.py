"""Measure the support for the arrowhead, at its place and where it would be with the drawing turned by 180 degrees.

The arrowhead is small: the sampling that suffices for disc, ring and H covers it with one or two samples. Here the two places
alone are sampled finely. The light is projected on the line from disc paint to ring paint, and fitted with a linear slope, the
ring, and an arrowhead of unknown strength.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.detect.alignment import ArrowPlace
from estimator.vision.detect.template import BLURS_M, DISC, ORANGE
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from tests.estimator.vision.oracle.template import maps, sampled

F32 = NDArray[np.float32]

_PITCH_M = 0.008
_MARGIN_M = 0.02
_CLEAR_VAR = 0.05
"""Residual variance of the projected light (disc 0, ring 1) that halves, roughly, the trust that nothing else lies there."""

_HIDDEN, _PLAIN = 2.0, 5.0
"""Strength of a whole arrowhead, in deviations of the noise, up to which it is hidden, and from which it is plain."""


@dataclass(frozen=True, slots=True, eq=False)
class _Design:
    xy_m: F32
    """Positions of the samples at the fore place, (n, 2) m."""
    arrow: F32
    """Coverage of each sample by the arrowhead, (n,)."""
    others: F64
    """The other regressors, (n, 4): constant, two slopes, ring."""
    own: tuple[F64, F64]
    """Orthogonal columns of `others`, (n, 4), and the part of the arrowhead orthogonal to them, (n,); for a place fully in
    view.
    """


@lru_cache(maxsize=16)
def _design(pad: Pad, blur: int) -> _Design:
    x = np.arange(
        pad.markings.arrow_tip_m - pad.markings.arrow_depth_m - _MARGIN_M, pad.markings.arrow_tip_m + _MARGIN_M - 1e-9, _PITCH_M
    )
    y = np.arange(-pad.markings.arrow_half_base_m - _MARGIN_M, pad.markings.arrow_half_base_m + _MARGIN_M + 1e-9, _PITCH_M)
    xx, yy = np.meshgrid(x, y, indexing="ij")
    xy = np.stack([xx.ravel(), yy.ravel()], axis=1).astype(np.float32)
    drawing = maps(pad)[blur]
    fore, aft = (
        sampled(drawing.coverage, (s * xy[:, ::-1] * drawing.per_m + drawing.centre).astype(np.float32))[:, ORANGE]
        for s in (1, -1)
    )
    others = np.stack([np.ones(len(xy)), xx.ravel() - xx.mean(), yy.ravel(), aft], axis=1)
    arrow = (fore - aft).astype(np.float32)
    return _Design(xy, arrow, others, _left(others, arrow.astype(float)))


def _left(others: F64, arrow: F64) -> tuple[F64, F64]:
    Q, _ = np.linalg.qr(others)
    return Q, arrow - Q @ (Q.T @ arrow)


def arrow_places(
    image: NDArray[np.uint8], step: int, lut: F32, camera: Camera, pad: Pad, pose: PadPose, root_paints: F64, noise: float
) -> tuple[ArrowPlace, ArrowPlace]:
    """Return the support at the fore place and at the aft place.

    Args:
        image: the frame, `step` times smaller than the camera's.
        lut: (256,) square root of light of a pixel's value.
        noise: standard deviation of the frame's noise beyond the usual, as a fraction of full scale.
        root_paints: (4, 3) paints of the aligned drawing, square root of light, known up to a value common to all four.
    """
    nothing = ArrowPlace(0.0, 0.0, 0.0)
    way = root_paints[ORANGE] - root_paints[DISC]
    length = float(way @ way)
    pixel_m = step * float(pose.t_cam_pad[2]) / camera.fx
    if length < 1e-4 or pixel_m > 1.2 * pad.markings.arrow_depth_m:
        return nothing, nothing
    blur = int(np.argmin(np.abs(np.log(np.array(BLURS_M) / math.hypot(0.29 * pixel_m, 0.7 * pixel_m / step)))))
    design = _design(pad, blur)
    h, w = image.shape[:2]
    R, t = pose.R_cam_pad.matrix[:, :2], pose.t_cam_pad
    energy = design.arrow.astype(float) ** 2
    var = (noise / step) ** 2 / length
    deviations = math.sqrt(float(energy.sum()) / max(1.0, pixel_m / _PITCH_M) ** 2 / max(var, 1e-12))
    shown = min(1.0, max(0.0, (deviations - _HIDDEN) / (_PLAIN - _HIDDEN)))
    out = []
    for sign in (1.0, -1.0):
        uv = (camera.project(sign * design.xy_m @ R.T + t) + 0.5) / step - 0.5
        with np.errstate(invalid="ignore"):
            inside = (uv[:, 0] > -0.5) & (uv[:, 0] < w - 0.5) & (uv[:, 1] > -0.5) & (uv[:, 1] < h - 0.5)
        whole = bool(inside.all())
        seen = 1.0 if whole else float(energy[inside].sum() / energy.sum())
        if seen < 0.6:
            out.append(nothing)
            continue
        v = sampled(cv2.LUT(image, lut), np.fmax(uv, -1e4).astype(np.float32)) @ (way / length)
        # Constant, slope and ring are projected out of light and arrowhead; the remainders give the strength (Frisch and Waugh
        # 1933).
        if whole:
            Q, T = design.own
        else:
            v = v[inside]
            Q, T = _left(design.others[inside], design.arrow[inside].astype(float))
        rest = v - Q @ (Q.T @ v)
        total, square = float(T @ T), max(0.0, float(rest @ rest) - var * len(v))
        strength = float(T @ rest) / total if total > 1e-9 else 0.0
        explained = strength**2 * total / max(square, 1e-9) if strength > 0.0 else 0.0
        left = max(0.0, square - strength**2 * total) / len(v)
        fine = min(1.0, 2.0 * pad.markings.arrow_depth_m / pixel_m - 1.0) if pixel_m > pad.markings.arrow_depth_m / 2 else 1.0
        found = min(1.0, max(0.0, strength)) * min(1.0, explained)
        out.append(ArrowPlace(found, seen * max(0.0, fine * shown), math.exp(-left / _CLEAR_VAR)))
    return out[0], out[1]
