"""Arguments of the native core have the type, the size and the strides that the core reads."""

import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.core.abi import DL_WRONG_SIZE
from estimator.core.library import CORE
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.native import checked, image_of, pad_shape, tracker_of
from tests.support.pad_scenes import load_camera, load_pad

CAMERA, PAD = load_camera("sim"), load_pad("thesis")


def test_an_image_that_c_would_misread_is_refused() -> None:
    px = np.zeros((4, 6, 3), np.uint8)
    part = image_of(px[1:, 2:])
    assert int(CORE.ffi.cast("uintptr_t", part.px)) == px.ctypes.data + 18 + 6
    assert (part.width, part.height, part.stride, part.channels) == (4, 3, 18, 3)
    wrong: list[NDArray[np.generic]] = [px[:, ::2], px[:, :, :2], px.astype(np.int8), px[:, :, 0]]
    for image in wrong:
        with pytest.raises(TypeError, match="bytes in rows"):
            image_of(image)  # type: ignore[arg-type]


def test_a_swapped_argument_is_a_type_error() -> None:
    pyramid, pose = Pyramid(np.zeros((360, 640, 3), np.uint8)), CORE.ffi.new("dl_pad_pose *")
    how, out = CORE.ffi.new("dl_alignment *"), CORE.ffi.new("dl_aligned_pad *")
    with pytest.raises(TypeError, match="dl_alignment"):
        CORE.lib.dl_align(tracker_of(CAMERA, PAD), pyramid.native, pose, how, out)


def test_what_a_tracker_is_not_made_for_is_refused() -> None:
    how, out, pose = CORE.ffi.new("dl_alignment *"), CORE.ffi.new("dl_aligned_pad *"), CORE.ffi.new("dl_pad_pose *")
    small, whole = Pyramid(np.zeros((36, 64, 3), np.uint8)), Pyramid(np.zeros((360, 640, 3), np.uint8))
    assert CORE.lib.dl_align(tracker_of(CAMERA, PAD), small.native, how, pose, out) == DL_WRONG_SIZE
    assert CORE.lib.dl_align(tracker_of(CAMERA), whole.native, how, pose, out) == DL_WRONG_SIZE
    start, looked, outline = CORE.ffi.new("dl_start *"), CORE.ffi.new("dl_registered_pad *"), np.empty(2)
    assert (
        CORE.lib.dl_look(tracker_of(CAMERA, PAD), whole.native, start, looked, CORE.array("double", outline), 1) == DL_WRONG_SIZE
    )
    with pytest.raises(ValueError, match="refuses"):
        checked(DL_WRONG_SIZE)


@pytest.mark.parametrize("member", ["contrast_count", "pointer_kind", "lies_on", "paint_of_kind"])
def test_a_drawing_with_more_parts_than_the_core_holds_is_refused(member: str) -> None:
    shape = {**pad_shape(PAD), member: 99}
    pad, camera = CORE.record("dl_pad", shape=shape, drawn={"n": 5}), CORE.record("dl_camera", lens={"width": 64, "height": 36})
    maps, edges, of = np.zeros(4 * 5 * 25, np.int16), np.zeros(5), np.zeros(2, np.int32)
    made = CORE.lib.dl_tracker_new(
        CORE.array("dl_camera", camera), CORE.ffi.NULL, CORE.array("dl_pad", pad), CORE.array("int16_t", maps),
        CORE.array("int16_t", maps), CORE.array("double", edges), CORE.array("int32_t", of), CORE.ffi.NULL,
    )  # fmt: skip
    assert not made
