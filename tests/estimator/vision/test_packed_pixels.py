"""What goes to the core as an address has the type and the strides that the core reads."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.vision.native import address, pixels


def test_an_image_that_c_would_misread_is_refused() -> None:
    px = np.zeros((4, 6, 3), np.uint8)
    assert pixels(px[1:, 2:]) == (px.ctypes.data + 18 + 6, 18)
    wrong: list[NDArray[np.generic]] = [px[:, ::2], px[:, :, :2], px.astype(np.int8), px[:, :, 0]]
    for image in wrong:
        with pytest.raises(TypeError, match="BGR"):
            pixels(image)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="float64"):
        address(np.zeros(3, np.float32))
