"""A frame of a rolling shutter as all its rows would show it at one instant, that of the middle row.

Each row is exposed in its turn and shows the pad where the motion has carried it by then: a roll shears it, a pitch stretches it.
The pad lies in a plane whose place is nearly known, and so is the motion against it. That says for each pixel where the row's
time has carried it, and the frame is read from there.
Source: Hedborg, Forssen, Felsberg and Ringaby, Rolling shutter bundle adjustment, CVPR 2012, section 2 (the model of the rows).
"""

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, skew
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose

_BLOCK_PX = 8  # Size of the squares of the frame within which the displacement is interpolated
_SMALL_PX = 0.05  # A frame in which nothing is displaced by more is left as it is
_LARGEST_PX = 15.0
"""A displacement beyond it comes from a wrong belief rather than from a shutter, and the frame is left as it is."""
_FLAT = 0.05  # Least sine between a ray and the pad's plane at which the plane is looked at


class CameraMotion(NamedTuple):
    """Motion of the camera against the pad during a frame."""

    w_cam: F64
    """Its angular velocity, (3,) rad/s in `cam`."""
    v_pad_cam: F64
    """Velocity of the pad's centre minus that of the camera, without the rotation of the axes, (3,) m/s in `cam`."""


class _Nodes(NamedTuple):
    """The middles of the squares of a frame."""

    uv: F64
    """(N, 2) px."""
    rays: F64
    """(N, 3), z = 1."""
    shape: tuple[int, int]
    """Rows and columns."""


def at_one_instant(px: NDArray[np.uint8], camera: Camera, pose: PadPose, motion: CameraMotion) -> NDArray[np.uint8]:
    """Return the frame as it would be without the readout's time; the same array where that makes no difference.

    Args:
        px: (H, W, 3) BGR.
        camera: the camera with its `readout_s`.
        pose: about where the pad is in the middle of the readout.
    """
    off = _displaced_px(camera, pose, motion)
    most = float(np.abs(off).max(initial=0.0))
    if not _SMALL_PX < most < _LARGEST_PX:
        return px
    where = np.asarray(cv2.resize(off, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR), np.float32)
    where += _pixels(camera.width, camera.height)
    there = cv2.remap(px, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
    return np.asarray(there, np.uint8)


def _displaced_px(camera: Camera, pose: PadPose, motion: CameraMotion) -> NDArray[np.float32]:
    """Return by how much what a square shows is displaced in the frame as it was read out, (rows, columns, 2) px."""
    nodes = _nodes(camera.optics)
    normal = pose.R_cam_pad.matrix[:, 2]
    sine = nodes.rays @ normal / np.linalg.norm(nodes.rays, axis=1)
    ahead = float(normal @ pose.t_cam_pad)
    if ahead <= 0.0:
        return np.zeros((*nodes.shape, 2), np.float32)
    depth = ahead / np.maximum(nodes.rays @ normal, _FLAT)
    # Of a unit depth, per second: the pad's plane against the lens.
    rate = motion.v_pad_cam / depth[:, None] - nodes.rays @ skew(motion.w_cam).T
    flow = np.where(sine[:, None] > _FLAT, rate[:, :2] - nodes.rays[:, :2] * rate[:, 2:], 0.0)
    later_s = camera.readout_s * (nodes.uv[:, 1] / (camera.height - 1) - 0.5)
    for _ in range(2):
        moved = nodes.rays.copy()
        moved[:, :2] += flow * later_s[:, None]
        uv = camera.project(moved)
        later_s = camera.readout_s * (uv[:, 1] / (camera.height - 1) - 0.5)
    return np.nan_to_num(uv - nodes.uv).astype(np.float32).reshape(*nodes.shape, 2)


@lru_cache(maxsize=4)
def _nodes(lens: Camera) -> _Nodes:
    columns, rows = -(-lens.width // _BLOCK_PX), -(-lens.height // _BLOCK_PX)
    u, v = (np.arange(columns) + 0.5) * lens.width / columns - 0.5, (np.arange(rows) + 0.5) * lens.height / rows - 0.5
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    return _Nodes(uv, np.column_stack([lens.rays(uv), np.ones(len(uv))]), (rows, columns))


@lru_cache(maxsize=4)
def _pixels(width: int, height: int) -> NDArray[np.float32]:
    return np.stack(np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)), axis=-1)
