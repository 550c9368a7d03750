"""The driver on a USB camera: the kernel's own `uvcvideo`, with a device in software on the other end of the bus."""

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from fractions import Fraction
from functools import lru_cache
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera.exposure_law import ExposureGovernor
from drivers.camera.metering import TARGET, meter_inside
from drivers.camera.open_camera import open_camera
from drivers.camera.options import CameraOptions, ExposureOptions, Size
from drivers.camera.v4l2 import cameras
from drivers.clock import SystemClock
from qualification.v4l2_vm.capture import check_bars, check_stamps, controls_text, refusal, settled, take, until
from qualification.v4l2_vm.webcam import CARD, Format, Webcam

SMALL = (320, 240)
FORMATS = (Format("YUYV", (SMALL,)), Format("MJPG", (SMALL, (640, 480))), Format("H264", (SMALL,)))
BARS = np.array([(b, g, r) for g in (190, 0) for r in (190, 0) for b in (190, 0)], np.uint8)
GROUP = 10
"""Frames from one IDR to the next."""


class Faults:
    """Faults of the next frames, one each."""

    def __init__(self) -> None:
        self.next: list[str] = []

    def image(self, fourcc: str, size: tuple[int, int], n: int) -> tuple[bytes, bool] | None:
        whole = _encoded(fourcc, *size)
        data = whole[n % len(whole)]
        fault = self.next.pop(0) if self.next else ""
        if fault == "torn":
            return data[: len(data) // 2], False
        return None if fault == "left out" else (data, fault == "marked")


@lru_cache
def _encoded(fourcc: str, width: int, height: int) -> tuple[bytes, ...]:
    px = np.empty((height, width, 3), np.uint8)
    px[:] = np.repeat(BARS, width // 8, axis=0)
    if fourcc == "YUYV":
        return (cv2.cvtColor(px, cv2.COLOR_BGR2YUV_YUYV).tobytes(),)
    if fourcc == "MJPG":
        return (cv2.imencode(".jpg", px)[1].tobytes(),)
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt, codec.framerate = width, height, "yuv420p", Fraction(30)
    codec.options = {"preset": "ultrafast", "tune": "zerolatency", "x264-params": f"keyint={GROUP}:scenecut=0"}
    units = []
    for n in range(2 * GROUP):
        px[-16:, :] = 16 * (n % 16)  # something must move, or nothing is coded
        units += codec.encode(av.VideoFrame.from_ndarray(px, format="bgr24"))
    return tuple(bytes(unit) for unit in units + codec.encode(None))


def farthest_from_bars(px: NDArray[np.uint8]) -> int:
    """Grey values, over the middle of each bar but the lowest lines, where the coded frame moves."""
    middle = np.s_[: -px.shape[0] // 8, px.shape[1] // 16 :: px.shape[1] // 8]
    return int(np.abs(px[middle].astype(int) - BARS).max())


class Deck:
    """A pad with white paint on a deck, in a light that may change; the frames follow exposure and gain two frames later."""

    def __init__(self) -> None:
        self.light = 3.0
        """White paint at an exposure of 1 ms without gain, full scale is 1."""
        self.webcam: Webcam | None = None
        self._settings: deque[tuple[int, int]] = deque(maxlen=3)
        where = np.zeros((SMALL[1], SMALL[0]), np.intp)
        where[80:160, 100:220] = 1
        where[100:120, 120:200] = 2
        self._where = where

    def image(self, fourcc: str, size: tuple[int, int], n: int) -> tuple[bytes, bool]:
        self._settings.append((self.webcam.exposure.now, self.webcam.gain.now))
        units, gain = self._settings[0]
        white = self.light * 0.1 * units * (1.0 + gain / 16.0)
        grey = 255.0 * np.clip(white * np.array([0.05, 0.2, 1.0]), 0.0, 1.0) ** (1 / 2.2)
        luma = np.round(16.0 + grey * 219.0 / 255.0).astype(np.uint8)[self._where]
        return np.stack([luma, np.full_like(luma, 128)], axis=-1).tobytes(), False


@asynccontextmanager
async def plugged(deck: Deck | None = None) -> AsyncIterator[tuple[Webcam, Faults]]:
    faults = Faults()
    webcam = Webcam(FORMATS, faults.image if deck is None else deck.image)
    if deck is not None:
        deck.webcam = webcam
    webcam.plug()
    try:
        async with asyncio.timeout(20):
            await until(lambda: any(CARD in f.card for f in cameras()))
        yield webcam, faults
    finally:
        webcam.unplug()
        async with asyncio.timeout(20):
            await until(lambda: not any(CARD in f.card for f in cameras()))


def options(**more: Any) -> tuple[CameraOptions, Size]:
    usual = {"source": "v4l2", "device": "Webcam", "reconnect_first_s": 0.1, "reconnect_most_s": 0.4}
    size = more.pop("size", SMALL)
    return CameraOptions(**(usual | {"controls": controls_text(more.pop("controls", {}))} | more)), size


async def each_format_arrives_whole_and_stamped() -> None:
    async with plugged():
        cards = [f.card for f in cameras() if CARD in f.card]
        assert len(cards) == 2, "frames and metadata; a part of the name means the one with frames"
        for name in ("YUYV", "MJPG", "H264", "auto"):
            began = time.monotonic_ns()
            async with open_camera(*options(format=name), SystemClock()) as camera:
                frames = await take(camera, 12)
                counted = await settled(camera)
            check_bars(frames[-1], BARS, SMALL[::-1])
            check_stamps(frames, counted, began)
            assert counted["frames_damaged"] == 0
            by_kernel = [frame.stamp.measured_at for frame in frames if frame.stamp.source == "kernel"]
            # Where the machine stands still for seconds, a stamp is too old to be believed.
            assert len(by_kernel) >= len(frames) // 2
            assert by_kernel == sorted(set(by_kernel))
        async with open_camera(*options(size=(640, 480)), SystemClock()) as camera:
            check_bars((await take(camera, 3))[-1], BARS, (480, 640))


async def the_exposure_is_fixed_switch_first_and_travels_with_each_frame() -> None:
    async with plugged() as (webcam, _):
        fixed = {"exposure_time_absolute": 50, "auto_exposure": "Manual Mode", "gain": 33}
        async with open_camera(*options(controls=fixed), SystemClock()) as camera:
            frames = await take(camera, 3)
            assert (webcam.mode.now, webcam.exposure.now, frames[-1].exposure_s) == (1, 50, 0.005)
            await settled(camera)
        fixed = {"exposure_time_absolute": 60, "auto_exposure": "Aperture Priority Mode"}
        words = await refusal(*options(controls=fixed))
        assert "'exposure_time_absolute' cannot be set to 60 now" in words, words


async def a_damaged_image_is_counted_and_never_given_out() -> None:
    async with plugged() as (_, faults):
        for name in ("YUYV", "MJPG", "H264"):
            for fault in ("torn", "marked"):
                async with open_camera(*options(format=name), SystemClock()) as camera:
                    await take(camera, 3)
                    faults.next = [fault]
                    frames = await take(camera, 2 * GROUP)
                    counted = await settled(camera)
                assert max(farthest_from_bars(frame.px) for frame in frames) <= 6, (name, fault)
                # The kernel keeps back what it knows to be damaged, and its count of frames shows the gap.
                assert counted["frames_damaged"] + counted["frames_lost"] + counted["frames_overtaken"] >= 1, (name, fault)
                # What follows a lost frame cannot be read until one that stands alone.
                assert (counted["frames_waiting"] > 0) == (name == "H264"), (name, fault)


async def a_camera_pulled_out_comes_back_with_its_exposure() -> None:
    """It is unplugged while it streams, and returns as another node, with its controls as after a power-on."""
    async with plugged() as (webcam, _):
        fixed = {"auto_exposure": 1, "exposure_time_absolute": 50}
        async with open_camera(*options(format="MJPG", controls=fixed), SystemClock()) as camera:
            await take(camera, 3)
            webcam.unplug()
            began = time.monotonic()
            await until(lambda: camera.down is not None)
            assert time.monotonic() - began < 1.5
            assert "it was unplugged" in (camera.down or "")
            webcam.reset()
            webcam.plug()
            async with asyncio.timeout(20):
                await until(lambda: camera.down is None)
            frames = await take(camera, 4)
            check_bars(frames[-1], BARS, SMALL[::-1])
            assert (webcam.exposure.now, frames[-1].exposure_s) == (50, 0.005)
            assert (await settled(camera))["restarts.unplugged"] == 1


async def a_driven_exposure_brings_the_pad_to_its_level_and_a_refused_one_ends_nothing() -> None:
    """The light falls to a thirtieth; then the picture moves; then the camera refuses."""
    deck, outline = Deck(), np.array([(100.0, 80.0), (219.0, 80.0), (219.0, 159.0), (100.0, 159.0)])
    async with plugged(deck) as (webcam, _):
        driven = ExposureOptions(mode="pad", gain_ratio=8.0)
        async with open_camera(*options(format="YUYV", exposure=driven, silence_s=10.0), SystemClock()) as camera:
            drive = camera.exposure
            assert drive is not None
            governor = ExposureGovernor(driven, drive)

            async def watch(frames: int, speed_px_s: float) -> tuple[float, float]:
                """Return exposure and gain at the end; the pad has come to its level by then."""
                levels: list[float] = []
                for _ in range(frames):
                    frame = await camera.frames.get()
                    governor.on_frame(frame, outline, speed_px_s)
                    seen = meter_inside(frame.px, outline)
                    levels.append(0.0 if seen is None else seen.level)
                assert all(0.4 * TARGET < level < 1.4 * TARGET for level in levels[-10:]), levels
                assert (webcam.mode.now, webcam.auto_balance.now, webcam.balance.now) == (1, 0, 6500)
                held_s, gain = drive.held.exposure_s, drive.held.gain
                assert abs(held_s - 1e-4 * webcam.exposure.now) < 1e-9
                assert (frame.exposure_s, frame.gain) == (held_s, gain)
                return held_s, gain

            bright_s, _ = await watch(60, 0.0)
            deck.light /= 30.0
            dark_s, gain = await watch(60, 0.0)
            moving_s, _ = await watch(40, 500.0)
            assert dark_s * gain > 10 * bright_s
            assert moving_s <= 1.5 / 500.0 < dark_s
            webcam.stubborn = True
            deck.light *= 30.0
            for _ in range(20):
                governor.on_frame(await camera.frames.get(), outline, 0.0)
            assert drive.refused >= 1
            assert drive.why_refused
            await settled(camera)


SCENES = (
    each_format_arrives_whole_and_stamped, the_exposure_is_fixed_switch_first_and_travels_with_each_frame,
    a_damaged_image_is_counted_and_never_given_out, a_camera_pulled_out_comes_back_with_its_exposure,
    a_driven_exposure_brings_the_pad_to_its_level_and_a_refused_one_ends_nothing,
)  # fmt: skip
