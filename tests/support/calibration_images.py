"""Images of a printed board as a known camera takes them: each pixel's rays, bent by its lens, meet the board's plane."""

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.tools.calibrate.board import Board
from estimator.contracts.geometry import F64, Rotation, Transform
from estimator.vision.camera.camera import Camera

FINE = 2
"""Rays a pixel, each way."""
PX_PER_M = 8000.0


def lens(width: int, height: int, f: float, distortion: tuple[float, ...]) -> Camera:
    mount = Transform(Rotation.from_rpy(0.0, 0.0, np.pi / 2), np.zeros(3))
    return Camera(width, height, f, 1.004 * f, width / 2 + 6.3, height / 2 - 4.7, np.array(distortion), mount)


class Studio:
    """Takes images of one board with one camera."""

    def __init__(self, camera: Camera, board: Board, seed: int = 1) -> None:
        self.camera, self.board = camera, board
        self._random = np.random.default_rng(seed)
        offsets = (np.arange(FINE) + 0.5) / FINE - 0.5
        u = (np.arange(camera.width)[:, None] + offsets).ravel()
        v = (np.arange(camera.height)[:, None] + offsets).ravel()
        uv = np.stack(np.meshgrid(u, v), axis=2)
        rays = np.concatenate([camera.rays(uv.reshape(-1, 2)), np.ones((uv.shape[0] * uv.shape[1], 1))], axis=1)
        self._rays = rays.astype(np.float32)
        self._shape = uv.shape[:2]
        self._margin = board.square_m / 2
        self._texture = self._print()

    def _print(self) -> NDArray[np.uint8]:
        wide = np.array(self.board.outline_m) + 2 * self._margin
        paper = np.full((round(wide[1] * PX_PER_M), round(wide[0] * PX_PER_M)), 235, np.uint8)
        for rectangle in self.board.black_m():
            (x0, y0), (x1, y1) = np.round((rectangle[[0, 2]] + self._margin) * PX_PER_M).astype(int)
            paper[y0:y1, x0:x1] = 20
        return cv2.blur(paper, (5, 5)).astype(np.uint8)

    def image(self, R_cam_board: Rotation, p_cam_board: F64, noise: float = 2.0) -> NDArray[np.uint8]:
        """(H, W) grey; the board's outer top-left corner at `p_cam_board`, grey table around it."""
        m = R_cam_board.matrix
        plane = np.linalg.inv(np.column_stack([m[:, 0], m[:, 1], p_cam_board]))
        xyw = self._rays @ plane.T.astype(np.float32)
        at = ((xyw[:, :2] / xyw[:, 2:] + self._margin) * PX_PER_M - 0.5).reshape(*self._shape, 2)
        seen = cv2.remap(self._texture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=110)
        grey = cv2.resize(seen, (self.camera.width, self.camera.height), interpolation=cv2.INTER_AREA).astype(float)
        return np.clip(grey + self._random.normal(0.0, noise, grey.shape), 0, 255).astype(np.uint8)

    def aim(self, toward_px: tuple[float, float], distance_m: float, rpy_deg: tuple[float, float, float]) -> NDArray[np.uint8]:
        """Return the board's middle seen at a pixel, so far away, turned (0, 0, 0) as the image lies."""
        R = Rotation.from_rpy(*np.radians(rpy_deg))
        middle = np.array([*self.board.outline_m, 0.0]) / 2
        ray = np.append(self.camera.rays(np.array([toward_px]))[0], 1.0)
        return self.image(R, distance_m * ray - R.matrix @ middle)


def good_round(studio: Studio, distance_m: float, inset: tuple[float, float], middle: float) -> list[NDArray[np.uint8]]:
    """Return views as a person takes them: the middle and four corners, at three tilts each; the middle nearer by a factor."""
    w, h = studio.camera.width, studio.camera.height
    x, y = inset
    places = [(0.5, 0.5), (x, y), (1 - x, y), (x, 1 - y), (1 - x, 1 - y)]
    tilts = [(28.0, 5.0, 4.0), (-8.0, 30.0, -12.0), (-26.0, -24.0, 85.0)]
    near = [middle, 1.0, 1.0, 1.0, 1.0]
    return [
        studio.aim((fx * w, fy * h), n * distance_m, tilt) for (fx, fy), n in zip(places, near, strict=True) for tilt in tilts
    ]
