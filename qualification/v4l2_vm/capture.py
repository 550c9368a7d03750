"""Shared steps of the guest's scenes: take frames, and report them and the counters."""

import asyncio
from collections.abc import Callable
from typing import Any

from drivers.camera.source import VideoSource
from estimator.contracts.samples import Frame

Seen = dict[str, Any]


def controls_text(values: dict[str, int | bool | str]) -> str:
    """Return controls as the key `controls` has them."""
    return ", ".join(f"{name}={str(value).lower() if isinstance(value, bool) else value}" for name, value in values.items())


def accounted(counters: Seen) -> bool:
    """Return whether every buffer ended in exactly one verdict."""
    parts = ("frames", "frames_overtaken", "frames_damaged", "frames_waiting")
    return bool(counters["buffers"] == sum(counters[part] for part in parts) > 0)


async def until(true: Callable[[], bool]) -> None:
    while not true():  # noqa: ASYNC110
        await asyncio.sleep(0.02)


async def settled(camera: VideoSource) -> Seen:
    """Return the counters between two frames: a buffer still being decoded has no verdict yet."""
    for _ in range(200):
        counted = camera.counters.as_dict()
        if accounted(counted):
            break
        await asyncio.sleep(0.01)
    return counted


async def take(camera: VideoSource, n: int) -> list[Frame]:
    frames: list[Frame] = []
    try:
        async with asyncio.timeout(150):  # an emulated machine on a busy one
            while len(frames) < n:
                frames.append(await camera.frames.get())
    except TimeoutError as why:
        raise RuntimeError(f"{len(frames)} of {n} frames, {camera.down}, {camera.counters.as_dict()}") from why
    return frames


def describe(frames: list[Frame]) -> Seen:
    px = frames[-1].px
    bars = [px[px.shape[0] // 2 + 40, int((i + 0.5) * px.shape[1] / 8)].tolist() for i in range(8)]
    return {
        "shape": list(px.shape),
        "bars_bgr": bars,
        "source": [f.stamp.source for f in frames],
        "delay_s": [round(f.stamp.delay_s, 6) for f in frames],
        "sigma_s": frames[-1].stamp.sigma_s,
        "taken": [f.stamp.measured_at for f in frames],
        "seq": [f.seq for f in frames],
        "exposure_s": frames[-1].exposure_s,
    }
