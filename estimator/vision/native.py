"""What vision gives to the native core: a camera, and the addresses of arrays."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from estimator.contracts.geometry import F64
from estimator.core.records import record
from estimator.vision.camera import Camera


@lru_cache(maxsize=4)
def packed_camera(camera: Camera) -> F64:
    """Return the structure `camera_lens` of the core."""
    words = record("camera_lens", {
        "width": camera.width, "height": camera.height, "distorted": camera.distorted, "fx": camera.fx, "fy": camera.fy,
        "cx": camera.cx, "cy": camera.cy, "distortion": camera.distortion, "R_body_cam": camera.T_body_cam.R.matrix,
    })  # fmt: skip
    words.setflags(write=False)
    return words


def address(array: NDArray[Any], dtype: DTypeLike = np.float64) -> int:
    """Return the address of an array's first number.

    Raises:
        TypeError: its numbers are of another type, or not one after the other.
    """
    if array.dtype != dtype or not array.flags.c_contiguous:
        raise TypeError(f"the core takes contiguous {np.dtype(dtype)}, not {array.dtype} of strides {array.strides}")
    return int(array.__array_interface__["data"][0])


def pixels(part: NDArray[np.uint8]) -> tuple[int, int]:
    """Return the address of a part (h, w, 3) of an image, and the number of bytes from row to row.

    Raises:
        TypeError: the pixels of a row are not three bytes each, one after the other.
    """
    if part.dtype != np.uint8 or part.ndim != 3 or part.shape[2] != 3 or part.strides[1:] != (3, 1):
        raise TypeError(f"the core takes BGR bytes in rows, not {part.dtype} of shape {part.shape} and strides {part.strides}")
    return int(part.__array_interface__["data"][0]), part.strides[0]
