"""Open and read one V4L2 capture device, and set its exposure.

A failing device raises `OSError`, a request that it cannot fulfil `BadInput`, and a file that is no camera `SetupImpossible`. The
controls of a driven exposure are found and taken over once, and then set.

Source: Linux media documentation, Camera Control Reference (exposure time in units of 100 us) and User Controls.
"""

import contextlib
import difflib
import errno
import math
import mmap
import os
from collections.abc import Mapping

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from drivers.camera import v4l2_kernel as kernel
from drivers.camera.exposure import FRAME_PART, ExposureRange, ExposureSetting
from drivers.camera.images import ImageRefused, decode
from drivers.camera.options import FORMATS, CameraOptions, ExposureOptions, Size
from drivers.camera.videos import most_pixels
from drivers.pyav import AccessUnitDecoder, has_pyav, whole
from estimator.contracts.errors import BadInput, SetupImpossible, refused

U8 = NDArray[np.uint8]


class FrameLayout(Struct, frozen=True):
    """The format of the frames that the device agreed to send."""

    format: str
    width: int
    height: int
    bytes_per_line: int
    """The length of an image line, bytes; 0 for compressed formats."""


def line_length(layout: FrameLayout) -> int:
    """Return the length of an image line, bytes; where a driver says 0, the lines follow one another without a gap.

    Raises:
        BadInput: the driver reports a line that is too short for the width.
    """
    w, even = layout.width, layout.width + layout.width % 2
    needed = {"YUYV": 2 * even, "NV12": even}.get(layout.format, w)
    stride = layout.bytes_per_line or needed
    if stride < (needed if layout.format == "YUYV" else w):
        raise BadInput(
            f"the camera's driver says that a line of {w} px in {layout.format} takes {stride} bytes, but it takes {needed}: "
            "choose another camera.format or size, or another driver"
        )
    return stride


def to_bgr(data: bytes, layout: FrameLayout) -> U8 | None:
    """Decode one buffer of a format whose frames are independent to (H, W, 3) BGR; None if torn, damaged or of another size.

    YUYV and NV12 are read as BT.601 with studio swing, which webcams send and V4L2 assumes for standard definition. Their sizes
    may be odd.

    Raises:
        BadInput: the layout is none that can be; the device checks it when it is opened.
    """
    if layout.format == "MJPG":
        try:
            return decode(data, (layout.width, layout.height))
        except ImageRefused:
            return None
    w, h, stride = layout.width, layout.height, line_length(layout)
    rows = h + (h + 1) // 2 if layout.format == "NV12" else h
    if len(data) < rows * stride:
        return None
    lines = np.frombuffer(data, np.uint8, rows * stride).reshape(rows, stride)
    if layout.format == "YUYV":
        even = w + w % 2
        return _u8(cv2.cvtColor(lines[:, : 2 * even].reshape(h, even, 2), cv2.COLOR_YUV2BGR_YUYV)[:, :w])
    if layout.format == "NV12":
        return _u8(cv2.cvtColor(_even_planes(lines, w, h), cv2.COLOR_YUV2BGR_NV12)[:h, :w])
    return _u8(cv2.cvtColor(np.ascontiguousarray(lines[:, :w]), cv2.COLOR_GRAY2BGR))


def _even_planes(lines: U8, w: int, h: int) -> U8:
    """Return NV12's two planes with an even width and height, the last column and row of brightness twice."""
    even = min(w + w % 2, lines.shape[1])
    planes = lines[:, :even]
    if even % 2:
        planes = np.pad(planes, ((0, 0), (0, 1)), mode="edge")
        planes[h:, -1] = planes[h:, -3]  # the colours alternate
    if h % 2:
        planes = np.insert(planes, h, planes[h - 1], axis=0)
    return np.ascontiguousarray(planes)


def _u8(px: NDArray[np.generic]) -> U8:
    return np.asarray(px, dtype=np.uint8)


class H264Decoder:
    """Decodes access units in Annex B, in order. After damage everything is dropped up to the next IDR."""

    def __init__(self) -> None:
        self._codec: AccessUnitDecoder | None = None

    def broken(self) -> None:
        """Drop all units up to the next IDR, because units were lost."""
        self._codec = None

    @property
    def waiting(self) -> bool:
        """True if the decoder waits for an IDR."""
        return self._codec is None

    def decode(self, unit: bytes, layout: FrameLayout) -> U8 | None:
        """Decode one access unit to (H, W, 3) BGR; None while waiting for an IDR, or if the unit is damaged (then it waits).

        Raises:
            BadInput: PyAV is not installed.
        """
        size = layout.width, layout.height
        if self._codec is None:
            if not stands_alone(unit):
                return None
            self._codec = AccessUnitDecoder(
                "a camera that sends H.264", most_pixels(size), err_detect="explode", flags="low_delay"
            )
        image = whole(self._codec.decode(unit), size)
        if image is None:
            self._codec = None
            return None
        return _u8(image.to_ndarray(format="bgr24"))


