"""The kernel's calls for video: their numbers, which hold the size of each struct, and where the fields lie in it."""

import shutil
import subprocess
from pathlib import Path

import pytest

from drivers.camera import v4l2_kernel as kernel

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
