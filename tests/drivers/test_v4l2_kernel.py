"""The kernel's calls for video: their numbers, which hold the size of each struct, and where the fields lie in it."""

import errno
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivers.camera import v4l2_kernel
from drivers.camera import v4l2_kernel as kernel
from drivers.camera.exposure_options import ExposureOptions
from drivers.camera.v4l2_device import KernelExposure

CALLS = (
    "QUERYCAP", "ENUM_FMT", "S_FMT", "REQBUFS", "QUERYBUF", "QBUF", "DQBUF", "STREAMON", "STREAMOFF", "G_PARM", "S_PARM",
    "G_CTRL", "S_CTRL", "QUERYMENU", "G_EXT_CTRLS", "S_EXT_CTRLS", "QUERY_EXT_CTRL",
)  # fmt: skip
STRUCTS = {
    "v4l2_capability": kernel.Capability, "v4l2_fmtdesc": kernel.FormatDescription, "v4l2_pix_format": kernel.PixelFormat,
    "v4l2_format": kernel.Format, "v4l2_requestbuffers": kernel.RequestBuffers, "v4l2_buffer": kernel.KernelBuffer,
    "v4l2_control": kernel.ControlValue, "v4l2_query_ext_ctrl": kernel.VideoControl, "v4l2_querymenu": kernel.MenuEntry,
    "v4l2_ext_control": kernel.WideControl, "v4l2_ext_controls": kernel.WideControls,
}  # fmt: skip


def test_a_call_has_the_number_that_the_documentation_gives() -> None:
    assert (kernel.QUERYCAP, kernel.S_FMT, kernel.DQBUF, kernel.STREAMON) == (0x80685600, 0xC0D05605, 0xC0585611, 0x40045612)


def test_the_calls_and_structs_are_those_of_the_kernel_s_header(tmp_path: Path) -> None:
    if shutil.which("cc") is None or not Path("/usr/include/linux/videodev2.h").is_file():
        pytest.skip("there is no compiler, or no header of the kernel")
    lines = [f'printf("VIDIOC_{name} %lu\\n", (unsigned long)VIDIOC_{name});' for name in CALLS]
    wanted = {f"VIDIOC_{name}": getattr(kernel, name) for name in CALLS}
    for name, ours in STRUCTS.items():
        for field in (field[0] for field in ours._fields_):
            lines.append(f'printf("{name}.{field} %zu\\n", offsetof(struct {name}, {field}));')
            wanted[f"{name}.{field}"] = getattr(ours, field).offset
    lines.append('printf("parm %zu\\n", offsetof(struct v4l2_streamparm, parm.capture.timeperframe));')
    wanted["parm"] = kernel.StreamParameters.numerator.offset
    source = tmp_path / "layout.c"
    source.write_text(
        "#include <linux/videodev2.h>\n#include <stddef.h>\n#include <stdio.h>\nint main(void) {\n"
        + "\n".join(lines)
        + "\nreturn 0; }\n"
    )
    subprocess.run(["cc", str(source), "-o", str(tmp_path / "layout")], check=True)
    output = subprocess.run([str(tmp_path / "layout")], capture_output=True, text=True, check=True).stdout
    assert {line.split()[0]: int(line.split()[1]) for line in output.splitlines()} == wanted


def test_a_pixel_format_is_its_letters() -> None:
    assert kernel.fourcc(0x56595559) == "YUYV"
    assert kernel.fourcc(0x20363159) == "Y16"
    assert kernel.fourcc(0xB6363159) == "Y166"


_MODE, _TIME = 0x009A0901, 0x009A0902


def controls(_: int) -> list[SimpleNamespace]:
    usual = {"minimum": 1, "maximum": 5000, "step": 1, "type": 1, "name": b"control"}
    return [SimpleNamespace(id=number, **usual) for number in (_MODE, _TIME)]


@pytest.fixture
def values(monkeypatch: pytest.MonkeyPatch) -> dict[int, int]:
    """Return the values of the device's controls, by number."""
    held = {_MODE: 3, _TIME: 156}
    monkeypatch.setattr(v4l2_kernel, "controls", controls)
    monkeypatch.setattr(v4l2_kernel, "control_value", lambda _fd, number, _type: held[number])
    monkeypatch.setattr(v4l2_kernel, "set_control", lambda _fd, number, value, _type: held.update({number: value}))
    return held


def refuse_times(monkeypatch: pytest.MonkeyPatch, held: dict[int, int], code: int) -> None:
    def set_control(_fd: int, number: int, value: int, _type: int) -> None:
        if number == _TIME:
            raise OSError(code, "refused")
        held[number] = value

    monkeypatch.setattr(v4l2_kernel, "set_control", set_control)


def test_a_camera_that_refuses_a_time_when_it_is_opened_gives_frames_with_the_one_it_holds(values, monkeypatch):
    """A camera that is lost in flight and comes back stubborn must not stay lost."""
    refuse_times(monkeypatch, values, errno.EILSEQ)
    exposure = KernelExposure(3, "/dev/video0", ExposureOptions(mode="pad"), 30.0)
    assert (exposure.held.exposure_s, exposure.held.gain) == (pytest.approx(0.0156), 1.0)
    assert values[_MODE] == 1


def test_a_camera_that_is_gone_while_its_exposure_is_taken_over_is_gone(values, monkeypatch):
    refuse_times(monkeypatch, values, errno.ENODEV)
    with pytest.raises(OSError, match="refused"):
        KernelExposure(3, "/dev/video0", ExposureOptions(mode="pad"), 30.0)


def test_an_exposure_longer_than_the_frame_allows_is_cut_when_it_is_taken_over(values: dict[int, int]) -> None:
    values[_TIME] = 5000
    exposure = KernelExposure(3, "/dev/video0", ExposureOptions(mode="pad"), 30.0)
    assert exposure.held.exposure_s == pytest.approx(1e-4 * values[_TIME])
    assert values[_TIME] == 266
