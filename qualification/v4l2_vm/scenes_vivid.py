"""The driver on the vivid camera, whose drops, damages and disconnections come at the press of a button."""

import asyncio
import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from drivers.camera import v4l2_kernel as kernel
from drivers.camera.open_camera import open_camera
from drivers.camera.options import CameraOptions, ExposureOptions, Size
from drivers.camera.v4l2 import cameras
from drivers.camera.v4l2_device import KernelDevice
from drivers.clock import SystemClock
from qualification.v4l2_vm.capture import check_bars, check_stamps, controls_text, refusal, settled, take, until

BY_ID = Path("/dev/v4l/by-id/usb-Decklander_test_camera_0001-video-index0")
DRIVER = Path("/sys/bus/platform/drivers/vivid")
SIZE, SHAPE = (640, 360), (360, 640)
BARS = np.array([(190, 190, 190), (0, 190, 190), (190, 190, 0), (0, 190, 0), (190, 0, 190), (0, 0, 190), (190, 0, 0), (0, 0, 0)])
"""BGR of the 75 % colour bars: white, yellow, cyan, green, magenta, red, blue, black."""


def options(**more: Any) -> tuple[CameraOptions, Size]:
    usual = {"source": "v4l2", "device": str(BY_ID), "format": "YUYV", "reconnect_first_s": 0.1, "reconnect_most_s": 0.4}
    # The test camera stamps its end of frame 0.9 periods ahead of its handing over, as no real one does; its start is true.
    fixed = {"timestamp_source": "Start of Exposure"} | more.pop("controls", {})
    size = more.pop("size", SIZE)
    return CameraOptions(**(usual | {"controls": controls_text(fixed)} | more)), size


def link() -> None:
    """Make the device links as udev does on a real system."""
    BY_ID.parent.mkdir(parents=True, exist_ok=True)
    BY_ID.unlink(missing_ok=True)
    node = next(f.node for f in cameras() if "vivid" in f.card)
    BY_ID.symlink_to(node)


def numbers(fd: int) -> dict[str, int]:
    return {control.name.decode(): control.id for control in kernel.controls(fd)}


def press(name: str) -> None:
    """Press a button of the test camera, from outside the driver."""
    with BY_ID.open("rb") as device:
        kernel.set_control(device.fileno(), numbers(device.fileno())[name], 1)


def held(name: str) -> int:
    with BY_ID.open("rb") as device:
        return kernel.control_value(device.fileno(), numbers(device.fileno())[name])


async def a_camera_without_an_exposure_time_cannot_be_driven() -> None:
    words = await refusal(*options(exposure=ExposureOptions(mode="pad")))
    assert words.endswith('it has no exposure time that can be set; let camera.exposure.mode be "camera"'), words


async def each_format_shows_the_colour_bars() -> None:
    grey = np.repeat((BARS @ (0.0722, 0.7152, 0.2126))[:, None], 3, axis=1)  # the test camera's grey is Rec. 709 luma
    for name, bars in (("NV12", BARS), ("GREY", grey), ("auto", BARS)):
        device = "vivid" if name == "auto" else str(BY_ID)
        async with open_camera(*options(format=name, device=device), SystemClock()) as camera:
            check_bars((await take(camera, 4))[-1], bars, SHAPE)
            await settled(camera)


async def frames_are_stamped_by_the_kernel_on_our_clock() -> None:
    """The test camera reckons its stamps from ticks, so in a slow machine some lie in the future, at times most of them."""
    began = time.monotonic_ns()
    async with open_camera(*options(), SystemClock()) as camera:
        frames = await take(camera, 20)
        check_stamps(frames, await settled(camera), began)
    check_bars(frames[-1], BARS, SHAPE)
    elapsed_s = (frames[-1].stamp.measured_at - frames[0].stamp.measured_at) * 1e-9
    counted = frames[-1].seq - frames[0].seq
    assert counted >= 19
    assert abs(elapsed_s / counted - 1 / 30) < 0.15 / 30
    assert all(-0.006 < frame.stamp.delay_s < 2.0 for frame in frames)


async def the_flags_say_what_the_stamp_is_of() -> None:
    for label, at_start in (("End of Frame", False), ("Start of Exposure", True)):
        fixed = {"timestamp_source": label}
        device = KernelDevice(str(BY_ID), *options(controls=fixed))
        try:
            buffer = device.dequeue()
            while buffer is None:
                await asyncio.sleep(0.01)
                buffer = device.dequeue()
            assert (buffer.at_start, buffer.monotonic) == (at_start, True)
        finally:
            device.close()
        async with open_camera(*options(controls=fixed, exposure_s=0.008, latency_s=0.003), SystemClock()) as camera:
            frames = await take(camera, 3)
            assert {frame.stamp.source for frame in frames} <= {"kernel", "arrival"}
            assert frames[-1].exposure_s == 0.008


