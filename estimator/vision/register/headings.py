"""Compare headings at which a drawing looks nearly the same.

The light of the pixels on the pad is fitted with the mean of both drawings and with half of their difference. If the first
heading is right, the difference has the strength of the mean; if the second is, minus that. Uneven light and wear
are in the residuals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.detect.pyramid import U8
from estimator.vision.detect.template import BLURS_M, F32, STEP_M, template
from estimator.vision.pad.pad import Pad
from estimator.vision.srgb import LINEAR_LIGHT, LUMA, linear_light

_LENS_PX = 0.75  # Standard deviation of a pixel and of a lens together, px
_MOST_PX = 160  # Pixels along a side that are looked at; of a larger image every second one or fewer
_FEWEST = 40  # Least number of pixels for which headings are compared


def heading_z_scores(px: U8, camera: Camera, pad: Pad, pose: PadPose, turns_rad: Sequence[float]) -> dict[float, float]:
    """Return for each turn by how many standard deviations a pose is right and not the turned one; negative if that is right.

    Args:
        px: (H, W, 3) BGR.
    """
    uv, at = _places(camera, pad, pose)
    if len(uv) < _FEWEST:
        return dict.fromkeys(turns_rad, 0.0)
    light = LINEAR_LIGHT[px[uv[:, 1], uv[:, 0]]] @ LUMA[::-1]
    blur_m = _LENS_PX * pose.range_m / camera.fx
    own = _drawn(pad, at, blur_m)
    turned = {turn: at @ Rotation.from_rpy(0.0, 0.0, turn).matrix[:2, :2] for turn in turns_rad}
    return {turn: _z_score(light, own, _drawn(pad, there, blur_m)) for turn, there in turned.items()}


def _z_score(light: F64, own: F64, other: F64) -> float:
    """Return by how many standard deviations light (N,) follows one drawing and not the other."""
    rows = np.stack([np.ones(len(light)), 0.5 * (own + other), 0.5 * (own - other)])
    normal = rows @ rows.T + 1e-9 * np.eye(3)
    fitted = np.linalg.solve(normal, rows @ light)
    left = light - fitted @ rows
    var = float(left @ left) / (len(light) - 3) * float(np.linalg.inv(normal)[2, 2])
    return float(np.sign(fitted[1]) * fitted[2]) / math.sqrt(max(var, 1e-18))


def _places(camera: Camera, pad: Pad, pose: PadPose) -> tuple[np.ndarray, F64]:
    """Return the pixels (N, 2) that show the inside of the pad, and where their rays meet it, (N, 2) m."""
    reach = camera.project(pose.points(pad.circle(pad.disc_radius_m, 24)))
    ok = np.isfinite(reach).all(axis=1)
    if not ok.any():
        return np.empty((0, 2), np.intp), np.empty((0, 2))
    low = np.clip(np.floor(reach[ok].min(axis=0)), 0, (camera.width - 1, camera.height - 1)).astype(int)
    high = np.clip(np.ceil(reach[ok].max(axis=0)), 0, (camera.width - 1, camera.height - 1)).astype(int)
    step = 1 + int((high - low).max()) // _MOST_PX
    u, v = np.meshgrid(np.arange(low[0], high[0] + 1, step), np.arange(low[1], high[1] + 1, step))
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    rays = np.c_[camera.rays(uv.astype(float)), np.ones(len(uv))] @ pose.R_cam_pad.matrix
    d = pose.R_cam_pad.matrix.T @ pose.t_cam_pad
    at = rays[:, :2] * (d[2] / rays[:, 2])[:, None] - d[:2]
    inside = (np.hypot(*at.T) < 0.97 * pad.disc_radius_m) & (rays[:, 2] > 1e-3)
    return uv[inside], at[inside]


def _drawn(pad: Pad, at_m: F64, blur_m: float) -> F64:
    """Return the luminance of the drawing at places (N, 2) m."""
    image = _luminance(pad, int(np.argmin(np.abs(np.log(BLURS_M) - math.log(blur_m)))))
    x, y = ((at_m[:, k] / STEP_M + len(image) // 2).astype(np.float32) for k in (0, 1))
    out = cv2.remap(image, y[None, :], x[None, :], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(out[0], float)


@lru_cache(maxsize=16)
def _luminance(pad: Pad, blur: int) -> F32:
    colours = pad.markings.colours
    paints = [float(linear_light(rgb) @ LUMA) for rgb in (colours.h, colours.ring, colours.disc, colours.disc)]
    return np.asarray(template(pad).coverage[blur] @ np.array(paints, np.float32) / 16384.0, np.float32)
