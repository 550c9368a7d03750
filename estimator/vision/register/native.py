"""What registration gives to the native core: the camera, the frame, the expected tilt, the options."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.interface.registration import FIT_ROWS
from estimator.core.library import address
from estimator.core.records import record
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from estimator.vision.pose import Orientation
from estimator.vision.register.shape import pad_shape
from estimator.vision.register.state import U8, light_table, ray_map

if TYPE_CHECKING:
    from estimator.vision.register.registration import RegistrationOptions

_LANES = 16
_BYTES_OF_A_FLOAT = 4


@lru_cache(maxsize=8)
def _lens(camera: Camera) -> tuple[F64, int]:
    """Return the words of the core's `camera_lens`, and the address of the rays of its pixels, 0 without distortion."""
    words = record("camera_lens", {
        "width": camera.width, "height": camera.height, "distorted": camera.distorted, "fx": camera.fx, "fy": camera.fy,
        "cx": camera.cx, "cy": camera.cy, "distortion": camera.distortion, "R_body_cam": camera.T_body_cam.R.matrix,
    })  # fmt: skip
    return words, address(ray_map(camera)) if camera.distorted else 0


@lru_cache(maxsize=2)
def _light(gamma: bool) -> NDArray[np.float32]:
    return light_table(gamma).astype(np.float32)


@lru_cache(maxsize=8)
def _options(options: RegistrationOptions) -> F64:
    return record("fit_options", {
        "max_profiles": options.max_profiles, "dense_pixels": options.dense_pixels, "blur_px": options.blur_px,
        "edge_sigma_px": options.edge_sigma_px, "dense_edge_sigma_px": options.dense_edge_sigma_px,
        "edge_sigma_m": options.edge_sigma_m,
    })  # fmt: skip


def _prior(prior: Orientation | None) -> F64:
    if prior is None:
        return record("tilt_prior", {})
    return record("tilt_prior", {
        "given": True, "roll_rad": prior.roll_rad, "pitch_rad": prior.pitch_rad, "cov_tilt": prior.cov_tilt,
        "sigma_deck_rad": prior.sigma_deck_rad,
    })  # fmt: skip


class Inputs:
    """The arguments of the core's functions of registration for one frame; it keeps their memory."""

    def __init__(self, px: U8, camera: Camera, pad: Pad, prior: Orientation | None, options: RegistrationOptions) -> None:
        lens, rays = _lens(camera)
        px = np.ascontiguousarray(px, np.uint8)
        light, shape = _light(options.gamma), pad_shape(pad)
        self._prior, self._options = _prior(prior), _options(options)
        self._room = -(-options.dense_pixels // _LANES) * _LANES
        self._scratch = np.empty(FIT_ROWS * self._room, np.float32)
        self._kept: tuple[Any, ...] = (lens, px, light, shape)
        self.frame = address(lens), rays, _start(px), _start(light), address(shape)
        """Camera, rays, pixels, light of their values, and the pad."""
        self.prior, self.options = address(self._prior), address(self._options)
        self.room = self._room, _start(self._scratch)
        """Floats in a row of the memory that the core works on, and where it begins."""


def _start(array: NDArray[Any]) -> int:
    return int(array.ctypes.data)