async def drops_are_counted_by_the_devices_own_number() -> None:
    async with open_camera(*options(controls={"percentage_of_dropped_buffers": 40}), SystemClock()) as camera:
        frames = await take(camera, 20)
        while camera.counters.frames_lost < 8 and len(frames) < 200:  # the kernel draws which, now and then few of the first
            frames += await take(camera, 10)
        counted = await settled(camera)
    async with open_camera(*options(controls={"percentage_of_dropped_buffers": 0}), SystemClock()) as camera:
        await take(camera, 2)
    assert counted["frames_lost"] >= 4
    missing = frames[-1].seq - frames[0].seq + 1 - len(frames)
    assert missing <= counted["frames_lost"] + counted["frames_overtaken"], (missing, counted)
    # A machine that is slow loses some of its own accord.
    assert counted["frames_lost"] / (counted["frames_lost"] + counted["buffers"]) > 0.4 - 0.25, counted


async def buffers_marked_bad_are_dropped_and_counted() -> None:
    async with open_camera(*options(), SystemClock()) as camera:
        await take(camera, 3)
        for _ in range(2):
            press("Inject V4L2_BUF_FLAG_ERROR")
            await take(camera, 3)
        counted = await settled(camera)
    assert counted["frames_damaged"] == 2, counted


async def a_slow_reader_gets_the_newest() -> None:
    async with open_camera(*options(), SystemClock()) as camera:
        (first,) = await take(camera, 1)
        async with asyncio.timeout(150):  # an emulated machine on a busy one
            await until(lambda: camera.counters.frames_replaced >= 5)
        newest = await camera.frames.get()
        await settled(camera)
    assert newest.seq - first.seq > 5, "the five that were replaced lie between"


async def controls_hold_and_what_cannot_be_is_refused_by_name() -> None:
    left = held("Contrast")
    async with open_camera(*options(controls={"brightness": 77, "gain_automatic": False, "gain": 33}), SystemClock()) as camera:
        await take(camera, 1)
        assert (held("Brightness"), held("Gain"), held("Contrast")) == (77, 33, left)
    refused: tuple[tuple[dict[str, Any], tuple[str, ...]], ...] = (
        ({"controls": {"brightnes": 1}}, ("no control 'brightnes'", "brightness")),
        ({"controls": {"brightness": 9999}}, ("'brightness' must lie in 0..255, got 9999",)),
        ({"controls": {"timestamp_source": "noon"}}, ("'Start of Exposure'", "got 'noon'")),
        ({"size": (650, 400)}, ("no frame of 650x400", "640x360")),
        ({"format": "MJPG"}, ("no MJPG", "YUYV")),
    )
    for more, words in refused:
        text = await refusal(*options(**more))
        assert all(word in text for word in words), text
    absent = options(device="no such camera", silence_s=0.3, reconnect_first_s=0.1, reconnect_most_s=0.1)
    async with open_camera(*absent, SystemClock()) as camera:
        await until(lambda: "no such camera" in (camera.down or ""))


async def unplugging_is_noticed_and_the_camera_comes_back() -> None:
    """The driver disconnects, then the device is torn off its bus; each time it comes back under another name.

    It is noticed by itself and not after some timeout of minutes; an emulated processor on a busy machine keeps no closer time.
    """
    async with open_camera(*options(), SystemClock()) as camera:
        await take(camera, 3)
        for way in ("button", "bus"):
            began = time.monotonic()
            if way == "button":
                press("Disconnect")
            else:
                (DRIVER / "unbind").write_text("vivid.0")
            os.unlink(BY_ID)
            await until(lambda: camera.down is not None)
            assert "it was unplugged" in (camera.down or "")
            assert time.monotonic() - began < 30.0
            if way == "button":
                (DRIVER / "unbind").write_text("vivid.0")
            await asyncio.sleep(0.5)
            (DRIVER / "bind").write_text("vivid.0")
            link()
            back = time.monotonic()
            await until(lambda: camera.down is None)
            check_bars((await take(camera, 4))[-1], BARS, SHAPE)
            assert time.monotonic() - back < 60.0
        counted = await settled(camera)
    assert counted["restarts.unplugged"] == 2, counted
    assert counted["restarts.absent"] >= 1, counted


SCENES = (
    a_camera_without_an_exposure_time_cannot_be_driven, each_format_shows_the_colour_bars,
    frames_are_stamped_by_the_kernel_on_our_clock, the_flags_say_what_the_stamp_is_of,
    drops_are_counted_by_the_devices_own_number, buffers_marked_bad_are_dropped_and_counted, a_slow_reader_gets_the_newest,
    controls_hold_and_what_cannot_be_is_refused_by_name, unplugging_is_noticed_and_the_camera_comes_back,
)  # fmt: skip
