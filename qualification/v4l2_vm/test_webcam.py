"""The V4L2 driver through the kernel's `uvcvideo`, which most cameras use: judged from what the guest reports."""

import numpy as np
import pytest

from drivers.camera.exposure import TARGET
from qualification.v4l2_vm.capture import Seen, accounted
from qualification.v4l2_vm.conftest import NEEDS_A_MACHINE
from qualification.v4l2_vm.scenes_webcam import BARS
from qualification.v4l2_vm.webcam import CARD

pytestmark = NEEDS_A_MACHINE


def shows_bars(shot: Seen, within: float = 4.0) -> bool:
    return bool(np.abs(np.array(shot["bars_bgr"]) - BARS.astype(int)).max() <= within)


def test_each_format_arrives_whole_and_stamped(seen: dict[str, Seen]) -> None:
    shots = seen["webcam_formats"]
    assert len(shots["nodes"]) == 2  # frames and metadata; a part of the name means the one with frames
    assert all(CARD in card for card in shots["nodes"])
    for name in ("YUYV", "MJPG", "H264", "auto"):
        shot = shots[name]
        assert shot["shape"] == [240, 320, 3]
        assert shows_bars(shot)
        assert accounted(shot)
        assert shot["frames_damaged"] == 0
        # Where the machine stands still for seconds, a stamp is too old to be believed, which is counted.
        assert shot["source"].count("kernel") >= len(shot["source"]) // 2
        assert shot["stamps_refused"] == shot["source"].count("arrival")
        assert shot["before"] < min(shot["taken"]) < max(shot["taken"]) < shot["after"]
        by_kernel = [measured_at for measured_at, source in zip(shot["taken"], shot["source"], strict=True) if source == "kernel"]
        assert by_kernel == sorted(set(by_kernel))


def test_auto_takes_the_format_that_has_the_size(seen: dict[str, Seen]) -> None:
    assert seen["webcam_formats"]["larger"]["shape"] == [480, 640, 3]
    assert shows_bars(seen["webcam_formats"]["larger"])


def test_the_exposure_is_fixed_switch_first_and_travels_with_each_frame(seen: dict[str, Seen]) -> None:
    fixed = seen["webcam_controls"]["fixed"]
    assert (fixed["mode"], fixed["exposure"], fixed["exposure_s"]) == (1, 50, 0.005)


def test_an_exposure_the_camera_governs_itself_is_refused_by_name(seen: dict[str, Seen]) -> None:
    kind, text = seen["webcam_controls"]["refused"]
    assert kind == "BadInput"
    assert "'exposure_time_absolute' cannot be set to 60 now" in text


@pytest.mark.parametrize("fault", ["torn", "marked"])
@pytest.mark.parametrize("name", ["YUYV", "MJPG", "H264"])
def test_a_damaged_image_is_counted_and_never_given_out(seen: dict[str, Seen], name: str, fault: str) -> None:
    shot = seen["webcam_damage"][name][fault]
    # The kernel keeps back what it knows to be damaged, and its count of frames shows the gap; one overtaken is not looked at.
    assert shot["frames_damaged"] + shot["frames_lost"] + shot["frames_overtaken"] >= 1
    assert accounted(shot)
    assert shot["worst"] <= 6
    assert (shot["frames_waiting"] > 0) == (
        name == "H264"
    )  # what follows a lost frame cannot be read until one that stands alone


def test_a_camera_pulled_out_comes_back_with_its_exposure(seen: dict[str, Seen]) -> None:
    shot = seen["webcam_unplugged"]
    assert "No such device" in shot["down"]
    assert shot["noticed_s"] < 1.5
    assert shot["restarts.unplugged"] == 1
    assert shows_bars(shot["back"])
    assert (shot["back"]["exposure"], shot["back"]["exposure_s"]) == (50, 0.005)
    assert accounted(shot)


def test_a_driven_exposure_brings_the_pad_to_its_level(seen: dict[str, Seen]) -> None:
    shot = seen["webcam_exposure"]
    for name in ("bright", "dark", "moving"):
        assert all(0.4 * TARGET < level < 1.4 * TARGET for level in shot[name]["levels"][-10:]), (name, shot[name])
        (held_s, gain), (mode, units, auto_balance, balance) = shot[name]["held"], shot[name]["camera"]
        assert (mode, auto_balance, balance) == (1, 0, 6500)
        assert held_s == pytest.approx(1e-4 * units)
        assert shot[name]["frame"] == [held_s, gain]
    assert shot["dark"]["held"][0] * shot["dark"]["held"][1] > 10 * shot["bright"]["held"][0]
    assert shot["moving"]["held"][0] <= 1.5 / 500.0 < shot["dark"]["held"][0]


def test_a_refused_exposure_is_counted_and_frames_go_on(seen: dict[str, Seen]) -> None:
    shot = seen["webcam_exposure"]
    assert shot["refusals"] >= 1
    assert shot["why"]
    assert len(shot["refused"]["levels"]) == 20
    assert accounted(shot)
