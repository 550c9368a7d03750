"""The renderer's part of the native core: the same bits with and without vector instructions, and arrays that are refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.core.library import Door
from sitl.core import abi
from sitl.core.abi import DL_PAD_EDGE, DL_PAD_PAINTS
from sitl.core.library import SIM
from supply import core

H, W, TAPS = 10, 24, np.array([40000, 12000, 768], np.uint16)


def deck_samples(library: Door, rng: np.random.Generator) -> NDArray[Any]:
    """Positions of texels from well outside the drawing on one side to the other, under a mask with every coverage."""
    across, down = np.meshgrid(np.linspace(-20.0, 70.0, W // 8 + 2), np.linspace(-15.0, 50.0, 2 + 2))
    cells = np.stack([across, down + 0.3 * across], axis=-1).astype(np.float32)
    texels = rng.integers(0, 65536, (32, 40, 4)).astype(np.uint16)
    mask = rng.integers(0, 256, (H, W)).astype(np.uint8)
    scene = rng.integers(0, 65536, (H, W, 4)).astype(np.uint16)
    part, drawn = library.new("dl_sim_frame_part", w=W, x1=W, y1=H), library.new("dl_sim_drawing", texels=texels, h=32, w=40)
    where = library.new("dl_sim_plane_cells", at=cells, columns=cells.shape[1])
    library.lib.dl_sim_render_deck(part, where, drawn, library.array("uint8_t", mask), library.array("uint16_t", scene))
    return scene


def lit(library: Door, rng: np.random.Generator) -> Any:
    """Return a scene in a light with a pad's paints and edges on it."""
    kinds, edges = (
        rng.integers(0, DL_PAD_PAINTS, (H, W)).astype(np.uint8),
        np.sort(rng.choice(H * W, 40, replace=False)).astype(np.int32),
    )
    kinds.flat[edges] = DL_PAD_EDGE
    return library.new(
        "dl_sim_lit_scene", h=H, w=W, edges=len(edges), where=edges, kinds=kinds,
        scene=rng.integers(0, 65536, (H, W, 4)).astype(np.uint16), gain=rng.integers(0, 16385, (H, W)).astype(np.int16),
        exposure=np.array([0.3, 0.9, 3.0, 0.0], np.float32),
        pad_scene=rng.integers(0, 65536, (DL_PAD_PAINTS, 4)).astype(np.uint16),
        shares=rng.dirichlet(np.ones(DL_PAD_PAINTS), len(edges)).astype(np.float32),
    )  # fmt: skip


def exposed(library: Door, rng: np.random.Generator) -> NDArray[Any]:
    light = np.zeros(H * W * 3, np.int16)
    library.lib.dl_sim_render_expose(lit(library, rng), library.array("int16_t", light))
    return light


def imaged(library: Door, rng: np.random.Generator) -> NDArray[Any]:
    """Return a frame by `dl_sim_render_image`, which the frame of the light by `dl_sim_render_expose` equals."""
    seen, light = lit(library, rng), library.array("int16_t", np.zeros(H * W * 3, np.int16))
    blur = library.new(
        "dl_sim_lens_blur", radius=2, numbers=20 * 3 * W, taps=TAPS, scratch=np.zeros(20 * 3 * W, np.uint16),
        window=np.array([3, 2, 20, 5], np.int32), added=rng.integers(-400, 400, (5, 3, 20)).astype(np.int16),
    )  # fmt: skip
    noise, codes = rng.integers(0, 32, (H, W, 3)).astype(np.uint8), rng.integers(0, 256, 65536).astype(np.uint8)
    tone = library.new("dl_sim_sensor_tone", noise=noise, codes=codes)
    frame, again = np.zeros((H, W, 3), np.uint8), np.zeros((H, W, 3), np.uint8)
    assert library.lib.dl_sim_render_image(seen, blur, tone, library.array("uint8_t", frame))
    library.lib.dl_sim_render_expose(seen, light)
    library.lib.dl_sim_render_mix(seen, light)
    assert library.lib.dl_sim_render_frame(H, W, light, blur, tone, library.array("uint8_t", again))
    assert np.array_equal(frame, again)
    blur.numbers = 3 * W
    assert not library.lib.dl_sim_render_image(seen, blur, tone, library.array("uint8_t", frame))
    return frame


def smeared(library: Door, rng: np.random.Generator) -> NDArray[Any]:
    scene, out = rng.integers(0, 65000, (H, W, 4)).astype(np.uint16), np.zeros((2, H, W, 4), np.uint16)
    shifts, weights = np.array([(-2, 1), (0, 0), (2, -1)], np.int32), np.array([20000, 25000, 20000], np.uint16)
    weighed = library.array("int32_t", shifts), library.array("uint16_t", weights)
    seen, (first, second) = library.array("uint16_t", scene), (library.array("uint16_t", each) for each in out)
    library.lib.dl_sim_render_smear(H, W, seen, 3, *weighed, first)
    library.lib.dl_sim_render_average(H, W, seen, weighed[0], second)
    return out


@pytest.fixture(scope="module")
def one_by_one(tmp_path_factory: pytest.TempPathFactory) -> Door:
    folder: Path = tmp_path_factory.mktemp("core")
    renderer = core.SIMULATED.part("base/digest.c", "render/*.c", "sea/*.c")
    return Door(abi, str(core.build(renderer, folder / "one_by_one.so", ("-DLANES_ONE_BY_ONE", "-O0"))))


@pytest.mark.parametrize("step", [deck_samples, exposed, imaged, smeared])
def test_a_machine_without_vector_instructions_renders_the_same_bits(one_by_one, step):
    here, there = step(SIM, np.random.default_rng(5)), step(one_by_one, np.random.default_rng(5))
    assert np.array_equal(here, there)
    assert np.ptp(here) > 100