def stands_alone(unit: bytes) -> bool:
    """Return whether an access unit holds an IDR slice (NAL type 5) and can be decoded without those before it."""
    at = unit.find(b"\0\0\1")
    while at != -1 and at + 3 < len(unit):
        if unit[at + 3] & 0x1F == 5:
            return True
        at = unit.find(b"\0\0\1", at + 3)
    return False


_MODE, _TIME, _PRIORITY = 0x009A0901, 0x009A0902, 0x009A0903
_AUTOGAIN, _GAINS = 0x00980912, (0x00980913, 0x009E0903)
_AUTO_WHITE_BALANCE, _TEMPERATURE = 0x0098090C, 0x0098091A
_MANUAL = 1
_UNIT_S = 100e-6


class KernelExposure:
    """The exposure of one open device.

    Args:
        fd: the open device.
        path: its name in errors.

    Raises:
        OSError: the device is gone.
        BadInput: it has no exposure time that can be set, or keeps its automatics.
    """

    def __init__(self, fd: int, path: str, options: ExposureOptions, rate_hz: float) -> None:
        self._fd, self._path = fd, path
        there = {control.id: control for control in kernel.controls(fd)}
        if _TIME not in there:
            raise BadInput(f'camera {path}: it has no exposure time that can be set; let camera.exposure.mode be "camera"')
        self._time = there[_TIME]
        self._gain = next((there[number] for number in _GAINS if number in there), None) if options.gain_ratio > 1.0 else None
        if self._gain is not None and self._gain.maximum <= self._gain.minimum:
            self._gain = None
        self._ratio = options.gain_ratio
        for number, value in ((_MODE, _MANUAL), (_PRIORITY, 0), (_AUTOGAIN, 0), (_AUTO_WHITE_BALANCE, 0)):
            if number in there:
                self._fix(there[number], value)
        if _TEMPERATURE in there:
            balance = there[_TEMPERATURE]
            nearest = min(max(options.white_balance_k, balance.minimum), balance.maximum)
            step = max(1, int(balance.step))
            self._fix(balance, balance.minimum + (nearest - balance.minimum) // step * step)
        longest_s = min(_UNIT_S * self._time.maximum, FRAME_PART / rate_hz)
        shortest_s = _UNIT_S * max(1, self._time.minimum)
        self.can = ExposureRange(shortest_s, max(longest_s, shortest_s), self._ratio if self._gain is not None else 1.0)
        try:
            self.held = self.set(self.can.split(self._time_s() * self._amplification(), self.can.longest_s))
        except OSError as why:
            if why.errno == errno.ENODEV:
                raise
            # A camera that is opened again in flight and refuses gives frames all the same.
            self.held = ExposureSetting(self._time_s(), self._amplification())

    def set(self, wanted: ExposureSetting) -> ExposureSetting:
        """Set the exposure, and return what the camera holds then. It may take as long as the device's bus does.

        Raises:
            OSError: the camera refuses it, or is gone.
        """
        # Downwards, because the time is a limit; the gain makes up for it.
        units = math.floor(wanted.exposure_s / _UNIT_S + 1e-6)
        step = max(1, int(self._time.step))
        low, high = int(self._time.minimum), int(self._time.maximum)
        units = min(max(low + (units - low) // step * step, low, 1), high)
        kernel.set_control(self._fd, _TIME, units, self._time.type)
        held_s = self._time_s()
        if self._gain is None:
            return ExposureSetting(held_s, 1.0)
        gain = min(max(wanted.product_s / held_s, 1.0), self._ratio)
        low, high = int(self._gain.minimum), int(self._gain.maximum)
        value = low + round((gain - 1.0) / (self._ratio - 1.0) * (high - low))
        kernel.set_control(self._fd, self._gain.id, value, self._gain.type)
        return ExposureSetting(held_s, self._amplification())

    def _time_s(self) -> float:
        return _UNIT_S * kernel.control_value(self._fd, _TIME, self._time.type)

    def _amplification(self) -> float:
        if self._gain is None:
            return 1.0
        value = kernel.control_value(self._fd, self._gain.id, self._gain.type)
        low, high = int(self._gain.minimum), int(self._gain.maximum)
        return 1.0 + (self._ratio - 1.0) * (value - low) / (high - low)

    def _fix(self, control: kernel.VideoControl, value: int) -> None:
        name = control.name.decode(errors="replace")
        try:
            kernel.set_control(self._fd, control.id, value, control.type)
            held = kernel.control_value(self._fd, control.id, control.type)
        except OSError as why:
            if why.errno == errno.ENODEV:
                raise
            raise BadInput(
                f'camera {self._path}: {name!r} cannot be set to {value} ({why.strerror}); let camera.exposure.mode be "camera"'
            ) from why
        if held != value:
            raise BadInput(
                f'camera {self._path}: {name!r} was set to {value} but holds {held}; let camera.exposure.mode be "camera"'
            )


_MANUAL_MODES = (1, 2)
"""The values of V4L2_CID_EXPOSURE_AUTO for manual, and for shutter priority, which fixes the time too."""
_NUMBERS = {kernel.INTEGER, kernel.INTEGER64}
_CHOICES = {kernel.BOOLEAN, kernel.MENU, kernel.INTEGER_MENU}


class Buffer(Struct, frozen=True):
    """A copy of one buffer of the kernel."""

    data: bytes
    sequence: int
    """The device's own count of frames."""
    stamp_ns: int
    monotonic: bool
    """True if `stamp_ns` is by CLOCK_MONOTONIC; otherwise its clock is not known."""
    at_start: bool
    """True if `stamp_ns` is the start of the exposure; otherwise it is the end of the transfer."""
    error: bool
    """True if the kernel reports damaged content."""


class KernelDevice:
    """An open device that has the options' settings and streams.

    Raises:
        OSError: it cannot be opened, is busy or went away.
        BadInput: it cannot do what the options request; the text lists what it can.
        SetupImpossible: permission is missing, or the device is not a camera.
    """

    def __init__(self, path: str, options: CameraOptions, size: Size) -> None:
        self._path = path
        self._maps: list[mmap.mmap] = []
        try:
            self._fd: int | None = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        except PermissionError as why:
            raise SetupImpossible(f"camera {path}: no permission; the user must be in the group that owns it (video)") from why
        try:
            self._check()
            self.layout, self.rate_hz = self._set_format(options, *size)
            self._set_controls(options.control_values())
            self.driven: KernelExposure | None = None
            """The exposure, where the options say that it is driven."""
            if options.exposure.driven:
                self.driven = KernelExposure(self.fileno(), path, options.exposure, self.rate_hz)
            self.exposure_s = self._exposure()
            self._stream(options.buffers)
        except BaseException:
            self.close()
            raise

    def fileno(self) -> int:
        if self._fd is None:
            raise OSError(errno.EBADF, "the camera is closed")
        return self._fd

    def dequeue(self) -> Buffer | None:
        """Return the oldest waiting buffer, None if none waits.

        Raises:
            OSError: the device is gone.
        """
        try:
            buff = kernel.dequeue(self.fileno())
        except BlockingIOError:
            return None
        if buff.index >= len(self._maps):
            raise OSError(errno.EIO, f"the driver gave buffer {buff.index} of {len(self._maps)}")
        try:
            data = self._maps[buff.index][: buff.bytesused]
        finally:
            kernel.enqueue(self.fileno(), buff.index)
        flags, stamp = int(buff.flags), buff.timestamp
        return Buffer(
            data,
            int(buff.sequence),
            stamp.secs * 1_000_000_000 + stamp.usecs * 1_000,
            flags & kernel.STAMP_MASK == kernel.STAMP_MONOTONIC,
            flags & kernel.SOURCE_MASK == kernel.SOURCE_START,
            bool(flags & kernel.FLAG_ERROR),
        )

    def close(self) -> None:
        if self._fd is None:
            return
        with contextlib.suppress(OSError):  # unplugged, or never begun
            kernel.stream(self._fd, on=False)
        for m in self._maps:
            m.close()
        self._maps = []
        fd, self._fd = self._fd, None
        os.close(fd)

    def _check(self) -> None:
        try:
            caps = kernel.capabilities(self.fileno())
        except OSError as why:
            if why.errno in (errno.ENOTTY, errno.EINVAL):
                raise SetupImpossible(f"camera {self._path}: not a video device") from why
            raise
        if not caps & kernel.CAP_CAPTURE or not caps & kernel.CAP_STREAMING:
            what = "only multi-planar" if caps & kernel.CAP_CAPTURE_MPLANE else "no"
            raise SetupImpossible(f"camera {self._path}: it offers {what} video capture (another node of it may)")

    def _set_format(self, o: CameraOptions, width: int, height: int) -> tuple[FrameLayout, float]:
        offered = dict.fromkeys(kernel.formats(self.fileno()))
        known = [f for f in FORMATS if f != "H264" or has_pyav()]
        wanted = [f for f in known if f in offered] if o.format == "auto" else [o.format] if o.format in offered else []
        if not wanted:
            asked = f"none of {', '.join(FORMATS)}" if o.format == "auto" else f"no {o.format}"
            raise BadInput(f"camera {self._path}: it offers {asked}; it has {', '.join(offered) or 'nothing'}")
        best: tuple[float, str] | None = None
        sizes = []
        for name in wanted:
            layout, rate_hz = self._try(name, width, height, o.rate_hz)
            if (layout.format, layout.width, layout.height) != (name, width, height):
                sizes.append(f"{layout.width}x{layout.height} ({name})")
                continue
            with refused(f"camera {self._path}", BadInput):
                line_length(layout)
            if rate_hz >= 0.9 * o.rate_hz:
                return layout, rate_hz
            if best is None or rate_hz > best[0]:
                best = rate_hz, name
        if best is None:
            raise BadInput(f"camera {self._path}: no frame of {width}x{height} px; the nearest is {', '.join(sizes)}")
        return self._try(best[1], width, height, o.rate_hz)

    def _try(self, name: str, width: int, height: int, asked_hz: float) -> tuple[FrameLayout, float]:
        got = kernel.set_format(self.fileno(), name, width, height)
        if order := kernel.INTERLACED.get(got.field):
            raise BadInput(
                f"camera {self._path}: its pictures are of two instants (field order: {order}), and a pad in motion is torn into "
                "combs: set the receiver or the camera to progressive pictures, or take a camera that has them"
            )
        try:
            rate_hz = kernel.set_rate(self.fileno(), asked_hz)
        except OSError as why:
            if why.errno not in (errno.ENOTTY, errno.EINVAL):
                raise
            rate_hz = None
        layout = FrameLayout(kernel.fourcc(got.pixelformat), int(got.width), int(got.height), int(got.bytesperline))
        return layout, asked_hz if rate_hz is None else rate_hz

    def _controls(self) -> dict[str, kernel.VideoControl]:
        return {_control_name(c.name.decode(errors="replace")): c for c in kernel.controls(self.fileno())}

    def _set_controls(self, wanted: Mapping[str, int | bool | str]) -> None:
        there = self._controls() if wanted else {}
        for name in wanted:
            if name not in there:
                near = difflib.get_close_matches(name, there, n=3) or sorted(there)
                raise BadInput(f"camera {self._path}: no control {name!r}; it has {', '.join(near)}")
        # Switches first: while a camera governs its exposure itself, it refuses or forgets a time that is set.
        for name in sorted(wanted, key=lambda n: there[n].type not in _CHOICES):
            self._set_control(name, there[name], wanted[name])

    def _set_control(self, name: str, control: kernel.VideoControl, value: int | bool | str) -> None:
        if control.type == kernel.BUTTON:
            raise BadInput(f"camera {self._path}: control {name!r} is a button and holds no value")
        if control.type not in _NUMBERS | _CHOICES:
            raise BadInput(f"camera {self._path}: control {name!r} is of a kind that cannot be set here")
        number = self._menu(name, control, value) if isinstance(value, str) else int(value)
        low, high = int(control.minimum), int(control.maximum)
        if not low <= number <= high:
            raise BadInput(f"camera {self._path}: control {name!r} must lie in {low}..{high}, got {value!r}")
        try:
            kernel.set_control(self.fileno(), control.id, number, control.type)
            held = kernel.control_value(self.fileno(), control.id, control.type)
        except OSError as why:
            if why.errno == errno.ENODEV:
                raise
            raise BadInput(f"camera {self._path}: control {name!r} cannot be set to {value!r} now ({why.strerror})") from why
        if abs(held - number) >= max(1, int(control.step)):
            raise BadInput(f"camera {self._path}: control {name!r} was set to {number} but holds {held}")

    def _menu(self, name: str, control: kernel.VideoControl, label: str) -> int:
        entries = kernel.menu(self.fileno(), control) if control.type == kernel.MENU else {}
        for entry, number in entries.items():
            if entry.lower() == label.lower():
                return number
        known = f"one of {', '.join(map(repr, entries))}" if entries else "a number"
        raise BadInput(f"camera {self._path}: control {name!r} must be {known}, got {label!r}")

    def _exposure(self) -> float | None:
        """Return the exposure in seconds; None unless the camera holds it fixed and reports it."""
        try:
            if kernel.control_value(self.fileno(), _MODE) not in _MANUAL_MODES:
                return None
            return kernel.control_value(self.fileno(), _TIME) * _UNIT_S
        except OSError:
            return None

    def _stream(self, count: int) -> None:
        granted = kernel.request_buffers(self.fileno(), count)
        for index in range(granted):
            length, offset = kernel.query_buffer(self.fileno(), index)
            self._maps.append(mmap.mmap(self.fileno(), length, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE, offset=offset))
            kernel.enqueue(self.fileno(), index)
        kernel.stream(self.fileno(), on=True)


def _control_name(text: str) -> str:
    """Return the control's name as v4l2-ctl writes it: lower case, one underscore for each run of other characters."""
    return "_".join("".join(c if c.isalnum() else " " for c in text.lower()).split())
