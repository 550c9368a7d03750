"""The native core fits the interface that Python expects, or is refused with the cure."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.contracts.errors import SetupImpossible
from estimator.core import abi
from estimator.core.abi import DL_WRONG_SIZE
from estimator.core.library import CORE, Door
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.native import checked, image_of, tracker_of
from estimator.vision.pad.shape import pad_shape
from sitl.core import abi as sim_abi
from sitl.core.library import SIM
from supply import core
from tests.support.pad_scenes import load_camera, load_pad

ROOT = Path(__file__).parents[3]


def entries(door: Door) -> set[str]:
    """Return the names of the functions that a library's header declares."""
    return {name for name in dir(door.lib) if not isinstance(getattr(door.lib, name), int)}


def test_each_library_has_what_its_header_declares() -> None:
    for door, made, library in ((CORE, abi, core.FLYING), (SIM, sim_abi, core.SIMULATED)):
        assert library.digest == made.DIGEST, "make core"
        assert {"dl_digest"} < entries(door)
    with pytest.raises(AttributeError, match="take_off"):
        CORE.lib.take_off()


def test_another_structure_another_kind_or_size_is_refused() -> None:
    picture, lens = CORE.ffi.new("dl_uvlc_picture *"), CORE.record("dl_lens", width=640, distortion=[0.1, 0.2])
    with pytest.raises(TypeError, match="dl_uvlc_picture"):
        CORE.lib.dl_uvlc_header(b"", 0, CORE.array("dl_lens", lens))
    with pytest.raises(TypeError, match="takes dl_lens, not"):
        CORE.array("dl_lens", np.zeros(1, CORE.dtype("dl_uvlc_picture")))
    with pytest.raises(TypeError, match="float32"):
        CORE.array("double", np.zeros(3, np.float32))
    with pytest.raises(ValueError, match="takes 9 of double, not 8"):
        CORE.array("double", np.zeros(8), 9)
    with pytest.raises(ValueError, match="contiguous"):
        CORE.array("double", np.zeros((3, 3)).T[:, :2])
    assert CORE.array("double", np.zeros((3, 3)), 9)
    assert picture.width == 0


def test_a_record_is_written_by_the_names_of_the_header() -> None:
    lens = CORE.record("dl_lens", width=640, distortion=[0.1, 0.2])
    assert (lens["width"], *lens["distortion"]) == (640, 0.1, 0.2, 0.0, 0.0, 0.0)
    nested = CORE.record("dl_pad_shape", zones=[{}, {"box_m": np.ones(4)}], wedge={"sides": 3})
    assert nested["zones"]["box_m"].sum(axis=1).tolist() == [0.0, 4.0, 0.0, 0.0, 0.0]
    assert nested["wedge"]["sides"] == 3
    with pytest.raises(ValueError, match="widht"):
        CORE.record("dl_lens", widht=640)
    with pytest.raises(ValueError, match="distortion holds 5 elements, not 6"):
        CORE.record("dl_lens", distortion=np.zeros(6))
    with pytest.raises(TypeError, match="float64"):
        CORE.record("dl_lens", width=640.5)
    assert list(CORE.names("dl_uvlc_result"))[:2] == ["DL_UVLC_DONE", "DL_UVLC_SHORT"]


def test_a_missing_library_or_one_of_another_interface_is_refused_with_the_cure(tmp_path: Path) -> None:
    with pytest.raises(SetupImpossible, match=r"none\.so cannot be loaded .*make core"):
        Door(abi, str(tmp_path / "none.so"))
    (tmp_path / "torn.so").write_bytes(core.FLYING.file.read_bytes()[:100])
    with pytest.raises(SetupImpossible, match=r"torn\.so cannot be loaded .*make core"):
        Door(abi, str(tmp_path / "torn.so"))
    other = core.build(core.SIMULATED.part("base/digest.c"), tmp_path / "other.so")
    with pytest.raises(SetupImpossible, match=rf"built for interface {sim_abi.DIGEST:08x}, this code needs .*make core"):
        Door(abi, str(other))


def test_a_library_without_the_core_in_it_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.c").write_text("int nothing(void) { return 0; }\n")
    subprocess.run([*core.compiler(), "-shared", "-fPIC", "empty.c", "-o", "empty.so"], cwd=tmp_path, check=True)
    with pytest.raises(SetupImpossible, match=r"empty\.so is not the native core; .*make core"):
        Door(abi, str(tmp_path / "empty.so"))


@pytest.mark.parametrize("unbuilt", ["*.so*", "abi.py"])
def test_the_command_line_says_the_cure_in_one_line(unbuilt: str, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "estimator", tmp_path / "estimator", ignore=shutil.ignore_patterns(unbuilt, "__pycache__"))
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from companion.cli.main import main; sys.exit(main(sys.argv[1:]))"
    output = subprocess.run(
        [sys.executable, "-c", code, "simulate", "calm"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert output.returncode == 1
    assert "make core" in output.stderr
    assert "circular import" not in output.stderr
    assert len(output.stderr.splitlines()) == 1, output.stderr


def test_without_a_compiler_the_build_names_both(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(core.BuildError, match=r"apt install gcc.*compiler\.txt"):
        core.build(core.FLYING)


def test_a_source_that_the_compiler_refuses_leaves_the_library_as_it_was(tmp_path: Path) -> None:
    out = tmp_path / "libdecklander.so.1"
    out.write_bytes(b"before")
    with pytest.raises(core.BuildError, match="uint32_t"):
        core.build(core.FLYING.part("base/digest.c"), out, ("-Duint32_t=(",))
    assert out.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [out]


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
