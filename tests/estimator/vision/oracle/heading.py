"""Independent computation of the score at all headings in numpy: correlation along the angle by an FFT."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.abi import POLAR_ANGLES
from estimator.vision.camera import Camera
from estimator.vision.detect.heading import Heading
from estimator.vision.detect.template import polar_drawing
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose

U8 = NDArray[np.uint8]

_NO_SECOND_MAP = np.empty(0, np.float32)
_LEAST = 1e-3
_RIM_PX, _WIDEST_RIM = 1.2, 0.5
"""Width of the disc's edge, px, that is left out, and the greatest share of the radius."""
_RESOLVED_PX = 20.0
"""Radius of the disc, px, below which the ring is compared with what is outside of it alone."""


def searched_heading(px: U8, step: int, camera: Camera, pad: Pad, pose: PadPose, side: F64 | None = None) -> Heading | None:
    """Return the best heading of the drawing at a pose; None if hardly any of it is in view.

    Args:
        px: the frame, `step` times smaller than the camera's.
        side: (2,) unit direction in x and y of `pose`: only this half of the disc is used, because the other is covered.
    """
    drawing = polar_drawing(pad)
    uv = ((camera.project(drawing.xy_m @ pose.R_cam_pad.matrix[:, :2].T + pose.t_cam_pad) + 0.5) / step - 0.5).astype(np.float32)
    h, w = px.shape[:2]
    shape = drawing.arrow.shape
    u, v = uv[:, 0], uv[:, 1]
    seen = ((u > -0.5) & (u < w - 0.5) & (v > -0.5) & (v < h - 0.5)).reshape(shape)
    weight = seen * drawing.area_inside
    # The disc's edge sees the surroundings, too.
    rim_m = min(_RIM_PX * step * float(pose.t_cam_pad[2]) / camera.fx, _WIDEST_RIM * pad.disc_radius_m)
    weight = weight * (np.hypot(*drawing.xy_m.T) <= pad.disc_radius_m - rim_m).reshape(shape)
    if side is not None:
        weight = weight * (drawing.xy_m @ side > 0.0).reshape(shape)
    total = float(drawing.area_inside.sum()) * POLAR_ANGLES
    in_view = float(weight.sum()) / total
    if in_view < 0.02:
        return None
    # Points behind the lens are nan, which remap would turn into arbitrary pixels. Their weight is zero.
    at = np.fmax(uv, np.float32(-1e4)).reshape(*shape, 2)
    remapped = cv2.remap(px, np.asarray(at, np.float32), _NO_SECOND_MAP, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    seen_px = remapped.transpose(2, 0, 1)
    values = np.empty((4, *shape), np.float32)
    values[0] = weight
    np.multiply(seen_px, weight * np.float32(1 / 255.0), out=values[1:])
    spectra = np.fft.rfft(values, axis=2)
    # These are sums of the weight and of the weighted blue, green, red under H and arrowhead at every heading.
    turning = np.conj(np.fft.rfft(np.stack([drawing.h_marking, drawing.arrow]), axis=2))
    products = np.stack([(spectra * one).sum(axis=1) for one in turning])
    sums = np.fft.irfft(products, n=POLAR_ANGLES, axis=2)
    whole = values.sum(axis=(1, 2))
    ring = (values * drawing.ring).sum(axis=(1, 2))
    h_marking, arrow = sums[0], sums[1]
    orange = ring[:, None] + arrow
    disc = whole[:, None] - h_marking - orange
    squares = float(np.einsum("crf,crf->", values[1:], seen_px)) / 255.0
    spread = squares - float((whole[1:] ** 2).sum()) / float(whole[0])
    if spread <= 1e-6 * total:
        return None
    between = np.full(POLAR_ANGLES, -float((whole[1:] ** 2).sum()) / float(whole[0]))
    least = _LEAST * total
    means = []
    for part in (h_marking, orange, disc):
        n = np.maximum(part[0], least)
        m = part[1:] / n
        between += np.where(part[0] > least, (part[1:] * m).sum(axis=0), 0.0)
        means.append(np.where(part[0] > least, m, np.nan))
    mean_h, mean_orange, mean_disc = means
    beside = mean_disc[2]
    if camera.fx * pad.disc_radius_m < _RESOLVED_PX * step * float(pose.t_cam_pad[2]):
        outermost = int(np.flatnonzero(drawing.ring[:, 0])[-1])
        outside = values[:, outermost + 1 :].sum(axis=(1, 2))[:, None] - arrow
        beside = np.where(outside[0] > least, outside[3] / np.maximum(outside[0], least), beside)
    with np.errstate(invalid="ignore"):
        dark = np.minimum(
            np.nanmin(np.nan_to_num(mean_h - mean_disc, nan=1.0), axis=0), np.nan_to_num(mean_orange[2] - beside, nan=1.0)
        )
    score = np.where(dark > 0.0, between / spread, 0.25 * between / spread)
    k = int(np.argmax(score))
    opposite = float(score[(k + POLAR_ANGLES // 2) % POLAR_ANGLES])
    left, right = float(score[k - 1]), float(score[(k + 1) % POLAR_ANGLES])
    bend = left - 2 * float(score[k]) + right
    fine = 0.5 * (left - right) / bend if bend < -1e-9 else 0.0
    return Heading((k + fine) * math.tau / POLAR_ANGLES, float(score[k]), float(score[k]) - opposite, in_view)
