"""Exact images of the pad for tests: every sub-sample of every pixel is traced to the deck and requested its paint."""

import math
from typing import Any

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64, Rotation, Transform, wrap_pi
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera.camera import Camera
from estimator.vision.pad.information import paint_at
from estimator.vision.pad.pad import Pad
from estimator.vision.srgb import LINEAR_LIGHT, linear_light

STAMP = Stamp(MonoNs(0), MonoNs(0), 0.0, "sim")
DECK_RGB = (110, 105, 112)
_FINE_PX = 150
"""Size of the pad below which every pixel is sampled in full, px: lines are hardly wider than one."""


def sim_camera(p_body_cam_m: tuple[float, float, float] = (0.15, 0.0, 0.0), distortion: tuple[float, ...] = (0.0,) * 5) -> Camera:
    """Return the camera of configs/cameras/sim.toml, at a chosen place."""
    mount = Transform(Rotation.from_rpy(0.0, 0.0, math.pi / 2), np.array(p_body_cam_m))
    return Camera(640, 360, 374.67, 374.67, 319.5, 179.5, np.array(distortion), mount)


class PadPlacement(Struct, frozen=True):
    """The pad's position relative to the body, and the tilt of the body."""

    d_body_pad_level: tuple[float, float, float]
    yaw_rad: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    deck_roll_rad: float = 0.0
    deck_pitch_rad: float = 0.0

    def attitude(self, sigma_rad: float = math.radians(0.05)) -> Attitude:
        """Return the attitude of an IMU without error; the vehicle's heading is some angle that nothing may depend on."""
        return Attitude(STAMP, Rotation.from_rpy(self.roll_rad, self.pitch_rad, 0.7), np.eye(3) * sigma_rad**2)

    def T_cam_pad(self, camera: Camera) -> Transform:
        R_level_pad = Rotation.from_rpy(0.0, 0.0, -self.yaw_rad) @ Rotation.from_rpy(self.deck_roll_rad, self.deck_pitch_rad, 0.0)
        T_level_pad = Transform(R_level_pad, np.array(self.d_body_pad_level))
        T_level_body = Transform(Rotation.from_rpy(self.roll_rad, self.pitch_rad, 0.0), np.zeros(3))
        return (T_level_body @ camera.T_body_cam).inv @ T_level_pad


def project(points_pad: F64, scene: PadPlacement, camera: Camera) -> F64:
    """(N, 3) m on the pad to (N, 2) px."""
    T = scene.T_cam_pad(camera)
    return camera.project(points_pad @ T.R.matrix.T + T.t)


def image(
    scene: PadPlacement, camera: Camera, pad: Pad, *, samples: int = 4, blur_px: float = 0.0, noise: float = 0.0, seed: int = 0,
    deck_rgb: tuple[int, int, int] = DECK_RGB, gain: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Frame:  # fmt: skip
    """One frame; `samples` squared sub-samples a pixel added up as light, Gaussian blur, then noise in grey levels."""
    deck = linear_light(np.array(deck_rgb))
    px: NDArray[np.float32] = np.empty((camera.height, camera.width, 3), np.float32)
    px[:] = deck[::-1]
    T = scene.T_cam_pad(camera)
    rim = pad.circle(1.02 * pad.disc_radius_m, 256) @ T.R.matrix.T + T.t
    if np.all(rim[:, 2] > 0.02):
        uv = camera.project(rim)
        low = np.maximum(np.floor(uv.min(axis=0)).astype(int), 0)
        high = np.minimum(np.ceil(uv.max(axis=0)).astype(int) + 1, (camera.width, camera.height))
    else:
        low, high = np.array([0, 0]), np.array([camera.width, camera.height])
    if np.all(high > low):
        px[low[1] : high[1], low[0] : high[0]] = _trace(low, high, T, camera, pad, samples, deck)
    px *= np.array(gain[::-1], np.float32)
    if blur_px > 0.0:
        px = np.asarray(cv2.GaussianBlur(px, (0, 0), blur_px), np.float32)
    px = np.asarray(np.interp(px, LINEAR_LIGHT, np.arange(256)), np.float32)
    if noise > 0.0:
        px = px + np.random.default_rng(seed).normal(0.0, noise, px.shape).astype(np.float32)
    return Frame(STAMP, 0, np.clip(np.rint(px), 0, 255).astype(np.uint8))


def errors(s: Sighting, scene: PadPlacement) -> tuple[F64, float]:
    """(3,) m of position, rad of heading (nan where none is given; the nearer of two where it is ambiguous)."""
    d = s.d_body_pad_level - np.array(scene.d_body_pad_level)
    if s.yaw_rad is None:
        return d, math.nan
    off = wrap_pi(s.yaw_rad - scene.yaw_rad)
    if s.yaw_ambiguous and abs(off) > math.pi / 2:
        off = wrap_pi(off + math.pi)
    return d, off


def _trace(low: NDArray[np.int_], high: NDArray[np.int_], T: Transform, camera: Camera, pad: Pad, samples: int, deck: F64) -> F64:
    """Return the light of the pixels from `low` to before `high`. Where all around is of one paint, one sample says it."""
    rows, columns = np.mgrid[low[1] - 2 : high[1] + 2, low[0] - 2 : high[0] + 2]
    light, around, inside = _seen(columns, rows, T, camera, pad, deck), np.ones((5, 5), np.uint8), np.s_[2:-2, 2:-2]
    paint = np.asarray(light @ [1.0, math.pi, math.e**2], np.float32)
    mixed = (cv2.dilate(paint, around) != cv2.erode(paint, around))[inside] | (max(high - low) < _FINE_PX)
    rows, columns, light = rows[inside], columns[inside], light[inside].copy()
    # Rows of sub-samples are shifted against one another, and columns too, so that an upright edge meets samples squared places.
    step = (np.arange(samples) + 0.5) / samples - 0.5
    u = columns[mixed][:, None, None] + step[None, None, :] + step[None, :, None] / samples
    v = rows[mixed][:, None, None] + step[None, :, None] + step[None, None, :] / samples
    light[mixed] = _seen(u, v, T, camera, pad, deck).mean(axis=(1, 2))
    return light


def _seen(u: NDArray[Any], v: NDArray[Any], T: Transform, camera: Camera, pad: Pad, deck: F64) -> F64:
    """Return the light, blue, green and red, of what points of the image (px) show."""
    rays = np.c_[camera.rays(np.stack([u.ravel(), v.ravel()], axis=1).astype(float)), np.ones(u.size)] @ T.R.matrix
    # The point of a ray on the pad's plane, in pad coordinates.
    t = T.R.matrix.T @ T.t
    s = t[2] / np.where(np.abs(rays[:, 2]) > 1e-9, rays[:, 2], 1e-9)
    light = paint_at(pad, rays[:, :2] * s[:, None] - t[:2], deck)
    light[s <= 0] = deck
    return light[:, ::-1].reshape(*u.shape, 3)
