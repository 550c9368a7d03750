"""The driver on the vivid camera, whose drops, damages and disconnections come at the press of a button."""

import asyncio
import os
import time
from pathlib import Path
from typing import Any

from drivers.camera import v4l2_kernel as kernel
from drivers.camera.exposure_options import ExposureOptions
from drivers.camera.open_camera import open_camera
from drivers.camera.options import CameraOptions, Size
from drivers.camera.v4l2 import cameras
from drivers.camera.v4l2_device import KernelDevice
from drivers.clock import SystemClock
from estimator.contracts.errors import DecklanderError
from qualification.v4l2_vm.capture import Seen, controls_text, describe, settled, take, until

BY_ID = Path("/dev/v4l/by-id/usb-Decklander_test_camera_0001-video-index0")
DRIVER = Path("/sys/bus/platform/drivers/vivid")
SIZE = (640, 360)


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


def unlink() -> None:
    BY_ID.unlink()


def numbers(fd: int) -> dict[str, int]:
    return {control.name.decode(): control.id for control in kernel.controls(fd)}


def press(name: str) -> None:
    """Press a button of the test camera, from outside the driver."""
    with BY_ID.open("rb") as device:
        kernel.set_control(device.fileno(), numbers(device.fileno())[name], 1)


def held(name: str) -> int:
    with BY_ID.open("rb") as device:
        return kernel.control_value(device.fileno(), numbers(device.fileno())[name])


async def formats() -> Seen:
    out: Seen = {}
    for name in ("YUYV", "NV12", "GREY"):
        before = time.monotonic_ns()
        async with open_camera(*options(format=name), SystemClock()) as camera:
            frames = await take(camera, 20 if name == "YUYV" else 4)
            out[name] = describe(frames) | {"before": before, "after": time.monotonic_ns(), **await settled(camera)}
    return out


async def automatic() -> Seen:
    async with open_camera(*options(format="auto", device="vivid"), SystemClock()) as camera:
        return describe(await take(camera, 3))


async def stamps() -> Seen:
    """Return the flags as the kernel sets them, and what half an exposure does to the instant."""
    out: Seen = {}
    for label in ("End of Frame", "Start of Exposure"):
        fixed = {"timestamp_source": label}
        device = KernelDevice(str(BY_ID), *options(controls=fixed))
        try:
            buffer = device.dequeue()
            while buffer is None:
                await asyncio.sleep(0.01)
                buffer = device.dequeue()
            out[label] = {
                "at_start": buffer.at_start,
                "monotonic": buffer.monotonic,
                "age_ns": time.monotonic_ns() - buffer.stamp_ns,
            }
        finally:
            device.close()
        async with open_camera(*options(controls=fixed, exposure_s=0.008, latency_s=0.003), SystemClock()) as camera:
            out[label]["frame"] = describe(await take(camera, 3))
    return out


async def drops() -> Seen:
    async with open_camera(*options(controls={"percentage_of_dropped_buffers": 40}), SystemClock()) as camera:
        frames = await take(camera, 20)
        while camera.counters.frames_lost < 8 and len(frames) < 200:  # the kernel draws which, now and then few of the first
            frames += await take(camera, 10)
        out = describe(frames) | await settled(camera)
    async with open_camera(*options(controls={"percentage_of_dropped_buffers": 0}), SystemClock()) as camera:
        await take(camera, 2)
    return out


async def damage() -> Seen:
    async with open_camera(*options(), SystemClock()) as camera:
        await take(camera, 3)
        for _ in range(2):
            press("Inject V4L2_BUF_FLAG_ERROR")
            await take(camera, 3)
        return await settled(camera)


async def slow_reader() -> Seen:
    async with open_camera(*options(), SystemClock()) as camera:
        (first,) = await take(camera, 1)
        async with asyncio.timeout(150):  # an emulated machine on a busy one
            await until(lambda: camera.counters.frames_replaced >= 5)
        newest = await camera.frames.get()
        return {"seq": [first.seq, newest.seq], **await settled(camera)}


async def controls() -> Seen:
    left = held("Contrast")
    async with open_camera(*options(controls={"brightness": 77, "gain_automatic": False, "gain": 33}), SystemClock()) as camera:
        await take(camera, 1)
        out: Seen = {"brightness": held("Brightness"), "gain": held("Gain"), "contrast": [left, held("Contrast")]}
    for name, more in {
        "unknown": {"controls": {"brightnes": 1}},
        "range": {"controls": {"brightness": 9999}},
        "label": {"controls": {"timestamp_source": "noon"}},
        "size": {"size": (650, 400)},
        "format": {"format": "MJPG"},
        "ambiguous_or_none": {"device": "no such camera", "silence_s": 0.3, "reconnect_first_s": 0.1, "reconnect_most_s": 0.1},
    }.items():
        try:
            async with open_camera(*options(**more), SystemClock()) as camera:
                if name == "ambiguous_or_none":
                    await until(lambda camera=camera: "no such camera" in (camera.down or ""))
                    out[name] = ["down", camera.down]
                else:
                    await camera.frames.get()
        except DecklanderError as why:
            out[name] = [type(why).__name__, str(why)]
    return out


async def unplugged() -> Seen:
    """Twice: the driver's own disconnect, then the device torn off its bus; each time it comes back under another name."""
    out: Seen = {}
    async with open_camera(*options(), SystemClock()) as camera:
        await take(camera, 3)
        out["first"] = os.readlink(BY_ID)
        for way in ("button", "bus"):
            began = time.monotonic()
            if way == "button":
                press("Disconnect")
                unlink()
                await until(lambda: camera.down is not None)
                out["button_down"] = camera.down
                (DRIVER / "unbind").write_text("vivid.0")
            else:
                (DRIVER / "unbind").write_text("vivid.0")
                unlink()
                await until(lambda: camera.down is not None)
                out["bus_down"] = camera.down
            out[f"{way}_noticed_s"] = round(time.monotonic() - began, 3)
            await asyncio.sleep(0.5)
            (DRIVER / "bind").write_text("vivid.0")
            link()
            back = time.monotonic()
            await until(lambda: camera.down is None)
            newest = await take(camera, 4)
            out[f"{way}_back_s"] = round(time.monotonic() - back, 3)
            out[f"{way}_frames"] = describe(newest)
        out |= camera.counters.as_dict()
    return out


async def exposure() -> Seen:
    """Return the result for a test camera with a gain and no exposure time."""
    try:
        async with open_camera(*options(exposure=ExposureOptions(mode="pad")), SystemClock()) as camera:
            await take(camera, 1)
    except DecklanderError as why:
        return {"refused": [type(why).__name__, str(why)]}
    return {}


SCENES = (exposure, formats, automatic, stamps, drops, damage, slow_reader, controls, unplugged)
