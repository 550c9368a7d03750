"""The meaning of the system's errors at a camera, a serial port and a network is what the drivers say."""

import asyncio
import errno
import os
from pathlib import Path

import pytest

from drivers.camera.options import CameraOptions, Size
from drivers.camera.source import CameraLost, VideoSource
from drivers.camera.v4l2 import V4l2Channel
from drivers.camera.v4l2_device import KernelDevice
from drivers.clock import SystemClock
from drivers.device_errors import DEVICE_ERRORS, device_fault


def test_no_device_passes_on_words_about_a_disk_and_what_the_table_lacks_is_the_system_s() -> None:
    for device, table in DEVICE_ERRORS.items():
        assert errno.ENOSPC not in table or "disk" not in table[errno.ENOSPC]
        assert device_fault(OSError(errno.EDOM, "out of domain"), device) == "out of domain"
        assert device_fault(OSError("no number"), device) == "no number"


@pytest.mark.parametrize(("number", "reason"), [(errno.ENOSPC, "failed"), (errno.EBUSY, "failed"), (errno.ENODEV, "absent")])
def test_a_camera_that_does_not_begin_says_why(tmp_path: Path, number: int, reason: str) -> None:
    node = tmp_path / "video2"
    node.touch()

    def fails(path: str, options: CameraOptions, size: Size) -> KernelDevice:
        raise OSError(number, os.strerror(number))

    options = CameraOptions(source="v4l2", device=str(node))
    channel = V4l2Channel(options, (640, 480), SystemClock(), VideoSource(), fails)
    with pytest.raises(CameraLost) as lost:
        asyncio.run(channel.run())
    assert str(lost.value) == f"{node}: {DEVICE_ERRORS['camera'][number]}"
    assert lost.value.reason == reason
