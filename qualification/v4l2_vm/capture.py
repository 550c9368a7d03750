"""Shared steps of the guest's scenes: take frames, wait for the counters, and judge both."""

import asyncio
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from drivers.camera.open_camera import open_camera
from drivers.camera.options import CameraOptions, Size
from drivers.camera.source import VideoSource
from drivers.clock import SystemClock
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Frame


def controls_text(values: dict[str, int | bool | str]) -> str:
    """Return controls as the key `controls` has them."""
    return ", ".join(f"{name}={str(value).lower() if isinstance(value, bool) else value}" for name, value in values.items())


async def until(true: Callable[[], bool]) -> None:
    while not true():  # noqa: ASYNC110
        await asyncio.sleep(0.02)


async def settled(camera: VideoSource) -> dict[str, int]:
    """Return the counters once each buffer has ended in exactly one verdict: one that is still being decoded has none."""
    for _ in range(200):
        counted = camera.counters.as_dict()
        parts = (counted[name] for name in ("frames", "frames_overtaken", "frames_damaged", "frames_waiting"))
        if counted["buffers"] == sum(parts) > 0:
            return counted
        await asyncio.sleep(0.01)
    raise AssertionError(f"a buffer has no verdict: {counted}")


async def take(camera: VideoSource, n: int) -> list[Frame]:
    frames: list[Frame] = []
    try:
        async with asyncio.timeout(150):  # an emulated machine on a busy one
            while len(frames) < n:
                frames.append(await camera.frames.get())
    except TimeoutError as why:
        raise RuntimeError(f"{len(frames)} of {n} frames, {camera.down}, {camera.counters.as_dict()}") from why
    return frames


async def refusal(options: CameraOptions, size: Size) -> str:
    """Return the words in which a camera with these options is refused as wrong settings."""
    try:
        async with open_camera(options, size, SystemClock()) as camera:
            await camera.frames.get()
    except BadInput as why:
        return str(why)
    raise AssertionError("it is not refused")


def check_bars(frame: Frame, bars: ArrayLike, shape: tuple[int, int]) -> None:
    """Check that a frame of this height and width shows eight colour bars, BGR, to 4 grey values."""
    assert frame.px.shape == (*shape, 3), frame.px.shape
    shown = frame.px[shape[0] // 2 + 40, shape[1] // 16 :: shape[1] // 8].astype(int)
    assert np.abs(shown - bars).max() <= 4, shown.tolist()


def check_stamps(frames: list[Frame], counted: dict[str, int], since_ns: int) -> None:
    """Check that the kernel stamps frames on our clock; a stamp that cannot be is refused and counted."""
    sources = [frame.stamp.source for frame in frames]
    assert "kernel" in sources
    assert counted["stamps_refused"] == sources.count("arrival") == len(sources) - sources.count("kernel"), sources
    measured = [frame.stamp.measured_at for frame in frames]
    assert since_ns < min(measured) < max(measured) < time.monotonic_ns(), measured
