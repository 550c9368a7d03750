"""Read frames from a V4L2 camera: the kernel stamps them, one worker thread decodes them, and only the newest is kept.

Source for the meaning of buffers: Linux media documentation, struct v4l2_buffer (flags, timestamp, sequence).
"""

from __future__ import annotations

import asyncio
import errno
import logging
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from drivers.camera.exposure_setter import ExposureSetter
from drivers.camera.images import claimed_size
from drivers.camera.options import CameraOptions, Size, check_size
from drivers.camera.source import CameraLost, VideoSource
from drivers.camera.stamping import stamp_of
from drivers.camera.v4l2_device import Buffer, Device, KernelDevice
from drivers.camera.v4l2_formats import FrameLayout, H264Decoder, to_bgr
from drivers.camera.v4l2_names import cameras, find
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp

log = logging.getLogger(__name__)

_WRAP = 1 << 32

OpenDevice = Callable[[str, CameraOptions, Size], Device]


class V4l2Channel:
    """One run from opening to unplugging; run it again after that."""

    def __init__(
        self, options: CameraOptions, size: Size, clock: Clock, camera: VideoSource, open_device: OpenDevice = KernelDevice
    ) -> None:
        self._o = options
        self._size = check_size(size)
        self._clock = clock
        self._camera = camera
        self._open = open_device
        self._h264 = H264Decoder()

    async def run(self) -> None:
        """Read frames until the camera is gone or silent.

        Raises:
            CameraLost: the camera is absent, unplugged or silent.
            BadInput, SetupImpossible: raised as by `KernelDevice`.
        """
        loop = asyncio.get_running_loop()
        self._h264.broken()
        with ThreadPoolExecutor(1, "v4l2") as pool:
            opening = loop.run_in_executor(pool, self._opened)
            try:
                device = await asyncio.shield(opening)
            except asyncio.CancelledError:
                if not isinstance(opened := (await asyncio.gather(opening, return_exceptions=True))[0], BaseException):
                    opened.close()
                raise
            control = ExposureSetter(device, self._camera.exposure)
            try:
                self._camera.down = None
                await self._watch(device, pool, control)
            finally:
                await asyncio.shield(control.close())
                # A buffer still being decoded was copied out, so the device may go at once; its closing may block for long.
                await asyncio.shield(loop.run_in_executor(pool, device.close))

    def _opened(self) -> Device:
        name = self._o.device
        path = find(name, cameras())
        if path is None:
            there = ", ".join(str(c.path) for c in cameras())
            raise CameraLost("absent", f"{name}: no such camera; there is {there or 'none at all'}")
        try:
            return self._open(str(path), self._o, self._size)
        except OSError as why:
            gone = why.errno in (errno.ENODEV, errno.ENOENT, errno.ENXIO)
            raise CameraLost("absent" if gone else "failed", f"{name}: {why.strerror or why}") from why

    async def _watch(self, device: Device, pool: ThreadPoolExecutor, control: ExposureSetter) -> None:
        loop = asyncio.get_running_loop()
        counters = self._camera.counters
        last: int | None = None
        while True:
            received_at = await self._readable(device)
            batch = self._drain(device)
            counters.buffers += len(batch)
            gap = 0
            for buffer in batch:
                if last is not None:
                    missed = (buffer.sequence - last - 1) % _WRAP
                    gap += missed if missed < _WRAP // 2 else 0
                last = buffer.sequence
            counters.frames_lost += gap
            if last is not None:
                control.tend(last)
            if not batch:
                continue
            seen = await loop.run_in_executor(pool, self._newest, device, batch, gap > 0)
            if seen is None:
                continue
            buffer, px = seen
            exposure_s = self._o.exposure_s if device.exposure_s is None else device.exposure_s
            gain, error_s = 0.0, 0.0
            if (driven := control.of(buffer.sequence)) is not None:
                (exposure_s, gain), error_s = (driven[0].exposure_s, driven[0].gain), driven[1]
            stamp, refused = kernel_stamp(buffer, received_at, self._o, exposure_s, 0.5 * error_s)
            counters.stamps_refused += refused
            counters.frames += 1
            frame = Frame(stamp, buffer.sequence, px, exposure_s, gain, device.layout.format == "H264")
            counters.frames_replaced += self._camera.frames.offer(frame) is not None

    async def _readable(self, device: Device) -> MonoNs:
        """Wait until the device is readable and return that instant."""
        loop = asyncio.get_running_loop()
        ready: asyncio.Future[MonoNs] = loop.create_future()
        fd = device.fileno()
        # The reader is level-triggered: left in place it would spin while a frame is being decoded.
        loop.add_reader(fd, lambda: None if ready.done() else ready.set_result(self._clock.now()))
        try:
            async with asyncio.timeout(self._o.silence_s):
                return await ready
        except TimeoutError as why:
            raise CameraLost("silent", f"{self._o.device}: no frame for {self._o.silence_s:g} s") from why
        finally:
            loop.remove_reader(fd)

    def _drain(self, device: Device) -> list[Buffer]:
        batch: list[Buffer] = []
        try:
            while len(batch) < self._o.buffers and (buffer := device.dequeue()) is not None:
                batch.append(buffer)
        except OSError as why:
            raise CameraLost("unplugged", f"{self._o.device}: {why.strerror or why}") from why
        return batch

    def _newest(self, device: Device, batch: Sequence[Buffer], gap: bool) -> tuple[Buffer, NDArray[np.uint8]] | None:
        if device.layout.format == "H264":
            return self._newest_h264(device, batch, gap)
        counters = self._camera.counters
        good = [buffer for buffer in batch if buffer.data and not buffer.error]
        counters.frames_damaged += len(batch) - len(good)
        while good:
            buffer = good.pop()
            px = to_bgr(buffer.data, device.layout)
            if px is not None:
                counters.frames_overtaken += len(good)
                return buffer, px
            counters.frames_damaged += 1
            self._note_size(buffer.data, device.layout)
        return None

    def _note_size(self, data: bytes, layout: FrameLayout) -> None:
        """Count a JPEG of another size than was agreed, and log the first."""
        claimed = claimed_size(data) if layout.format == "MJPG" else None
        if claimed is None or claimed == (layout.width, layout.height):
            return
        self._camera.counters.frames_wrong_size += 1
        if self._camera.counters.frames_wrong_size == 1:
            log.warning(
                "%s: an image claims %dx%d px in place of %dx%d: such ones are not decoded, and counted",
                self._o.device, *claimed, layout.width, layout.height,
            )  # fmt: skip

    def _newest_h264(self, device: Device, batch: Sequence[Buffer], gap: bool) -> tuple[Buffer, NDArray[np.uint8]] | None:
        counters, decoder = self._camera.counters, self._h264
        if gap:
            decoder.broken()
        seen: tuple[Buffer, NDArray[np.uint8]] | None = None
        for buffer in batch:
            if buffer.error:
                decoder.broken()
            waited = decoder.waiting
            px = None if buffer.error else decoder.decode(buffer.data, device.layout)
            if px is not None:
                counters.frames_overtaken += seen is not None
                seen = buffer, px
            elif waited and decoder.waiting and not buffer.error:
                counters.frames_waiting += 1
            else:
                counters.frames_damaged += 1
        return seen


def kernel_stamp(
    buffer: Buffer, received_at: MonoNs, options: CameraOptions, exposure_s: float, error_s: float = 0.0
) -> tuple[Stamp, bool]:
    """Return the stamp of mid-exposure, and whether the kernel's stamp had to be refused.

    A stamp of the start of the exposure lies half an exposure before its middle, one of the end of the transfer half an exposure
    after it.

    Args:
        error_s: largest error of mid-exposure for want of a better known exposure time, s.
    """
    half_s = 0.5 * exposure_s if buffer.at_start else -0.5 * exposure_s
    return stamp_of(MonoNs(buffer.stamp_ns) if buffer.monotonic else None, half_s, received_at, options, exposure_s, error_s)
