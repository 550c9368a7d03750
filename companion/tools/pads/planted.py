"""Plant a pad into a view: what a camera over it would see, in the view's own light, blur and noise."""

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import Rotation
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from estimator.vision.pad_information import paint_at
from estimator.vision.pad_pose import PadPose
from estimator.vision.regions import covers
from estimator.vision.srgb import linear_light

U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]
_FINE = 512
"""Points along a side of the drawing."""
_SHEET = 1.35
"""Half of the side of a sheet of the ground's paint, in radii of the pad."""
_TILT_RAD = math.radians(20.0)


@lru_cache(maxsize=4)
def _drawing(pad: Pad) -> tuple[F32, float]:
    """Return the pad's linear blue, green, red and its share of each point, (n, n, 4): row by x, column by y; and the points per m."""
    half = _SHEET * pad.disc_radius_m
    axis = (np.arange(_FINE) - 0.5 * (_FINE - 1)) * 2.0 * half / _FINE
    gx, gy = np.meshgrid(axis, axis, indexing="ij")
    at = np.stack([gx.ravel(), gy.ravel()], axis=1)
    ground = linear_light(dict(pad.paints)[pad.ground]) if pad.ground else np.zeros(3)
    share = np.ones(len(at), bool) if pad.ground else np.any([covers(region, at) for region in pad.regions], axis=0)
    light = paint_at(pad, at, ground)[:, ::-1] * share[:, None]
    return np.asarray(np.c_[light, share].reshape(_FINE, _FINE, 4), np.float32), _FINE / (2.0 * half)


def random_pose(rng: np.random.Generator, camera: Camera, pad: Pad, radius_px: float) -> PadPose:
    """Return a pose in which the pad has a radius in the frame, its centre in view, its plane within 20 degrees of the camera's."""
    depth = camera.fx * pad.disc_radius_m / radius_px
    aside = np.clip(np.array([0.5 * camera.width - radius_px, 0.5 * camera.height - radius_px]), 10.0, None)
    middle = np.array([camera.cx, camera.cy]) + rng.uniform(-1.0, 1.0, 2) * aside
    ray = np.append(camera.rays(middle[None])[0], 1.0)
    axis = rng.uniform(0.0, math.tau)
    tilt = Rotation.from_rotvec(float(rng.uniform(0.0, _TILT_RAD)) * np.array([math.cos(axis), math.sin(axis), 0.0]))
    return PadPose(tilt @ Rotation.from_rpy(0.0, 0.0, float(rng.uniform(-math.pi, math.pi))), ray * depth)


def planted(px: U8, camera: Camera, pad: Pad, pose: PadPose, rng: np.random.Generator) -> U8:
    """Return a view, (H, W, 3) BGR, with the pad in it."""
    drawing, per_m = _drawing(pad)
    # From the drawing's points to the frame's: x runs along rows of the drawing, y along its columns.
    to_pad = np.array([[0.0, 1.0 / per_m, 0.0], [1.0 / per_m, 0.0, 0.0], [0.0, 0.0, 1.0]])
    to_pad[:2, 2] = -0.5 * (_FINE - 1) / per_m
    K = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    H = K @ np.column_stack([pose.R_cam_pad.matrix[:, :2], pose.t_cam_pad]) @ to_pad
    fine = 2
    S = np.array([[fine, 0.0, 0.5 * (fine - 1)], [0.0, fine, 0.5 * (fine - 1)], [0.0, 0.0, 1.0]])
    shrunk = max(1.0, 0.5 * _FINE / max(1.0, fine * 1.4 * pose.disc_px(camera, pad)))
    source = cv2.GaussianBlur(drawing, (0, 0), 0.5 * shrunk) if shrunk > 1.0 else drawing
    size = fine * camera.width, fine * camera.height
    seen = cv2.warpPerspective(source, S @ H, size, flags=cv2.INTER_LINEAR)
    seen = cv2.GaussianBlur(cv2.resize(seen, (camera.width, camera.height), interpolation=cv2.INTER_AREA), (0, 0), float(rng.uniform(0.5, 1.1)))
    under = (px.astype(np.float32) / 255.0) ** 2.2
    light = float(np.exp(rng.uniform(math.log(0.25), math.log(1.1))))
    out = under * (1.0 - seen[..., 3:]) + light * seen[..., :3]
    noise = float(rng.uniform(0.5, 4.0)) * rng.standard_normal(px.shape, np.float32)
    return np.asarray(np.clip(255.0 * np.clip(out, 0.0, 1.0) ** (1.0 / 2.2) + noise, 0, 255), np.uint8)
