"""The V4L2 driver on the kernel's `vivid` camera: judged from what the guest reports."""

import numpy as np
import pytest

from qualification.v4l2_vm.capture import Seen, accounted
from qualification.v4l2_vm.conftest import NEEDS_A_MACHINE

pytestmark = NEEDS_A_MACHINE
BARS = [(190, 190, 190), (0, 190, 190), (190, 190, 0), (0, 190, 0), (190, 0, 190), (0, 0, 190), (190, 0, 0), (0, 0, 0)]
"""BGR of the 75 % colour bars: white, yellow, cyan, green, magenta, red, blue, black."""


def test_each_format_shows_the_colour_bars(seen: dict[str, Seen]) -> None:
    for name in ("YUYV", "NV12"):
        assert np.abs(np.array(seen["formats"][name]["bars_bgr"]) - BARS).max() <= 4
    grey = np.array(seen["formats"]["GREY"]["bars_bgr"])
    luma = np.array(BARS) @ (0.0722, 0.7152, 0.2126)  # the test camera's grey is Rec. 709 luma
    assert np.abs(grey - luma[:, None]).max() <= 4
    for name in ("YUYV", "NV12", "GREY"):
        assert seen["formats"][name]["shape"] == [360, 640, 3]
        assert accounted(seen["formats"][name])
    assert seen["automatic"]["shape"] == [360, 640, 3]
    assert np.abs(np.array(seen["automatic"]["bars_bgr"]) - BARS).max() <= 4


def test_frames_are_stamped_by_the_kernel_on_our_clock(seen: dict[str, Seen]) -> None:
    shot = seen["formats"]["YUYV"]
    # The test camera reckons its stamps from ticks, so in a machine that is slow some lie in the future, at times most of them.
    # Those are refused and counted.
    assert "kernel" in shot["source"]
    assert set(shot["source"]) <= {"kernel", "arrival"}
    assert shot["stamps_refused"] == shot["source"].count("arrival")
    assert shot["before"] < min(shot["taken"]) < max(shot["taken"]) < shot["after"]
    elapsed_s, counted = (shot["taken"][-1] - shot["taken"][0]) * 1e-9, shot["seq"][-1] - shot["seq"][0]
    assert counted >= 19
    assert elapsed_s / counted == pytest.approx(1 / 30, rel=0.15)
    assert all(-0.006 < delay_s < 2.0 for delay_s in shot["delay_s"])


def test_the_flags_say_what_the_stamp_is_of(seen: dict[str, Seen]) -> None:
    end, start = seen["stamps"]["End of Frame"], seen["stamps"]["Start of Exposure"]
    assert (end["at_start"], end["monotonic"]) == (False, True)
    assert (start["at_start"], start["monotonic"]) == (True, True)
    assert set(start["frame"]["source"]) <= {"kernel", "arrival"}
    assert start["frame"]["exposure_s"] == 0.008


def test_drops_are_counted_by_the_devices_own_number(seen: dict[str, Seen]) -> None:
    shot = seen["drops"]
    assert accounted(shot)
    assert shot["frames_lost"] >= 4
    missing = shot["seq"][-1] - shot["seq"][0] + 1 - len(shot["seq"])
    assert missing <= shot["frames_lost"] + shot["frames_overtaken"]
    # A machine that is slow loses some of its own accord.
    assert shot["frames_lost"] / (shot["frames_lost"] + shot["buffers"]) > 0.4 - 0.25


def test_buffers_marked_bad_are_dropped_and_counted(seen: dict[str, Seen]) -> None:
    assert seen["damage"]["frames_damaged"] == 2
    assert accounted(seen["damage"])


def test_a_slow_reader_gets_the_newest(seen: dict[str, Seen]) -> None:
    first, newest = seen["slow_reader"]["seq"]
    assert newest - first > 5, "the five that were replaced lie between"
    assert accounted(seen["slow_reader"])


def test_controls_hold_and_what_cannot_be_is_refused_by_name(seen: dict[str, Seen]) -> None:
    shot = seen["controls"]
    assert (shot["brightness"], shot["gain"]) == (77, 33)
    assert shot["contrast"][0] == shot["contrast"][1]
    for name, words in {
        "unknown": ("no control 'brightnes'", "brightness"),
        "range": ("'brightness' must lie in 0..255, got 9999",),
        "label": ("'Start of Exposure'", "got 'noon'"),
        "size": ("no frame of 650x400", "640x360"),
        "format": ("no MJPG", "YUYV"),
    }.items():
        kind, text = shot[name]
        assert kind == "BadInput"
        assert all(word in text for word in words)
    assert shot["ambiguous_or_none"][0] == "down"
    assert "no such camera" in shot["ambiguous_or_none"][1]


def test_unplugging_is_noticed_and_the_camera_comes_back(seen: dict[str, Seen]) -> None:
    shot = seen["unplugged"]
    for way in ("button", "bus"):
        assert "No such device" in shot[f"{way}_down"]
        # By itself, and not after some timeout of minutes; an emulated processor beside other programs keeps no closer time.
        assert shot[f"{way}_noticed_s"] < 30.0
        assert shot[f"{way}_back_s"] < 60.0
        assert np.abs(np.array(shot[f"{way}_frames"]["bars_bgr"]) - BARS).max() <= 4
    assert shot["restarts.unplugged"] == 2
    assert shot["restarts.absent"] >= 1
    assert accounted(shot)


def test_a_camera_without_an_exposure_time_cannot_be_driven(seen: dict[str, Seen]) -> None:
    kind, text = seen["exposure"]["refused"]
    assert kind == "BadInput"
    assert text.endswith('it has no exposure time that can be set; let camera.exposure.mode be "camera"')
