"""The simulator's functions of the native core, and how arrays are given to them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from estimator.core.library import CORE

render_blur = CORE.function("render_blur")
render_deck = CORE.function("render_deck")
render_expose = CORE.function("render_expose")
render_fill = CORE.function("render_fill")
render_frame = CORE.function("render_frame")
render_mix = CORE.function("render_mix")
render_pad_kinds = CORE.function("render_pad_kinds")
render_pad_shares = CORE.function("render_pad_shares")
render_sea = CORE.function("render_sea")
render_smear = CORE.function("render_smear")
render_water = CORE.function("render_water")


def address(array: NDArray[Any] | None, dtype: DTypeLike, shape: tuple[int, ...] | None = None) -> int:
    """Return the address of an array's first number, 0 for None.

    Raises:
        TypeError: its numbers are of another type or not in rows, one after the other, or its shape is another.
    """
    if array is None:
        return 0
    if array.dtype != dtype or not array.flags.c_contiguous or (shape is not None and array.shape != shape):
        raise TypeError(f"the core takes contiguous {np.dtype(dtype)} of shape {shape}, not {array.dtype} of shape {array.shape}")
    return int(array.__array_interface__["data"][0])
