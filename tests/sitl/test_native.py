"""The renderer's part of the native core: the same bits with and without vector instructions, and arrays that are refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sitl.core.abi import PAD_EDGE

from estimator.core.library import Door
from sitl.core import abi
from sitl.core.library import SIM
from sitl.native import address
from supply import core

H, W, TAPS = 10, 24, np.array([40000, 12000, 768], np.uint16)


def deck(library: Door, rng: np.random.Generator) -> NDArray[Any]:
    """Positions of texels from well outside the drawing on one side to the other, under a mask with every coverage."""
    across, down = np.meshgrid(np.linspace(-20.0, 70.0, W // 8 + 2), np.linspace(-15.0, 50.0, 2 + 2))
    cells = np.stack([across, down + 0.3 * across], axis=-1).astype(np.float32)
    texels = rng.integers(0, 65536, (32, 40, 4)).astype(np.uint16)
    mask = rng.integers(0, 256, (H, W)).astype(np.uint8)
    scene = rng.integers(0, 65536, (H, W, 4)).astype(np.uint16)
    numbers = (W, 0, W, 0, H, cells.ctypes.data, cells.shape[1], texels.ctypes.data, *texels.shape[:2])
    library.function("render_deck")(*numbers, mask.ctypes.data, scene.ctypes.data)
    return scene


def exposed(library: Door, rng: np.random.Generator) -> NDArray[Any]:
    scene = rng.integers(0, 65536, (H, W, 4)).astype(np.uint16)
    kinds, gain = rng.integers(0, 5, (H, W)).astype(np.uint8), rng.integers(0, 32768, (H, W)).astype(np.int16)
    exposure, paints = np.array([0.2, 0.9, 3.0, 0.0], np.float32), rng.integers(0, 65536, (5, 4)).astype(np.uint16)
    light = np.zeros(H * W * 3, np.int16)
    arrays = (scene, kinds, gain, exposure, paints, light)
    library.function("render_expose")(H * W, *(array.ctypes.data for array in arrays))
    return light


def imaged(library: Door, rng: np.random.Generator) -> NDArray[Any]:
    """A frame by `render_image`, which the frame of the light by `render_expose` equals."""
    scene, gain = rng.integers(0, 65536, (H, W, 4)).astype(np.uint16), rng.integers(0, 16385, (H, W)).astype(np.int16)
    kinds, exposure = (
        np.where(rng.random((H, W)) < 0.5, 0, rng.integers(0, 5, (H, W))).astype(np.uint8),
        np.array([0.3, 0.7, 1.5, 0]),
    )
    edges = np.sort(rng.choice(H * W, 40, replace=False)).astype(np.int32)
    kinds.flat[edges] = PAD_EDGE
    shares = rng.dirichlet(np.ones(5), len(edges)).astype(np.float32)
    exposure = exposure.astype(np.float32)
    paints, noise = rng.integers(0, 65536, (5, 4)).astype(np.uint16), rng.integers(0, 32, (H, W, 3)).astype(np.uint8)
    codes, scratch = rng.integers(0, 256, 65536).astype(np.uint8), np.zeros(20 * 3 * W, np.uint16)
    light, frame, again = np.zeros(H * W * 3, np.int16), np.zeros((H, W, 3), np.uint8), np.zeros((H, W, 3), np.uint8)
    window, added = np.array([3, 2, 20, 5], np.int32), rng.integers(-400, 400, (5, 3, 20)).astype(np.int16)
    seen = [array.ctypes.data for array in (scene, kinds, gain, exposure, paints)]
    mixed = [len(edges), edges.ctypes.data, shares.ctypes.data]
    lens = [2, *(array.ctypes.data for array in (TAPS, window, added, noise, codes, scratch))]
    library.function("render_image")(H, W, *seen, *mixed, *lens, frame.ctypes.data)
    library.function("render_expose")(H * W, *seen, light.ctypes.data)
    library.function("render_mix")(*mixed, seen[0], *seen[2:], light.ctypes.data)
    library.function("render_frame")(H, W, light.ctypes.data, *lens, again.ctypes.data)
    assert np.array_equal(frame, again)
    return frame


def smeared(library: Door, rng: np.random.Generator) -> NDArray[Any]:
    scene, out = rng.integers(0, 65000, (H, W, 4)).astype(np.uint16), np.zeros((2, H, W, 4), np.uint16)
    shifts, weights = np.array([(-2, 1), (0, 0), (2, -1)], np.int32), np.array([20000, 25000, 20000], np.uint16)
    library.function("render_smear")(H, W, scene.ctypes.data, 3, shifts.ctypes.data, weights.ctypes.data, out[0].ctypes.data)
    library.function("render_average")(H, W, scene.ctypes.data, shifts.ctypes.data, out[1].ctypes.data)
    return out


@pytest.fixture(scope="module")
def one_by_one(tmp_path_factory: pytest.TempPathFactory) -> Door:
    folder: Path = tmp_path_factory.mktemp("core")
    renderer = core.SIMULATED.part("base/digest.c", "render/*.c", "sea/*.c")
    return Door(abi, str(core.build(renderer, folder / "one_by_one.so", ("-DLANES_ONE_BY_ONE", "-O0"))))


@pytest.mark.parametrize("step", [deck, exposed, imaged, smeared])
def test_a_machine_without_vector_instructions_renders_the_same_bits(
    one_by_one: Door, step: Callable[[Door, np.random.Generator], NDArray[Any]]
) -> None:
    here, there = step(SIM, np.random.default_rng(5)), step(one_by_one, np.random.default_rng(5))
    assert np.array_equal(here, there)
    assert np.ptp(here) > 100


def test_an_array_that_the_renderer_would_misread_is_refused() -> None:
    assert address(None, np.uint8) == 0
    assert address(np.zeros((4, 2), np.uint8), np.uint8, (4, 2)) != 0
    with pytest.raises(TypeError, match="uint8"):
        address(np.zeros(3, np.int16), np.uint8)
    with pytest.raises(TypeError, match=r"shape \(4, 2\)"):
        address(np.zeros((2, 4), np.uint8), np.uint8, (4, 2))
    with pytest.raises(TypeError, match="contiguous"):
        address(np.zeros((4, 4), np.uint8)[:, ::2], np.uint8)
