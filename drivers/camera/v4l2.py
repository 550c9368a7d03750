"""Find V4L2 cameras, read frames from one, and set its exposure.

The kernel stamps the frames, and only the newest is kept. One worker thread decodes those that are packed or large, and another
one sets the exposure, so that a slow bus never holds up frames. Device numbers change with each boot and each plug; names do not.

Source for the meaning of buffers: Linux media documentation, struct v4l2_buffer (flags, timestamp, sequence).
"""

import asyncio
import errno
import logging
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from drivers.camera.exposure import ExposureDrive, ExposureSetting
from drivers.camera.images import claimed_size
from drivers.camera.options import CameraOptions, Size, check_size
from drivers.camera.source import CameraLost, VideoSource, stamp_of
from drivers.camera.v4l2_device import Buffer, KernelDevice
from drivers.camera.v4l2_frames import FrameLayout, H264Decoder, to_bgr
from drivers.device_errors import device_fault
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Frame
from estimator.contracts.time import Clock, MonoNs, Stamp

log = logging.getLogger(__name__)

BY_NAME = (Path("/dev/v4l/by-id"), Path("/dev/v4l/by-path"))
SYSFS = Path("/sys/class/video4linux")
_WRAP = 1 << 32  # frames are counted modulo this number
_UNPACKED = ("YUYV", "NV12", "GREY")
"""Formats whose small frames are decoded sooner than a thread for it begins."""
_SMALL_PX = 640 * 480  # pixels of the largest such frame


class CaptureDevice(Struct, frozen=True):
    """A capture device of this machine."""

    path: Path
    """The most stable path that exists: by-id, by-path, else /dev/videoN."""
    node: Path
    """The present device node /dev/videoN."""
    card: str
    """The name that the kernel driver gives the device."""
    body: Path
    """The hardware device in sysfs, which may have several nodes."""
    index: int = 0
    """The index among the nodes of one hardware device: the first gives frames, a second often metadata."""


def cameras(by_name: tuple[Path, ...] = BY_NAME, sysfs: Path = SYSFS, dev: Path = Path("/dev")) -> list[CaptureDevice]:
    """Return every video device with its most stable path, in order of that path.

    A device may be plugged out while it is read: what is gone by then counts as absent.
    """
    stable: dict[Path, Path] = {}
    for folder in reversed(by_name):
        for link in _entries(folder):
            if (node := _resolved(link)) is not None:
                stable[node] = link
    found = []
    for entry in _entries(sysfs):
        if not entry.name.startswith("video"):
            continue
        node, body = dev / entry.name, _resolved(entry / "device") or entry
        found.append(CaptureDevice(stable.get(node, node), node, _text(entry / "name"), body, int(_text(entry / "index") or 0)))
    return sorted(found, key=lambda f: str(f.path))


def find(text: str, there: list[CaptureDevice]) -> Path | None:
    """Return the path that `text` means: itself if it is a path, else the one camera whose stable name or card contains it.

    If a camera has several nodes (many have one for frames and one for metadata) the first is returned.
    The result is None if there is no such camera at the moment.

    Raises:
        BadInput: more than one camera matches.
    """
    if "/" in text:
        path = Path(text)
        return path if path.exists() else None
    matches = [f for f in there if text.lower() in f.path.name.lower() or text.lower() in f.card.lower() or text == f.node.name]
    exact = [f for f in matches if text in (f.path.name, f.node.name)]
    matches = sorted(exact or matches, key=lambda f: f.index)
    if len({f.body for f in matches}) > 1:
        raise BadInput(f"camera {text!r} may be any of {', '.join(str(f.path) for f in matches)}; give more of its name")
    return matches[0].path if matches else None


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []


def _resolved(link: Path) -> Path | None:
    try:
        return link.resolve(strict=True)
    except OSError:
        return None


def _text(file: Path) -> str:
    try:
        return file.read_text().strip()
    except OSError:
        return ""


