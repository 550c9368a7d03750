"""Taking over the exposure of a V4L2 device, on controls in memory. On real kernel devices: qualification/v4l2_vm."""

import errno
from types import SimpleNamespace

import pytest

from drivers.camera import v4l2_kernel
from drivers.camera.exposure_options import ExposureOptions
from drivers.camera.v4l2_device import KernelExposure

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
