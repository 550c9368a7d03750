"""What the camera itself does to a frame of the scene: motion blur of the scenery, vignetting, the rows of a rolling shutter."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from sitl.camera.light import I16, U16
from sitl.camera.projection import F32, Lens
from sitl.camera.render.pad import Pose, in_row, pad_from_ray
from sitl.core.abi import CELL_PX, GAIN_ONE
from sitl.native import address, render_average, render_deck, render_smear


def smear(scene: U16, lens: Lens, middle: tuple[F64, F64], ends: list[tuple[F64, F64]]) -> U16:
    """Return the scenery (H, W, 4) blurred along its motion in the middle of the frame, if that is a pixel or more."""
    camera = lens.camera
    R, t = middle
    on_pad = -t.dot(R)
    depth = -float(on_pad[2]) / max(0.05, float(R[2, 2]))
    if not 0 < depth < 1e4:
        return scene
    on_pad += depth * R[2]
    right, down = _way_px(camera, *(r.dot(on_pad) + p for r, p in ends))
    length = math.hypot(right, down)
    if not length >= 1.0:
        return scene
    way = np.array([right, down]) * min(1.0, 31.0 / length)
    # A long way is a short one, up to some four pixels, seen twice, four times and so on, whole pixels apart.
    doublings = max(0, math.ceil(math.log2(min(length, 31.0) / 4.0)))
    steps = [np.round(way / 2 ** (doublings - n)) for n in range(doublings)]
    shifts, taps = _smear_taps(way - np.sum(steps, axis=0, initial=0.0))
    h, w = scene.shape[:2]
    smeared = np.empty_like(scene)
    render_smear(
        h,
        w,
        address(scene, np.uint16),
        len(taps),
        address(shifts, np.int32),
        address(taps, np.uint16),
        address(smeared, np.uint16),
    )
    spare = np.empty_like(scene) if doublings else smeared
    off = np.zeros(2)
    for apart in steps:
        first = np.round(-apart / 2 - off)
        off += first + apart / 2
        pair = np.concatenate([first, first + apart]).astype(np.int32)
        render_average(h, w, address(smeared, np.uint16), address(pair, np.int32), address(spare, np.uint16))
        smeared, spare = spare, smeared
    return smeared


def _way_px(camera: Camera, first: F64, last: F64) -> tuple[float, float]:
    """Return the way in the frame from one point in `cam` to another, px."""
    if camera.distorted:
        right, down = np.diff(camera.project(np.array([first, last])), axis=0)[0].tolist()
        return right, down
    (x0, y0, z0), (x1, y1, z1) = first.tolist(), last.tolist()
    if min(z0, z1) <= 1e-3:
        return math.nan, math.nan
    return camera.fx * (x1 / z1 - x0 / z0), camera.fy * (y1 / z1 - y0 / z0)


def _smear_taps(way: F64) -> tuple[NDArray[np.int32], U16]:
    """Return the shifts (N, 2) px and the weights (N,), parts of 65536, that blur a scene along a straight way (2,) px."""
    half = math.floor(np.hypot(*way) / 2) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    for s in (np.arange(64) + 0.5) / 64 - 0.5:
        x, y = half + way[0] * s, half + way[1] * s
        i, j = math.floor(x), math.floor(y)
        fx, fy = x - i, y - j
        for dj, di, share in ((0, 0, (1 - fx) * (1 - fy)), (0, 1, fx * (1 - fy)), (1, 0, (1 - fx) * fy), (1, 1, fx * fy)):
            kernel[j + dj, i + di] += share / 64
    weights = np.floor(65536.0 * kernel)
    rows, columns = np.nonzero(weights)
    return np.stack([columns - half, rows - half], axis=1).astype(np.int32), weights[rows, columns].astype(np.uint16)


def vignette(lens: Lens, loss: float) -> I16:
    """Return the (H, W) vignetting: the fourth power of the cosine of the angle off the axis, scaled to the corners' loss."""
    r2 = (lens.rays**2).sum(axis=-1)
    fall = 1.0 - (1.0 + r2) ** -2
    return np.asarray(np.round(GAIN_ONE * (1.0 - loss * fall / fall.max())), dtype=np.int16)


def row_map(lens: Lens, first: Pose, middle: Pose, last: Pose) -> F32 | None:
    """Return where in the frame of one instant a rolling shutter looks, px; the deck's plane is seen.

    Args:
        first: pose of the pad while the first row is exposed.
        middle: pose in the middle of the readout.
        last: pose while the last row is exposed.

    Returns:
        Positions for the cells of `Lens.coarse`, (R, C, 2), or None if the deck's plane is not in front of the camera.
    """
    R, t = middle
    if not float(R[:, 2] @ t) > 0.02:
        return None
    coarse, c = lens.coarse, lens.camera
    s = (CELL_PX * np.arange(-1, len(coarse) - 1) + (CELL_PX - 1) / 2) * 2.0 / (c.height - 1) - 1.0
    M = in_row(pad_from_ray(first, middle, last), s.astype(np.float32)[:, None])
    x, y = coarse[..., 0], coarse[..., 1]
    q = [M[i, 0] * x + M[i, 1] * y + M[i, 2] for i in range(3)]
    there = np.stack([R[:, 0], R[:, 1], t], axis=1).astype(np.float32) @ np.stack(q).reshape(3, -1)
    uv = c.project(there.T.astype(float) / np.maximum(there[2:].T, 1e-6)).reshape(*coarse.shape)
    # Beyond the horizon the plane says nothing: those pixels look where they are.
    at = np.stack(np.meshgrid(*(CELL_PX * np.arange(-1, n - 1) + (CELL_PX - 1) / 2 for n in coarse.shape[1::-1])), axis=-1)
    sane = np.isfinite(uv).all(axis=-1) & (np.abs(uv - at).max(axis=-1) < 60.0) & (q[2] > 0) & (there[2] > 0).reshape(q[2].shape)
    return np.where(sane[..., None], uv, at).astype(np.float32)


def moved_scene(scene: U16, cells: F32) -> U16:
    """Return a scene (H, W, 4) as the rows of a rolling shutter see it; `cells` are the result of `row_map`."""
    h, w = scene.shape[:2]
    seen = np.empty_like(scene)
    out = address(seen, np.uint16)
    render_deck(w, 0, w, 0, h, address(cells, np.float32), cells.shape[1], address(scene, np.uint16), h, w, 0, out)
    return seen


def moved(image: NDArray[Any], rows: F32) -> NDArray[Any]:
    """Return an image as the rows of a rolling shutter see it; `rows` are the positions for all pixels, (H, W, 2)."""
    return np.asarray(cv2.remap(image, rows, np.empty(0, np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