class ExposureSetter:
    """Applies the settings of `drive`, one at a time, from the device's opening to its closing.

    Args:
        drive: None for a camera that is not driven.
    """

    def __init__(self, device: KernelDevice, drive: ExposureDrive | None) -> None:
        self._driven, self._drive = device.driven, drive
        self._setting: asyncio.Future[ExposureSetting] | None = None
        self._asked_at = 0
        self._pool: ThreadPoolExecutor | None = None
        if self._driven is not None and drive is not None:
            self._pool = ThreadPoolExecutor(1, "v4l2-exposure")
            drive.opened(self._driven.can, self._driven.held)

    def tend(self, newest: int) -> None:
        """Take the result of a setting, and begin the next one; call it with each frame's number."""
        if self._driven is None or self._drive is None or self._pool is None:
            return
        if self._setting is not None:
            if not self._setting.done():
                return
            done, self._setting = self._setting, None
            if (why := done.exception()) is None:
                self._drive.changed(done.result(), self._asked_at, newest)
            elif isinstance(why, OSError):
                if self._drive.why_refused is None:
                    log.warning("the camera refuses an exposure: %s", why.strerror or why)
                self._drive.refuse(why.strerror or str(why))
            else:
                raise why
        wanted = self._drive.take()
        if wanted is not None:
            self._asked_at = newest
            self._setting = asyncio.get_running_loop().run_in_executor(self._pool, self._driven.set, wanted)

    def of(self, number: int) -> tuple[ExposureSetting, float] | None:
        """Return the setting with which a frame was taken, and the largest error of its exposure time, s; None if not driven."""
        return None if self._drive is None else self._drive.of(number)

    async def close(self) -> None:
        """Wait for a setting that is under way; the device may be closed then."""
        if self._setting is not None:
            await asyncio.gather(self._setting, return_exceptions=True)
            self._setting = None
        if self._pool is not None:
            self._pool.shutdown()
        if self._drive is not None:
            self._drive.closed()


OpenDevice = Callable[[str, CameraOptions, Size], KernelDevice]


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

    def _opened(self) -> KernelDevice:
        name = self._o.device
        path = find(name, cameras())
        if path is None:
            there = ", ".join(str(c.path) for c in cameras())
            raise CameraLost("absent", f"{name}: no such camera; there is {there or 'none at all'}")
        try:
            return self._open(str(path), self._o, self._size)
        except OSError as why:
            gone = why.errno in (errno.ENODEV, errno.ENOENT, errno.ENXIO)
            raise CameraLost("absent" if gone else "failed", f"{name}: {device_fault(why, 'camera')}") from why

    async def _watch(self, device: KernelDevice, pool: ThreadPoolExecutor, control: ExposureSetter) -> None:
        loop = asyncio.get_running_loop()
        counters = self._camera.counters
        last: int | None = None
        while True:
            received_at = await self._readable(device)
            batch = self._drain(device)
            counters.buffers += len(batch)
            self._camera.count_damage(self._o.device, received_at)
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
            at_once = device.layout.format in _UNPACKED and device.layout.width * device.layout.height <= _SMALL_PX
            decoding = partial(self._newest, device, batch, gap > 0)
            seen = decoding() if at_once else await loop.run_in_executor(pool, decoding)
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

    async def _readable(self, device: KernelDevice) -> MonoNs:
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

    def _drain(self, device: KernelDevice) -> list[Buffer]:
        batch: list[Buffer] = []
        try:
            while len(batch) < self._o.buffers and (buffer := device.dequeue()) is not None:
                batch.append(buffer)
        except OSError as why:
            raise CameraLost("unplugged", f"{self._o.device}: {device_fault(why, 'camera')}") from why
        return batch

    def _newest(self, device: KernelDevice, batch: Sequence[Buffer], gap: bool) -> tuple[Buffer, NDArray[np.uint8]] | None:
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

    def _newest_h264(self, device: KernelDevice, batch: Sequence[Buffer], gap: bool) -> tuple[Buffer, NDArray[np.uint8]] | None:
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
